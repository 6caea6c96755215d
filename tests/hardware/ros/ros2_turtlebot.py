"""The emulated TurtleBot as a node of a real ROS 2 graph: `python ros2_turtlebot.py FILE_DESCRIPTOR`."""

import sys
from multiprocessing.connection import Connection

from emulated import PRESET, make_robot, orders

from tfg_drake.hardware.emulation.emulated_turtlebot import Ros2Emulator

connection, robot = Connection(int(sys.argv[1])), make_robot()
emulator = Ros2Emulator(robot, PRESET)
connection.send(None)
emulator.run(orders(robot, connection))

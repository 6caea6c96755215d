"""The emulated TurtleBot of these tests, in the scenario `house`, without noise, and what a test may order."""

import math
import time

from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.emulation.emulated_turtlebot import EmulatedTurtlebot
from tfg_drake.hardware.ros.preset import load_preset

PRESET = load_preset("emulated")


def make_robot():
    """A full circle of one ray a degree; tags up to 5 m."""
    scan = ScanConfig(field_of_view=2.0 * math.pi, resolution=math.pi / 180.0)
    world = MakeWorld(LoadScenario("house").world)
    return EmulatedTurtlebot(world, PRESET, TagSensorConfig(range=5.0), scan, OdometryConfig())


def orders(robot, connection, more=None):
    """For EmulatedTurtlebot.run: obeys what the test says until it lets go.

    ("silent", topic keys), ("jump", s), ("report", None), ("moved", None), ("stands", time, s) and those of `more`,
    functions by name. The answer is the report, when it was last told to move, since when it has been told to stand
    after that time, what the function returns, or the time, s.
    """

    def last_motion():
        return next((t for t, v, w in reversed(robot.commands) if v or w), -math.inf)

    def go_on():
        while connection.poll():
            try:
                name, value = connection.recv()
            except EOFError:
                return False
            answer = time.monotonic()
            if name == "silent":
                robot.silent = set(value)
            elif name == "jump":
                robot.clock += value
            elif name == "report":
                answer = {"commands": list(robot.commands), "poses": list(robot.poses)}
            elif name == "moved":
                answer = last_motion()
            elif name == "stands":
                after = max(value, last_motion())
                answer = min((t for t, v, w in robot.commands if not (v or w) and t > after), default=math.inf)
            else:
                answer = more[name]() or answer
            connection.send(answer)
        return True

    return go_on

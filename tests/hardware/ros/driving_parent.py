"""A program that drives the robot for ever, to be killed or frozen: `python driving_parent.py TRANSPORT [PORT]`."""

import contextlib
import sys
import time

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.preset import load_preset

preset = load_preset("emulated")
if sys.argv[1] == "ros2":
    from tfg_drake.hardware.ros.ros2 import connect

    device = connect(preset)
else:
    from tfg_drake.hardware.ros.rosbridge import connect

    device = connect(preset, port=int(sys.argv[2]))
while True:
    # On a loaded machine odometry may pause: a robot without any is not enabled, or locked again.
    if device.locked:
        with contextlib.suppress(DeviceError):
            device.enable()
    device.command(0.0, 0.5)
    time.sleep(0.02)

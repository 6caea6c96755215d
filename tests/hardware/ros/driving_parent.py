"""A program that drives the robot for ever, to be killed or frozen: `python driving_parent.py [HOST PORT]`."""

import contextlib
import sys
import time

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.graph_driver import connect
from tfg_drake.hardware.ros.preset import load_preset

host, port = sys.argv[1:] or ("", 0)
device = connect(load_preset("emulated"), host, int(port))
while True:
    # On a loaded machine odometry may pause: a robot without any is not enabled, or locked again.
    if device.locked:
        with contextlib.suppress(DeviceError):
            device.enable()
    device.command(0.0, 0.5)
    time.sleep(0.02)

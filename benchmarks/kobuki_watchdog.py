"""How soon the Kobuki's wheels are told to stop when something goes wrong, measured at an emulated base.

python benchmarks/kobuki_watchdog.py
python benchmarks/kobuki_watchdog.py --trials 50

The time from what went wrong to the first stop that only stops follow, as the emulator read it, every 20 ms: until then
the base drives on.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

from tfg_drake.hardware.device import Device
from tfg_drake.hardware.emulation.emulator import Emulator
from tfg_drake.hardware.kobuki.driver import connect
from tfg_drake.hardware.kobuki.payloads import BaseControl

_STOP = BaseControl(0, 0)
_PARENT = """
import sys, time
from tfg_drake.hardware.kobuki.driver import connect
device = connect(sys.argv[1])
device.enable()
while True:
    device.command(0.2, 0.0)
    time.sleep(0.02)
"""
# Motion this long after what went wrong has no end, and a stop that has lasted so long is one, s.
_AT_MOST, _AFTERWARDS = 3.0, 0.4


def stopped_after(emulator: Emulator, begin: float) -> float:
    """Time from begin to the first stop after which nothing else is said, s; inf where motion does not end."""
    stopped = math.inf
    while time.monotonic() < min(stopped, begin + _AT_MOST) + _AFTERWARDS:
        time.sleep(0.02)
        stopped = math.inf
        for when, what in list(emulator.commands):
            stopped = min(stopped, when) if what == _STOP else math.inf
    return max(0.0, stopped - begin)


def of_parent(how: signal.Signals) -> float:
    """A parent in a process of its own gets a signal while it drives."""
    with Emulator() as emulator:
        parent = subprocess.Popen([sys.executable, "-c", _PARENT, emulator.device])
        while not emulator.commands or emulator.commands[-1][1] == _STOP:
            time.sleep(0.01)
        begin = time.monotonic()
        parent.send_signal(how)
        after = stopped_after(emulator, begin)
        parent.kill()
        parent.wait()
    return after


def of_device(fault: Callable[[Emulator, Device], None]) -> float:
    """Something happens while this process drives."""
    with Emulator() as emulator, connect(emulator.device) as device:
        device.enable()
        _drive(device, 0.3)
        begin = time.monotonic()
        fault(emulator, device)
        return stopped_after(emulator, begin)


def _drive(device: Device, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        device.command(0.2, 0.0)
        time.sleep(0.02)


def _silence(emulator: Emulator, device: Device) -> None:
    emulator.silent = True
    _drive(device, 0.8)


def _hanging_wheel(emulator: Emulator, device: Device) -> None:
    emulator.base.wheel_drop = 1
    _drive(device, 0.3)


def _bumper(emulator: Emulator, device: Device) -> None:
    emulator.base.bumper = 2
    _drive(device, 0.3)


def _signal(number: signal.Signals) -> Callable[[Emulator, Device], None]:
    return lambda _, device: os.kill(device.process_id, number)


FAULTS: dict[str, Callable[[], float]] = {
    "parent killed (-9)": lambda: of_parent(signal.SIGKILL),
    "parent stopped (SIGSTOP)": lambda: of_parent(signal.SIGSTOP),
    "no more commands": lambda: of_device(lambda _, __: None),
    "command NaN": lambda: of_device(lambda _, device: device.command(math.nan, 0.0)),
    "base silent, commands go on": lambda: of_device(_silence),
    "wheel hangs, commands go on": lambda: of_device(_hanging_wheel),
    "bumper, forward commands go on": lambda: of_device(_bumper),
    "SIGTERM to the driver": lambda: of_device(_signal(signal.SIGTERM)),
    "driver killed (-9)": lambda: of_device(_signal(signal.SIGKILL)),
    "driver stopped (SIGSTOP)": lambda: of_device(_signal(signal.SIGSTOP)),
    "device closed": lambda: of_device(lambda _, device: device.close()),
}


def main() -> None:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10)
    options = parser.parse_args()
    print(f"{'what':<32}{'median, s':>10}{'worst, s':>10}")
    for name, trial in FAULTS.items():
        times = [trial() for _ in range(options.trials)]
        print(f"{name:<32}{statistics.median(times):>10.3f}{max(times):>10.3f}", flush=True)


if __name__ == "__main__":
    main()

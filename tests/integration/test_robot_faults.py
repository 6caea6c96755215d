"""What goes wrong in the middle of a mission on an emulated robot, in real time: the wheels are told to stand where
that is due, the operator is told, nothing moves before it is due, and the mission goes on."""

import contextlib
import dataclasses
import os
import re
import signal
import subprocess
import time

import pytest

from tests.integration.robot_explorer import Explorer, moves, wait_until
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.emulation.emulator import Emulator, order
from tfg_drake.hardware.emulation.sensor_faults import sensor_fault
from tfg_drake.hardware.kobuki.odometry import velocity

pytestmark = pytest.mark.slow
# The house takes longer, s, than a mission that drives: one that does not is stuck.
PATIENCE = 90.0
# How long nothing may move where it must be enabled anew, s.
QUIET = 2.0


@dataclasses.dataclass(frozen=True)
class Fault:
    """wrong, mend: lines of docs/kobuki_emulator.md, or a sensor and what is wrong with it, or a signal to a process.
    stands: what must stand, "all", "ahead" (no way forward) or "". anew: it must be enabled anew. told: the operator
    is told."""

    wrong: str | tuple
    mend: str = ""
    stands: str = "all"
    anew: bool = True
    told: bool = True


def scan(*fault):
    return Fault(("scan", *fault), stands="ahead", anew=False)


def nonsense(*fault, told=True):
    return Fault(fault, stands="", anew=False, told=told)


FAULTS = {
    "no answer": scan("nan"),
    "nothing near": scan("empty"),
    "no rays": scan("none"),
    "one ray in a hundred": scan("thin"),
    "frozen": scan("frozen"),
    "silent": scan("silent"),
    "blind near by": nonsense("scan", "blind", 0.45, told=False),
    "a fifth of the rays lost": nonsense("scan", "drop", 0.2, told=False),
    "an endless range": nonsense("scan", "range_max", 1e300),
    "tags too far": nonsense("tags", "range", 1e200),
    "ids of any size": nonsense("tags", "id", 2.0**56),
    "ids that might be": Fault(("tags", "random"), anew=False),
    "no tags": Fault(("tags", "silent"), anew=False),
    "dock": Fault("dock", "undock"),
    "overcurrent": Fault("overcurrent both", "overcurrent none"),
    "bumper": Fault("press bumper centre", "release bumper centre", stands="ahead", anew=False),
    "cliff": Fault("open cliff centre", "close cliff centre"),
    "wheel drop": Fault("drop wheel", "raise wheel"),
    "corrupt frames": Fault("corrupt 0.3", "corrupt 0", stands="", anew=False),
    "clock set back": Fault("clock -2", "clock 2"),
    "silent base": Fault("silent on", "silent off"),
    "stuck encoders": Fault("stick encoders", "free encoders"),
    "sensors killed": Fault((signal.SIGKILL, "sensors"), stands="ahead", anew=False),
    "base frozen": Fault((signal.SIGSTOP, "base")),
    "guardian frozen": Fault((signal.SIGSTOP, "guardian")),
    "guardian killed": Fault((signal.SIGKILL, "guardian")),
    "planner frozen": Fault((signal.SIGSTOP, "planner"), anew=False, told=False),
}


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    """A robot that explores the house: its emulator and its explorer, which is begun anew when it has ended."""
    with Emulator(MakeWorld(LoadScenario("house").world)) as emulator:
        going = []

        def explorer():
            if not going or going[-1].process.poll() is not None:
                going.append(Explorer(emulator, tmp_path_factory.mktemp("run"), 1e5))
                going[-1].wait_for("nothing moves before it is enabled")
                going[-1].press("e")
            return going[-1]

        yield emulator, explorer
        for one in going:
            one.process.kill()
            one.process.wait()


def told_velocities(emulator, since):
    """(m/s, rad/s) of the commands after a time, s of time.monotonic()."""
    return [velocity(what) for when, what in list(emulator.commands) if when > since]


def travels(emulator):
    """It has been told to drive forward all through the last half second."""
    lately = told_velocities(emulator, time.monotonic() - 0.5)
    return len(lately) > 10 and all(v > 0.1 for v, _ in lately)


def stood(emulator, how, seconds=0.8):
    lately = told_velocities(emulator, time.monotonic() - seconds)
    return all(v <= 1e-3 and (how == "ahead" or (abs(v) <= 1e-3 and abs(w) <= 1e-3)) for v, w in lately)


def send(explorer, number, which):
    """A signal to the explorer ("planner"), or to the process of its base, of its guardian or of its sensors."""
    if which == "planner":
        explorer.process.send_signal(number)
        return
    table = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    rows = [(int(pid), int(parent), line) for pid, parent, line in re.findall(r"^ *(\d+) +(\d+) (.*)$", table, re.M)]
    drivers = {pid for pid, parent, line in rows if parent == explorer.process.pid and "driver_process" in line}
    guardian, base = next(
        (pid, parent) for pid, parent, line in rows if "kobuki.guardian" in line and parent in drivers
    )
    one = {"base": base, "guardian": guardian, "sensors": next(iter(drivers - {base}))}[which]
    os.kill(one, number)


@pytest.mark.parametrize("name", FAULTS)
def test_what_goes_wrong_while_it_drives(mission, name):
    emulator, explorer = mission[0], mission[1]()
    fault = FAULTS[name]
    wait_until(lambda: travels(emulator), "it does not drive", PATIENCE)
    contacts = emulator.report()["contacts"]
    begin, so_far = time.monotonic(), len(explorer.lines)
    if isinstance(fault.wrong, str):
        order(emulator, fault.wrong)
    elif isinstance(fault.wrong[0], signal.Signals):
        send(explorer, *fault.wrong)
    else:
        emulator.base.faults[fault.wrong[0]] = sensor_fault(fault.wrong[0], fault.wrong[1], fault.wrong[2:])
    if fault.stands:
        wait_until(lambda: time.monotonic() > begin + 1.0 and stood(emulator, fault.stands), "it does not stand")
    else:
        time.sleep(7.0)
    mended = time.monotonic()
    if fault.mend:
        order(emulator, fault.mend)
    elif isinstance(fault.wrong[0], signal.Signals):
        with contextlib.suppress(IndexError):
            send(explorer, signal.SIGCONT, fault.wrong[1])
    else:
        del emulator.base.faults[fault.wrong[0]]
    if fault.anew:
        time.sleep(QUIET)
        assert all(abs(v) <= 1e-3 and abs(w) <= 1e-3 for v, w in told_velocities(emulator, mended))
        explorer.press("e")
    moves(emulator, mended, PATIENCE)
    assert emulator.report()["contacts"] == contacts
    told = [line for line in explorer.lines[so_far:] if not re.match(r" *\d+ s  ", line)]
    assert told or not fault.told

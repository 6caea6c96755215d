"""Faults of a whole mission against an emulated robot in real time: how soon its wheels stand, and whether it goes on.

    python benchmarks/robot_faults.py --trials 20
    python benchmarks/robot_faults.py --trials 20 --only "clock jumps"

A mission of `tfg-drake explore --robot` explores the house. Whenever it drives, something goes wrong, and is mended two
seconds later. Measured is the time from what went wrong to the last command to the wheels that is not a stop, for as
long as it lasts; whether they move again before they are enabled anew, where that is due; and whether the mission goes
on after it, or how it ends. Prints a line a fault.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.kobuki.emulator import Emulator
from tfg_drake.hardware.ros.emulated_turtlebot import EmulatedTurtlebot
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.ros.ros2_emulator import Ros2Emulator

# The wheels must stand after this, s.
BOUND = 0.6
# How long something is wrong, and how long nothing may move afterwards where an enabling is due, s.
WRONG, QUIET = 2.0, 2.0
# A mission that does not drive within this has ended, s.
PATIENCE = 60.0
SCENARIO = LoadScenario("house")


class Kobuki:
    """An emulated Kobuki in this process."""

    def __init__(self) -> None:
        self.emulator = Emulator(MakeWorld(SCENARIO.world))
        self.emulator.start()
        host, port = self.emulator.sensors
        source = f"socket:{host}:{port}"
        self.arguments = ["kobuki", "--port", self.emulator.device, "--tags", source, "--scan", source]

    def moves(self) -> list[float]:
        """When it was told to move."""
        return [when for when, what in list(self.emulator.commands) if what.speed]

    def contacts(self) -> object:
        return self.emulator.report()["contacts"]

    def close(self) -> None:
        self.emulator.close()


class TurtleBot4:
    """An emulated TurtleBot 4 on a ROS 2 graph, in this process."""

    def __init__(self) -> None:
        os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
        preset = load_preset("emulated")
        sensors = SCENARIO.tags, SCENARIO.scan, SCENARIO.odometry
        self.robot = EmulatedTurtlebot(MakeWorld(SCENARIO.world), preset, *sensors, 0)
        self._node, self._go_on = Ros2Emulator(self.robot, preset), True
        self._thread = threading.Thread(target=lambda: self._node.run(lambda: self._go_on), daemon=True)
        self._thread.start()
        self.arguments = ["ros2", "--preset", "emulated"]

    def moves(self) -> list[float]:
        """When it was told to move."""
        return [when for when, v, w in list(self.robot.commands) if v or w]

    def contacts(self) -> object:
        return self.robot.truth()["contacts"]

    def close(self) -> None:
        self._go_on = False
        self._thread.join()
        self._node.close()


class Explorer:
    """`tfg-drake explore --robot` in a process of its own."""

    def __init__(self, arguments: list[str], folder: Path) -> None:
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", "--robot", *arguments]
        self.process = subprocess.Popen(
            [*command, "--headless", "--max-time", "100000", "--out", str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("nothing moves before"):
                break
        threading.Thread(target=self.process.stdout.read, daemon=True).start()
        self._folder = folder

    def press(self, key: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(key)
        self.process.stdin.flush()

    def ended(self) -> str:
        """How it ended, "" while it goes on."""
        if self.process.poll() is None:
            return ""
        with contextlib.suppress(OSError):
            summary = json.loads((self._folder / "summary.json").read_text())
            return f"{summary['outcome']}: {summary['reason']}"
        return "killed"

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


@dataclasses.dataclass(frozen=True)
class Fault:
    """name. Robot: what has it. wrong(robot, explorer), mend(robot, explorer). enabling: one is due afterwards. stops:
    the wheels must stand. fatal: the explorer does not live on."""

    name: str
    Robot: type
    wrong: Callable[..., object]
    mend: Callable[..., object]
    enabling: bool
    stops: bool = True
    fatal: bool = False


def _nothing(*_: object) -> None:
    pass


def _signal(number: signal.Signals) -> Callable[..., object]:
    return lambda _, explorer: explorer.process.send_signal(number)


FAULTS = (
    Fault("cable pulled", Kobuki, lambda r, _: r.emulator.unplug(), lambda r, _: r.emulator.plug(), True),
    Fault(
        "base silent",
        Kobuki,
        lambda r, _: setattr(r.emulator, "silent", True),
        lambda r, _: setattr(r.emulator, "silent", False),
        True,
    ),
    Fault(
        "scan silent",
        Kobuki,
        lambda r, _: r.emulator.muted.add("scan"),
        lambda r, _: r.emulator.muted.discard("scan"),
        False,
    ),
    Fault(
        "5 % of frames corrupt",
        Kobuki,
        lambda r, _: setattr(r.emulator, "corrupt", 0.05),
        lambda r, _: setattr(r.emulator, "corrupt", 0.0),
        False,
        stops=False,
    ),
    Fault("planner frozen", Kobuki, _signal(signal.SIGSTOP), _signal(signal.SIGCONT), False),
    Fault("planner killed", Kobuki, _signal(signal.SIGKILL), _nothing, True, fatal=True),
    Fault(
        "odometry silent",
        TurtleBot4,
        lambda r, _: r.robot.silent.add("odometry"),
        lambda r, _: r.robot.silent.discard("odometry"),
        True,
    ),
    Fault(
        "clock jumps",
        TurtleBot4,
        lambda r, _: setattr(r.robot, "clock", r.robot.clock + 5.0),
        _nothing,
        True,
    ),
    Fault("planner frozen, on ROS", TurtleBot4, _signal(signal.SIGSTOP), _signal(signal.SIGCONT), False),
)


def drives(robot: Kobuki | TurtleBot4, since: float, patience: float, alive: Callable[[], bool]) -> bool:
    """Whether the wheels are told to move for a second on end after `since`, within `patience` s."""
    end = time.monotonic() + patience
    while time.monotonic() < end and alive():
        now = time.monotonic()
        lately = [when for when in robot.moves() if when > max(since, now - 1.0)]
        if len(lately) >= 20 and lately[-1] - lately[0] > 0.8:
            return True
        time.sleep(0.05)
    return False


def trials(fault: Fault, count: int, folder: Path) -> Iterator[tuple[float, bool, str]]:
    """Of each trial: how long the wheels went on, s, whether they moved without a due enabling, how it went on."""
    robot = fault.Robot()
    explorer: Explorer | None = None
    for number in range(count):
        if explorer is None:
            explorer = Explorer(robot.arguments, folder / f"{fault.name}-{number}")
            explorer.press("e")
        going = explorer
        if not drives(robot, time.monotonic(), PATIENCE, lambda going=going: not going.ended()):
            yield float("inf"), False, going.ended() or "does not drive"
            going.close()
            explorer = None
            continue
        began = time.monotonic()
        fault.wrong(robot, going)
        time.sleep(WRONG)
        during = [when - began for when in robot.moves() if when > began]
        went_on = max(during, default=0.0)
        mended = time.monotonic()
        fault.mend(robot, going)
        early = False
        if fault.enabling:
            time.sleep(QUIET)
            early = any(when > mended for when in robot.moves())
            if not fault.fatal:
                # A base whose cable is put back is found again after a while: an operator tries until it is.
                for _ in range(10):
                    going.press("e")
                    if drives(robot, mended, 3.0, lambda: True):
                        break
        if fault.fatal:
            going.close()
            explorer, after = None, "ended"
        else:
            goes_on = drives(robot, mended, PATIENCE, lambda going=going: not going.ended())
            after = "goes on" if goes_on else going.ended() or "does not drive"
            if not goes_on:
                going.close()
                explorer = None
        yield went_on, early, after
    if explorer is not None:
        explorer.close()
    if robot.contacts():
        print(f"  contacts with walls: {robot.contacts()}")
    robot.close()


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--only", help="one fault, by its name")
    options = parser.parse_args()
    print(f"{'fault':<24}{'trials':>7}{'median s':>10}{'worst s':>9}{'moved early':>13}  then")
    with tempfile.TemporaryDirectory() as temporary:
        for fault in FAULTS:
            if options.only not in (None, fault.name):
                continue
            results = list(trials(fault, options.trials, Path(temporary)))
            after = [then for _, _, then in results]
            then = ", ".join(f"{after.count(one)} {one}" for one in dict.fromkeys(after))
            times = [went_on for went_on, _, _ in results]
            stops = f"{statistics.median(times):10.2f}{max(times):9.2f}" if fault.stops else f"{'-':>10}{'-':>9}"
            early = sum(moved for _, moved, _ in results)
            print(f"{fault.name:<24}{len(results):>7}{stops}{early:>13}  {then}", flush=True)


if __name__ == "__main__":
    main()

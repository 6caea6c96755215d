"""Faults of a whole mission against an emulated robot in real time: how soon its wheels stand, and whether it goes on.

    python benchmarks/robot_faults.py --trials 20 --jobs 2 --out runs/robot_faults
    python benchmarks/robot_faults.py --trials 20 --out runs/robot_faults --only "clock jumps"

A mission of `tfg-drake explore --robot` explores the house. Whenever it drives, something goes wrong, and is mended two
or three seconds later. Measured is the time from what went wrong until the wheels are told to stand, for as long as it
lasts, where a stop is due; whether they move before they are enabled anew, where that is due; contacts with walls;
which line was shown meanwhile; and whether the mission goes on.

Every trial is a line of JSON in the folder `--out`, and those that are there already are not run again. Prints a line a
row: "bad" counts the trials in which anything was not as it should be, and below the row stand what was not, and the
first line that the newest trial showed. Rows without a number are not on the list of faults.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import ctypes
import dataclasses
import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import disk_full
from picture_faults import STARTING, asking, send

from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.emulation.emulated_base import FULL
from tfg_drake.hardware.emulation.emulated_turtlebot import EmulatedTurtlebot
from tfg_drake.hardware.emulation.emulator import Emulator
from tfg_drake.hardware.emulation.emulator_orders import order
from tfg_drake.hardware.emulation.ros2_emulator import Ros2Emulator
from tfg_drake.hardware.emulation.sensor_faults import sensor_fault
from tfg_drake.hardware.kobuki import odometry
from tfg_drake.hardware.ros.preset import load_preset

# The wheels must stand after this, s; where the scan's content must be watched for a while to see what is wrong, this.
BOUND, SLOW_BOUND = 0.6, 2.0
# How long nothing may move after the mending where an enabling is due, s.
QUIET = 2.0
# A mission that does not drive within this is stuck, and is enabled once more halfway, s.
PATIENCE = 90.0
# A command slower than this is a stop, m/s and rad/s.
STOP = 1e-3
# The robot moves as a trial wants it when so many of the commands of the last second are such.
DRIVING = 20
CLI = [sys.executable, "-m", "tfg_drake.diagrams.cli"]
SCENARIO = LoadScenario("house")
# A line of progress is no message.
PROGRESS = re.compile(r" *\d+ s  ")
BYSTANDER = Path(__file__).parents[1] / "tests" / "hardware" / "ros" / "bystander.py"

Command = tuple[float, float, float]


class Kobuki:
    """An emulated Kobuki in this process. shown: its explorer has a picture."""

    shown = False

    def __init__(self) -> None:
        self.emulator = Emulator(MakeWorld(SCENARIO.world))
        self.faults = self.emulator.faults
        self.emulator.start()
        host, port = self.emulator.sensors
        source = f"socket:{host}:{port}"
        self.arguments = ["kobuki", "--port", self.emulator.device, "--tags", source, "--scan", source]

    def commands(self) -> list[Command]:
        """What the wheels were told: when, m/s, rad/s."""
        return [(when, *odometry.velocity(what)) for when, what in list(self.emulator.commands)]

    def contacts(self) -> int:
        return int(str(self.emulator.report()["contacts"]))

    def close(self) -> None:
        self.emulator.close()


class ShownKobuki(Kobuki):
    """An emulated Kobuki whose explorer has a picture."""

    shown = True


class TurtleBot4:
    """An emulated TurtleBot 4 on a ROS 2 graph, in this process."""

    shown = False

    def __init__(self) -> None:
        os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
        preset = load_preset("emulated")
        sensors = SCENARIO.tags, SCENARIO.scan, SCENARIO.odometry
        self.robot = EmulatedTurtlebot(MakeWorld(SCENARIO.world), preset, *sensors, 0)
        self.faults = self.robot.faults
        self._node, self._go_on = Ros2Emulator(self.robot, preset), True
        self._thread = threading.Thread(target=lambda: self._node.run(lambda: self._go_on), daemon=True)
        self._thread.start()
        self.arguments = ["ros2", "--preset", "emulated"]

    def commands(self) -> list[Command]:
        """What the wheels were told: when, m/s, rad/s."""
        return list(self.robot.commands)

    def contacts(self) -> int:
        return int(self.robot.truth()["contacts"])

    def close(self) -> None:
        self._go_on = False
        self._thread.join()
        self._node.close()


class TurtleBot4BesideAnother(TurtleBot4):
    """The same in a network with another machine, whose robot would obey anybody. Needs root and iproute2."""

    def __init__(self) -> None:
        # CLONE_NEWNET, of sched.h: this process and its children leave the network of the machine.
        if ctypes.CDLL(None, use_errno=True).unshare(0x40000000):
            raise OSError(ctypes.get_errno(), "a namespace of the network needs root")
        os.environ.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)
        self._other = f"tfg-{os.getpid()}"
        subprocess.run(["ip", "netns", "add", self._other], check=True)
        ours = ["ip", "address", "add", "10.99.1.1/24", "dev", "there"]
        theirs = ["ip", "-n", self._other, "address", "add", "10.99.1.2/24", "dev", "here"]
        cable = ["ip", "link", "add", "there", "type", "veth", "peer", "here", "netns", self._other]
        up = [["link", "set", "lo", "up"], ["-n", self._other, "link", "set", "lo", "up"]]
        up += [["link", "set", "there", "up"], ["-n", self._other, "link", "set", "here", "up"]]
        for command in (cable, ours, theirs, *(["ip", *one] for one in up)):
            subprocess.run(command, check=True)
        time.sleep(4.0)  # until the new addresses may be used
        super().__init__()
        self._process = subprocess.Popen(
            ["ip", "netns", "exec", self._other, sys.executable, str(BYSTANDER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def heard(self, *_: object) -> str:
        """What the other robot has heard of this one, "" for nothing."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("report\n")
        self._process.stdin.flush()
        report = json.loads(self._process.stdout.readline())
        return f"another machine hears {report}" if report["commands"] or report["published"] else ""

    def close(self) -> None:
        super().close()
        self._process.kill()
        self._process.wait()
        subprocess.run(["ip", "netns", "delete", self._other], check=True)


class Explorer:
    """`tfg-drake explore --robot` in a process of its own. lines: (time, line) of its standard output."""

    def __init__(self, arguments: list[str], folder: Path, shown: bool = False) -> None:
        """shown: with a picture."""
        self.folder = folder
        self.lines: list[tuple[float, str]] = []
        short = ["--set", "explorer.first_look=2", "--set", "explorer.first_turns=1"]
        picture = [] if shown else ["--headless"]
        errors = folder.with_suffix(".err")
        with errors.open("w") as stream:
            self.process = subprocess.Popen(
                [*CLI, "explore", "--robot", *arguments, *picture, *short, "--max-time", "100000", "--out", folder],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stream,
                text=True,
            )
        threading.Thread(target=self._listen, daemon=True).start()
        while not any(line.startswith("nothing moves before") for _, line in list(self.lines)):
            if self.process.poll() is not None:
                raise RuntimeError(f"the explorer does not begin: {errors.read_text()}")
            time.sleep(0.1)

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if not PROGRESS.match(line):
                self.lines.append((time.monotonic(), line.rstrip()))

    @property
    def port(self) -> int:
        """Of its picture."""
        return next(int(re.findall(r":(\d+)/", line)[0]) for _, line in self.lines if line.startswith("page: http"))

    def press(self, key: str) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(key)
            self.process.stdin.flush()

    def ended(self) -> str:
        """How it ended, "" while it goes on."""
        if self.process.poll() is None:
            return ""
        with contextlib.suppress(OSError, ValueError):
            summary = json.loads((self.folder / "summary.json").read_text())
            return f"{summary['outcome']}: {summary['reason']}"
        return f"exit code {self.process.returncode}, no summary"

    def descendants(self) -> dict[int, tuple[int, str]]:
        """(parent, command line) of its processes, by their ids."""
        found: dict[int, tuple[int, str]] = {}
        parents = [self.process.pid]
        processes = _processes()
        while parents:
            one = parents.pop()
            mine = {pid: process for pid, process in processes.items() if process[0] == one}
            found |= mine
            parents += mine
        return found

    def signal(self, number: signal.Signals, *which: str) -> None:
        """To its processes: "guardian", "base" (the base's driver), "sensors" (the driver of tags and scans)."""
        processes = self.descendants()
        guardian = next(pid for pid, (_, line) in processes.items() if "kobuki.guardian" in line)
        base, _ = processes[guardian]
        sensors = next(pid for pid, (_, line) in processes.items() if "driver_process" in line and pid != base)
        for name in which:
            os.kill({"guardian": guardian, "base": base, "sensors": sensors}[name], number)

    def close(self) -> None:
        """Ends it and what it has left behind."""
        left = self.descendants()
        self.process.kill()
        self.process.wait()
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def _processes() -> dict[int, tuple[int, str]]:
    """(parent, command line) of every process of this machine, by its id."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            # The name, in parentheses, may hold anything.
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            found[int(folder.name)] = parent, (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


Action = Callable[[Any, Explorer], object]


def _nothing(*_: object) -> None:
    pass


@dataclasses.dataclass(frozen=True)
class Fault:
    """number: in the list of faults. Robot: what has it. wrong(robot, explorer), mend(robot, explorer): a text that
    either returns is something that was not as it should be.

    stands: what must stand: "all", "ahead" (no way forward), "once" (all, but the explorer may mend it and drive on) or
    "" for nothing. enabling: one is due afterwards; None where either will do. lasts: s. bound: until it stands, s.
    told: a line must be shown; once: words of one that is not repeated for long, so that an earlier trial's will do.
    turning: it goes wrong while the robot turns in place. ends: the mission may end. fatal: the explorer does not live
    on.
    """

    number: int
    name: str
    Robot: type
    wrong: Action
    mend: Action
    stands: str = ""
    enabling: bool | None = None
    lasts: float = 2.5
    bound: float = BOUND
    told: bool = True
    once: str = ""
    turning: bool = False
    ends: bool = False
    fatal: bool = False


@dataclasses.dataclass(frozen=True)
class Check:
    """What needs no robot. run(folder): what was not as it should be, "" for nothing, and the line that was shown."""

    number: int
    name: str
    run: Callable[[Path], tuple[str, str]]


def _sensor(number: int, Robot: type, sensor: str, fault: str, *numbers: float, name: str = "", **more: Any) -> Fault:
    """Something wrong with the "scan" or the "tags"."""
    if not name:
        name = " ".join([sensor, fault, *(f"{one:g}" for one in numbers)])
        name += ", on ROS" if Robot is TurtleBot4 else ""

    def wrong(robot: Any, _: Explorer) -> None:
        robot.faults[sensor] = sensor_fault(sensor, fault, numbers)

    return Fault(number, name, Robot, wrong, lambda robot, _: robot.faults.pop(sensor), **more)


def _ordered(number: int, name: str, wrong: str, mend: str, **more: Any) -> Fault:
    """What happens by lines of docs/kobuki_emulator.md."""

    def obey(line: str) -> Action:
        return lambda robot, _: order(robot.emulator, line)

    return Fault(number, name, Kobuki, obey(wrong), obey(mend), **more)


def _process(number: int, name: str, sent: signal.Signals, *which: str, **more: Any) -> Fault:
    """A signal to processes of the explorer; those that are frozen are thawed."""

    def mend(_: Kobuki, explorer: Explorer) -> None:
        if sent == signal.SIGSTOP:
            with contextlib.suppress(StopIteration):  # it was ended meanwhile
                explorer.signal(signal.SIGCONT, *which)

    return Fault(number, name, Kobuki, lambda _, explorer: explorer.signal(sent, *which), mend, **more)


def _planner(name: str, Robot: type, sent: signal.Signals, mended: signal.Signals | None, **more: Any) -> Fault:
    def mend(_: object, explorer: Explorer) -> None:
        if mended is not None:
            explorer.process.send_signal(mended)

    more = {"stands": "all", "told": False} | more
    return Fault(0, name, Robot, lambda _, explorer: explorer.process.send_signal(sent), mend, **more)


def _second_run(folder: Path) -> tuple[str, str]:
    """A simulated mission goes on where a second one is started into its folder."""
    out = folder / "run"
    command = [*CLI, "explore", "house", "--headless", "--out", str(out), "--max-time"]
    with subprocess.Popen([*command, "20", "--realtime-rate", "1"], stdout=subprocess.DEVNULL) as first:
        while not out.exists() or not any(out.iterdir()):
            time.sleep(0.1)
        second = subprocess.run([*command, "5"], capture_output=True, text=True, check=False)
        again = first.poll() is None
        first.wait()
    line = second.stderr.strip()
    wrongs = [] if second.returncode == 2 else [f"the second run has exit code {second.returncode}"]
    if not again or first.returncode:
        wrongs.append(f"the first run has exit code {first.returncode}")
    if json.loads((out / "summary.json").read_text())["sim_time_s"] < 19.0:
        wrongs.append("the summary is the second run's")
    return ", ".join(wrongs), line


def _second_robot(_: Kobuki, explorer: Explorer) -> str:
    """A simulated mission into the folder of the robot's."""
    command = [*CLI, "explore", "house", "--headless", "--out", str(explorer.folder), "--max-time", "5"]
    code = subprocess.run(command, capture_output=True, text=True, check=False).returncode
    return "" if code == 2 else f"the second run has exit code {code}"


def _asked_from_outside(_: Kobuki, explorer: Explorer) -> None:
    """The operator stops the robot, and a page of a foreign origin asks for whatever could start it."""
    explorer.press(" ")
    for name in STARTING:
        send(explorer.port, asking(name, explorer.port))


def _full_disk(folder: Path) -> tuple[str, str]:
    """A simulated mission whose disk fills up at a stage that differs from trial to trial."""
    _, outcome, _, mapped, landmarks, lines = disk_full.mission("house", 4 + 13 * int(folder.name), 0)
    wrong = "" if outcome == "complete" and landmarks == mapped else f"{outcome}, {landmarks} of {mapped} landmarks"
    return wrong, lines[0] if lines else ""


MALFORMED = b"POST /request HTTP/1.1\r\nContent-Length: 9\r\n\r\n\xc1"
# What a scan must do for the robot to stand, and to go on by itself.
BLIND: dict[str, Any] = {"stands": "ahead", "enabling": False}
SLOW = BLIND | {"bound": SLOW_BOUND, "lasts": 4.0}
# Of what locks the base.
LOCKED: dict[str, Any] = {"stands": "all", "enabling": True}
ROWS: tuple[Fault | Check, ...] = (
    _sensor(1, Kobuki, "scan", "nan", **BLIND),
    _sensor(1, Kobuki, "scan", "empty", **BLIND),
    _sensor(1, Kobuki, "scan", "none", **BLIND),
    _sensor(1, Kobuki, "scan", "thin", **SLOW),
    _sensor(1, Kobuki, "scan", "frozen", **SLOW),
    _sensor(1, Kobuki, "scan", "blind", 0.45, told=False),
    _sensor(1, Kobuki, "scan", "drop", 0.2, told=False),
    _sensor(1, TurtleBot4, "scan", "nan", **BLIND),
    _sensor(1, TurtleBot4, "scan", "empty", **BLIND),
    _sensor(1, TurtleBot4, "scan", "zero", **BLIND),
    _sensor(1, TurtleBot4, "scan", "near", **BLIND),
    _sensor(1, TurtleBot4, "scan", "none", **BLIND),
    _sensor(1, TurtleBot4, "scan", "thin", **SLOW),
    _sensor(1, TurtleBot4, "scan", "frozen", **SLOW),
    Fault(2, "a foreign page enables", ShownKobuki, _asked_from_outside, _nothing, told=False, **LOCKED),
    Fault(
        3,
        "malformed request to the page",
        ShownKobuki,
        lambda _, explorer: "" if send(explorer.port, MALFORMED) else "nobody listens",
        _nothing,
        enabling=False,
    ),
    Check(5, "disk full", _full_disk),
    _sensor(4, TurtleBot4, "tags", "range", math.inf, once="not plausible"),
    _ordered(6, "battery at 13.8 V", "battery 13.8", f"battery {0.1 * FULL:g}", lasts=7.0, ends=True, fatal=True),
    _ordered(6, "battery at 13.0 V", "battery 13.0", f"battery {0.1 * FULL:g}", stands="all", ends=True, fatal=True),
    _ordered(6, "battery at 11 V", "battery 11", f"battery {0.1 * FULL:g}", stands="all", ends=True, fatal=True),
    _ordered(6, "in the dock", "dock", "undock", **LOCKED),
    _ordered(6, "overcurrent", "overcurrent both", "overcurrent none", **LOCKED),
    _ordered(7, "bumper", "press bumper centre", "release bumper centre", stands="ahead", enabling=False),
    _ordered(7, "cliff", "open cliff centre", "close cliff centre", **LOCKED),
    _ordered(7, "wheel drop", "drop wheel", "raise wheel", **LOCKED),
    _ordered(7, "30 % of frames corrupt", "corrupt 0.3", "corrupt 0", lasts=7.0, once="arrive corrupt"),
    _ordered(7, "60 % of frames lost", "lost 0.6", "lost 0", lasts=7.0, once="are lost"),
    _process(8, "sensors' process killed", signal.SIGKILL, "sensors", stands="once", enabling=False),
    _process(8, "base's driver frozen", signal.SIGSTOP, "base", lasts=3.0, **LOCKED),
    _sensor(9, Kobuki, "tags", "range", 1e200, once="not plausible"),
    _sensor(9, Kobuki, "tags", "sigma", 1e-200, once="not plausible"),
    _sensor(9, Kobuki, "tags", "sigma", 1e-12, once="not plausible"),
    _sensor(9, Kobuki, "tags", "id", 2.0**56, name="tags id 2^56", once="not plausible"),
    # Ids that might be: nothing is refused.
    _sensor(9, Kobuki, "tags", "random", told=False),
    _sensor(9, Kobuki, "scan", "range_max", 1e300, once="not plausible"),
    _sensor(9, TurtleBot4, "tags", "range", 1e200, once="not plausible"),
    _sensor(9, TurtleBot4, "tags", "sigma", 1e-200, once="not plausible"),
    _sensor(9, TurtleBot4, "tags", "id", 2.0**56, name="tags id 2^56, on ROS", once="not plausible"),
    Check(10, "two runs into one folder", _second_run),
    Fault(10, "a run into a robot's folder", Kobuki, _second_robot, _nothing, told=False),
    Fault(
        11,
        "another robot in the network",
        TurtleBot4BesideAnother,
        _nothing,
        TurtleBot4BesideAnother.heard,
        told=False,
        lasts=5.0,
    ),
    _process(12, "guardian frozen", signal.SIGSTOP, "guardian", **LOCKED),
    _process(12, "guardian killed", signal.SIGKILL, "guardian", **LOCKED),
    _process(12, "base's driver killed", signal.SIGKILL, "base", stands="all", ends=True, fatal=True),
    _process(12, "driver and guardian killed", signal.SIGKILL, "base", "guardian", stands="all", ends=True, fatal=True),
    _ordered(13, "base's clock 2 s back", "clock -2", "clock 2", **LOCKED),
    _ordered(13, "frames reordered", "late 0.5", "late 0", **LOCKED),
    _ordered(14, "gyro stuck", "stick gyro", "free gyro", lasts=3.0, turning=True, **LOCKED),
    # The cable takes every command with it: until it is back the base drives on as it was told.
    _ordered(0, "cable pulled", "unplug", "plug", enabling=True),
    _ordered(0, "base silent", "silent on", "silent off", **LOCKED),
    _ordered(0, "encoders stuck", "stick encoders", "free encoders", bound=1.0, **LOCKED),
    _sensor(0, Kobuki, "scan", "silent", **BLIND | {"stands": "all"}),
    _sensor(0, Kobuki, "tags", "silent", stands="all", enabling=False, bound=1.1),
    _ordered(0, "5 % of frames corrupt", "corrupt 0.05", "corrupt 0", told=False),
    _planner("planner frozen", Kobuki, signal.SIGSTOP, signal.SIGCONT, enabling=False),
    _planner("planner killed", Kobuki, signal.SIGKILL, None, enabling=True, fatal=True),
    Fault(
        0,
        "odometry silent",
        TurtleBot4,
        lambda r, _: r.robot.silent.add("odometry"),
        lambda r, _: r.robot.silent.discard("odometry"),
        **LOCKED,
    ),
    Fault(
        0, "clock jumps", TurtleBot4, lambda r, _: setattr(r.robot, "clock", r.robot.clock + 5.0), _nothing, **LOCKED
    ),
    _planner("planner frozen, on ROS", TurtleBot4, signal.SIGSTOP, signal.SIGCONT, enabling=False),
)


def moving(command: Command) -> bool:
    """Whether a command is not a stop."""
    _, v, w = command
    return abs(v) > STOP or abs(w) > STOP


def ahead(command: Command) -> bool:
    """Whether a command goes forward."""
    return command[1] > STOP


def travelling(command: Command) -> bool:
    """Whether a command goes forward quickly."""
    return command[1] > 0.1


def turning(command: Command) -> bool:
    """Whether a command turns in place."""
    _, v, w = command
    return abs(w) > 0.3 and abs(v) < 0.05


def drives(
    robot: Any, how: Callable[[Command], bool], since: float, patience: float, alive: Callable[[], bool]
) -> bool:
    """Whether the wheels are told to move in a way for a second on end after `since`, within `patience` s."""
    end = time.monotonic() + patience
    while time.monotonic() < end and alive():
        begin = max(since, time.monotonic() - 1.0)
        commands = [one for one in robot.commands() if one[0] > begin]
        lately = [one[0] for one in commands if how(one)]
        if len(lately) >= DRIVING and lately[-1] - lately[0] > 0.8 and how(commands[-1]):
            return True
        time.sleep(0.02)
    return False


def stands_after(robot: Any, how: Callable[[Command], bool], began: float, until: float) -> float:
    """When the wheels are told to stand, for the rest of the time until `until`, s after `began`; inf where they are
    not. how: what standing is not."""
    stop = math.inf
    for command in robot.commands():
        if command[0] > until:
            break
        stop = math.inf if how(command) else min(stop, command[0])
    return max(0.0, stop - began)


def _first_stop(robot: Any, began: float, until: float) -> float:
    """When the wheels are first told to stand after `began`, or `until`."""
    return min((one[0] for one in robot.commands() if one[0] > began and not moving(one)), default=until)


def started(fault: Fault, robot: Any, explorer: Explorer | None, folder: Path) -> Explorer:
    """An explorer whose robot drives as the fault wants it; the one that there is, if it does."""
    how = turning if fault.turning else travelling
    for attempt in range(3):
        if explorer is None:
            explorer = Explorer(robot.arguments, folder / f"{time.monotonic_ns()}", robot.shown)
            explorer.press("e")
        going = explorer
        if drives(robot, how, time.monotonic(), PATIENCE, lambda going=going: not going.ended()):
            return going
        print(f"  {fault.name}: a new mission, the last one: {going.ended() or 'does not drive'}", flush=True)
        going.close()
        explorer = None
        robot.faults.clear()
        time.sleep(attempt)
    raise RuntimeError(f"{fault.name}: no mission drives")


def trial(fault: Fault, robot: Any, explorer: Explorer) -> dict[str, Any]:
    """One time that it goes wrong, and is mended."""
    contacts, began = robot.contacts(), time.monotonic()
    wrongs = [fault.wrong(robot, explorer)]
    time.sleep(max(0.0, began + fault.lasts - time.monotonic()))
    mended = time.monotonic()
    stood = None
    if fault.stands:
        until = _first_stop(robot, began, mended) if fault.stands == "once" else mended
        stood = stands_after(robot, ahead if fault.stands == "ahead" else moving, began, until)
    wrongs.append(fault.mend(robot, explorer))
    early, after = False, "ended"
    if fault.enabling:
        time.sleep(QUIET)
        early = any(moving(one) for one in robot.commands() if one[0] > mended)
        # A base whose cable is put back is found again after a while: an operator tries until it is.
        for _ in range(0 if fault.fatal else 10):
            explorer.press("e")
            if drives(robot, moving, mended, 3.0, lambda: not explorer.ended()):
                break
    if not fault.fatal:
        after = _after(robot, explorer, mended)
    elif fault.ends:
        with contextlib.suppress(subprocess.TimeoutExpired):
            explorer.process.wait(PATIENCE)
        after = explorer.ended() or "goes on"
    lines = [line for when, line in explorer.lines if when > began or (fault.once and fault.once in line)]
    touched = robot.contacts() - contacts
    if stood is not None and stood > fault.bound:
        wrongs.append("does not stand" if stood == math.inf else "stands too late")
    if early:
        wrongs.append("moves before it is enabled")
    if touched:
        wrongs.append("touches a wall")
    if fault.told and not lines:
        wrongs.append("no line")
    if not fault.fatal and not after.startswith("goes on"):
        wrongs.append("does not go on")
    if fault.enabling is False and after == "goes on once enabled":
        wrongs.append("must be enabled")
    return {
        "stands": stood if stood is None or math.isfinite(stood) else "never",
        "early": early,
        "contacts": touched,
        "after": after,
        "lines": lines,
        "wrong": [one for one in wrongs if isinstance(one, str) and one],
        "seconds": round(time.monotonic() - began, 1),
    }


def _after(robot: Any, explorer: Explorer, mended: float) -> str:
    """How it went on, with one more enabling where it does not by itself."""
    for how in ("goes on", "goes on once enabled"):
        if drives(robot, moving, mended, PATIENCE / 2.0, lambda: not explorer.ended()):
            return how
        explorer.press("e")
    return explorer.ended() or "does not drive"


def run_row(row: Fault | Check, count: int, out: Path) -> None:
    """The trials of a row that are not in its file yet."""
    file = _file(row, out)
    left = count - len(results(row, out))
    if left <= 0:
        return
    with tempfile.TemporaryDirectory() as temporary, file.open("a", encoding="utf-8") as stream:

        def keep(result: dict[str, Any]) -> None:
            stream.write(json.dumps(result) + "\n")
            stream.flush()

        if isinstance(row, Check):
            for number in range(left):
                began = time.monotonic()
                wrong, line = row.run(Path(temporary) / str(number))
                seconds = round(time.monotonic() - began, 1)
                wrongs, lines = [wrong] * bool(wrong), [line] * bool(line)
                keep({"after": wrong or "goes on", "lines": lines, "wrong": wrongs, "seconds": seconds})
            return
        robot, explorer = None, None
        try:
            for _ in range(left):
                robot = robot or row.Robot()
                began = time.monotonic()
                explorer = started(row, robot, explorer, Path(temporary))
                begun = time.monotonic() - began
                keep(trial(row, robot, explorer) | {"begin": round(begun, 1)})
                if row.fatal or explorer.ended():
                    explorer.close()
                    explorer = None
                if row.fatal:
                    robot.close()
                    robot = None
        finally:
            if explorer is not None:
                explorer.close()
            if robot is not None:
                robot.close()


def _file(row: Fault | Check, out: Path) -> Path:
    return out / (re.sub(r"\W+", "_", row.name) + ".jsonl")


def results(row: Fault | Check, out: Path) -> list[dict[str, Any]]:
    """The trials of a row so far."""
    if not (file := _file(row, out)).exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


HEADER = f"{'':>2} {'fault':<30}{'trials':>7}{'median s':>10}{'worst s':>9}{'bound s':>9}{'early':>7}{'contacts':>10}"
HEADER += f"{'told':>6}{'bad':>5}  then"


def table_row(row: Fault | Check, trials: Sequence[dict[str, Any]]) -> str:
    """A row of the table, and below it what was wrong and what the newest trial told first."""
    stands = f"{'-':>10}{'-':>9}{'-':>9}"
    if isinstance(row, Fault) and row.stands:
        times = [math.inf if one["stands"] == "never" else one["stands"] for one in trials]
        stands = f"{statistics.median(times):10.2f}{max(times):9.2f}{row.bound:9.1f}"
    early = sum(one.get("early", False) for one in trials)
    contacts = sum(one.get("contacts", 0) for one in trials)
    told = sum(bool(one["lines"]) for one in trials) / len(trials)
    bad = sum(bool(one["wrong"]) for one in trials)

    def counted(what: Sequence[str]) -> str:
        return ", ".join(f"{count} {one}" for one, count in collections.Counter(what).most_common())

    lines = [
        f"{row.number or '':>2} {row.name:<30}{len(trials):>7}{stands}{early:>7}{contacts:>10}{told:6.0%}{bad:>5}  "
        + counted([one["after"] for one in trials])
    ]
    if wrong := counted([what for one in trials for what in one["wrong"]]):
        lines.append(f"   ! {wrong}")
    if shown := [one["lines"][0] for one in trials if one["lines"]]:
        lines.append(f"   > {shown[-1]}")
    return "\n".join(lines)


def run_rows(rows: Sequence[Fault | Check], options: argparse.Namespace) -> None:
    """Each row in a process of its own, some at a time."""
    waiting: list[Fault | Check] = list(rows)
    going: list[subprocess.Popen[bytes]] = []
    same = ["--trials", str(options.trials), "--out", str(options.out)]
    try:
        while waiting or going:
            going = [one for one in going if one.poll() is None]
            while waiting and len(going) < options.jobs:
                row = waiting.pop(0)
                if len(results(row, options.out)) < options.trials:
                    print(f"  {row.name} ...", flush=True)
                    going.append(subprocess.Popen([sys.executable, __file__, "--only", row.name, *same, "--alone"]))
            time.sleep(0.2)
    finally:
        for one in going:
            one.terminate()
            one.wait()


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="some rows, by their names or numbers")
    parser.add_argument("--jobs", type=int, default=1, help="rows at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/robot_faults"), help="folder of the trials")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    wanted = options.only
    rows = [row for row in ROWS if wanted is None or {row.name, str(row.number)} & set(wanted)]
    if not rows:
        parser.error(f"no such row; the rows are {', '.join(row.name for row in ROWS)}")
    options.out.mkdir(parents=True, exist_ok=True)
    if options.alone:
        run_row(rows[0], options.trials, options.out)
        return
    run_rows(rows, options)
    print(HEADER)
    for row in rows:
        if trials := results(row, options.out):
            print(table_row(row, trials))


if __name__ == "__main__":
    main()

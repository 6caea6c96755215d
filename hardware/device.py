"""A robot's base and sensors behind a process of their own.

The process (driver_process.py) reads the robot, keeps the watchdog and sends the velocity: GTSAM holds the interpreter
while it solves, and a stop must not wait for that. All stamps are the host's monotonic clock, s.
"""

from __future__ import annotations

import collections
import contextlib
import enum
import importlib
import itertools
import math
import select
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.sweep import Sweep
from tfg_drake.hardware import process
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.io.extras import pip_install
from tfg_drake.messages import Hazards, LaserScan, Odometry, SaidPose, TagDetections, message


class Button(enum.IntFlag):
    """Bits of BaseState.buttons: a Kobuki's B0, B1 and B2."""

    B0 = 1
    B1 = 2
    B2 = 4


@message
class BaseState:
    """How a base is, where it says so: about every second, and at once where anything lasting changes.

    stamp: s. battery: V. charge: share of the battery's charge that is left; both nan where they are not known.
    battery_level: "good" (also where it is not known), "low" or "dangerous". charger: what it hangs on, "dock",
    "adapter" or "charger", "" for nothing. charging: its battery is not full yet. overcurrent: wheels that draw too
    much current, by the bits of Side. buttons: bits of Button of those that are pressed. firmware, hardware: versions
    such as "1.1.4". unique_id: in hexadecimal. lost: share of its frames that were garbled or never came since the
    state before.
    """

    stamp: float
    battery: float = math.nan
    charge: float = math.nan
    battery_level: str = "good"
    charger: str = ""
    charging: bool = False
    overcurrent: int = 0
    buttons: int = 0
    firmware: str = ""
    hardware: str = ""
    unique_id: str = ""
    lost: float = 0.0


Message = Odometry | LaserScan | Sweep | Hazards | TagDetections | BaseState | SaidPose
T = TypeVar("T", Odometry, LaserScan, Sweep, Hazards, TagDetections, BaseState, SaidPose)

# Time to wait for an answer of the process, s.
ANSWER_TIMEOUT = 5.0
# A process that has not started, or a base that has been silent, for this time, s, is lost for good.
HOPELESS = 60.0
# Greatest number of queued and of remembered messages of a kind: half a minute of the fastest.
WAITING = 2000
# Greatest number of kinds of faults reported of one source, and of characters of a line.
_KINDS, _LONGEST = 5, 300
_NO_ANSWER = "the robot's process does not answer"


class DeviceError(BadInput, RuntimeError):
    """The robot cannot be used; the message is one line: what is wrong and how to mend it."""


def imported(name: str, package: str, extra: str) -> Any:
    """A package that comes with an extra of ours; raises DeviceError without it. name: of what needs it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise DeviceError(f"{name}: {package} is not installed: {pip_install(extra)}") from None


class Refusals:
    """Lines for the operator; counts refusals. counts: by source and kind of reason."""

    def __init__(self) -> None:
        self.counts: collections.Counter[tuple[str, str]] = collections.Counter()
        self._lines: collections.deque[str] = collections.deque()

    def add(self, source: str, kind: str, why: str) -> None:
        """Counts what was refused of a source, and tells the first of its kind: why, in words."""
        known = (source, kind) in self.counts
        if not known and sum(name == source for name, _ in self.counts) >= _KINDS:
            kind = "other"
            known = True
        self.counts[source, kind] += 1
        if not known:
            self.tell(" ".join(f"{source}: {why}".split())[:_LONGEST])

    def tell(self, line: str) -> None:
        """Tells something else, every time; from any thread."""
        self._lines.append(line)

    def take(self) -> list[str]:
        """The lines since the last call."""
        return [self._lines.popleft() for _ in range(len(self._lines))]


class Inbox:
    """Messages, lines for the operator and a fault until they are taken. refusals: the lines, of what cannot be used,
    too."""

    def __init__(self) -> None:
        self.refusals = Refusals()
        self._messages: list[Message] = []
        self._fault: str | None = None

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call: what was refused, lost or found again."""
        return self.refusals.take()

    def take(self) -> list[Message]:
        """The messages since the last call, those of a kind in the order they arrived."""
        taken, self._messages = self._messages, []
        return taken

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once or as long as it is so; None when all is well."""
        fault, self._fault = self._fault, None
        return fault


class Driver(Inbox):
    """A robot's driver, used by one thread; a method that has nothing to do may be left out.

    sources: name of each kind of message in a remark, such as "scan of /scan".
    """

    limits: Limits = Limits()
    sources: Mapping[type, str]

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""

    def send(self, speed: float, turn_rate: float) -> None:
        """Sends a velocity, m/s and rad/s, to the base."""

    def show(self, enabled: bool) -> None:
        """Shows on the robot, if it can, whether it may move; said every tick."""

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Tells others what the explorer knows, as a dictionary of a message's fields, from a thread of its own; a
        header's stamp is the host's time, s."""

    def close(self) -> None:
        """Lets go of the robot."""


class Outbox:
    """Sends pairs of a key and what it stands for from a thread of its own: whoever reads late holds nothing up."""

    def __init__(self, connection: Connection, most: int | None = None) -> None:
        """most: how many pairs wait to be sent, at the most, the oldest of more being lost; None: of each key the
        newest waits."""
        self._connection, self._most = connection, most
        self._waiting: dict[object, tuple[str, Any]] = {}
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, key: str, content: Any) -> None:
        """Has a pair sent."""
        with self._changed:
            self._waiting[key if self._most is None else next(self._numbers)] = key, content
            if self._most is not None and len(self._waiting) > self._most:
                del self._waiting[next(iter(self._waiting))]
            self._changed.notify()

    def close(self) -> None:
        """Sends nothing more; the other end must be reading, or gone."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                waiting, self._waiting = self._waiting, {}
            try:
                for one in waiting.values():
                    self._connection.send(one)
            except OSError:
                return  # the process has ended; Device says so


# What the process is told, pickled, and calls: the driver, its robot found, odometry arriving; raises DeviceError.
OpenDriver = Callable[[], Driver]


class Device:
    """A robot: its messages, and a velocity that lasts half a second.

    Nothing moves before `enable`. Without a new command the velocity is zero after SILENCE. After a clock's
    jump or when odometry was silent the robot stands until `enable` is called again; `locked` says why.

    heard: how often the process has said anything, which it does twice a second at least. ended: why there is no
    process any more; None as long as there is one.
    """

    def __init__(self, open_driver: OpenDriver) -> None:
        """Starts the process, which opens the driver, and waits until odometry arrives; raises DeviceError."""
        self._open_driver = open_driver
        self._changed = threading.Condition()
        self._newest: dict[type, Message] = {}
        self._waiting: dict[type, collections.deque[Message]] = {}
        self._odometry: collections.deque[Odometry] = collections.deque(maxlen=WAITING)
        self._remarks: list[str] = []
        self.heard = self._answers = 0
        self._open()

    def _open(self) -> None:
        """Does so, anew where there was a process that has ended."""
        self._locked: str | None = "not enabled yet"
        # Whether the process takes no orders.
        self._full = False
        self.ended: str | None = None
        before = self.heard
        self._reader = threading.Thread(target=self._read, daemon=True)
        try:
            self._start()
        except (OSError, RuntimeError) as error:  # RuntimeError is what a thread raises that cannot be started
            self.ended = f"no process for it can be started: {error.args[-1]}; end other programs"
            raise DeviceError(self.ended) from None
        self._put(self._open_driver)
        with self._changed:
            begun = self._changed.wait_for(lambda: self.heard > before, HOPELESS)
        line = self.ended or ("" if begun else f"the robot's process did not begin in {HOPELESS:.0f} s")
        if line:
            Device.close(self)
            raise DeviceError(line)

    def _start(self) -> None:
        """Raises OSError, RuntimeError where the machine has too little left; nothing stays open then."""
        with contextlib.ExitStack() as undo:
            self._connection, theirs = Pipe()
            undo.callback(self._connection.close)  # The process ends then, if there is one.
            announced, announcing = Pipe(duplex=False)
            with theirs, announced:
                given = theirs.fileno(), announced.fileno()
                self._process = process.start("tfg_drake.hardware.driver_process", *given)
            self._announcements = Outbox(announcing)
            undo.callback(self._announcements.close)
            self._reader.start()
            undo.pop_all()

    def newest(self, kind: type[T]) -> T | None:
        """The newest message of a kind, such as Odometry; None where none has arrived yet."""
        message = self._newest.get(kind)
        return message if isinstance(message, kind) else None

    def first(self, kind: type[T]) -> T:
        """The newest message of a kind, waited for where none has arrived yet; raises DeviceError where none comes."""
        with self._changed:
            self._changed.wait_for(lambda: kind in self._newest or self.ended is not None, ANSWER_TIMEOUT)
        message = self.newest(kind)
        if message is None:
            raise DeviceError(self.ended or f"no {kind.__name__} in {ANSWER_TIMEOUT:.0f} s: is the robot switched on?")
        return message

    def take(self, kind: type[T], until: float) -> list[T]:
        """The messages of a kind that are stamped `until` (s) or before and were not taken yet, in order."""
        taken: list[T] = []
        with self._changed:
            waiting = self._waiting.get(kind, collections.deque())
            while waiting and waiting[0].stamp <= until:
                message = waiting.popleft()
                assert isinstance(message, kind)
                taken.append(message)
        return taken

    def odometry_near(self, stamp: float) -> Odometry | None:
        """The odometry that was stamped nearest to `stamp`, s; None where there is none, or none within a second."""
        with self._changed:
            nearest = min(self._odometry, key=lambda one: abs(one.stamp - stamp), default=None)
        return nearest if nearest is not None and abs(nearest.stamp - stamp) < 1.0 else None

    @property
    def locked(self) -> str | None:
        """Why the robot may not move; None when it may."""
        return self.ended or (_NO_ANSWER if self._full else self._locked)

    def take_remarks(self) -> list[str]:
        """The process's lines for the operator since the last call, each line once."""
        with self._changed:
            remarks, self._remarks = self._remarks, []
        return remarks

    def command(self, speed: float, turn_rate: float, due: float | None = None) -> None:
        """The velocity from now on, m/s and rad/s; repeat it at 20 Hz or more.

        due: when it was to be given, s, by default now: one that is late is not obeyed for longer. Where the process is
        held up the command is lost: it stands by itself when it runs again. Raises DeviceError where it has ended.
        """
        self._put(("command", time.monotonic() if due is None else due, float(speed), float(turn_rate)))

    def lock(self, reason: str) -> None:
        """Stops the robot at once, until `enable`; raises DeviceError."""
        self._put(("lock", reason))

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Has the driver publish a message."""
        self._announcements.put(key, message)

    def enable(self) -> None:
        """Lets the commands that follow move the robot; raises DeviceError where it may not."""
        with self._changed:
            before = self._answers
            answered = self._put(("enable", time.monotonic())) and self._changed.wait_for(
                lambda: self._answers > before or bool(self.ended), ANSWER_TIMEOUT
            )
        if not answered or self.locked is not None:
            raise DeviceError(f"the robot is not enabled: {self.locked if answered else _NO_ANSWER}")

    def close(self) -> None:
        """Stops the robot and ends the process."""
        with contextlib.suppress(DeviceError):
            self._put(("close",))
        self.ended = self.ended or "closed"
        try:
            self._process.wait(ANSWER_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader.is_alive():  # else it has ended, or could not be started
            self._reader.join()
        self._announcements.close()
        self._connection.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _put(self, order: Any) -> bool:
        """Returns True if the order went out: a held-up process has a full pipe."""
        if self.ended is not None:
            raise DeviceError(self.ended)
        try:
            # Unlike select, which fails where the process has more than 1024 descriptors.
            room = select.poll()
            room.register(self._connection, select.POLLOUT)
            self._full = not room.poll(0)
            if not self._full:
                self._connection.send(order)
        except OSError:
            raise DeviceError("the robot's process has ended") from None
        return not self._full

    def _read(self) -> None:
        while True:
            try:
                kind, content = self._connection.recv()
            except (EOFError, OSError):
                kind, content = "ended", "the robot's process has ended"
            with self._changed:
                self.heard += 1
                if kind == "message":
                    for value in vars(content).values():  # pickling loses that arrays are read-only
                        if isinstance(value, np.ndarray):
                            value.setflags(write=False)
                    self._newest[type(content)] = content
                    if isinstance(content, Odometry):
                        self._odometry.append(content)
                    self._waiting.setdefault(type(content), collections.deque(maxlen=WAITING)).append(content)
                elif kind == "locked":
                    self._locked = content
                elif kind == "remark":
                    self._remarks.append(content)
                elif kind == "answer":
                    self._answers, self._locked = self._answers + 1, content
                elif kind == "ended":
                    self.ended = self.ended or content
                self._changed.notify_all()
            if kind == "ended":
                return

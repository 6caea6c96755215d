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
    """State of a base that reports it: about every second, and at once when a lasting field changes.

    stamp: s. battery: V. charge: remaining share of the battery's charge; both nan if unknown. battery_level: "good"
    (also if unknown), "low" or "dangerous". charger: the connected charger, "dock", "adapter" or "charger", "" for
    none. charging: its battery is not full yet. overcurrent: wheels with overcurrent, bits of Side. buttons: pressed
    buttons, bits of Button. firmware, hardware: versions such as "1.1.4". unique_id: in hexadecimal. lost: share of its
    frames since the previous state that were garbled or missing.
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

# Time to wait for the process's answer or a first message, s; an older request to enable is ignored.
ANSWER_TIMEOUT = 5.0
# The robot is given up if its process does not start, or a message of it stays stale, for HOPELESS, s.
HOPELESS = 60.0
# Greatest number of queued or remembered messages of a kind: half a minute of the fastest one. Then the oldest is lost.
WAITING = 2000
# Of each source at most _KINDS kinds of faults are reported; a line is cut after _LONGEST characters.
_KINDS, _LONGEST = 5, 300
_NO_ANSWER = "the robot's process does not answer"


class DeviceError(BadInput, RuntimeError):
    """The robot cannot be used; the message is one line: what is wrong and how to mend it."""


def imported(name: str, package: str, extra: str) -> Any:
    """Return a package of one of our extras. name: what needs it. Raises DeviceError if it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise DeviceError(f"{name}: {package} is not installed: {pip_install(extra)}") from None


class Refusals:
    """Lines for the operator, and counts of refusals by source and kind of reason."""

    def __init__(self) -> None:
        self.counts: collections.Counter[tuple[str, str]] = collections.Counter()
        self._lines: collections.deque[str] = collections.deque()

    def add(self, source: str, kind: str, why: str) -> None:
        """Count a refusal of a source, and report the first of its kind. why: the reason in words."""
        known = (source, kind) in self.counts
        if not known and sum(name == source for name, _ in self.counts) >= _KINDS:
            kind = "other"
            known = True
        self.counts[source, kind] += 1
        if not known:
            self.tell(" ".join(f"{source}: {why}".split())[:_LONGEST])

    def tell(self, line: str) -> None:
        """Add a line in any case; callable from any thread."""
        self._lines.append(line)

    def take(self) -> list[str]:
        """Return the lines since the last call."""
        return [self._lines.popleft() for _ in range(len(self._lines))]


class Inbox:
    """Holds messages, lines for the operator and a fault until they are taken. refusals: the lines, also on unusable
    messages."""

    def __init__(self) -> None:
        self.refusals = Refusals()
        self._messages: list[Message] = []
        self._fault: str | None = None

    def remarks(self) -> list[str]:
        """Return the lines for the operator since the last call: on what was refused, lost or found again."""
        return self.refusals.take()

    def take(self) -> list[Message]:
        """Return the messages since the last call, each kind in order of arrival."""
        taken, self._messages = self._messages, []
        return taken

    def fault(self) -> str | None:
        """Return why the robot must stop until it is enabled anew, once or as long as that holds; None for no fault."""
        fault, self._fault = self._fault, None
        return fault


class Driver(Inbox):
    """A robot's driver, used by one thread; a method without a task may be left out.

    sources: name of each kind of message in a remark, such as "scan of /scan".
    """

    limits: Limits = Limits()
    sources: Mapping[type, str]

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""

    def send(self, speed: float, turn_rate: float) -> None:
        """Sends a velocity, m/s and rad/s, to the base."""

    def show(self, enabled: bool) -> None:
        """Show on the robot, if it has a display, whether it may move; called every tick."""

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publish the explorer's knowledge as a dictionary of a message's fields; called from a thread of its own. A
        header's stamp is the host's time, s."""

    def close(self) -> None:
        """Lets go of the robot."""


class Outbox:
    """Sends pairs of a key and its content from a thread of its own: a late reader holds nothing up."""

    def __init__(self, connection: Connection, most: int | None = None) -> None:
        """most: greatest number of queued pairs, beyond which the oldest is lost; None: the newest pair of each key is
        queued."""
        self._connection, self._most = connection, most
        self._waiting: dict[object, tuple[str, Any]] = {}
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, key: str, content: Any) -> None:
        """Queue a pair to be sent."""
        with self._changed:
            self._waiting[key if self._most is None else next(self._numbers)] = key, content
            if self._most is not None and len(self._waiting) > self._most:
                del self._waiting[next(iter(self._waiting))]
            self._changed.notify()

    def close(self) -> None:
        """Stop sending; the other end must be reading, or gone."""
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


# Pickled and called in the process: returns a driver whose robot is found and sends odometry, or raises DeviceError.
OpenDriver = Callable[[], Driver]


class Device:
    """A robot: its messages, and velocity commands, each valid for half a second.

    Nothing moves before `enable`. Without a new command the velocity is zero after SILENCE. After a jump of the clock
    or missing odometry the robot stands until `enable` is called again; `locked` says why.

    heard: number of items received from the process, at least two a second. ended: why the process has ended, None
    while it runs.
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
        """Start the process, also after an earlier one, and wait until it begins. Raises DeviceError."""
        self._locked: str | None = "not enabled yet"
        # The process takes no orders: its pipe is full.
        self._full = False
        self.ended: str | None = None
        before = self.heard
        self._reader = threading.Thread(target=self._read, daemon=True)
        try:
            self._start()
        except (OSError, RuntimeError) as error:  # RuntimeError: a thread could not be started
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
        """Start process and threads. Raises OSError, RuntimeError if resources are lacking; then nothing stays open."""
        with contextlib.ExitStack() as undo:
            self._connection, theirs = Pipe()
            undo.callback(self._connection.close)  # This ends the process, if it runs.
            announced, announcing = Pipe(duplex=False)
            with theirs, announced:
                given = theirs.fileno(), announced.fileno()
                self._process = process.start("tfg_drake.hardware.driver_process", *given)
            self._announcements = Outbox(announcing)
            undo.callback(self._announcements.close)
            self._reader.start()
            undo.pop_all()

    def newest(self, kind: type[T]) -> T | None:
        """Return the newest message of a kind, such as Odometry; None before the first."""
        message = self._newest.get(kind)
        return message if isinstance(message, kind) else None

    def first(self, kind: type[T]) -> T:
        """Return the newest message of a kind, or wait for the first. Raises DeviceError if none arrives."""
        with self._changed:
            self._changed.wait_for(lambda: kind in self._newest or self.ended is not None, ANSWER_TIMEOUT)
        message = self.newest(kind)
        if message is None:
            raise DeviceError(self.ended or f"no {kind.__name__} in {ANSWER_TIMEOUT:.0f} s: is the robot switched on?")
        return message

    def take(self, kind: type[T], until: float) -> list[T]:
        """Return the messages of a kind with stamps up to `until` (s) that were not taken yet, in order."""
        taken: list[T] = []
        with self._changed:
            waiting = self._waiting.get(kind, collections.deque())
            while waiting and waiting[0].stamp <= until:
                message = waiting.popleft()
                assert isinstance(message, kind)
                taken.append(message)
        return taken

    def odometry_near(self, stamp: float) -> Odometry | None:
        """Return the odometry message with the stamp nearest to `stamp`, s; None if none is within a second of it."""
        with self._changed:
            nearest = min(self._odometry, key=lambda one: abs(one.stamp - stamp), default=None)
        return nearest if nearest is not None and abs(nearest.stamp - stamp) < 1.0 else None

    @property
    def locked(self) -> str | None:
        """Why the robot may not move; None if it may."""
        return self.ended or (_NO_ANSWER if self._full else self._locked)

    def take_remarks(self) -> list[str]:
        """Return the process's lines for the operator since the last call."""
        with self._changed:
            remarks, self._remarks = self._remarks, []
        return remarks

    def command(self, speed: float, turn_rate: float, due: float | None = None) -> None:
        """Command a velocity, m/s and rad/s; repeat it at 20 Hz or more.

        due: time at which it was due, s, by default now: a late command is valid for less time. While the process is
        held up commands are lost; it lets the robot stand when it runs again. Raises DeviceError if it has ended.
        """
        self._put(("command", time.monotonic() if due is None else due, float(speed), float(turn_rate)))

    def lock(self, reason: str) -> None:
        """Stop the robot at once, until `enable`. Raises DeviceError."""
        self._put(("lock", reason))

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Let the driver publish a message."""
        self._announcements.put(key, message)

    def enable(self) -> None:
        """Let the following commands move the robot. Raises DeviceError if it may not move."""
        with self._changed:
            before = self._answers
            answered = self._put(("enable", time.monotonic())) and self._changed.wait_for(
                lambda: self._answers > before or bool(self.ended), ANSWER_TIMEOUT
            )
        if not answered or self.locked is not None:
            raise DeviceError(f"the robot is not enabled: {self.locked if answered else _NO_ANSWER}")

    def close(self) -> None:
        """Stop the robot and end the process."""
        with contextlib.suppress(DeviceError):
            self._put(("close",))
        self.ended = self.ended or "closed"
        try:
            self._process.wait(ANSWER_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader.is_alive():  # otherwise it has ended, or could not be started
            self._reader.join()
        self._announcements.close()
        self._connection.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _put(self, order: Any) -> bool:
        """Send an order; returns False if the pipe is full because the process is held up. Raises DeviceError."""
        if self.ended is not None:
            raise DeviceError(self.ended)
        try:
            # select would fail with more than 1024 file descriptors.
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
                    for value in vars(content).values():  # unpickled arrays are no longer read-only
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

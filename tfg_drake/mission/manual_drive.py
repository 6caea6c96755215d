"""Manual driving: the effect of keys on the velocity, and the keys of a drive as a file, for a replay."""

from __future__ import annotations

import math
from pathlib import Path

from tfg_drake.config import RobotConfig
from tfg_drake.io.files import FileError, read_text
from tfg_drake.messages import message

FORWARD, BACK, LEFT, RIGHT, HALT, LOOK, END = "forward", "back", "left", "right", "halt", "look", "end"
KEYS = {
    "w": FORWARD,
    "x": BACK,
    "a": LEFT,
    "d": RIGHT,
    "s": HALT,
    " ": HALT,
    "l": LOOK,
    "q": END,
    "\x1b[A": FORWARD,
    "\x1b[B": BACK,
    "\x1b[C": RIGHT,
    "\x1b[D": LEFT,
}
HELP = "keys: arrows or w a d x faster, left, right, slower; space (or s) halt, l look round, q end"
# Change of the velocity by a key, m/s and rad/s.
SPEED_STEP, TURN_STEP = 0.1, 0.3

_HEADER = "time_s,key"


class DriveError(FileError):
    """A file without a drive; the message is one line."""


@message
class Pressed:
    """A key pressed at a time, s; key: one of the values of KEYS, or the result of `stick` or `send`."""

    time: float
    key: str


def stick(forward: float, left: float) -> str:
    """Return the key of a gamepad's stick by its deflections forward and to the left, shares of 1."""
    bounded = (max(-1.0, min(share, 1.0)) for share in (forward, left))
    return " ".join(["stick", *(f"{share:.2f}" for share in bounded)])


def send(x: float, y: float) -> str:
    """Return the key that sends the robot to a place, m in M."""
    return f"send {float(x)!r} {float(y)!r}"


def place_sent(key: str) -> tuple[float, float] | None:
    """Return the place (x, y), m in M, that a key sends the robot to, None for other keys."""
    return _two_numbers(key, "send")


def _pushed(key: str) -> tuple[float, float] | None:
    """The deflections of a stick, None for other keys."""
    pushed = _two_numbers(key, "stick")
    return pushed if pushed is not None and max(map(abs, pushed)) <= 1.0 else None


def _two_numbers(key: str, word: str) -> tuple[float, float] | None:
    name, *numbers = key.split(" ")
    try:
        first, second = map(float, numbers)
    except ValueError:
        return None
    return (first, second) if name == word and math.isfinite(first) and math.isfinite(second) else None


def steered(velocity: tuple[float, float], key: str, robot: RobotConfig) -> tuple[float, float]:
    """Return the velocity (m/s, rad/s) after a key, within the robot's limits; it holds until the next key."""
    v, w = velocity
    pushed = _pushed(key)
    if pushed is not None:
        return round(pushed[0] * robot.max_speed, 6), round(pushed[1] * robot.max_turn_rate, 6)
    if key in (HALT, LOOK, END):
        return 0.0, 0.0
    v += SPEED_STEP * ((key == FORWARD) - (key == BACK))
    w += TURN_STEP * ((key == LEFT) - (key == RIGHT))
    bounded = max(-robot.max_speed, min(v, robot.max_speed)), max(-robot.max_turn_rate, min(w, robot.max_turn_rate))
    # Steps forward and back must end at rest in spite of rounding.
    return round(bounded[0], 6), round(bounded[1], 6)


def drive_csv(drive: tuple[Pressed, ...]) -> str:
    """Return a drive as the text of a file; times are exact to the bit."""
    return "\n".join([_HEADER, *(f"{one.time!r},{one.key}" for one in drive), ""])


def read_drive(path: Path) -> tuple[Pressed, ...]:
    """Read the keys of a drive, in the order of their times. Raises DriveError."""
    try:
        lines = read_text(path).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DriveError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'it is no text'}") from None
    if not lines or lines[0] != _HEADER:
        raise DriveError(f"{path}: holds no drive; name the keys.csv of a run with --method manual")
    drive = []
    for number, line in enumerate(lines[1:], start=2):
        time, _, key = line.partition(",")
        try:
            drive.append(Pressed(float(time), key))
        except ValueError:
            key = ""
        known = key in KEYS.values() or _pushed(key) or place_sent(key)
        if not known or (len(drive) > 1 and not drive[-1].time >= drive[-2].time):
            raise DriveError(f"{path}, line {number}: expected a time, not before the last, and a key; mend the line")
    return tuple(drive)

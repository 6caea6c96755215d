"""The protocol on an RPLidar's serial line, both ways.

A request is `A5 | command`, one with a payload `A5 | command | length | payload | xor` of all bytes before. An answer
is a descriptor, `A5 5A | length and mode | type`, and that many bytes, again and again where the mode is 1. Numbers are
little-endian. Source: Slamtec, RPLIDAR S and A series interface protocol 2.8.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
import operator
import struct

# Baud rates of the A1 and most of the A2, and of the A2M7, A2M12 and A3.
BAUD_RATES = (115200, 256000)


class Command(enum.IntEnum):
    """Requests to a scanner."""

    STOP = 0x25
    RESET = 0x40
    SCAN = 0x20
    GET_INFO = 0x50
    GET_HEALTH = 0x52
    MOTOR = 0xF0


class Health(enum.IntEnum):
    """Answers to GET_HEALTH; FAILED of a scanner that has stopped itself."""

    GOOD = 0
    WARNING = 1
    FAILED = 2


# Of the answer to each command: type, length, bytes, and whether it repeats.
ANSWERS = {Command.GET_INFO: (0x04, 20, False), Command.GET_HEALTH: (0x06, 3, False), Command.SCAN: (0x81, 5, True)}
# Motor duty, of 1023, at which an A2 or A3 turns ten times a second.
DUTY = 660

_NODE = struct.Struct("<BHH")
# A node is passed on if it begins _RUN plausible nodes in a row after lost bytes, otherwise _NEXT: a node whose last
# bytes are lost looks plausible itself.
_RUN, _NEXT = 6, 2
# Greatest increase and decrease of the angle from one node to the next, degrees.
_AHEAD, _BACK = 20.0, 3.0


def request(command: int, payload: bytes = b"") -> bytes:
    """Return the bytes of a command."""
    if not payload:
        return bytes((0xA5, command))
    body = bytes((0xA5, command, len(payload))) + payload
    return body + bytes((functools.reduce(operator.xor, body),))


def motor(duty: int) -> bytes:
    """Return the request that sets the motor's duty, 0 to 1023."""
    return request(Command.MOTOR, struct.pack("<H", duty))


def descriptor(command: Command) -> bytes:
    """Return the descriptor of a command's answer."""
    kind, length, goes_on = ANSWERS[command]
    return b"\xa5\x5a" + struct.pack("<I", length | (int(goes_on) << 30)) + bytes((kind,))


def answer(data: bytes, command: Command) -> bytes | None:
    """Return the data after the descriptor of a command's answer, of a repeating answer all that follow; None while
    they are missing or incomplete."""
    _, length, goes_on = ANSWERS[command]
    _, found, rest = data.partition(descriptor(command))
    if not found or (len(rest) < length and not goes_on):
        return None
    return rest if goes_on else rest[:length]


def model(told: bytes) -> int:
    """Return the model by a GET_INFO answer: 1 for an A1, 2 for an A2, 3 for an A3."""
    return told[0] >> 4


@dataclasses.dataclass(frozen=True)
class Node:
    """A ray. begins: it is the first of a revolution. angle: rad, clockwise as seen from above, from the scanner's x
    axis. range: m, nan without a return."""

    begins: bool
    angle: float
    range: float


def encode(node: Node) -> bytes:
    """Return the five bytes of a ray."""
    angle = round(math.degrees(node.angle) * 64.0) & 0x7FFF
    quarters = 0 if math.isnan(node.range) else round(node.range * 4000.0)
    quality = 15 if quarters else 0
    return _NODE.pack(quality << 2 | (1 if node.begins else 2), angle << 1 | 1, quarters)


class NodeDecoder:
    """Decodes rays from the arriving bytes. A ray has three check bits, and angles increase: after lost bytes rays are
    accepted again once several are consistent in a row.

    lost: bytes that belonged to no ray.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._pending = bytearray()
        # Angle of the last ray, degrees; None while the next one is searched for.
        self._angle: float | None = None

    def feed(self, data: bytes) -> list[Node]:
        """Return the rays that these bytes complete."""
        self._pending += data
        nodes = []
        at = 0
        while at + _NODE.size * (run := _RUN if self._angle is None else _NEXT) <= len(self._pending):
            angle = _angle(self._pending, at, self._angle)
            if angle is not None and self._runs(at, run):
                self._angle = angle
                first, _, quarters = _NODE.unpack_from(self._pending, at)
                distance = quarters / 4000.0 if quarters else math.nan
                nodes.append(Node(bool(first & 1), math.radians(angle), distance))
                at += _NODE.size
            elif self._angle is not None:
                self._angle = None  # the ray may be good, and the ones before it lost
            else:
                at += 1
                self.lost += 1
        del self._pending[:at]
        return nodes

    def _runs(self, at: int, run: int) -> bool:
        angle: float | None = None
        for k in range(run):
            angle = _angle(self._pending, at + _NODE.size * k, angle)
            if angle is None:
                return False
        return True


def _angle(data: bytearray, at: int, before: float | None) -> float | None:
    """Return the angle of the ray that begins there, degrees; None if none does or it does not follow `before`."""
    first, second = data[at], data[at + 1]
    if (first & 1) == (first >> 1 & 1) or not second & 1:
        return None
    angle = (second >> 1 | data[at + 2] << 7) / 64.0
    if angle >= 361.0:
        return None
    if before is not None and not -_BACK <= (angle - before + 180.0) % 360.0 - 180.0 <= _AHEAD:
        return None
    return angle

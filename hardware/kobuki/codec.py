"""The Kobuki's serial protocol, both ways: its sub-payloads, whole numbers in the wire's units, and their bytes.

A frame is `AA 55 | length | payload | xor`, the xor over length and payload. A payload is a row of sub-payloads
`id | length | data`, little-endian. An id means one thing in COMMANDS (host to base) and another in FEEDBACK (base to
host). Source: the vendor's driver kobuki_core 1.4.0 (packets/*.hpp, command.cpp) and the protocol appendix of its
developer guide; where they disagree, the driver's code. "0.1 V" and so on is the unit of a number;
tfg_drake.hardware.kobuki.odometry converts them to SI units. Other data of the base, on its dock, its motors' currents
or its expansion port, are not read.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import operator
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar

BAUD_RATE = 115200
# Time between two frames of feedback, s.
PERIOD = 0.02
HEADER = b"\xaa\x55"
# Least and greatest length of a payload, bytes: one sub-payload with a byte of data; the greatest value of the length.
MIN_PAYLOAD, MAX_PAYLOAD = 3, 255


@dataclasses.dataclass(frozen=True)
class SubPayload:
    """Sub-payload of a frame; each kind is a frozen dataclass. ID: its number. DATA: the layout of its fields."""

    ID: ClassVar[int]
    DATA: ClassVar[struct.Struct]


@dataclasses.dataclass(frozen=True)
class Other(SubPayload):
    """A sub-payload that is not read. number: its id. content: its bytes."""

    number: int
    content: bytes


class Tune(enum.IntEnum):
    """Some of a SoundSequence's."""

    ON = 0
    OFF = 1


class Extra(enum.IntFlag):
    """Flags of RequestExtra."""

    HARDWARE = 1
    FIRMWARE = 2
    UNIQUE_ID = 8


class Output(enum.IntFlag):
    """Bits of GeneralOutput: all power rails, the first LED."""

    POWER = 0x00F0
    RED = 0x0100
    GREEN = 0x0200


class Wheel(enum.IntFlag):
    """Bits of CoreSensors.wheel_drop."""

    RIGHT = 1
    LEFT = 2


class Motor(enum.IntFlag):
    """Bits of CoreSensors.overcurrent."""

    LEFT = 1
    RIGHT = 2


class Charger(enum.IntFlag):
    """Bits of CoreSensors.charger; where ADAPTER is not set it hangs in its dock."""

    CONNECTED = 2
    CHARGING = 4
    ADAPTER = 16


# --- Host to base ---


@dataclasses.dataclass(frozen=True)
class BaseControl(SubPayload):
    """How to drive. speed: of the outer wheel, mm/s. radius: of the arc, mm; 0 straight ahead, 1 turn in place."""

    ID = 1
    DATA = struct.Struct("<hh")
    speed: int = 0
    radius: int = 0


@dataclasses.dataclass(frozen=True)
class SoundSequence(SubPayload):
    """A tune. number: 0 on, 1 off, 2 recharge, 3 button, 4 error, 5 cleaning starts, 6 cleaning ends."""

    ID = 4
    DATA = struct.Struct("<B")
    number: int


@dataclasses.dataclass(frozen=True)
class RequestExtra(SubPayload):
    """Asks for what is not in every frame. flags: bits of Extra."""

    ID = 9
    DATA = struct.Struct("<H")
    flags: int


@dataclasses.dataclass(frozen=True)
class GeneralOutput(SubPayload):
    """All outputs at once. bits: 0x000F digital, 0x00F0 power (3.3 V, 5 V, 12 V 5 A, 12 V 1.5 A), 0x0F00 the LEDs' (red
    1, green 1, red 2, green 2). Power bits of 0 cut the power of sensors that hang on them."""

    ID = 12
    DATA = struct.Struct("<H")
    bits: int


# --- Base to host ---


@dataclasses.dataclass(frozen=True)
class CoreSensors(SubPayload):
    """Core sensor data, in every frame.

    stamp: ms, wraps at 65536. bumper: bits 1 right, 2 centre, 4 left. wheel_drop: bits of Wheel. cliff: bits as
    the bumper's. left_encoder, right_encoder: ticks, wrap at 65536. left_pwm, right_pwm: as the motors get it. buttons:
    bits 1, 2, 4. charger: bits of Charger. battery:
    0.1 V. overcurrent: bits of Motor.
    """

    ID = 1
    DATA = struct.Struct("<HBBBHHbbBBBB")
    stamp: int
    bumper: int
    wheel_drop: int
    cliff: int
    left_encoder: int
    right_encoder: int
    left_pwm: int
    right_pwm: int
    buttons: int
    charger: int
    battery: int
    overcurrent: int


@dataclasses.dataclass(frozen=True)
class Inertia(SubPayload):
    """The gyro about the vertical axis. angle: 0.01 degrees, integrated by the base. rate: 0.01 degrees/s."""

    ID = 4
    DATA = struct.Struct("<hh3x")
    angle: int
    rate: int


@dataclasses.dataclass(frozen=True)
class Version(SubPayload):
    """A version, such as 1.1.4."""

    DATA = struct.Struct("<BBBx")
    patch: int
    minor: int
    major: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.patch}"


class HardwareVersion(Version):
    """Version of the board."""

    ID = 10


class FirmwareVersion(Version):
    """Version of the firmware."""

    ID = 11


@dataclasses.dataclass(frozen=True)
class UniqueId(SubPayload):
    """Three words that no other base has."""

    ID = 19
    DATA = struct.Struct("<III")
    a: int
    b: int
    c: int


# Kinds by id.
Kinds = Mapping[int, type[SubPayload]]
COMMANDS: Kinds = {kind.ID: kind for kind in (BaseControl, SoundSequence, RequestExtra, GeneralOutput)}
FEEDBACK: Kinds = {kind.ID: kind for kind in (CoreSensors, Inertia, HardwareVersion, FirmwareVersion, UniqueId)}

# Versions that old firmware writes in two bytes: by their number, (patch, minor, major).
_OLD_VERSIONS: dict[type[SubPayload], dict[int, tuple[int, int, int]]] = {
    HardwareVersion: {104: (4, 0, 1)},
    FirmwareVersion: {123: (0, 0, 1), 110: (0, 1, 1), 10100: (0, 1, 1), 111: (1, 1, 1), 10101: (1, 1, 1)},
}


def checksum(body: bytes) -> int:
    """Return the xor of all bytes; body: length and payload."""
    return functools.reduce(operator.xor, body, 0)


def encode(*parts: SubPayload) -> bytes:
    """Return the frame with some sub-payloads. Raises ValueError if a number or the whole does not fit."""
    payload = b"".join(bytes([number, len(data)]) + data for number, data in map(_numbered, parts))
    if not MIN_PAYLOAD <= len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"a payload of {len(payload)} bytes; a frame carries {MIN_PAYLOAD} to {MAX_PAYLOAD}")
    body = bytes([len(payload)]) + payload
    return HEADER + body + bytes([checksum(body)])


def _numbered(part: SubPayload) -> tuple[int, bytes]:
    if isinstance(part, Other):
        return part.number, part.content
    try:
        return part.ID, part.DATA.pack(*(getattr(part, field.name) for field in dataclasses.fields(part)))
    except struct.error as error:
        raise ValueError(f"{part}: {error}") from None


def decode(payload: bytes, kinds: Kinds) -> tuple[SubPayload, ...]:
    """Return the sub-payloads of one payload, in order.

    Those with an unknown id or an impossible length, or cut off by the payload's end, are skipped.
    """
    whole = [(number, data) for number, data, end in _split(payload) if end <= len(payload)]
    parts = [_part(kinds[number], data) for number, data in whole if number in kinds]
    return tuple(part for part in parts if part is not None)


def _split(payload: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Return ids and data of sub-payloads, known or not, and their ends: the last may lie beyond the payload."""
    at = 0
    while at + 2 <= len(payload):
        number, begin, at = payload[at], at + 2, at + 2 + payload[at + 1]
        yield number, payload[begin:at], at


def _part(kind: type[SubPayload], data: bytes) -> SubPayload | None:
    make: Callable[..., SubPayload] = kind
    if kind in _OLD_VERSIONS and len(data) == 2:
        version = _OLD_VERSIONS[kind].get(int.from_bytes(data, "little"))
        return None if version is None else make(*version)
    return make(*kind.DATA.unpack(data)) if len(data) == kind.DATA.size else None


def _tiled(payload: bytes) -> bool:
    """Return True if whole sub-payloads, known or not, fill the payload."""
    return max((end for *_, end in _split(payload)), default=0) == len(payload)


class Deframer:
    """Finds the payloads in a stream of bytes that may begin, break off and be garbled anywhere.

    A checksum of one byte is right by chance once in 256 times, so a payload must consist of whole sub-payloads, too.
    bad: number of false beginnings of a frame. A true frame may follow within one: the search goes on at its next byte.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.bad = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads with a right checksum that these bytes complete."""
        buffer, found, at = self._buffer, [], 0
        buffer += data
        while (start := buffer.find(HEADER, at)) >= 0:
            at = start
            if len(buffer) < at + 3:
                break
            length = buffer[at + 2]
            end = at + 4 + length
            if length >= MIN_PAYLOAD and len(buffer) < end:
                break
            body = bytes(buffer[at + 2 : end - 1])
            if length >= MIN_PAYLOAD and checksum(body) == buffer[end - 1] and _tiled(body[1:]):
                found.append(body[1:])
                at = end
            else:
                self.bad += 1
                at += 1
        else:
            # The last byte may be half a header.
            at = len(buffer) - (buffer[-1:] == HEADER[:1])
        del buffer[:at]
        return found

"""The bytes on the Kobuki's serial line: frames, their checksum, and the sub-payloads in them, both ways.

A frame is `AA 55 | length | payload | xor`, the xor over length and payload. A payload is a row of sub-payloads
`id | length | data`, little-endian. An id means one thing in COMMANDS (host to base) and another in FEEDBACK (base to
host). Source: the vendor's driver kobuki_core 1.4.0, see tfg_drake.hardware.kobuki.payloads.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
import struct
from collections.abc import Callable, Mapping

from tfg_drake.hardware.kobuki import payloads
from tfg_drake.hardware.kobuki.payloads import FirmwareVersion, HardwareVersion, Other, SubPayload

BAUD_RATE = 115200
HEADER = b"\xaa\x55"
# Least and greatest length of a payload: one sub-payload with a byte of data; what the length's byte can say.
MIN_PAYLOAD, MAX_PAYLOAD = 3, 255

# Kinds by id.
Kinds = Mapping[int, type[SubPayload]]
COMMANDS: Kinds = {
    1: payloads.BaseControl,
    4: payloads.SoundSequence,
    9: payloads.RequestExtra,
    12: payloads.GeneralOutput,
}
FEEDBACK: Kinds = {
    1: payloads.CoreSensors,
    4: payloads.Inertia,
    10: payloads.HardwareVersion,
    11: payloads.FirmwareVersion,
    19: payloads.UniqueId,
}
_ID = {kind: number for kinds in (COMMANDS, FEEDBACK) for number, kind in kinds.items()}

# Versions that old firmware writes in two bytes, as (patch, minor, major).
_OLD_VERSIONS: dict[type[SubPayload], dict[int, tuple[int, int, int]]] = {
    HardwareVersion: {104: (4, 0, 1)},
    FirmwareVersion: {123: (0, 0, 1), 110: (0, 1, 1), 10100: (0, 1, 1), 111: (1, 1, 1), 10101: (1, 1, 1)},
}


def checksum(body: bytes) -> int:
    """The xor of all bytes; body: length and payload."""
    return functools.reduce(operator.xor, body, 0)


def encode(*parts: SubPayload) -> bytes:
    """The frame that carries these sub-payloads. Raises ValueError where a number or the whole does not fit."""
    payload = b"".join(bytes([number, len(data)]) + data for number, data in map(_numbered, parts))
    if not MIN_PAYLOAD <= len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"a payload of {len(payload)} bytes; a frame carries {MIN_PAYLOAD} to {MAX_PAYLOAD}")
    body = bytes([len(payload)]) + payload
    return HEADER + body + bytes([checksum(body)])


def _numbered(part: SubPayload) -> tuple[int, bytes]:
    if isinstance(part, Other):
        return part.number, part.content
    try:
        return _ID[type(part)], part.DATA.pack(*(getattr(part, field.name) for field in dataclasses.fields(part)))
    except struct.error as error:
        raise ValueError(f"{part}: {error}") from None


def decode(payload: bytes, kinds: Kinds) -> tuple[SubPayload, ...]:
    """The sub-payloads of one payload, in order.

    Unknown ids are skipped, and so is a known one of a length it cannot have, or one cut off by the payload's end.
    """
    parts: list[SubPayload] = []
    at = 0
    while at + 2 <= len(payload):
        number, end = payload[at], at + 2 + payload[at + 1]
        data, at = payload[at + 2 : end], end
        if at <= len(payload) and number in kinds and (part := _part(kinds[number], data)) is not None:
            parts.append(part)
    return tuple(parts)


def _part(kind: type[SubPayload], data: bytes) -> SubPayload | None:
    make: Callable[..., SubPayload] = kind
    if kind in _OLD_VERSIONS and len(data) == 2:
        version = _OLD_VERSIONS[kind].get(int.from_bytes(data, "little"))
        return None if version is None else make(*version)
    return make(*kind.DATA.unpack(data)) if len(data) == kind.DATA.size else None


def _tiled(payload: bytes) -> bool:
    """Returns True if whole sub-payloads, known or not, fill it."""
    at = 0
    while at + 2 <= len(payload):
        at += 2 + payload[at + 1]
    return at == len(payload)


class Deframer:
    """Finds the payloads in a stream of bytes that may begin, break off and be garbled anywhere.

    A checksum of one byte is right by chance once in 256 times, so a payload must consist of whole sub-payloads, too.
    bad: beginnings of a frame that turned out to be none. A true frame may hide behind such a one: the search goes on
    at its next byte.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.bad = 0

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads that are complete with these bytes, whose checksums are right."""
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
            # Half a header may be the last byte.
            at = len(buffer) - (buffer[-1:] == HEADER[:1])
        del buffer[:at]
        return found

"""Tags and scans as lines of JSON, and the client of a sensor socket, see docs/sensor_socket.md."""

from __future__ import annotations

import json
import math
import socket
import time
import typing
from multiprocessing.connection import wait
from typing import Any

import numpy as np

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.plausible import judged
from tfg_drake.hardware.sensor_reader import PATIENCE, SensorReader
from tfg_drake.messages import LaserScan, TagDetections
from tfg_drake.table import dtype_of

# Time to wait for a server's answer, s: shorter than the silence after which the process counts as hanging.
CONNECT_WITHIN = 2.0

# Greatest length of a line, bytes; a longer one is refused.
LONGEST_LINE = 1_000_000
_TOO_LONG = f"a line of more than {LONGEST_LINE} bytes"

_KINDS: dict[str, type[LaserScan] | type[TagDetections]] = {"scan": LaserScan, "detections": TagDetections}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def message_of(line: bytes) -> TagDetections | LaserScan | None:
    """Return the message of a line, None if its type is unknown. Raises ValueError if it is malformed.

    Plausibility and equal lengths of lists are judged elsewhere, see tfg_drake.hardware.plausible.
    """
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        raise ValueError("no JSON") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("type"), str):
        raise ValueError("no object with a type")
    if (kind := _KINDS.get(fields["type"])) is None:
        return None
    # JSON has no infinity and no NaN: null stands for free (inf), 0 for unknown (nan).
    free: list[bool] = []
    if kind is LaserScan and isinstance(ranges := fields.get("ranges"), list):
        free = [one is None for one in ranges]
        fields["ranges"] = [0.0 if one is None else one for one in ranges]
    try:
        values = {name: _value(fields.get(name), name, hint) for name, hint in typing.get_type_hints(kind).items()}
    except OverflowError:
        raise ValueError(f"{fields['type']}: a number is too large") from None
    except ValueError as error:
        raise ValueError(f"{fields['type']}: {error}") from None
    if kind is LaserScan:
        values["ranges"][values["ranges"] == 0.0] = math.nan
        values["ranges"][free] = math.inf
    return kind(**values)


def sensor_line(message: TagDetections | LaserScan) -> bytes:
    """Return a message as a line, with its newline."""
    fields = {name: np.asarray(value).tolist() for name, value in vars(message).items()}
    if isinstance(message, LaserScan):
        # JSON has neither inf, no return, nor nan, unknown.
        told = {math.inf: None, -math.inf: 0.0}
        fields["ranges"] = [0.0 if math.isnan(one) else told.get(one, one) for one in fields["ranges"]]
    return json.dumps({"type": _NAMES[type(message)], **fields}, allow_nan=False).encode() + b"\n"


def _value(value: Any, name: str, hint: Any) -> Any:
    """Return a field of a message in the type of its annotation."""
    dtype = dtype_of(hint)
    if dtype is None:
        if type(value) not in (int, float) or not math.isfinite(value):
            raise ValueError(f"{name} is no number")
        return float(value)
    numbers = (int,) if dtype == np.int64 else (int, float)
    if not isinstance(value, list) or not all(type(one) in numbers for one in value):
        raise ValueError(f"{name} is no list of {'whole ' if dtype == np.int64 else ''}numbers")
    array = np.array(value, dtype=dtype)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must hold finite numbers")
    return array


class SocketDriver(SensorReader):
    """Reads lines; see tfg_drake.hardware.device.Driver. Lost connections are opened again.

    refusals: lines without a valid message.
    """

    def __init__(self, host: str, port: int, kinds: tuple[type[LaserScan] | type[TagDetections], ...]) -> None:
        """Wait for a plausible message of each kind. kinds: the wanted ones. Raises DeviceError."""
        name = f"socket:{host}:{port}"
        super().__init__(name, {kind: f"{_NAMES[kind]} of {name}" for kind in kinds})
        self._address, self._kinds = (host, port), kinds
        self._pending = bytearray()
        # The kinds that have arrived, and why other lines were refused.
        self._arrived: set[type] = set()
        self._doubt = ""
        try:
            self._begin()
        except OSError as error:
            raise DeviceError(
                f"{self.name}: {error.strerror or error}: start what serves tags and scans there, or name the "
                "HOST:PORT that it prints"
            ) from None

    def _missing(self) -> str:
        missing = [_NAMES[kind] for kind in self._kinds if kind not in self._arrived]
        why = f" ({self._doubt})" if self._doubt else ""
        return f"no {missing[0]} in {PATIENCE:.0f} s{why}: name what serves them" if missing else ""

    def _connect(self) -> None:
        self._device = socket.create_connection(self._address, CONNECT_WITHIN)
        self._device.setblocking(False)
        self._pending.clear()  # the beginning of a line from the old connection

    def _receive(self, left: float) -> None:
        if not wait([self._device], left):
            return
        try:
            data = self._device.recv(1 << 20)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._lose("the connection is lost; start what serves it again, it is looked for")
            return
        self._pending += data
        *lines, rest = self._pending.split(b"\n")
        self._pending = rest
        for line in lines:
            self.read(bytes(line))
        if len(self._pending) > LONGEST_LINE:
            self._pending.clear()  # the rest of the line will be malformed, too
            self._refuse(_TOO_LONG)

    def read(self, line: bytes) -> None:
        """Take in a line; one without a valid message is refused, whatever it contains."""
        if len(line) > LONGEST_LINE:
            self._refuse(_TOO_LONG)
            return
        try:
            message = message_of(line)
        except Exception as error:  # the next line may be good
            self._refuse(str(error))
            return
        if message is None or not isinstance(message, self._kinds):
            return
        self._messages.append(message)
        if type(message) not in self._arrived:
            believed, reasons = judged(message, time.monotonic())
            if believed is not None:
                self._arrived.add(type(message))
            self._doubt = "; ".join(reasons.values()) or self._doubt

    def _refuse(self, why: str) -> None:
        self._doubt = why
        self.refusals.add(self.name, "line", f"lines are not used: {why}")

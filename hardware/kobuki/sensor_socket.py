"""Tags and scans as lines of JSON on a TCP socket of this machine, see docs/sensor_socket.md."""

from __future__ import annotations

import json
import math
import socket
from typing import Any

import numpy as np

from tfg_drake.messages import FloatArray, LaserScan, TagDetections

# A client this far behind misses whole lines, bytes.
_BACKLOG = 200_000


def sensor_line(message: TagDetections | LaserScan) -> bytes:
    """The line that says a message, with its newline."""
    fields = {name: np.asarray(value).tolist() for name, value in vars(message).items()}
    if isinstance(message, LaserScan):
        fields["ranges"] = [_range(distance) for distance in fields["ranges"]]
    kind = "scan" if isinstance(message, LaserScan) else "detections"
    return json.dumps({"type": kind, **fields}, allow_nan=False).encode() + b"\n"


def _range(distance: float) -> float | None:
    """JSON has neither inf, nothing was met, nor nan, nothing is known."""
    return distance if math.isfinite(distance) else None if distance > 0.0 else 0.0


def message_of(line: bytes) -> TagDetections | LaserScan | None:
    """The message that a line says, None of a type that is not known. Raises ValueError where it says none rightly.

    Whether it is plausible is not judged here, see tfg_drake.hardware.plausible.
    """
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        raise ValueError("no JSON") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("type"), str):
        raise ValueError("no object with a type")
    try:
        if fields["type"] == "detections":
            return _detections(fields)
        return _scan(fields) if fields["type"] == "scan" else None
    except OverflowError:
        raise ValueError(f"{fields['type']}: a number is too large") from None


def _detections(fields: dict[str, Any]) -> TagDetections:
    ids = fields.get("ids")
    if not isinstance(ids, list) or not all(type(one) is int and abs(one) < 2**63 for one in ids):
        raise ValueError("detections: ids is no list of whole numbers")
    columns = (_numbers(fields, key, len(ids)) for key in ("range", "bearing", "sigma_range", "sigma_bearing"))
    return TagDetections(_number(fields, "stamp"), np.array(ids, dtype=np.int64), *columns)


def _scan(fields: dict[str, Any]) -> LaserScan:
    ranges = fields.get("ranges")
    if not isinstance(ranges, list):
        raise ValueError("scan: ranges is no list of numbers")
    angles = _numbers(fields, "angles", len(ranges))
    hit = np.array([one is not None for one in ranges], dtype=bool)
    distances = np.full(len(ranges), math.inf)
    met = [one for one in ranges if one is not None]
    distances[hit] = _numbers(fields | {"ranges": met}, "ranges", len(met))
    distances[distances == 0.0] = math.nan
    range_max, sigma = _number(fields, "range_max"), _number(fields, "sigma")
    return LaserScan(_number(fields, "stamp"), angles, distances, range_max, sigma)


def _number(fields: dict[str, Any], key: str) -> float:
    value = fields.get(key)
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{fields['type']}: {key} is no number")
    return float(value)


def _numbers(fields: dict[str, Any], key: str, count: int) -> FloatArray:
    values = fields.get(key)
    if not isinstance(values, list) or not all(type(one) in (int, float) for one in values):
        raise ValueError(f"{fields['type']}: {key} is no list of numbers")
    array = np.array(values, dtype=float)
    if len(array) != count or not np.isfinite(array).all():
        raise ValueError(f"{fields['type']}: {key} must hold {count} finite numbers")
    return array


class SensorSocket:
    """Sends lines to whoever is connected, and waits for nobody. address: (host, port)."""

    def __init__(self) -> None:
        """Listens on a free port of 127.0.0.1."""
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()
        # What each client has yet to get.
        self._clients: dict[socket.socket, bytearray] = {}

    def send(self, line: bytes) -> None:
        """Sends a line to every client that keeps up; newcomers are let in."""
        try:
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                self._clients[client] = bytearray()
        except BlockingIOError:
            pass
        for client, pending in list(self._clients.items()):
            if len(pending) < _BACKLOG:
                pending += line
            try:
                del pending[: client.send(pending)]
            except BlockingIOError:
                pass
            except OSError:
                client.close()
                del self._clients[client]

    def close(self) -> None:
        """Ends all connections."""
        for each in (self._listener, *self._clients):
            each.close()

"""The server of a sensor socket, on this machine: an emulator's tags and scans, see docs/sensor_socket.md."""

from __future__ import annotations

import json
import math
import socket

import numpy as np

from tfg_drake.hardware.socket_sensors import LONGEST_LINE
from tfg_drake.messages import LaserScan, TagDetections


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


class SensorSocket:
    """Sends lines to whoever is connected, and waits for nobody: who is LONGEST_LINE behind misses whole lines.

    address: (host, port)."""

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
            if len(pending) < LONGEST_LINE:
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

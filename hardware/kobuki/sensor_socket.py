"""Tags and scans as lines of JSON on a TCP socket of this machine, see docs/sensor_socket.md."""

from __future__ import annotations

import json
import math
import socket

from tfg_drake.messages import LaserScan, TagDetections

# A client this far behind misses whole lines, bytes.
_BACKLOG = 200_000


def sensor_line(message: TagDetections | LaserScan) -> bytes:
    """The line that says a message, with its newline."""
    if isinstance(message, TagDetections):
        fields = {
            "type": "detections",
            "stamp": message.stamp,
            "ids": message.ids.tolist(),
            "range": message.range.tolist(),
            "bearing": message.bearing.tolist(),
            "sigma_range": message.sigma_range.tolist(),
            "sigma_bearing": message.sigma_bearing.tolist(),
        }
    else:
        fields = {
            "type": "scan",
            "stamp": message.stamp,
            "angles": message.angles.tolist(),
            "ranges": [distance if math.isfinite(distance) else None for distance in message.ranges.tolist()],
            "range_max": message.range_max,
            "sigma": message.sigma,
        }
    return json.dumps(fields, allow_nan=False).encode() + b"\n"


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

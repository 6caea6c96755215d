"""The server of a sensor socket, on this machine: an emulator's tags and scans, see docs/sensor_socket.md."""

from __future__ import annotations

import socket

from tfg_drake.hardware.socket_sensors import LONGEST_LINE


class SensorSocket:
    """Sends lines to whoever is connected, and waits for nobody: who is LONGEST_LINE behind misses whole lines.

    address: (host, port)."""

    def __init__(self) -> None:
        """Listens on a free port of 127.0.0.1."""
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()
        # Bytes still to be sent to each client.
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

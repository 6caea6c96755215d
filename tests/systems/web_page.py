"""What any web page may do to a picture: open a WebSocket to it and send what it likes."""

from __future__ import annotations

import socket

_HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: pages.example\r\nOrigin: http://pages.example\r\nUpgrade: websocket\r\n"
    "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class WebPage:
    """A page of another origin, connected to the picture at a port of this machine."""

    def __init__(self, port: int) -> None:
        """Raises OSError where nothing listens there."""
        self._socket = socket.create_connection(("localhost", port), timeout=10.0)
        self._socket.sendall(_HANDSHAKE.encode())
        self.answer = self._socket.recv(4096).decode("latin-1")

    def send(self, payload: bytes) -> None:
        """A binary message of less than 126 bytes."""
        mask = b"\x01\x02\x03\x04"
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
        self._socket.sendall(bytes([0x82, 0x80 | len(payload)]) + mask + masked)

    def close(self) -> None:
        """Leave."""
        self._socket.close()

"""A server over HTTP that takes a bounded number of a process's descriptors and threads, whatever is sent to it.

A connection that has not said all yet costs a descriptor and no thread, and the oldest goes where there are too many:
nobody keeps others out by half a request. A POST is answered at once, before anybody else is let in, so it must take no
time; whatever is to be read, by a thread of its own.
"""

from __future__ import annotations

import contextlib
import io
import re
import socket
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import wait
from typing import Any

# Connections that have not said all yet, and those that a thread answers: where there are more the oldest goes.
WAITING, ANSWERED = 128, 32
# Newcomers that are let in before it is looked who has said all, at most: nobody goes before that.
_AT_ONCE = 64
# A request with its head is no longer than this, bytes.
_WHOLE = 2**14


class WholeRequestHandler(BaseHTTPRequestHandler):
    """request: what was said, and the connection that it was said on."""

    # Whoever does not read for so long has gone, s.
    timeout = 60.0

    def setup(self) -> None:
        """Has what was said read from memory: nobody is waited for."""
        said, self.request = self.request
        super().setup()
        self.rfile = io.BytesIO(said)


class WholeRequestServer(ThreadingHTTPServer):
    """Its handler is a WholeRequestHandler. answered: the connections that threads answer, the oldest first."""

    block_on_close = False
    # Whoever comes in the middle of a flood stands in this line: where it is full one tries again a second later.
    request_queue_size = 4096

    def __init__(self, address: tuple[str, int], handler: type[WholeRequestHandler]) -> None:
        """Raises OSError where nobody can listen there."""
        self.answered: dict[socket.socket, None] = {}
        # What each connection has said, the oldest first.
        self._waiting: dict[Any, bytes] = {}
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        super().__init__(address, handler)
        self.socket.setblocking(False)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Let a newcomer wait until it has said all."""
        for oldest in list(self._waiting)[: 1 - WAITING]:
            self.shutdown_request((self._waiting.pop(oldest), oldest))
        request.setblocking(False)
        self._waiting[request] = b""

    def service_actions(self) -> None:
        """Answer whoever has said all, as `serve_forever` wants it after each newcomer and when there is none."""
        with contextlib.suppress(OSError):  # until nobody is left
            for _ in range(_AT_ONCE):
                self.process_request(*self.get_request())
        connection: Any
        for connection in wait(list(self._waiting), 0.0):
            data = b""
            with contextlib.suppress(OSError):
                data = connection.recv(_WHOLE)
            said = self._waiting[connection] = self._waiting[connection] + data
            if data and not _is_whole(said):
                continue
            del self._waiting[connection]
            if data and said.startswith(b"POST "):
                self.process_request_thread((said, connection), None)
            elif data and len(self.answered) < 2 * ANSWERED:
                self._begin_answer((said, connection))
            else:
                self.shutdown_request((said, connection))

    def _begin_answer(self, request: tuple[bytes, socket.socket]) -> None:
        for oldest in list(self.answered)[: 1 - ANSWERED]:
            with contextlib.suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)  # Its thread notices, soon: until then there are more of them.
        self.answered[request[1]] = None
        try:
            super().process_request(request, None)
        except RuntimeError:  # the process can have no more threads
            self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Hang up. request: as the handler has it."""
        super().shutdown_request(request[1])
        self.answered.pop(request[1], None)


def _is_whole(said: bytes) -> bool:
    """Whether a request has come with all that belongs to it; or is too long, which is to be answered, too."""
    head, end, body = said.partition(b"\r\n\r\n")
    length = re.search(rb"\r\ncontent-length:[ \t]*(\d{1,4})[ \t]*\r\n", head + b"\r\n", re.IGNORECASE)
    return len(said) >= _WHOLE or bool(end and (length is None or len(body) >= int(length[1])))

"""A server over HTTP that takes a bounded number of a process's descriptors and threads, whatever is sent to it.

A connection that has not said all yet costs a descriptor and no thread, and where there are too many the oldest of the
address with most of them goes: nobody keeps others out by half a request. A POST is answered at once, so it must take
no time; whatever is to be read, by a thread of its own, and before each of these it is looked who has said a POST
meanwhile.
"""

from __future__ import annotations

import collections
import contextlib
import io
import re
import resource
import socket
from collections.abc import Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import wait
from typing import Any

# Greatest number of connections with an incomplete request, a quarter of the process's descriptors, and of those that a
# thread answers; beyond it one is closed. At 1000 connections a second each has a quarter of a second.
_DESCRIPTORS = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
WAITING, ANSWERED = min(512, _DESCRIPTORS // 4) if _DESCRIPTORS > 0 else 512, 32
# Greatest length of a request with its header, bytes.
_WHOLE = 2**14


class WholeRequestHandler(BaseHTTPRequestHandler):
    """request: what was said, and the connection that it was said on."""

    # A client that does not read for this time, s, has gone.
    timeout = 60.0

    def setup(self) -> None:
        """Has what was said read from memory: nobody is waited for."""
        said, self.request = self.request
        super().setup()
        self.rfile = io.BytesIO(said)


class WholeRequestServer(ThreadingHTTPServer):
    """Its handler is a WholeRequestHandler. answered: the connections that threads answer, the oldest first."""

    block_on_close = False
    # Length of the queue of new connections; if it is full, a client tries again a second later.
    request_queue_size = 4096

    def __init__(self, address: tuple[str, int], handler: type[WholeRequestHandler]) -> None:
        """Raises OSError where nobody can listen there."""
        self.answered: dict[socket.socket, None] = {}
        # Received bytes of each connection, the oldest first; then the complete requests that await a thread.
        self._waiting: dict[Any, bytes] = {}
        self._whole: dict[Any, bytes] = {}
        self._address: dict[Any, str] = {}
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        super().__init__(address, handler)
        self.socket.setblocking(False)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Let a newcomer wait until it has said all."""
        if len(self._waiting) >= WAITING:
            for oldest in self._too_many(self._waiting, WAITING - 1 - WAITING // 16):  # some at once, which is cheap
                self._hang_up(oldest, self._waiting)
        self._waiting[request], self._address[request] = b"", client_address[0]

    def service_actions(self) -> None:
        """Answer whoever has said all, as `serve_forever` wants it after each newcomer and when there is none."""
        for _ in range(ANSWERED):
            with contextlib.suppress(OSError):  # until nobody is left
                for _ in range(WAITING // 2):  # It is looked who has said all before anybody of them goes.
                    self.process_request(*self.get_request())
            self._hear()
            if not self._whole or len(self.answered) >= 2 * ANSWERED:  # threads that have not noticed yet that they end
                break
            connection = next(iter(self._whole))
            self._begin_answer((self._whole.pop(connection), connection))

    def _hear(self) -> None:
        """Answer those who have said a POST, and note who has said all of something else."""
        connection: Any
        for connection in wait(list(self._waiting), 0.0):
            data = b""
            with contextlib.suppress(OSError):
                data = connection.recv(_WHOLE, socket.MSG_DONTWAIT)
            said = self._waiting[connection] = self._waiting[connection] + data
            if data and not _is_whole(said):
                continue
            del self._waiting[connection]
            if data and said.startswith(b"POST "):
                self.process_request_thread((said, connection), None)
            elif data:
                self._whole[connection] = said
            else:
                self._hang_up(connection, self._address)
        for oldest in self._too_many(self._whole, ANSWERED):
            self._hang_up(oldest, self._whole)

    def _hang_up(self, connection: Any, connections: dict[Any, Any]) -> None:
        """Leave a connection that was not answered, one of some: in a flood every call to the system counts."""
        connections.pop(connection, None)
        self._address.pop(connection, None)
        connection.close()

    def _too_many(self, connections: Iterable[Any], most: int) -> list[Any]:
        """Connections to close, of some in order of age: as many as are above `most`, each the oldest of the
        address that has most."""
        left, gone = {one: self._address.get(one, "") for one in list(connections)}, []
        crowds = collections.Counter(left.values())
        while len(left) > most:
            crowd = max(crowds, key=crowds.__getitem__)
            gone.append(next(one for one, address in left.items() if address == crowd))
            crowds[left.pop(gone[-1])] -= 1
        return gone

    def _begin_answer(self, request: tuple[bytes, socket.socket]) -> None:
        for oldest in self._too_many(self.answered, ANSWERED - 1):
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
        self._address.pop(request[1], None)


def _is_whole(said: bytes) -> bool:
    """True if a request has come with its whole body; or is too long, which is to be answered, too."""
    head, end, body = said.partition(b"\r\n\r\n")
    length = re.search(rb"\r\ncontent-length:[ \t]*(\d{1,4})[ \t]*\r\n", head + b"\r\n", re.IGNORECASE)
    return len(said) >= _WHOLE or bool(end and (length is None or len(body) >= int(length[1])))

"""Carries announcements of the explorer to the robot's process: a pipe of its own, with a thread at either end.

So a map of a large building holds up neither the planner nor the watchdog.
"""

from __future__ import annotations

import itertools
import threading
from multiprocessing.connection import Connection
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Publisher(Protocol):
    """A driver that can tell others what the explorer knows."""

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publishes a message as a dictionary of its fields, from a thread of its own; a header's stamp is the host's
        time, s."""


class Outbox:
    """Sends pairs of a key and what it stands for from a thread of its own: whoever reads late holds nothing up."""

    def __init__(self, connection: Connection, most: int | None = None) -> None:
        """most: how many pairs wait to be sent, at the most, the oldest of more being lost; None: of each key the
        newest waits."""
        self._connection, self._most = connection, most
        self._waiting: dict[object, tuple[str, Any]] = {}
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, key: str, content: Any) -> None:
        """Has a pair sent."""
        with self._changed:
            self._waiting[key if self._most is None else next(self._numbers)] = key, content
            if self._most is not None and len(self._waiting) > self._most:
                del self._waiting[next(iter(self._waiting))]
            self._changed.notify()

    def close(self) -> None:
        """Sends nothing more; the other end must be reading, or gone."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                waiting, self._waiting = self._waiting, {}
            try:
                for one in waiting.values():
                    self._connection.send(one)
            except OSError:
                return  # the process has ended; Device says so


def announce(publisher: Publisher, connection: Connection) -> None:
    """The process's end: publishes what arrives, until the other end is closed."""
    while True:
        try:
            key, message = connection.recv()
        except (EOFError, OSError):
            return
        publisher.publish(key, message)

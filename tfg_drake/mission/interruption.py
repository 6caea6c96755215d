"""Signals that end the work of a program: the first is noted, so that all there is can be written; a second ends it."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

# The signals by the names that a user knows.
NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "SIGHUP"}
# Signals within this time, s, are one: `timeout` and a terminal that is closed send theirs to the program and once more
# to its process group.
TOGETHER = 0.25


class Interruption(threading.Event):
    """Set by the first signal that comes while `heard`. number: the newest signal. first, again: the signal's handlers,
    that of the first and that of each later one."""

    def __init__(self) -> None:
        super().__init__()
        self.number = signal.SIGINT
        self.first: Callable[[int, Any], object] = signal.default_int_handler
        self.again: Callable[[int, Any], object] = signal.default_int_handler
        self._last = -math.inf

    @contextlib.contextmanager
    def heard(self) -> Iterator[None]:
        """Meanwhile the signals are heard; outside the main thread, which alone may, nobody does. A SIGHUP that the
        program was started to ignore, as by `nohup`, still is."""
        is_main = threading.current_thread() is threading.main_thread()
        before = {number: signal.getsignal(number) for number in NAMES} if is_main else {}
        self._last = -math.inf
        for number, handler in before.items():
            if number != signal.SIGHUP or handler != signal.SIG_IGN:
                signal.signal(number, self._handle)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: Any) -> None:
        now, call = time.monotonic(), self.again if self.is_set() else self.first
        if now < self._last + TOGETHER:
            return
        self._last, self.number = now, signal.Signals(number)
        self.set()
        call(number, frame)

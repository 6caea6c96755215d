"""Signals that end a program: the first is noted, so that the results can be written; a second one ends it at once."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

# Names of the signals for users.
NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "SIGHUP"}
# Signals within this time, s, count as one: `timeout` and a closed terminal signal the program and then its process
# group.
TOGETHER = 0.25


class Interruption(threading.Event):
    """An event that the first signal within `heard` sets. number: the newest signal. first, again: the handlers of the
    first signal and of each later one."""

    def __init__(self) -> None:
        super().__init__()
        self.number = signal.SIGINT
        self.first: Callable[[int, Any], object] = signal.default_int_handler
        self.again: Callable[[int, Any], object] = signal.default_int_handler
        self._last = -math.inf

    @contextlib.contextmanager
    def heard(self) -> Iterator[None]:
        """Handle the signals inside the context, in the main thread only, as Python allows no other. A SIGHUP that the
        program was started to ignore, as by `nohup`, stays ignored."""
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

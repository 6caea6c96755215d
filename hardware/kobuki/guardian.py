"""Stops the base when the process that drives it no longer can, because it was killed or is frozen.

A process of its own, `python -m tfg_drake.hardware.kobuki.guardian PORT_DESCRIPTOR`, which shares the open port. The
driver's process writes signs of life to its standard input; it answers each on its standard output, and ends when that
process does. If both are killed, nothing stops the base.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time

from tfg_drake.hardware import process
from tfg_drake.hardware.kobuki.codec import BaseControl, encode

# The base is stopped after SILENCE, s, without a sign of life from the driver.
SILENCE = 0.3
# The guardian is taken for dead if it does not answer within ANSWERS_WITHIN, s, or at first within STARTS_WITHIN, s.
ANSWERS_WITHIN, STARTS_WITHIN = 0.4, 10.0


class Guardian:
    """The handle on the guardian of one open port. Its holder calls trouble() at intervals shorter than SILENCE."""

    def __init__(self, port: int) -> None:
        """port: its file descriptor."""
        pipe = subprocess.PIPE
        self._process = process.start("tfg_drake.hardware.kobuki.guardian", port, stdin=pipe, stdout=pipe)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipe, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        for end in (self._pipe, self._answers):
            os.set_blocking(end, False)
        self._patience = STARTS_WITHIN
        # Time since which an answer is due, s; None if none is.
        self._asked: float | None = None

    def trouble(self, now: float) -> str | None:
        """Give a sign of life at `now`, s; returns what is wrong with the guardian, None if it answers."""
        try:
            if not os.read(self._answers, 4096):
                return "has ended"
            self._asked, self._patience = None, ANSWERS_WITHIN
        except BlockingIOError:
            pass
        if self._asked is None:
            self._asked = now
        elif now - self._asked > self._patience:
            return "does not answer"
        try:
            os.write(self._pipe, b".")
        except BlockingIOError:
            return "does not answer"
        except OSError:
            return "has ended"
        return None

    def close(self) -> None:
        """End the guardian, which then writes nothing to the port."""
        self._process.kill()
        self._process.communicate()


def guard(port: int) -> None:
    """Guard the base at an open port until standard input ends. Unread answers hold nothing up."""
    os.set_blocking(sys.stdout.fileno(), False)
    stop, there = encode(BaseControl()), True
    while there:
        heard = bool(select.select([sys.stdin], [], [], SILENCE)[0])
        if heard:
            there = bool(os.read(sys.stdin.fileno(), 4096))
            _write(sys.stdout.fileno(), b".")
        else:
            _write(port, stop)
    for _ in range(process.LAST_WORDS):
        _write(port, stop)
        time.sleep(process.TICK)


def _write(descriptor: int, data: bytes) -> None:
    with contextlib.suppress(OSError):
        os.write(descriptor, data)


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the driver handles these signals and then ends the guardian
    guard(int(sys.argv[1]))

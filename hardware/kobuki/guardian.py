"""Stops the base when the process that drives it cannot do so any more: it was killed, or it is frozen.

A process of its own, `python -m tfg_drake.hardware.kobuki.guardian PORT_DESCRIPTOR`, which shares the open port. On its
standard input it hears that the other lives, and answers each time on its standard output; it ends with it. Where both
are killed nobody is left to stop the base.
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

# The base is stopped after this time without a sign of life, s.
SILENCE = 0.3
# Time within which the guardian answers, and within which its process starts, s.
ANSWERS_WITHIN, STARTS_WITHIN = 0.4, 10.0


class Guardian:
    """The handle on the guardian of one open port. Who holds it calls trouble() oftener than every SILENCE."""

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
        # Since when an answer is due, s; None where nothing is.
        self._asked: float | None = None

    def trouble(self, now: float) -> str | None:
        """Says at `now`, s, that the caller lives; what is wrong with the guardian, None where it answers."""
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
        """Ends the guardian, which then says nothing more."""
        self._process.kill()
        self._process.communicate()


def guard(port: int) -> None:
    """Until standard input ends. Whoever does not read the answers holds up nothing."""
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
        signal.signal(number, signal.SIG_IGN)  # who ends the driver this way is answered by the driver
    guard(int(sys.argv[1]))

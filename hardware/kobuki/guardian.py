"""Stops the base when the process that drives it cannot do so any more: it was killed, or it is frozen.

A process of its own, `python -m tfg_drake.hardware.kobuki.guardian PORT_DESCRIPTOR`, which shares the open port. On its
standard input it hears that the other lives; it ends with it.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time

from tfg_drake.hardware.kobuki.codec import encode
from tfg_drake.hardware.kobuki.payloads import BaseControl

# After so long without a sign of life the base is told to stop, s.
SILENCE = 0.3
# How often it is told so when there is nobody left to say anything else, and how far apart, s: one may be lost.
_LAST_STOPS, _APART = 5, 0.02


class Guardian:
    """The handle on the guardian of one open port. Who holds it calls alive() oftener than every SILENCE."""

    def __init__(self, port: int) -> None:
        """port: its file descriptor."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tfg_drake.hardware.kobuki.guardian", str(port)],
            stdin=subprocess.PIPE,
            pass_fds=[port],
            start_new_session=True,
        )
        assert self._process.stdin is not None
        self._pipe = self._process.stdin.fileno()
        os.set_blocking(self._pipe, False)

    def alive(self) -> bool:
        """Says that the caller lives; whether the guardian does."""
        try:
            os.write(self._pipe, b".")
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Ends the guardian, which then says nothing more."""
        self._process.kill()
        self._process.communicate()


def guard(port: int) -> None:
    """Until standard input ends."""
    stop, there = encode(BaseControl(0, 0)), True
    while there:
        heard = bool(select.select([sys.stdin], [], [], SILENCE)[0])
        if heard:
            there = bool(os.read(sys.stdin.fileno(), 4096))
        else:
            _write(port, stop)
    for _ in range(_LAST_STOPS):
        _write(port, stop)
        time.sleep(_APART)


def _write(port: int, frame: bytes) -> None:
    with contextlib.suppress(OSError):
        os.write(port, frame)


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # who ends the driver this way is answered by the driver
    guard(int(sys.argv[1]))

"""A serial line with nothing but this program at its other end."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path


class PseudoTerminal:
    """A line that others open under a path, until close(). Nothing waits: what does not fit in is lost."""

    def __init__(self, path: Path) -> None:
        """path: a link to the device is made there."""
        # Both ends raw, or the line discipline would eat bytes; the slave stays open, or the master would see the
        # other's absence as an error.
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path = path
        path.symlink_to(os.ttyname(self._slave))

    def read(self) -> bytes:
        """The bytes since the last call."""
        try:
            return os.read(self._master, 65536)
        except BlockingIOError:
            return b""

    def write(self, data: bytes | bytearray) -> None:
        """Sends bytes."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def close(self) -> None:
        """Takes the path away and hangs up on whoever has it open."""
        self._path.unlink()
        os.close(self._master)
        os.close(self._slave)

"""A device behind a pseudo-terminal, in real time: its cable, and the thread in which it lives."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Self


class PseudoTerminal:
    """A serial line with this program at its other end, that others open under a path, until close(). Nothing waits:
    what does not fit in is lost."""

    def __init__(self, path: Path) -> None:
        """path: a link to the device is made there."""
        # Both ends are raw, or the line discipline would change bytes; the slave stays open, or reading the master
        # would fail without a client.
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


class EmulatedDevice(ABC):
    """Runs from `with` or start() until close().

    device: the path that a driver opens; it is there while the cable is plugged in, as udev's are.
    """

    def __init__(self, name: str) -> None:
        """name: of its path and its thread."""
        self._folder = tempfile.TemporaryDirectory(prefix=f"{name}-")
        self.device = str(Path(self._folder.name) / name)
        self._line: PseudoTerminal | None = None
        # Held during use of the line.
        self._lock = threading.Lock()
        self.plug()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{name}-emulator", daemon=True)

    def start(self) -> None:
        """Switches it on. All kernels are compiled before time begins to count."""
        self._switch_on()
        self._thread.start()

    def plug(self) -> None:
        """Puts the cable in, where it is out."""
        with self._lock:
            if self._line is None:
                self._line = PseudoTerminal(Path(self.device))

    def unplug(self) -> None:
        """Pulls the cable."""
        with self._lock:
            if self._line is not None:
                self._line.close()
            self._line = None

    def close(self) -> None:
        """Switches it off and pulls the cable."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self.unplug()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @abstractmethod
    def _switch_on(self) -> None:
        """Whatever comes before the first moment of `_run`."""

    @abstractmethod
    def _run(self) -> None:
        """In the thread: what it does until `_stop` is set."""

"""The operator's keyboard: single keys on a terminal, or characters on whatever standard input is."""

from __future__ import annotations

import atexit
import os
import queue
import re
import sys
import termios
import threading
import tty
import weakref
from collections.abc import Mapping
from multiprocessing.connection import wait
from typing import Any, Generic, TypeVar

from tfg_drake.mission.operation import Command

T = TypeVar("T", bound=str)

KEYS: Mapping[str, Command] = {"e": "enable", " ": "stop", "s": "stop", "p": "pause", "q": "end"}
HELP = "keys: e enable the wheels, space (or s) emergency stop, p pause or resume, q end"


# The characters of a key: an arrow sends three.
_KEY = re.compile(r"\x1b.{0,2}|.", re.DOTALL)

_open: weakref.WeakSet[Keyboard[Any]] = weakref.WeakSet()


@atexit.register
def restore_terminals() -> None:
    """Gives all terminals back as they were: for whoever ends the program at once."""
    for keyboard in list(_open):
        keyboard.restore()


class Keyboard(Generic[T]):
    """Reads keys in the background, from the constructor until close() or the end of the program.

    A terminal is set to give keys without Enter, and given back as it was. Ctrl-C stays what it is.
    """

    def __init__(self, keys: Mapping[str, T], descriptor: int | None = None) -> None:
        """keys: what each asks for. descriptor: of the file that is read, standard input by default."""
        self._keys = keys
        self._descriptor = sys.stdin.fileno() if descriptor is None else descriptor
        self._before = None
        if os.isatty(self._descriptor):
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
            _open.add(self)
        self._requests: queue.SimpleQueue[T] = queue.SimpleQueue()
        self._wake, self._end = os.pipe()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def requests(self) -> list[T]:
        """The requests since the last call."""
        return [self._requests.get_nowait() for _ in range(self._requests.qsize())]

    def close(self) -> None:
        """Gives the terminal back."""
        os.close(self._end)
        self._thread.join()
        os.close(self._wake)
        self.restore()

    def _read(self) -> None:
        while True:
            if self._wake in wait([self._descriptor, self._wake]):
                return
            try:
                keys = os.read(self._descriptor, 1024).decode(errors="replace")
            except OSError:
                return
            if not keys:
                return  # the end of a file
            for key in _KEY.findall(keys):
                if request := self._keys.get(key, self._keys.get(key.lower())):
                    self._requests.put(request)

    def restore(self) -> None:
        """Gives the terminal back as it was."""
        if self._before is not None:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)
            self._before = None

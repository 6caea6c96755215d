"""Progress of a command on the screen."""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

# Without a terminal the interval between two lines, wall s, grows from INTERVAL to LONGEST_INTERVAL as the share SHARE
# of the time passed. Work that takes longer than INTERVAL is shown with its duration.
INTERVAL, LONGEST_INTERVAL, SHARE = 2.0, 60.0, 1.0 / 6.0


def say(line: str) -> None:
    """Print a line by one write: a line of another thread comes before or after it, not within."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


class Screen:
    """Shows what is done now: as a live line on a terminal, elsewhere as a line now and then.

    A thread does so, and says how long the same has been done: who looks on can tell what takes long from what hangs.
    """

    def __init__(self, text: str = "") -> None:
        """text: what is shown first, see `__call__`."""
        self._text = text
        self._since = self._written = self._begun = time.monotonic()
        self._live: Any = None
        self._over = threading.Event()
        self._one = threading.Lock()
        self._thread = threading.Thread(target=self._repeat, daemon=True)

    def __enter__(self) -> Screen:
        """Begin to show."""
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(get_renderable=self._renderable, refresh_per_second=5, transient=True)
            self._live.start()
        else:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Show no more."""
        if self._live is not None:
            self._live.stop()
        else:
            self._over.set()
            self._thread.join()

    def __call__(self, text: str) -> None:
        """Show another text, a line of a terminal of 80 columns: what is done, and after a comma how far it is."""
        if text.partition(",")[0] != self._text.partition(",")[0]:
            self._since = time.monotonic()
        self._text = text
        if self._live is None:
            self._write()

    def line(self) -> str:
        """The line shown."""
        spent = time.monotonic() - self._since
        return f"{self._text} ({spent:.0f} s so far)" if spent >= INTERVAL else self._text

    def _renderable(self) -> Any:
        from rich.text import Text

        return Text(self.line(), no_wrap=True, overflow="ellipsis")

    def _repeat(self) -> None:
        while not self._over.wait(INTERVAL / 10.0):
            self._write()

    def _write(self) -> None:
        with self._one:
            now = time.monotonic()
            apart = max(INTERVAL, min(SHARE * (now - self._begun), LONGEST_INTERVAL))
            if not self._text or now < self._written + apart:
                return
            self._written = now
            try:
                say(self.line())
            except OSError:
                self._written = math.inf  # The reader is gone or the disk is full; the work itself goes on.

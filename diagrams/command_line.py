"""What the commands share: how bad input ends one, and how one waits for the user."""

from __future__ import annotations

import signal
import sys
import threading
from typing import NoReturn


class BadInput(Exception):
    """What the user gave cannot be used; the message is one line that names the culprit and the mend."""


def bad_input(message: str) -> NoReturn:
    """Ends a command: the message goes to standard error, the exit code is 2."""
    raise BadInput(message)


def wait_for_enter() -> None:
    """Until the user presses Enter or Ctrl-C; without a keyboard, until Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        if sys.stdin.isatty():
            input("The scene stays open; press Enter to close it. ")
        else:
            print("The scene stays open until Ctrl-C.", flush=True)
            threading.Event().wait()
    except (EOFError, KeyboardInterrupt):
        print()

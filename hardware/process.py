"""Starting processes of our own; and the times of those that drive a base. Imports nothing that takes time to load."""

from __future__ import annotations

import subprocess
import sys

# Period at which velocities are sent, s.
TICK = 0.02
# Number of times that the last command is sent, a tick apart: one may be lost.
LAST_WORDS = 5


def start(
    module: str, *descriptors: int, stdin: int = subprocess.DEVNULL, stdout: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a module as a process that inherits file descriptors, their numbers as arguments; streams: as for Popen.

    It has its own session: an interrupt from the keyboard goes to the process that started it, which ends it.
    """
    command = [sys.executable, "-m", module, *map(str, descriptors)]
    return subprocess.Popen(command, pass_fds=descriptors, start_new_session=True, stdin=stdin, stdout=stdout)

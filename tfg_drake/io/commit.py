"""The commit that the program is of."""

from __future__ import annotations

import functools
import subprocess
from pathlib import Path

_ROOT = Path(__file__).parents[2]


@functools.cache
def commit() -> str | None:
    """The abbreviated commit of the program's own clone, with -dirty if files are changed; None without a clone."""
    if not (_ROOT / ".git").exists():
        return None
    try:
        told = subprocess.run(
            ["git", "-C", _ROOT, "describe", "--always", "--dirty", "--exclude=*"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return told.stdout.strip()

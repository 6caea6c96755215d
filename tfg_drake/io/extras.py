"""How a package that an extra brings is installed where this program runs."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path


def pip_install(extra: str) -> str:
    """The command that installs an extra of this package, by the pip beside this Python: as a path from the working
    folder where that is shorter."""
    pip = Path(sys.executable).with_name("pip")
    return f"{shlex.quote(min(str(pip), os.path.relpath(pip), key=len))} install 'tfg-drake[{extra}]'"

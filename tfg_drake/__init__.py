"""Active SLAM on topological feature graphs. This layer never imports Drake."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from tfg_drake.storage.run import Run

__version__ = "0.1.0"


def load_run(folder: str | Path) -> Run:
    """A finished mission's folder as plain arrays, see `tfg_drake.storage.run.Run`."""
    from tfg_drake.storage.run import load_run

    return load_run(folder)


# What needs Drake is imported when it is asked for: the package without it must not.
_OF_DRAKE = {"explore": "tfg_drake.diagrams.missions.exploration", "fork": "tfg_drake.diagrams.missions.fork"}


def __getattr__(name: str) -> Any:
    if name in _OF_DRAKE:
        return getattr(importlib.import_module(_OF_DRAKE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""Active SLAM on topological feature graphs. This layer never imports Drake."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from tfg_drake.storage.run import Run

__version__ = "0.1.0"


def load_run(folder: str | Path) -> Run:
    """A finished mission's folder as plain arrays, see `tfg_drake.storage.run.Run`."""
    from tfg_drake.storage.run import load_run

    return load_run(folder)

"""Figures as files: written whole, and the same to the byte on any day."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from tfg_drake.io.files import write_atomic

# Formats of a paper's figure.
FORMATS = (".png", ".pdf")
# Metadata of matplotlib with its version and the date, which are left out.
_TOLD = {"png": ("Software",), "pdf": ("Creator", "Producer", "CreationDate")}


def write_figure(path: Path, figure: Figure, dpi: float = 160.0, *, bounds: str | None = None) -> None:
    """Write a figure as a PNG or PDF, by the file's suffix, atomically, without the metadata that would differ from
    version to version or day to day. bounds: "tight" cuts empty margins off.

    Raises:
        OSError: the file cannot be written.
    """
    buffer = io.BytesIO()
    form = "pdf" if path.suffix.lower() == ".pdf" else "png"
    figure.savefig(buffer, format=form, dpi=dpi, bbox_inches=bounds, metadata=dict.fromkeys(_TOLD[form]))
    write_atomic(path, buffer.getvalue())


def write_formats(folder: Path, name: str, figure: Figure) -> list[Path]:
    """Write a figure for a paper in each of FORMATS; returns the files. Raises OSError."""
    paths = [folder / f"{name}{suffix}" for suffix in FORMATS]
    for path in paths:
        write_figure(path, figure, dpi=300.0, bounds="tight")
    return paths

"""Tags to print: a PDF with cut marks, each tag with its id and the size to check with a rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

# The tag family, its number of ids, and the cells along a tag's black square.
FAMILY, COUNT, CELLS = "tag36h11", 587, 8
# Upright A4 and the margin that printers leave white, m; tags of 16 cm with their border just fit.
PAGE, MARGIN = (0.210, 0.297), 0.005
# Height of the text below a tag, and length of a cut mark, m.
_CAPTION, _MARK = 0.012, 0.004
_INCH = 0.0254


class SheetError(ValueError):
    """Tags that cannot be printed so; the message is one line."""


def parse_ids(text: str) -> list[int]:
    """The ids that "0-99" or "3,5,10-12" names, each once and in order; raises SheetError."""
    ids: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not (first.isdigit() and (last.isdigit() or not dash) and len(first + last) < 12):
            raise SheetError(f"{text[:50]}: is no list of ids; write it as 0-99 or 3,5,10-12")
        begin, end = int(first), int(last or first)
        if begin > end or end >= COUNT:
            raise SheetError(f"{part.strip()}: {FAMILY} has the ids 0 to {COUNT - 1}, a range goes upward")
        ids.update(dict.fromkeys(range(begin, end + 1)))
    return list(ids)


def tag_cells(tag: int) -> NDArray[np.bool_]:
    """(CELLS, CELLS) of a tag's square, top row first: which cells are black. OpenCV's tags stand on their heads."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, tag, CELLS) < 128)


def per_page(size: float) -> tuple[int, int]:
    """How many tags go side by side and above each other on a page; raises SheetError where none does."""
    most = (PAGE[0] - 2.0 * MARGIN) * CELLS / (CELLS + 2)
    if not 0.0 < size < most + 1e-9:
        raise SheetError(f"a tag of {size:g} m does not go on A4; the size is above 0 and at most {most:g} m")
    width, height = _tile(size)
    across = math.floor((PAGE[0] - 2.0 * MARGIN) / width + 1e-9)
    down = math.floor((PAGE[1] - 2.0 * MARGIN) / height + 1e-9)
    return across, down


def print_tags(ids: Sequence[int], size: float, path: Path) -> int:
    """Writes the PDF and says how many pages it has. size: side of the black square, m. Raises SheetError, OSError."""
    across, down = per_page(size)
    pages = [ids[i : i + across * down] for i in range(0, len(ids), across * down)]
    with PdfPages(path) as pdf:
        for page in pages:
            pdf.savefig(draw_page(page, size))
    return len(pages)


def draw_page(ids: Sequence[int], size: float) -> Figure:
    """One page of tags, at most as many as per_page says, its axes in metres from the lower left corner."""
    across, _ = per_page(size)
    tile_width, tile_height = _tile(size)
    figure = Figure(figsize=(PAGE[0] / _INCH, PAGE[1] / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, PAGE[0])
    axes.set_ylim(0.0, PAGE[1])
    axes.axis("off")
    left = 0.5 * (PAGE[0] - across * tile_width)
    for k, tag in enumerate(ids):
        x = left + (k % across) * tile_width
        y = PAGE[1] - MARGIN - (k // across + 1) * tile_height
        _draw_tag(axes, tag, size, x, y)
    return figure


def _tile(size: float) -> tuple[float, float]:
    """Width and height of a tag with its white border, one cell wide, and its caption, m."""
    whole = size * (CELLS + 2) / CELLS
    return whole, whole + _CAPTION


def _draw_tag(axes: Axes, tag: int, size: float, x: float, y: float) -> None:
    """A tag whose tile's lower left corner is (x, y), m."""
    cell = size / CELLS
    whole, height = _tile(size)
    # One outline of all black cells: between patches of their own, hairlines would show. Upright, as AprilTag has them.
    vertices, codes = [], []
    for row, column in np.argwhere(tag_cells(tag)[::-1, ::-1]).tolist():
        x0, y0 = x + (column + 1) * cell, y + height - (row + 2) * cell
        vertices += [(x0, y0), (x0 + cell, y0), (x0 + cell, y0 + cell), (x0, y0 + cell), (x0, y0)]
        codes += [Outline.MOVETO, *3 * [Outline.LINETO], Outline.CLOSEPOLY]
    axes.add_patch(PathPatch(Outline(vertices, codes), facecolor="black", edgecolor="none", linewidth=0.0))
    for corner_x in (x, x + whole):
        for corner_y in (y, y + height):
            inward_x = _MARK if corner_x == x else -_MARK
            inward_y = _MARK if corner_y == y else -_MARK
            axes.plot([corner_x, corner_x + inward_x], [corner_y, corner_y], color="0.6", linewidth=0.3)
            axes.plot([corner_x, corner_x], [corner_y, corner_y + inward_y], color="0.6", linewidth=0.3)
    rule = y + _CAPTION - 0.001
    axes.annotate(
        "", (x + cell, rule), (x + cell + size, rule), arrowprops={"arrowstyle": "|-|,widthA=0.2,widthB=0.2", "lw": 0.4,
                                                                   "shrinkA": 0.0, "shrinkB": 0.0},
    )  # fmt: skip
    text = f"{FAMILY}  id {tag}  black square {1000.0 * size:g} mm: check with a rule"
    points = min(8.0, whole / _INCH * 72.0 / (0.55 * len(text)))
    axes.text(x + 0.5 * whole, y + 0.45 * _CAPTION, text, ha="center", va="center", fontsize=points)

"""ROS map_server maps: an occupancy image and a .yaml that says how to read it; walls are the free cells' borders."""

from __future__ import annotations

import dataclasses
import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError
from scipy import ndimage

from tfg_drake.bad_input import not_radians
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.io.files import read_bytes
from tfg_drake.io.yaml_text import parse_yaml
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.vision.image import NO_IMAGE
from tfg_drake.world.world import FARTHEST, WorldError

# Greatest deviation of a wall from the cells' borders, cells; the staircase of a slanted wall stays within one.
_TOLERANCE = 1.0
# Greatest number of cells, 250 m a side at 5 cm per cell; each takes some ten bytes while the image is read.
_MOST_CELLS = 25_000_000
# Greatest number of sides between free and other cells, 10 km of wall at 5 cm per cell; a photograph has more.
_MOST_SIDES = 200_000
# Bytes of an image that contain its size, and greatest number of bytes per cell: three numbers in digits.
_HEADER_BYTES = 2**20
_CELL_BYTES = 18
_FORMATS = ("PNG", "PPM", "BMP", "JPEG")
# What map savers write for occupied, unknown and free; white is free, too.
_SAVED, _UNKNOWN = (0, 205, 254, 255), 205
# Greatest area of enclosed unknown cells, m^2, that are an error of the scan and not a pillar.
_SPECK = 0.011


@dataclasses.dataclass(frozen=True)
class OccupancyMap:
    """walls: (m, 4) in W, m, between the free cells and all others (occupied, unknown, beyond the image), free cells on
    the left. free: (rows, columns), row 0 lowest. resolution: m per cell. X_WI: (3,) the image's lower left corner.
    notes: a line for each thing that was assumed.
    """

    walls: FloatArray
    free: BoolArray
    resolution: float
    X_WI: FloatArray
    notes: tuple[str, ...]

    def is_free(self, p_WP: FloatArray) -> BoolArray:
        """Which points (n, 2) in W lie in free cells (n,)."""
        index = np.floor(transform(inverse(self.X_WI), p_WP) / self.resolution).astype(np.int64)
        inside = ((index >= 0) & (index < self.free.shape[::-1])).all(axis=1)
        free = np.zeros(len(p_WP), dtype=np.bool_)
        free[inside] = self.free[index[inside, 1], index[inside, 0]]
        return free


def load_map_server(path: Path) -> OccupancyMap:
    """Reads the map's .yaml, whose `image` (.pgm, .pgm.gz, .png) is relative to it; raises WorldError."""
    try:
        tree = parse_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise WorldError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    if not isinstance(tree, dict) or not isinstance(tree.get("image"), str):
        raise WorldError(f"{path}: image: missing; a map_server file names its image, for example image: map.pgm")
    resolution = _number(path, tree, "resolution")
    if resolution <= 0.0:
        raise WorldError(f"{path}: resolution: must be greater than 0 metres per cell, is {resolution:g}")
    origin = tree.get("origin", [0.0, 0.0, 0.0])
    if not (isinstance(origin, list) and len(origin) == 3 and all(_is_number(value) for value in origin)):
        raise WorldError(f"{path}: origin: expected [x, y, yaw] of the image's lower left corner, found {origin!r}")
    if told := not_radians(origin[2]):
        raise WorldError(f"{path}: origin: {told}")
    free, notes = _free_cells(path, tree, resolution)
    if not free.any():
        raise WorldError(f"{path}: no free space in the image; check negate and free_thresh")
    sides = np.count_nonzero(free[1:] != free[:-1]) + np.count_nonzero(free[:, 1:] != free[:, :-1])
    if sides > _MOST_SIDES:
        raise WorldError(
            f"{path}: image: {sides} sides of its cells are wall, at most {_MOST_SIDES} are read; is it a map of walls?"
        )
    polylines = [_outline(line) for line in borders(free)]
    corners = _distinct(np.concatenate([np.column_stack([line[:-1], line[1:]]) for line in polylines])) * resolution
    X_WI = np.array(origin, dtype=float)
    walls = np.column_stack([transform(X_WI, corners[:, :2]), transform(X_WI, corners[:, 2:])])
    return OccupancyMap(walls=walls, free=free, resolution=resolution, X_WI=X_WI, notes=notes)


def _distinct(segments: FloatArray) -> FloatArray:
    """Each segment (m, 4) once: a spur one cell thick may collapse into a line there and back."""
    # Complex numbers are sorted by x, then by y.
    ends = np.sort(segments[:, ::2] + 1j * segments[:, 1::2], axis=1)
    _, first = np.unique(ends, axis=0, return_index=True)
    return segments[np.sort(first)]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= FARTHEST


def _number(path: Path, tree: dict[str, object], key: str, default: float | None = None) -> float:
    value = tree.get(key, default)
    if not _is_number(value):
        found = "missing" if value is None else f"found {value!r}"
        raise WorldError(f"{path}: {key}: expected a number, {found}")
    assert isinstance(value, int | float)
    return float(value)


def _free_cells(path: Path, tree: dict[str, object], resolution: float) -> tuple[BoolArray, tuple[str, ...]]:
    """The free cells, row 0 lowest, as map_server reads them: occupancy p below free_thresh, transparent is unknown.

    But for the grey that savers write for unknown, and for specks of unknown cells; of both a line tells.
    """
    file = path.parent / str(tree["image"])
    try:
        level, white, known = _levels(file)
    except FileNotFoundError:
        raise WorldError(f"{path}: image: {file} does not exist") from None
    except UnidentifiedImageError:
        raise WorldError(f"{path}: image: {file} is not a readable image: its format is unknown") from None
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        complaint = f"has more than {_MOST_CELLS} cells; crop it to the building, or make its cells larger"
        raise WorldError(f"{path}: image: {file} {complaint}") from None
    except NO_IMAGE as error:
        raise WorldError(f"{path}: image: {file} is not a readable image: {' '.join(str(error).split())}") from None
    negate = tree.get("negate", 0)
    if negate not in (0, 1):
        raise WorldError(f"{path}: negate: expected 0 or 1, found {negate!r}")
    if tree.get("mode", "trinary") not in ("trinary", "scale"):
        raise WorldError(f"{path}: mode: expected trinary or scale, found {tree['mode']!r}")
    free_thresh = _number(path, tree, "free_thresh", 0.196)
    if not 0.0 < free_thresh <= 1.0:
        raise WorldError(f"{path}: free_thresh: must be greater than 0 and at most 1, is {free_thresh:g}")
    occupancy = (np.arange(white + 1) if negate else np.arange(white, -1, -1)) / white
    is_free = occupancy < free_thresh  # by level: the image itself stays integers
    notes = []
    if white == 255 and not negate and is_free[_UNKNOWN] and (level == _UNKNOWN).any():
        is_free[_UNKNOWN] = not np.isin(level, _SAVED).all()
        taken = "free; if it is unknown, set free_thresh: 0.196" if is_free[_UNKNOWN] else "unknown, as savers mean it"
        notes.append(f"grey {_UNKNOWN} is below free_thresh {free_thresh:g}; taken for {taken}")
    free = is_free[level] & known
    if not free.any() and not known.all():
        raise WorldError(
            f"{path}: image: {file} has no free space, for what is transparent is unknown; give it a white ground"
        )
    occupied = (occupancy > _number(path, tree, "occupied_thresh", 0.65))[level] & known
    labels, count = ndimage.label(np.pad(~free, 1, constant_values=True), np.ones((3, 3)))
    inner = labels[1:-1, 1:-1]
    specks = np.bincount(labels.ravel(), minlength=count + 1) * resolution**2 <= _SPECK
    specks[[0, labels[0, 0]]] = False
    specks[inner[occupied]] = False
    if specks.any():
        notes.append(f"{np.count_nonzero(specks)} specks of unknown cells within free space taken for free")
    return np.asarray(free | specks[inner])[::-1], tuple(notes)


def _levels(file: Path) -> tuple[IntArray, int, BoolArray]:
    """Each cell's level (rows, columns), 0 black, the level that is white, and which cells are not transparent.

    Raises DecompressionBombError or -Warning for an image of too many cells, before memory is taken for them.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(io.BytesIO(read_bytes(file, _HEADER_BYTES)), formats=_FORMATS) as image:
            cells = image.width * image.height
        if cells > _MOST_CELLS:
            raise Image.DecompressionBombError
        with Image.open(io.BytesIO(read_bytes(file, _HEADER_BYTES + _CELL_BYTES * cells)), formats=_FORMATS) as image:
            if image.mode.startswith("I"):  # 16 bits a pixel: conversion would cut them off, not scale them
                level = np.clip(np.asarray(image), 0, 65535)
                return level, 65535, np.ones(level.shape, dtype=np.bool_)
            pixels = np.asarray(image.convert("LA"))
            return pixels[:, :, 0], 255, pixels[:, :, 1] > 0


def borders(free: BoolArray) -> list[IntArray]:
    """Closed polylines (k + 1, 2) of cell corners (column, row), free cells on the left.

    Where two free cells touch at a corner only, the polylines keep them apart.
    """
    padded = np.pad(free, 1)
    following: dict[tuple[int, int], list[tuple[int, int]]] = {}
    # A border is walked with the free cell on its left: along the lower side of a cell to +x, its right side to +y, ...
    for (dr, dc), (start, end) in {
        (-1, 0): ((0, 0), (1, 0)),
        (0, 1): ((1, 0), (1, 1)),
        (1, 0): ((1, 1), (0, 1)),
        (0, -1): ((0, 1), (0, 0)),
    }.items():
        rows, columns = np.nonzero(free & ~padded[1 + dr : 1 + dr + free.shape[0], 1 + dc : 1 + dc + free.shape[1]])
        for r, c in zip(rows.tolist(), columns.tolist(), strict=True):
            following.setdefault((c + start[0], r + start[1]), []).append((c + end[0], r + end[1]))
    lines = []
    for first in sorted(following):
        while following[first]:
            line = [first, following[first].pop()]
            while line[-1] != first:
                ways = following[line[-1]]
                if len(ways) == 2:
                    dx, dy = line[-1][0] - line[-2][0], line[-1][1] - line[-2][1]
                    left = (line[-1][0] - dy, line[-1][1] + dx)
                    line.append(ways.pop(ways.index(left)))
                else:
                    line.append(ways.pop())
            lines.append(np.array(line))
    return lines


def _outline(line: IntArray) -> FloatArray:
    """Corners (k + 1, 2) of the closed polyline: simplified, but for specks that would become a line of no width."""
    corners = _simplify(line, _TOLERANCE)
    area = 0.5 * abs(np.sum(corners[:-1, 0] * corners[1:, 1] - corners[1:, 0] * corners[:-1, 1]))
    return corners if area >= 0.5 else _simplify(line, 0.0)


def _simplify(line: IntArray, tolerance: float) -> FloatArray:
    """Corners (k + 1, 2) of the closed polyline by Douglas and Peucker: none dropped is farther than tolerance off."""
    keep = np.zeros(len(line), dtype=np.bool_)
    far = int(np.argmax(np.sum((line - line[0]) ** 2, axis=1)))
    keep[[0, far, -1]] = True
    spans = [(0, far), (far, len(line) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        chord = (line[last] - line[first]).astype(float)
        offset = line[first + 1 : last] - line[first]
        away = np.abs(offset[:, 0] * chord[1] - offset[:, 1] * chord[0]) / np.hypot(*chord)
        split = int(np.argmax(away))
        if away[split] > tolerance:
            split += first + 1
            keep[split] = True
            spans += [(first, split), (split, last)]
    return line[keep].astype(float)

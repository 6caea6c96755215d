"""The star polygons of several views, the free space that each of them saw, in one frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.table import taken


class Stars(NamedTuple):
    """The stars of k views: star j has the vertices offsets[j]:offsets[j + 1], (v, 2) m, around its centre, (k, 2)
    m."""

    offsets: IntArray
    vertices: FloatArray
    centers: FloatArray

    @property
    def polygons(self) -> tuple[IntArray, FloatArray]:
        """The arguments for `tfg_drake.geometry.star.inside_any`."""
        return self.offsets, self.vertices


def placed_stars(offsets: IntArray, vertices: FloatArray, X_MA: FloatArray) -> Stars:
    """Return stars, with vertices in the frames of their views, in the map frame; X_MA: (k, 3), one row per star."""
    pose = np.repeat(X_MA, np.diff(offsets), axis=0)
    return Stars(offsets, pose[:, :2] + turned(vertices, pose[:, 2]), X_MA[:, :2].copy())


def some_stars(stars: Stars, which: BoolArray) -> Stars:
    """Return the stars of some (k,) of the views."""
    if which.all():
        return stars
    rows = np.flatnonzero(which)
    return Stars(*taken(rows, *stars.polygons), stars.centers[rows])

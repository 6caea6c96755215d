"""The star polygons of several views: free space as each of them saw it, in one frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.table import taken


class Stars(NamedTuple):
    """Of k views: star j has the vertices offsets[j]:offsets[j + 1], (v, 2) m, round its centre, (k, 2) m."""

    offsets: IntArray
    vertices: FloatArray
    centers: FloatArray

    @property
    def polygons(self) -> tuple[IntArray, FloatArray]:
        """As `tfg_drake.geometry.star.inside_any` takes them."""
        return self.offsets, self.vertices


def placed_stars(offsets: IntArray, vertices: FloatArray, X_MA: FloatArray) -> Stars:
    """Stars whose vertices are in the frames of their views, in the map frame; X_MA: (k, 3), a row a star."""
    pose = np.repeat(X_MA, np.diff(offsets), axis=0)
    return Stars(offsets, pose[:, :2] + turned(vertices, pose[:, 2]), X_MA[:, :2].copy())


def some_stars(stars: Stars, which: BoolArray) -> Stars:
    """The stars of some (k,) of the views."""
    if which.all():
        return stars
    rows = np.flatnonzero(which)
    return Stars(*taken(rows, *stars.polygons), stars.centers[rows])

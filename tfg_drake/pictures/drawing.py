"""Shapes for pictures: ribbons, discs and ellipses as triangles and polygons. Pure geometry, no colours."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, IntArray

Mesh = tuple[FloatArray, IntArray]


def ellipses(centers: FloatArray, covariances: FloatArray, sigmas: float = 3.0, corners: int = 32) -> FloatArray:
    """Outlines (n, corners, 2) of the ellipses (p - c)' P^-1 (p - c) = sigmas^2.

    Args:
        centers: (n, 2) m.
        covariances: (n, 2, 2) m^2, symmetric; slightly negative eigenvalues count as zero.
        sigmas: the radius in standard deviations; 3 holds 98.9 % of a planar Gaussian.
        corners: points of each outline.
    """
    values, vectors = np.linalg.eigh(covariances)
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    angle = 2.0 * np.pi * np.arange(corners) / corners
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(centers[:, None, :] + sigmas * np.swapaxes(axes @ circle, 1, 2))


def outline_segments(outlines: FloatArray) -> FloatArray:
    """Closed outlines (n, c, 2) as segments (n * c, 4)."""
    return np.concatenate([outlines, np.roll(outlines, -1, axis=1)], axis=2).reshape(-1, 4)


def polyline_segments(points: FloatArray) -> FloatArray:
    """A polyline (n, 2) as segments (n - 1, 4), none for fewer than two points."""
    return np.hstack([points[:-1], points[1:]]) if len(points) > 1 else np.zeros((0, 4))


def ribbons(segments: FloatArray, width: float, z: float) -> Mesh:
    """Segments (m, 4) as flat ribbons: vertices (4m, 3) at height z and triangles (2m, 3).

    Each is longer than its segment by half the width at both ends, so that polylines have no gaps at the corners.
    """
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.tile([1.0, 0.0], (len(segments), 1)), where=length > 0.0)
    side = 0.5 * width * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    tip = 0.5 * width * unit
    end = segments[:, 2:]
    corners = np.stack([start - tip - side, end + tip - side, end + tip + side, start - tip + side], axis=1)
    first = 4 * np.arange(len(segments))[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return _at_height(corners.reshape(-1, 2), z), faces


def discs(centers: FloatArray, radius: float, z: float, corners: int = 16) -> Mesh:
    """Discs round centers (n, 2): vertices (n * corners, 3) at height z, and triangles."""
    angle = 2.0 * np.pi * np.arange(corners) / corners
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    fan = np.stack([np.zeros(corners - 2), np.arange(1, corners - 1), np.arange(2, corners)], axis=1).astype(np.int64)
    faces = (corners * np.arange(len(centers))[:, None, None] + fan).reshape(-1, 3)
    return _at_height((centers[:, None, :] + circle).reshape(-1, 2), z), faces


def _at_height(points: FloatArray, z: float) -> FloatArray:
    return np.column_stack([points, np.full(len(points), z)])

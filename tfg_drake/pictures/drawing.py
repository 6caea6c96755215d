"""Shapes for pictures, as outlines and segments. Pure geometry, no colours."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray

# Factor by which small deviations are enlarged to be visible, which the legend states.
MAGNIFIED = 10.0


def ellipses(centers: FloatArray, covariances: FloatArray, sigmas: float = 3.0, corners: int = 24) -> FloatArray:
    """Outlines (n, corners, 2), anticlockwise, of the ellipses (p - c)' P^-1 (p - c) = sigmas^2.

    Args:
        centers: (n, 2) m.
        covariances: (n, 2, 2) m^2, symmetric; slightly negative eigenvalues count as zero.
        sigmas: the radius in standard deviations; 3 holds 98.9 % of a planar Gaussian.
        corners: points of each outline.
    """
    values, vectors = np.linalg.eigh(covariances)
    vectors[:, :, 1] *= np.sign(np.linalg.det(vectors))[:, None]
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


def bands(segments: FloatArray, width: float) -> FloatArray:
    """Segments (m, 4) as rectangles so wide: outlines (m, 4, 2), anticlockwise.

    Each is longer than its segment by half the width at both ends, so that polylines have no gaps at the corners.
    """
    along = segments[:, 2:] - segments[:, :2]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.tile([1.0, 0.0], (len(segments), 1)), where=length > 0.0)
    longer = segments + 0.5 * width * np.hstack([-unit, unit])
    return spreads(longer, np.full((len(segments), 2), 0.5 * width), 1.0)


def spreads(segments: FloatArray, deviations: FloatArray, sigmas: float = 3.0) -> FloatArray:
    """Segments (m, 4) as bands so many deviations (m, 2) of their ends to either side: outlines (m, 4, 2),
    anticlockwise."""
    along = segments[:, 2:] - segments[:, :2]
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    begin, end = (sigmas * deviations[:, [k]] * left for k in (0, 1))
    start, finish = segments[:, :2], segments[:, 2:]
    return np.stack([start - begin, finish - end, finish + end, start + begin], axis=1)


def circles(centers: FloatArray, radius: float, corners: int = 12) -> FloatArray:
    """Regular polygons round centers (n, 2): outlines (n, corners, 2), anticlockwise."""
    return ellipses(centers, np.tile(np.eye(2), (len(centers), 1, 1)), radius, corners)

"""Walls as landmarks, by the ends that they are drawn by."""

import numpy as np


def walls_between(ends, at=0.25):
    """Columns p_ML, anchor and reach, (w, 2) each, of walls between two ends (w, 2, 2) that were seen from their left,
    anchored before them, this share of their length from the first end."""
    ends = np.asarray(ends, dtype=float).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(*along.T)
    along /= length[:, None]
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    first, off = at * length, 0.1 + np.arange(len(ends)) % 3
    anchor = ends[:, 0] + first[:, None] * along - off[:, None] * normal
    reach = np.column_stack([-first, length - first])
    return np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), off]), anchor, reach


def known_at_their_ends(reach, sigma):
    """Covariances (w, 2, 2) of the angle and distance of walls, both of whose ends are known to sigma, m, across the
    wall, independently. reach: (w, 2)."""
    across = np.linalg.inv(np.stack([-reach, np.ones_like(reach)], axis=2))
    return sigma**2 * across @ across.transpose(0, 2, 1)


def no_walls(n):
    """Columns anchor and reach of n tags."""
    return {"anchor": np.zeros((n, 2)), "reach": np.zeros((n, 2))}

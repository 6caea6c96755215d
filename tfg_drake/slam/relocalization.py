"""Relocalisation: the pose of a lost robot by geometry, from mapped tags and how far it can have got.

Any two tags with range and bearing give a pose, and one gives a ring of them. Each is judged by how many tags agree
with it and by how far from the expected pose it is: beyond some distance that counts no more, as the robot
may have been kidnapped. Wrong ids and outliers are outvoted, and where there are several answers none is known.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TagDetections
from tfg_drake.slam.keyframe import rows_of

# Squared deviations of a tag from where it should be, beyond which they say no more: it is misread, or was moved.
GATE = 3.5**2
# A tag may be this far from where the map has it, m.
MAP_SIGMA = 0.05
# That the robot was moved at all costs as much as these squared deviations, and that it was moved anywhere at most as
# much as two tags that disagree: so without an expected pose three tags must agree.
MOVED = 9.0
ANYWHERE = 2.0 * GATE
# The share of the mapped tags that must agree.
LEAST_SHARE = 0.6
# A landmark whose place in the map is less certain than this, m, is not where it seems.
LOOSE = 10.0
# Two tags nearer than this to each other tell no heading, m.
LEAST_BASE = 0.4
# Headings that are tried for each tag by itself, and tags that are tried, the surest.
HEADINGS = 16
MOST_TAGS = 12
# Steps to the least squares.
STEPS = 8
# A pose is known when its deviations are below these, m, rad, and the next that is farther off than SAME costs this
# much more.
KNOWN = np.array([0.3, 0.3, 0.1])
SAME = (0.5, 0.3)
AHEAD = 6.0


class Expected(NamedTuple):
    """The pose X_MB (3,) of a robot that nobody has moved. still: its deviations (3,), m, m, rad, sigma: those of one
    that was moved as far as could go unnoticed."""

    X_MB: FloatArray
    still: FloatArray
    sigma: FloatArray


class Found(NamedTuple):
    """A pose X_MB (3,) and its covariance (3, 3), which of the tags (n,) agree with it, whether it was found near the
    expected one, and whether it is known: no other explains the tags as well."""

    X_MB: FloatArray
    covariance: FloatArray
    agreeing: BoolArray
    is_near: bool
    is_known: bool


class _Seen(NamedTuple):
    """Mapped tags (n, 2), m: in M and where they were seen in B, and the information (n, 2, 2) on the latter."""

    p_ML: FloatArray
    p_BL: FloatArray
    information: FloatArray


def relocalize(estimate: MapEstimate, detections: TagDetections, expected: Expected | None = None) -> Found | None:
    """The likeliest pose of a robot that has been moved, by a frame of tags; None where that says no more than that it
    has not."""
    row, mapped = _mapped(estimate, detections)
    if not len(mapped):
        return None
    seen = _seen(estimate.p_ML[row[mapped]], detections, mapped)
    X, squared, cost, H = _refined(seen, _candidates(seen), expected)
    best = int(np.argmin(cost))
    agrees, unmoved = squared[best] < GATE, len(mapped) * GATE
    if expected is not None:
        still = Expected(expected.X_MB, expected.still, expected.still)
        unmoved = float(_refined(seen, expected.X_MB[None], still)[2][0]) - MOVED
    if cost[best] >= unmoved or agrees.sum() < LEAST_SHARE * len(mapped):
        return None
    off = X - X[best]
    other = (np.hypot(off[:, 0], off[:, 1]) > SAME[0]) | (np.abs(se2.wrap_angle(off[:, 2])) > SAME[1])
    covariance = np.linalg.inv(H[best])
    known = np.all(np.diag(covariance) < KNOWN**2) and not np.any(cost[other] < cost[best] + AHEAD)
    inliers = np.zeros(len(detections.ids), dtype=bool)
    inliers[mapped[agrees]] = True
    near = expected is not None and bool(_distance(X[[best]], expected)[0] < ANYWHERE)
    return Found(X[best].copy(), covariance, inliers, near, bool(known))


def disagreeing(estimate: MapEstimate, detections: TagDetections, X_MB: FloatArray) -> int:
    """How many mapped tags of a frame are not where they should be, seen from a pose (3,)."""
    row, mapped = _mapped(estimate, detections)
    seen = _seen(estimate.p_ML[row[mapped]], detections, mapped)
    return int(np.count_nonzero(_squared(seen, X_MB[None]) >= GATE))


def _mapped(estimate: MapEstimate, detections: TagDetections) -> tuple[IntArray, IntArray]:
    """The rows (n,) of a frame's tags in the map, and which of them (m,) are mapped."""
    row, known = rows_of(detections.ids, estimate.ids)
    mapped = np.flatnonzero(known)
    # Landmarks of a part that nothing ties tell nothing of the rest of the map.
    return row, mapped[np.trace(estimate.landmark_covariance[row[mapped]], axis1=1, axis2=2) < LOOSE**2]


def _seen(p_ML: FloatArray, detections: TagDetections, mapped: IntArray) -> _Seen:
    r, b = detections.range[mapped], detections.bearing[mapped]
    direction = np.stack([np.cos(b), np.sin(b)], axis=1)
    across = direction[:, ::-1] * (-1.0, 1.0)
    along_information = 1.0 / (detections.sigma_range[mapped] ** 2 + MAP_SIGMA**2)
    across_information = 1.0 / ((r * detections.sigma_bearing[mapped]) ** 2 + MAP_SIGMA**2)
    information = along_information[:, None, None] * direction[:, :, None] * direction[:, None, :]
    information = information + across_information[:, None, None] * across[:, :, None] * across[:, None, :]
    return _Seen(p_ML, r[:, None] * direction, information)


def _candidates(seen: _Seen) -> FloatArray:
    """(k, 3) the poses that any two tags give, and some of those that each gives by itself."""
    tags = np.argsort(-np.linalg.det(seen.information), kind="stable")[:MOST_TAGS]
    pairs = np.array(list(itertools.combinations(tags, 2)), dtype=np.int64).reshape(-1, 2)
    i, j = pairs[np.hypot(*(seen.p_BL[pairs[:, 1]] - seen.p_BL[pairs[:, 0]]).T) >= LEAST_BASE].T
    in_M, in_B = seen.p_ML[j] - seen.p_ML[i], seen.p_BL[j] - seen.p_BL[i]
    theta = np.arctan2(in_M[:, 1], in_M[:, 0]) - np.arctan2(in_B[:, 1], in_B[:, 0])
    by_two = _placed(theta, 0.5 * (seen.p_ML[i] + seen.p_ML[j]), 0.5 * (seen.p_BL[i] + seen.p_BL[j]))
    theta = np.tile(np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS, len(tags))
    by_one = _placed(theta, np.repeat(seen.p_ML[tags], HEADINGS, axis=0), np.repeat(seen.p_BL[tags], HEADINGS, axis=0))
    return np.concatenate([by_two, by_one])


def _placed(theta: FloatArray, p_ML: FloatArray, p_BL: FloatArray) -> FloatArray:
    """(k, 3) the poses with headings (k,) from which what is at p_BL (k, 2) lies at p_ML (k, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    x, y = p_BL.T
    return np.column_stack([p_ML[:, 0] - c * x + s * y, p_ML[:, 1] - s * x - c * y, theta])


def _in_body(seen: _Seen, X: FloatArray) -> FloatArray:
    """(k, n, 2) where the mapped tags are from poses X (k, 3)."""
    c, s = np.cos(X[:, 2, None]), np.sin(X[:, 2, None])
    dx, dy = seen.p_ML[:, 0] - X[:, 0, None], seen.p_ML[:, 1] - X[:, 1, None]
    return np.stack([c * dx + s * dy, -s * dx + c * dy], axis=-1)


def _squared(seen: _Seen, X: FloatArray) -> FloatArray:
    """(k, n) squared deviations of the tags from where they should be, seen from poses X (k, 3)."""
    error = _in_body(seen, X) - seen.p_BL
    return np.asarray(np.einsum("kni,nij,knj->kn", error, seen.information, error))


def _distance(X: FloatArray, expected: Expected | None) -> FloatArray:
    """(k,) squared deviations of poses X (k, 3) from the expected one; anywhere without any."""
    if expected is None:
        return np.full(len(X), ANYWHERE)
    off = X - expected.X_MB
    off[:, 2] = se2.wrap_angle(off[:, 2])
    return np.asarray(np.minimum(np.square(off / expected.sigma).sum(axis=1), ANYWHERE))


def _refined(
    seen: _Seen, X: FloatArray, expected: Expected | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Poses (k, 3) brought to the least squares of the tags that agree with them, the squared deviations (k, n) of all
    tags, their costs (k,) and the information (k, 3, 3) on them."""
    for _ in range(STEPS):
        q, agrees = _in_body(seen, X), _squared(seen, X) < GATE
        c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
        J = np.empty((*q.shape, 3))
        J[:, :, 0, 0], J[:, :, 0, 1], J[:, :, 0, 2] = -c[:, None], -s[:, None], q[:, :, 1]
        J[:, :, 1, 0], J[:, :, 1, 1], J[:, :, 1, 2] = s[:, None], -c[:, None], -q[:, :, 0]
        weighted = agrees[:, :, None, None] * np.einsum("nij,knja->knia", seen.information, J)
        H = np.einsum("knia,knib->kab", J, weighted) + 1e-4 * np.eye(3)
        g = np.einsum("knia,kni->ka", weighted, q - seen.p_BL)
        if expected is not None:
            near = _distance(X, expected) < ANYWHERE
            off = X - expected.X_MB
            off[:, 2] = se2.wrap_angle(off[:, 2])
            H += near[:, None, None] * np.diag(expected.sigma**-2)
            g += near[:, None] * off / expected.sigma**2
        X = X - np.linalg.solve(H, g[:, :, None])[:, :, 0]
        X[:, 2] = se2.wrap_angle(X[:, 2])
    squared = _squared(seen, X)
    return X, squared, np.minimum(squared, GATE).sum(axis=1) + _distance(X, expected) + MOVED, H

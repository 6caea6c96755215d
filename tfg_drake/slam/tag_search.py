"""Tag search: finds the pose of one set of tags in another robustly, from the poses that pairs of tags give."""

from __future__ import annotations

import itertools

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, MapEstimate, is_tag
from tfg_drake.slam.estimator_state import Placed
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.place_search import is_elsewhere

# Number of tags that must agree, and their share of the common ones.
LEAST_TAGS, LEAST_SHARE = 3, 0.6
# A tag whose squared Mahalanobis distance from its expected place exceeds this is an outlier: misread or moved.
GATE = 3.5**2
# Additional deviation of a tag's mapped place, m. Tags whose deviation exceeds LOOSE, m, are not used.
MAP_SIGMA, LOOSE = 0.05, 10.0
# Least distance of the two tags of a hypothesis, m, as nearer ones give no heading; pairs are formed of the MOST_TAGS
# most certain tags.
LEAST_BASE, MOST_TAGS = 0.4, 12
# Iterations of the robust least squares.
STEPS = 8
# A pose is accepted if its deviations, at the middle of the tags, are below KNOWN, m, m, rad, and the cost of every
# other place exceeds its own by AHEAD.
KNOWN, AHEAD = np.array([0.3, 0.3, 0.1]), 6.0


def by_tags(of_A: MapEstimate | KeyframeGraph, of_B: MapEstimate | KeyframeGraph) -> Placed | None:
    """Return the pose of B in A from common tags, robustly; None if these are too few or ambiguous.

    Raises:
        BadInput: there are enough common tags, but their arrangements differ.
    """
    common, in_A, in_B = np.intersect1d(of_A.ids, of_B.ids, return_indices=True)
    in_both = of_A.landmark_covariance[in_A], of_B.landmark_covariance[in_B]
    variance = np.linalg.eigvalsh(in_both[0])[:, -1] + np.linalg.eigvalsh(in_both[1])[:, -1]
    tags = is_tag(common)
    told = tags & (variance < LOOSE**2)
    ids, weight = common[told], np.asarray(1.0 / (variance[told] + MAP_SIGMA**2))
    # Seen from amid them: far off a small error of heading is a large one of the place.
    p_A, p_B = of_A.p_ML[in_A[told]], of_B.p_ML[in_B[told]]
    middle = p_B.mean(axis=0) if len(ids) else np.zeros(2)
    p_B = p_B - middle
    tried = np.argsort(-weight, kind="stable")[:MOST_TAGS]
    pairs = np.array(list(itertools.combinations(tried, 2)), dtype=np.int64).reshape(-1, 2)
    pairs = pairs[np.hypot(*(p_B[pairs[:, 1]] - p_B[pairs[:, 0]]).T) >= LEAST_BASE]
    if len(ids) < LEAST_TAGS or not len(pairs):
        return None
    X = _aligned(p_A, p_B, np.eye(len(ids))[pairs].sum(axis=1))
    for _ in range(STEPS):
        X = _aligned(p_A, p_B, weight * (_squared(p_A, p_B, weight, X) < GATE))
    squared = _squared(p_A, p_B, weight, X)
    cost = np.minimum(squared, GATE).sum(axis=1)
    best = int(np.argmin(cost))
    agree = squared[best] < GATE
    if agree.sum() < LEAST_SHARE * len(ids):
        raise BadInput(
            f"{np.count_nonzero(tags)} tags are in both, but fewer than three in five of them stand alike: are both of "
            "one place?"
        )
    J = np.tile(np.eye(2, 3), (len(ids), 1, 1))
    J[:, :, 2] = (se2.transform(X[best], p_B) - X[best, :2])[:, ::-1] * [-1.0, 1.0]
    covariance = np.linalg.inv(np.einsum("n,nia,nib->ab", weight * agree, J, J) + 1e-4 * np.eye(3))
    rivals = cost[is_elsewhere(X, X[best])] < cost[best] + AHEAD
    if agree.sum() < LEAST_TAGS or rivals.any() or np.any(np.diag(covariance) >= KNOWN**2):
        return None
    X_AB, J = se2.compose(X[best], np.append(-middle, 0.0)), np.eye(3)
    J[:2, 2] = (X[best, :2] - X_AB[:2])[::-1] * [1.0, -1.0]
    return Placed(X_AB, J @ covariance @ J.T, ids[~agree], int(agree.sum()))


def _aligned(p_A: FloatArray, p_B: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the poses (k, 3) that bring points of B (n, 2) closest to those of A (n, 2), by weights (k, n)."""
    share = weight / np.maximum(weight.sum(axis=1), 1e-9)[:, None]
    mean_A, mean_B = share @ p_A, share @ p_B
    cross = np.einsum("kn,ni,nj->kij", share, p_B, p_A) - mean_B[:, :, None] * mean_A[:, None]
    theta = np.arctan2(cross[:, 0, 1] - cross[:, 1, 0], cross[:, 0, 0] + cross[:, 1, 1])
    turned = np.column_stack([np.zeros((len(theta), 2)), theta])
    return np.column_stack([mean_A - se2.compose(turned, np.pad(mean_B, ((0, 0), (0, 1))))[:, :2], theta])


def _squared(p_A: FloatArray, p_B: FloatArray, weight: FloatArray, X: FloatArray) -> FloatArray:
    """Return squared deviations (k, n) of the tags of B (n, 2) from those of A (n, 2), with B at poses X (k, 3)."""
    c, s = np.cos(X[:, 2, None]), np.sin(X[:, 2, None])
    x, y = p_B.T
    off = X[:, 0, None] + c * x - s * y - p_A[:, 0], X[:, 1, None] + s * x + c * y - p_A[:, 1]
    return np.asarray(weight * (np.square(off[0]) + np.square(off[1])))

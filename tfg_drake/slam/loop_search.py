"""Loops: places that the robot has come back to, found by how what it saw lately lies on what it saw long ago.

A coarse search over a window of what the pose is known to, by the share of recent points that lie on old ones, then a
fit of points to the surfaces of old ones. What one search finds may be a look-alike: a loop is believed once others
along the way agree with it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, message, replace
from tfg_drake.slam.keyframe import Keyframe, moved_points
from tfg_drake.slam.walls import ends_seen

# Way, m, that counts as lately, and after which a place is an old one; way of old keyframes that are searched at once.
LATELY, LONG_AGO, AT_ONCE = 3.0, 15.0, 6.0
# A search again after so much way, m. Points of the query, at most.
EVERY, QUERY = 1.0, 400
# Old places are asked for within this and the window, m. The window: at least, and in deviations, at most, m and rad.
WITHIN = 3.0
LEAST_WINDOW, MOST_WINDOW, DEVIATIONS = np.array([0.4, 0.08]), np.array([6.0, 0.5]), 3.0
DRIFT = np.array([0.03, 0.003])
# Cells of the field and its blur, m; steps of the search, m and rad; what a wall is told by, m between points.
RESOLUTION, BLUR, STEP, TURN, SPACING = 0.1, 0.15, 0.25, 0.03, 0.1
# The coarse search: least share of points on old ones; the fit: gates, m, and the share within ON of old surfaces.
LEAST_SCORE, GATES, ON, LEAST_SHARE = 0.35, (0.5, 0.3, 0.3, 0.15, 0.15, 0.1, 0.1, 0.1), 0.1, 0.5
# Loops agree, m and rad, and a share of the way between; along so much way.
AGREE, AGREE_SHARE, ALONG = np.array([0.2, 0.03]), np.array([0.02, 0.003]), 12.0


@message
class Loop:
    """A keyframe, newest, that lies at X_AB (3,) of an old one, at way, m, of the newest. rival: how well the second
    best place does, as a share. off: m, from where the graph had it."""

    old: int
    newest: int
    X_AB: FloatArray
    way: float
    rival: float
    off: float


@message
class LoopSearch:
    """The candidates of late, and the way, m, at the last search."""

    candidates: tuple[Loop, ...] = ()
    searched: float = -math.inf
    tied: float = 0.0


def seen_by(one: Keyframe, shared: FloatArray) -> FloatArray:
    """(p, 4) points with normals of all that a keyframe sees in A, its walls by points along them."""
    parts = [one.points[one.points[:, 2:].any(axis=1)]]
    for first, last in ends_seen(one, shared):
        along = last - first
        length = math.hypot(*along)
        if length > 0.0:
            along = along / length
            p = first + np.arange(0.0, length, SPACING)[:, None] * along
            parts.append(np.column_stack([p, np.tile([-along[1], along[0]], (len(p), 1))]))
    return np.vstack(parts)


def searched(
    search: LoopSearch,
    keyframes: tuple[Keyframe, ...],
    X_MN: FloatArray,
    shared: FloatArray,
    sigma: FloatArray,
) -> tuple[LoopSearch, tuple[Loop, ...]]:
    """The search with the newest keyframe, and the loops that are believed with it. X_MN: (k + 1, 3); sigma: (2,)
    standard deviations of the newest pose, m and rad."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(X_MN[:, :2], axis=0).T)))
    newest = len(keyframes) - 1
    if way[newest] < search.searched + EVERY:
        return search, ()
    since = way[newest] - max(search.tied, 0.0)
    window = np.minimum(LEAST_WINDOW + DEVIATIONS * sigma + DRIFT * since, MOST_WINDOW)
    old = np.flatnonzero(way[:newest] < way[newest] - LONG_AGO)
    apart = np.hypot(*(X_MN[old, :2] - X_MN[newest, :2]).T)
    old = old[apart < WITHIN + window[0]]
    if not len(old):
        return search, ()
    nearest = old[np.argmin(np.hypot(*(X_MN[old, :2] - X_MN[newest, :2]).T))]
    group = old[np.abs(way[old] - way[nearest]) < AT_ONCE]
    recent = np.flatnonzero(way[: newest + 1] > way[newest] - LATELY)
    before = np.vstack([moved_points(X_MN[j], seen_by(keyframes[j], shared)) for j in group])
    here = [moved_points(se2.between(X_MN[newest], X_MN[j]), seen_by(keyframes[j], shared)) for j in recent]
    query = np.vstack(here)
    search = replace(search, searched=float(way[newest]))
    if min(len(before), len(query)) < 30:
        return search, ()
    query = query[np.random.default_rng(newest).permutation(len(query))[:QUERY]]
    found = _placed(before, query, X_MN[newest], window)
    if found is None:
        return search, ()
    X, rival = found
    loop = Loop(
        int(nearest),
        newest,
        se2.between(X_MN[nearest], X),
        float(way[newest]),
        rival,
        math.dist(X[:2], X_MN[newest, :2]),
    )
    agree = tuple(other for other in search.candidates if _agree(loop, other, X_MN))
    late = tuple(other for other in search.candidates if other.way > way[newest] - ALONG)
    search = replace(search, candidates=(*late, loop))
    if len(agree) < (2 if loop.off > 0.3 or rival > 0.9 else 1):
        return search, ()
    return replace(search, tied=float(way[newest])), (*agree, loop)


def _agree(one: Loop, other: Loop, X_MN: FloatArray) -> bool:
    """Whether two loops close: the way between the new ends, and that between the old ones."""
    between = one.way - other.way
    if between > ALONG:
        return False
    there = se2.compose(one.X_AB, se2.between(X_MN[one.newest], X_MN[other.newest]))
    back = se2.compose(se2.between(X_MN[one.old], X_MN[other.old]), other.X_AB)
    off = se2.between(back, there)
    return bool(
        math.hypot(off[0], off[1]) < AGREE[0] + AGREE_SHARE[0] * between
        and abs(se2.wrap_angle(off[2])) < AGREE[1] + AGREE_SHARE[1] * between
    )


def _placed(
    before: FloatArray, query: FloatArray, X: FloatArray, window: FloatArray
) -> tuple[FloatArray, float] | None:
    """Where (3,) in M the frame of a query (p, 4) lies by old points (q, 4) in M, in a window (2,), m and rad, round X
    (3,), and how well another place does, over that; None where there is no such."""
    low = before[:, :2].min(axis=0) - 1.0
    cells = np.ceil((before[:, :2].max(axis=0) + 1.0 - low) / RESOLUTION).astype(np.int64)
    field = _field(before[:, :2], low, cells)
    scores = _scores(field, low, query[:130, :2], X, window)
    best = np.unravel_index(np.argmax(scores), scores.shape)
    score = float(scores[best])
    if score < LEAST_SCORE:
        return None
    turns, steps = scores.shape[0] // 2, scores.shape[1] // 2
    start = X + np.array([(best[2] - steps) * STEP, (best[1] - steps) * STEP, (best[0] - turns) * TURN])
    near = slice(max(0, best[1] - 4), best[1] + 5), slice(max(0, best[2] - 4), best[2] + 5)
    scores[:, near[0], near[1]] = 0.0
    there, share = _fitted(before, query, start)
    return (there, float(scores.max()) / score) if share > LEAST_SHARE else None


def _fitted(before: FloatArray, query: FloatArray, X: FloatArray) -> tuple[FloatArray, float]:
    """X (3,) moved so that the query's points lie on the old surfaces, and the share of them that do."""
    tree, share = cKDTree(before[:, :2]), 0.0
    for gate in GATES:
        p = moved_points(X, query)
        _, row = tree.query(p[:, :2], distance_upper_bound=gate)
        met = row < len(before)
        old = before[np.where(met, row, 0)]
        met &= np.sum(old[:, 2:] * p[:, 2:], axis=1) > 0.8
        e = np.sum(old[:, 2:] * (p[:, :2] - old[:, :2]), axis=1)
        lever = p[:, :2] - X[:2]
        J = np.column_stack([old[:, 2:], old[:, 3] * lever[:, 0] - old[:, 2] * lever[:, 1]])
        w = met / (1.0 + (e / max(gate / 3.0, 0.04)) ** 2)
        X = X - np.linalg.solve((w[:, None] * J).T @ J + 1e-3 * np.eye(3), (w * e) @ J)
        share = float(np.mean(met & (np.abs(e) < ON)))
    return X, share


@njit(cache=True)
def _field(points: FloatArray, low: FloatArray, cells: IntArray) -> FloatArray:
    """How near a place is to one of some points (p, 2), 1 at it, in cells from the corner low (2,) on."""
    field, reach = np.zeros((cells[1], cells[0])), int(math.ceil(3.0 * BLUR / RESOLUTION))
    for p in points:
        u, v = (p[0] - low[0]) / RESOLUTION, (p[1] - low[1]) / RESOLUTION
        for i in range(max(0, int(v) - reach), min(cells[1], int(v) + reach + 1)):
            for j in range(max(0, int(u) - reach), min(cells[0], int(u) + reach + 1)):
                square = ((j + 0.5 - u) ** 2 + (i + 0.5 - v) ** 2) * (RESOLUTION / BLUR) ** 2
                field[i, j] = max(field[i, j], math.exp(-0.5 * square))
    return field


@njit(cache=True)
def _scores(field: FloatArray, low: FloatArray, query: FloatArray, X: FloatArray, window: FloatArray) -> FloatArray:
    """(a, s, s) mean of the field at a query's points (p, 2), by turn, y and x round X (3,)."""
    turns, steps = int(math.ceil(window[1] / TURN)), int(math.ceil(window[0] / STEP))
    scores = np.zeros((2 * turns + 1, 2 * steps + 1, 2 * steps + 1))
    rows, columns = field.shape
    for a in range(len(scores)):
        theta = X[2] + (a - turns) * TURN
        c, s = math.cos(theta), math.sin(theta)
        for p in query:
            u, v = X[0] + c * p[0] - s * p[1] - low[0], X[1] + s * p[0] + c * p[1] - low[1]
            for i in range(2 * steps + 1):
                row = int(math.floor((v + (i - steps) * STEP) / RESOLUTION))
                if row < 0 or row >= rows:
                    continue
                for j in range(2 * steps + 1):
                    column = int(math.floor((u + (j - steps) * STEP) / RESOLUTION))
                    if 0 <= column < columns:
                        scores[a, i, j] += field[row, column] / len(query)
    return scores

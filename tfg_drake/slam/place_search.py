"""Search for the place of a look among the surfaces of a map: correlative, then a fit of the best places.

What is seen is slid over the map in steps of place and heading, and judged by the share of its points that lie on the
map's (Olson, "Real-time correlative scan matching", ICRA 2009). The best places are fitted, and judged by how much of
all that is seen lies on surfaces. Where another place explains nearly as much, as in a building of equal rooms, none is
known.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.surface_fit import CELL, Surfaces, thinned

# Side of a cell, m, in a window and in a whole map; blur and step, in cells; a turn, in cells at this distance, m.
SIDE, SIDE_OF_MAP, BLUR, STEP, AT = 0.1, 0.16, 1.5, 2.5, 8.3
# Another place is so far off, m, or turned, rad; so many places are tried, and points of the query, coarsely and in the
# fit, at most.
APART, TURNED, PLACES, COARSE, QUERY = 1.0, 0.3, 30, 130, 400
# The fit of a place known to a step: gates, m, and as good as no information.
LOOSELY, UNTIED = (0.5, 0.3, 0.3, 0.15, 0.15, 0.1, 0.1, 0.1), np.eye(3)
# The robot is where so large a share of the surface that it has seen lies on the map's, of so much of it, m, and where
# that tells its place in both directions: the smaller information is such a share of the larger.
LEAST_SHARE, LEAST_LENGTH, LEAST_ACROSS = 0.8, 5.0, 0.03
# And every place farther off than SAME, m and rad, leaves so much more of it unexplained, m.
SAME, MARGIN = (0.5, 0.3), 1.5
# A place as near as this, m and rad, is asked first: that the robot has drifted is likelier than that somebody has
# carried it, but where places farther off explain so much more. And nobody carries it farther than this: the other end
# of a building, not mapped yet, may be alike.
DRIFTED, NEARER, CARRIED = (1.5, 0.5), 0.03, 10.0


def find_place(
    before: FloatArray, query: FloatArray, expected: FloatArray, *, anywhere: bool = False
) -> tuple[FloatArray | None, float]:
    """The pose X_MA (3,) of the frame A in which points (q, 4) were seen, None where that is not known; and the share
    of them that lies on the map's surfaces from the best pose no farther than SAME from the expected one (3,), 0 where
    another place explains nearly all, and MARGIN more.

    before: (p, 4) points with normals of the map, in M. anywhere: the robot may be, and no place is likelier than
    others beforehand.
    """
    if not len(before) or not tells_place(query):
        return None, 0.0
    surfaces, query = Surfaces(before), thinned(query)
    margin = MARGIN / (CELL * len(query))
    query = query[np.random.default_rng(0).permutation(len(query))[:QUERY]]
    low, high = before[:, :2].min(axis=0), before[:, :2].max(axis=0)
    middle, window = np.append(0.5 * (low + high), 0.0), np.append(0.5 * (high - low), math.pi)
    _, starts = peaks(before[:, :2], query[:COARSE, :2], middle, window, SIDE_OF_MAP)
    fits = [surfaces.fitted(query, X, UNTIED, LOOSELY) for X in (expected, *starts)]
    poses, share = np.array([X for X, _, _ in fits]), np.array([share for *_, share in fits])
    off = np.hypot(*(poses - expected)[:, :2].T)
    here = float(share[~_elsewhere(poses, expected)].max(initial=0.0))
    if share.max() >= max(LEAST_SHARE, here + margin):
        here = 0.0
    drifted = (off < DRIFTED[0]) & (np.abs(se2.wrap_angle(poses[:, 2] - expected[2])) < DRIFTED[1])
    every = np.ones(len(poses), dtype=np.bool_)
    for is_rival, may_be in ((every, every),) if anywhere else ((drifted, drifted), (every, off < CARRIED)):
        best = int(np.argmax(np.where(may_be, share, -1.0)))
        elsewhere = _elsewhere(poses, poses[best])
        others = max(share[is_rival & elsewhere].max(initial=0.0) + margin, share[elsewhere].max(initial=0.0) - NEARER)
        across = np.linalg.eigvalsh(fits[best][1][:2, :2])
        if may_be[best] and share[best] >= max(LEAST_SHARE, others) and across[0] > LEAST_ACROSS * across[1]:
            return poses[best], here
    return None, here


def tells_place(query: FloatArray) -> bool:
    """Whether points with normals (q, 4) are enough to tell where they are, in both directions."""
    seen = thinned(query)
    across = np.linalg.eigvalsh(seen[:, 2:].T @ seen[:, 2:])
    return CELL * len(seen) >= LEAST_LENGTH and bool(across[0] > LEAST_ACROSS * across[1])


def _elsewhere(poses: FloatArray, X: FloatArray) -> BoolArray:
    """Which poses (k, 3) are farther than SAME from another (3,)."""
    off = poses - X
    return np.asarray((np.hypot(off[:, 0], off[:, 1]) > SAME[0]) | (np.abs(se2.wrap_angle(off[:, 2])) > SAME[1]))


def peaks(
    before: FloatArray, query: FloatArray, X: FloatArray, window: FloatArray, side: float = SIDE
) -> tuple[FloatArray, FloatArray]:
    """Scores (k,) and poses (k, 3) in M from which a query (q, 2) lies best on points (p, 2), best first, APART or
    TURNED from each other, within a window (3,) of x, y (m) and heading (rad) round X (3,). side: of a cell, m."""
    step, turn = STEP * side, STEP * side / AT
    low = before.min(axis=0) - 1.0
    cells = np.ceil((before.max(axis=0) + 1.0 - low) / side).astype(np.int64)
    steps = np.ceil(window / [step, step, turn]).astype(np.int64)
    scores = _scores(_field(before, low, cells, side), low, side, query, X, steps, turn)
    apart, turned, found, poses = math.ceil(APART / step), math.ceil(TURNED / turn), [], []
    for _ in range(PLACES):
        a, i, j = np.unravel_index(np.argmax(scores), scores.shape)
        if scores[a, i, j] <= 0.0:
            break
        found.append(float(scores[a, i, j]))
        poses.append(X + np.array([(j - steps[0]) * step, (i - steps[1]) * step, (a - steps[2]) * turn]))
        beside = np.arange(a - turned, a + turned + 1)
        if 2.0 * window[2] >= 2.0 * math.pi:
            beside = beside % (2 * steps[2] + 1)
        beside = beside[(beside >= 0) & (beside < len(scores))]
        scores[beside, max(0, i - apart) : i + apart + 1, max(0, j - apart) : j + apart + 1] = 0.0
    return np.array(found), np.array(poses).reshape(-1, 3)


@njit(cache=True)
def _field(points: FloatArray, low: FloatArray, cells: IntArray, side: float) -> FloatArray:
    """How near a place is to one of some points (p, 2), 1 at it, in cells of a side, m, from the corner low (2,) on."""
    field, reach = np.zeros((cells[1], cells[0])), math.ceil(3.0 * BLUR)
    for p in points:
        u, v = (p[0] - low[0]) / side, (p[1] - low[1]) / side
        for i in range(max(0, int(v) - reach), min(cells[1], int(v) + reach + 1)):
            for j in range(max(0, int(u) - reach), min(cells[0], int(u) + reach + 1)):
                square = ((j + 0.5 - u) ** 2 + (i + 0.5 - v) ** 2) / BLUR**2
                field[i, j] = max(field[i, j], math.exp(-0.5 * square))
    return field


@njit(cache=True)
def _scores(
    field: FloatArray, low: FloatArray, side: float, query: FloatArray, X: FloatArray, steps: IntArray, turn: float
) -> FloatArray:
    """(2a + 1, 2i + 1, 2j + 1) mean of the field at a query's points (p, 2), by turns of so many rad and STEP cells in
    y and x round X (3,); steps: (3,) j, i, a."""
    scores = np.zeros((2 * steps[2] + 1, 2 * steps[1] + 1, 2 * steps[0] + 1))
    rows, columns = field.shape
    for a in range(len(scores)):
        theta = X[2] + (a - steps[2]) * turn
        c, s = math.cos(theta), math.sin(theta)
        for p in query:
            u, v = (X[0] + c * p[0] - s * p[1] - low[0]) / side, (X[1] + s * p[0] + c * p[1] - low[1]) / side
            for i in range(scores.shape[1]):
                row = math.floor(v + (i - steps[1]) * STEP)
                if row < 0 or row >= rows:
                    continue
                for j in range(scores.shape[2]):
                    column = math.floor(u + (j - steps[0]) * STEP)
                    if 0 <= column < columns:
                        scores[a, i, j] += field[row, column] / len(query)
    return scores

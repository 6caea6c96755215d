"""Place search: finds the places of observed surfaces in a map by correlation and fit, and computes their odds.

The observed points are correlated with the map in steps of position and heading; the score is the share of points that
lie on the map's (Olson, "Real-time correlative scan matching", ICRA 2009). The best places are fitted. The odds of each
then follow from what both sides have seen: each metre of observed surface lies on the map's, or where the map's views
have looked through, or where they have not looked; and some of the map's surface is looked through. Surface that a side
has looked through itself was a person or a removed object and does not count; surface that is not straight may be one
and counts little. In a building of equal rooms several places are equally likely; if the map explains nothing, none is
likely.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.surface_fit import CELL, Surfaces, surface_points, thinned

# Correlation grid: the cell's side, m, in a window (SIDE) and in a whole map; blur and step, in cells; the distance AT,
# m, at which a step of heading moves a point by a step of position.
SIDE, SIDE_OF_MAP, BLUR, STEP, AT = 0.1, 0.16, 1.5, 2.5, 8.3
# Peaks of the correlation are APART, m, or TURNED, rad, from each other, at most PLACES of them. At most COARSE points
# of the query are correlated, those within SURROUNDINGS, m, of the newest eye; at most QUERY points are fitted.
APART, TURNED, PLACES, COARSE, QUERY, SURROUNDINGS = 1.0, 0.3, 30, 130, 400, 8.0
# The fit of a peak: the correspondence distance of each iteration, m, and the information of a negligible prior.
LOOSELY, UNTIED = (0.5, 0.3, 0.3, 0.15, 0.15, 0.1, 0.1, 0.1), np.eye(3)
# A query determines its place with LEAST_LENGTH metres of surface and at least this ratio of the smaller eigenvalue of
# the position's information to the larger.
LEAST_LENGTH, LEAST_ACROSS = 5.0, 0.03
# Poses within this of each other, m, m and rad, are one place.
SAME_PLACE = np.array([0.5, 0.5, 0.3])
# A fit whose share of points on surfaces is lower than the best one's by this is rejected.
MUCH_LESS = 0.3
# Log odds of a place per metre of surface. ON: seen on the map's surface. AGAINST (straight surface), MOVABLE (other):
# one side has looked through it and should have seen it. BEYOND: seen where the map has not looked, in total at least
# MOST_BEYOND, in an unfinished map GROWING. There, lest places win that are mapped well, a metre beyond counts as HALF
# a metre ON, for at most as many metres as are ON, and unmapped surface explains the share ALIKE of what the second
# best place explains.
ON, AGAINST, MOVABLE, BEYOND, MOST_BEYOND, GROWING = math.log(0.97 / 0.55), -3.0, -0.25, -0.6, -6.0, -2.0
HALF, ALIKE = 0.5, 0.6
# A cell within NEAR, m, of a surface is on it. It is looked through by an eye that sees at least DEPTH, m, farther,
# unless the other side has a surface within BESIDE, m, of it.
NEAR, DEPTH, BESIDE = 0.1, 0.3, 0.25
# A surface is straight if it extends along the tangent of a cell by at least SHORT, m, more than a person. Against a
# known pose only one of LONG, m, counts fully, more than the leaf of a door. Cells within ACROSS, m, of the tangent
# belong to it if their normals' cosine exceeds SAME_NORMAL.
SHORT, LONG, ACROSS, SAME_NORMAL = 0.8, 1.2, 0.1, 0.92
# Number of bearings of an eye's ranges. A surface within SIGHT, m, whose incidence has a cosine above SLANT is seen for
# certain.
BEARINGS, SIGHT, SLANT = 180, 8.0, 0.35
# A place is accepted below this error probability.
WRONG = 1e-4
# Probability of a likely event. A place may be right if it is more than LIKELY times as probable as the likeliest one.
LIKELY = 0.5


class Seen(NamedTuple):
    """Points with normals (q, 4) in a frame A, the places eyes (e, 2) in A from which they were seen, and the range
    seen from each: depth (e, BEARINGS), see `nearest`."""

    points: FloatArray
    eyes: FloatArray
    depth: FloatArray

    def with_look(self, points: FloatArray, X_AE: FloatArray) -> Seen:
        """Return it with points (q, 4) in the frame E (3,) of one more eye."""
        # The copy is writable, as other callers' arrays are, so that the kernel is compiled only once.
        moved, eye = moved_points(X_AE, points), np.array(X_AE[:2])
        depth = np.vstack([self.depth, nearest(eye, moved)])
        return Seen(np.vstack([self.points, moved]), np.vstack([self.eyes, eye]), depth)

    def staying(self) -> FloatArray:
        """The cells (n, 4) of surface that none of the eyes has looked through."""
        return thinned(self.points[~looked_through(self.points, self.eyes, self.depth)])


def nothing_seen() -> Seen:
    """Return an empty observation."""
    return Seen(np.empty((0, 4)), np.empty((0, 2)), np.empty((0, BEARINGS)))


def seen_from(eyes: FloatArray, points: FloatArray) -> Seen:
    """Return points with normals (q, 4) as seen by eyes (e, 2)."""
    return Seen(points, eyes, np.array([nearest(eye, points) for eye in eyes]).reshape(-1, BEARINGS))


def seen_by_keyframes(graph: KeyframeGraph, which: Iterable[int] | None = None) -> Seen:
    """Return the surfaces that some keyframes of a graph, by default all, have seen, in M; the eyes are the views."""
    keyframes, view = np.unique(graph.view_keyframe, return_index=True)
    eye = dict(zip(keyframes.tolist(), graph.X_MA[view, :2], strict=True))
    points, eyes, depth = [np.empty((0, 4))], [np.empty((0, 2))], [np.empty((0, BEARINGS))]
    for k in range(len(graph.keyframes)) if which is None else which:
        points.append(moved_points(graph.X_MN[k], surface_points(graph.keyframes[k], graph.shared.mean)))
        if k in eye:
            eyes.append(eye[k][None])
            depth.append(nearest(eye[k], points[-1])[None])
    return Seen(np.vstack(points), np.vstack(eyes), np.vstack(depth))


class Prior(NamedTuple):
    """The prior of a body's pose. X: (3,) the expected pose, sigma: (3,) its deviations, m, m, rad. elsewhere: log
    probability ratio beyond three deviations, in the map or not; farther: the same per metre there, 1/m. at: (3,) pose
    of the body in the searched frame, the identity if that is its own."""

    X: FloatArray
    sigma: FloatArray
    elsewhere: float
    farther: float = 0.0
    at: FloatArray = np.zeros(3)

    @property
    def of_frame(self) -> FloatArray:
        """The pose (3,) of the searched frame if the body is at X."""
        return se2.compose(self.X, se2.inverse(self.at))

    def log(self, poses: FloatArray) -> FloatArray:
        """Return the log prior (k,) of poses (k, 3) of the searched frame, 0 near X."""
        off = se2.compose(poses, self.at) - self.X
        off[:, 2] = se2.wrap_angle(off[:, 2])
        near = np.all(np.abs(off) < 3.0 * self.sigma, axis=1)
        return np.where(near, 0.0, self.elsewhere + self.farther * np.hypot(off[:, 0], off[:, 1]))


class Places(NamedTuple):
    """Poses X (k, 3) in M of a frame, the likeliest first, and the probability (k,) of each; the rest to 1 is the
    probability of none of them. tells: (k,) mask of the places that are determined in both directions."""

    X: FloatArray
    probability: FloatArray
    tells: BoolArray

    def found(self) -> FloatArray | None:
        """Return the pose whose error probability is at most WRONG, None without one."""
        sure = len(self.X) > 0 and self.tells[0] and self.probability[0] > 1.0 - WRONG
        return self.X[0] if sure else None

    def near(self, X: FloatArray, within: FloatArray = SAME_PLACE) -> float:
        """Return the probability of a pose (3,) within tolerances, m, m and rad."""
        off = np.abs(self.X - X)
        off[:, 2] = np.abs(se2.wrap_angle(off[:, 2]))
        return float(self.probability[np.all(off < within, axis=1)].sum())

    def may_be(self, X: FloatArray, within: FloatArray) -> bool:
        """Return whether a pose (3,) within tolerances, m, m and rad, is more than LIKELY times as probable as the
        likeliest place. Along a corridor several places are alike, none more probable than half."""
        return self.near(X, within) > LIKELY * float(self.probability.max(initial=0.0))


def no_places() -> Places:
    """Return an empty set of places."""
    return Places(np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.bool_))


def find_places(
    known: Seen,
    seen: Seen,
    prior: Prior | None = None,
    before: FloatArray | None = None,
    *,
    is_growing: bool = False,
) -> Places:
    """Find the poses in M of an observation among the surfaces `known` that a map's views have seen. prior: of the
    pose; None: anywhere in the map. before: (k, 3) poses that were likely with fewer observations. is_growing: the map
    is unfinished, and more of the right place than of a wrong one may be missing in it."""
    points = known.points
    if not len(points) or not tells_place(seen.points):
        return no_places()
    surfaces, rng = Surfaces(points), np.random.default_rng(0)
    X_AC = np.append(seen.eyes[-1], 0.0)
    cells = moved_points(se2.inverse(X_AC), thinned(seen.points))
    cells = cells[rng.permutation(len(cells))]
    around = cells[np.hypot(cells[:, 0], cells[:, 1]) < SURROUNDINGS]
    around = around if tells_place(around) else cells
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    middle, window = np.append(0.5 * (low + high), 0.0), np.append(0.5 * (high - low), math.pi)
    # Recent observations are usually the most informative, but not where the map has not looked.
    queries = (around,) if len(around) == len(cells) else (around, cells)
    found = [peaks(points[:, :2], query[:COARSE, :2], middle, window, SIDE_OF_MAP)[1] for query in queries]
    given = [np.zeros((0, 3)) if before is None else before, np.zeros((0, 3)) if prior is None else prior.of_frame]
    starts = np.vstack([se2.compose(np.vstack(given), X_AC), *found])
    if not len(starts):
        return no_places()
    fits = [surfaces.fitted(around[:QUERY], X, UNTIED, LOOSELY) for X in starts]
    if len(around) < len(cells):
        fits = [surfaces.fitted(cells[:QUERY], X, UNTIED, LOOSELY) for X, *_ in fits]
    share = np.array([of for *_, of in fits])
    kept = [k for k in np.argsort(-share, kind="stable") if share[k] > share.max() - MUCH_LESS]
    X = se2.compose(np.array([fits[k][0] for k in kept]), se2.inverse(X_AC))
    first = [k for k in range(len(X)) if is_elsewhere(X[:k], X[k]).all()]
    X, information = X[first], np.array([fits[kept[k]][1] for k in first])
    log, on, beyond = _agreement(known, surfaces, seen, X, SHORT)
    log += 0.0 if prior is None else prior.log(X)
    odds = log + _beyond(beyond, is_growing=is_growing)
    among = log + HALF * ON * np.minimum(beyond, on) if is_growing else odds
    # Unmapped surface may look like another place, too.
    others = np.delete(on, np.argmax(among)).max(initial=0.0) if is_growing else 0.0
    of_none = ALIKE * ON * others + (0.0 if prior is None else prior.elsewhere)
    of_any = float(np.logaddexp.reduce(odds))
    probability = np.exp(among - np.logaddexp.reduce(among) - np.logaddexp(0.0, of_none - of_any))
    order = np.argsort(-probability, kind="stable")
    across = np.linalg.eigvalsh(information[:, :2, :2])
    tells = across[:, 0] > LEAST_ACROSS * across[:, 1]
    return Places(X[order], probability[order], tells[order])


def log_odds(known: Seen, seen: Seen) -> float:
    """Return the log odds that an observation has the pose that it seems to have in M, from what both sides have looked
    at; places where the map has not looked do not count."""
    return float(_agreement(known, Surfaces(known.points), seen, np.zeros((1, 3)), LONG)[0, 0])


def fits_near(known: Seen, seen: Seen, X: FloatArray, window: FloatArray) -> bool:
    """Return whether an observation that need not determine its place agrees with a map at some pose within a window
    (3,), m, m and rad, around X (3,)."""
    cells, surfaces = thinned(seen.points), Surfaces(known.points)
    if not len(cells) or not len(known.points):
        return False
    cells = cells[np.random.default_rng(0).permutation(len(cells))]
    _, starts = peaks(known.points[:, :2], cells[:COARSE, :2], X, window)
    poses = np.array([surfaces.fitted(cells[:QUERY], start, UNTIED, LOOSELY)[0] for start in (X, *starts)])
    off = np.abs(poses - X)
    off[:, 2] = np.abs(se2.wrap_angle(off[:, 2]))
    agrees = _agreement(known, surfaces, seen, poses, LONG)[0] > 0.0
    return bool(np.any(agrees & np.all(off < window, axis=1)))


def _beyond(length: FloatArray, *, is_growing: bool) -> FloatArray:
    """Return the log odds (k,) of lengths of surface (k,), m, where the map has not looked."""
    return np.maximum(BEYOND * length, GROWING if is_growing else MOST_BEYOND)


def _agreement(known: Seen, surfaces: Surfaces, seen: Seen, X: FloatArray, least: float) -> FloatArray:
    """Return (3, k): the log odds of each pose X (k, 3) from what both sides have looked at, and the lengths of
    observed surface, m, on the map's surfaces and where the map has not looked. least: m, of straight surface."""
    cells, there, told = seen.staying(), known.staying(), np.empty((3, len(X)))
    against, against_there = (np.where(is_straight(one, least), AGAINST, MOVABLE) for one in (cells, there))
    mine, others = cKDTree(cells[:, :2]), cKDTree(there[:, :2])
    for k, pose in enumerate(X):
        at, old = moved_points(pose, cells), moved_points(se2.inverse(pose), there)
        on = surfaces.on(at, NEAR)
        before = looked_through(at, known.eyes, known.depth) & ~on
        before[before] = others.query(at[before, :2])[0] > BESIDE
        through = looked_through(old, seen.eyes, seen.depth)
        through[through] = mine.query(old[through, :2])[0] > BESIDE
        log = ON * on.sum() + against[before].sum() + against_there[through].sum()
        told[:, k] = CELL * np.array([log, on.sum(), np.sum(~on & ~before)])
    return told


def is_straight(cells: FloatArray, least: float) -> BoolArray:
    """Return a mask of the cells (n, 4) of straight surface that extends by at least so many metres, as of walls but
    not of people."""
    n, (a, b) = len(cells), cKDTree(cells[:, :2]).query_pairs(least, output_type="ndarray").T
    i, j = np.concatenate([a, b, np.arange(n)]), np.concatenate([b, a, np.arange(n)])
    (x, y), (n_x, n_y) = (cells[j, :2] - cells[i, :2]).T, cells[i, 2:].T
    same = (np.abs(n_x * x + n_y * y) < ACROSS) & (np.sum(cells[i, 2:] * cells[j, 2:], axis=1) > SAME_NORMAL)
    # Surface may be seen several times: each step of a cell's side along the tangent counts once.
    most = math.ceil(least / CELL) + 1
    step = np.rint((n_x * y - n_y * x)[same] / CELL).astype(np.int64) + most
    extent = np.bincount(np.unique(i[same] * (2 * most + 1) + step) // (2 * most + 1), minlength=n)
    return np.asarray(extent * CELL > least - 0.5 * CELL)


@njit(cache=True)
def nearest(eye: FloatArray, points: FloatArray) -> FloatArray:
    """Return the distance (BEARINGS,), m, of the nearest of points (p, 4) with normals that face an eye (2,), by
    bearing from -pi on, inf without one."""
    found, step = np.full(BEARINGS, np.inf), 2.0 * math.pi / BEARINGS
    for p in points:
        x, y = p[0] - eye[0], p[1] - eye[1]
        distance = math.hypot(x, y)
        if distance < 0.1 or p[2] * x + p[3] * y > -0.1 * distance:
            continue
        bearing, half = math.atan2(y, x) + math.pi, 0.4 * CELL / distance
        for k in range(math.floor((bearing - half) / step), math.floor((bearing + half) / step) + 1):
            found[k % BEARINGS] = min(found[k % BEARINGS], distance)
    return found


@njit(cache=True)
def looked_through(cells: FloatArray, eyes: FloatArray, seen: FloatArray) -> BoolArray:
    """Return a mask of the cells (n, 4) of surface that some of the eyes (e, 2) have looked through, as they saw
    farther there: seen (e, BEARINGS), see `nearest`."""
    through, step = np.zeros(len(cells), dtype=np.bool_), 2.0 * math.pi / BEARINGS
    for i in range(len(cells)):
        for e in range(len(eyes)):
            x, y = cells[i, 0] - eyes[e, 0], cells[i, 1] - eyes[e, 1]
            distance = math.hypot(x, y)
            if not 0.2 < distance < SIGHT or cells[i, 2] * x + cells[i, 3] * y > -SLANT * distance:
                continue
            k = math.floor((math.atan2(y, x) + math.pi) / step)
            a, b, c = seen[e, (k - 1) % BEARINGS], seen[e, k % BEARINGS], seen[e, (k + 1) % BEARINGS]
            if min(a, b, c) > distance + DEPTH and max(a, b, c) < np.inf:
                through[i] = True
                break
    return through


def tells_place(query: FloatArray) -> bool:
    """Return whether points with normals (q, 4) determine their place in both directions."""
    seen = thinned(query)
    across = np.linalg.eigvalsh(seen[:, 2:].T @ seen[:, 2:])
    return CELL * len(seen) >= LEAST_LENGTH and bool(across[0] > LEAST_ACROSS * across[1])


def is_elsewhere(poses: FloatArray, X: FloatArray) -> BoolArray:
    """Return a mask of the poses (k, 3) that are farther than SAME_PLACE from another (3,)."""
    off = poses - X
    within, turned = SAME_PLACE[1:]
    return np.asarray((np.hypot(off[:, 0], off[:, 1]) > within) | (np.abs(se2.wrap_angle(off[:, 2])) > turned))


def peaks(
    before: FloatArray, query: FloatArray, X: FloatArray, window: FloatArray, side: float = SIDE
) -> tuple[FloatArray, FloatArray]:
    """Return scores (k,) and poses (k, 3) in M at which a query (q, 2) fits points (p, 2) best, best first, APART or
    TURNED from each other, within a window (3,) of x, y (m) and heading (rad) around X (3,). side: of a cell, m."""
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
    """Return the closeness to the nearest of points (p, 2), 1 at a point, in cells of a side, m, from the corner low
    (2,) on."""
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
    """Return the mean (2a + 1, 2i + 1, 2j + 1) of the field at a query's points (p, 2), for steps of `turn` rad and of
    STEP cells in y and x around X (3,); steps: (3,) j, i, a."""
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

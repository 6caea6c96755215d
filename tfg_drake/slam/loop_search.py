"""Loop search: matches recent observations to old ones to find places that the robot has come back to.

A search (`place_search`) covers a window given by the uncertainty of the pose. A single match may be a look-alike, so a
loop is accepted once others along the way agree with it.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, MapEstimate, Observation, message, replace
from tfg_drake.slam.keyframe import moved_points, rows_of, way
from tfg_drake.slam.keyframe_graph import KeyframeGraph, empty_graph, moved_part
from tfg_drake.slam.map_solver import solve, solved
from tfg_drake.slam.map_update import deviation_of
from tfg_drake.slam.place_search import COARSE, LOOSELY, QUERY, UNTIED, peaks
from tfg_drake.slam.surface_fit import Surfaces, map_points
from tfg_drake.slam.surfaces import Ties

# Path lengths, m: what was seen over the last LATELY is the query, places LONG_AGO or more back are old, and old
# keyframes within AT_ONCE of the nearest place are searched together.
LATELY, LONG_AGO, AT_ONCE = 3.0, 15.0, 6.0
# Path length between searches, m. Least number of points of the query, and of the old surfaces.
EVERY, LEAST_POINTS = 1.0, 30
# Old places are considered within WITHIN, m, of the search window. The window, m and rad, is LEAST_WINDOW, plus
# DEVIATIONS deviations of the pose, plus DRIFT per metre of path since the last loop, up to MOST_WINDOW.
WITHIN, DEVIATIONS = 3.0, 3.0
LEAST_WINDOW, MOST_WINDOW, DRIFT = np.array([0.4, 0.08]), np.array([6.0, 0.5]), np.array([0.03, 0.003])
# Least score of the coarse search, and least share of points on old surfaces after the fit.
LEAST_SCORE, LEAST_SHARE = 0.35, 0.5
# Two loops within ALONG, m of path, agree within AGREE, m and rad, plus AGREE_SHARE per metre of it. A loop needs one
# other that agrees, or two if it moves the robot by more than FAR, m, or if the second peak exceeds RIVAL times the
# first. The new loops are closed if the solved graph agrees with most of them, within AGREE.
AGREE, AGREE_SHARE, ALONG = np.array([0.2, 0.03]), np.array([0.02, 0.003]), 12.0
FAR, RIVAL = 0.3, 0.9
# Deviations when a path is bent: of the path, m and rad per square root of a metre, and of a loop, m, m and rad.
BEND, TIE = np.array([0.03, 0.02]), np.array([0.05, 0.05, 0.01])


@message
class Loop:
    """A match: the newest view lies at X_AB (3,) in the frame of an old one."""

    old: int
    newest: int
    X_AB: FloatArray


@message
class LoopSearch:
    """The recent candidates, the closed loops, and the newest views at the last search and at the last loop."""

    candidates: tuple[Loop, ...] = ()
    closed: tuple[Loop, ...] = ()
    searched: int = 0
    tied: int = 0


def searched(search: LoopSearch, graph: KeyframeGraph, sigma: FloatArray) -> tuple[LoopSearch, tuple[Loop, ...]]:
    """Return the search after a graph's newest view, and the loops that it confirms. sigma: (2,) standard deviations of
    the newest pose, m and rad."""
    X = graph.X_MA
    newest, way = len(X) - 1, _way(X)
    if way[newest] < way[search.searched] + EVERY:
        return search, ()
    since = way[newest] - way[search.tied]
    window = np.minimum(LEAST_WINDOW + DEVIATIONS * sigma + DRIFT * since, MOST_WINDOW)
    old = np.flatnonzero(way < way[newest] - LONG_AGO)
    apart = np.hypot(*(X[old, :2] - X[newest, :2]).T)
    near = apart < WITHIN + window[0]
    old, apart = old[near], apart[near]
    if not len(old):
        return search, ()
    search = replace(search, searched=newest)
    nearest = old[np.argmin(apart)]
    group = old[np.abs(way[old] - way[nearest]) < AT_ONCE]
    before = map_points(graph, np.unique(graph.view_keyframe[group]))
    late = np.unique(graph.view_keyframe[way > way[newest] - LATELY])
    query = moved_points(se2.inverse(X[newest]), map_points(graph, late))
    if min(len(before), len(query)) < LEAST_POINTS:
        return search, ()
    query = query[np.random.default_rng(newest).permutation(len(query))[:QUERY]]
    scores, starts = peaks(before[:, :2], query[:COARSE, :2], X[newest], window[[0, 0, 1]])
    if not len(scores) or scores[0] < LEAST_SCORE:
        return search, ()
    there, _, share = Surfaces(before).fitted(query, starts[0], UNTIED, LOOSELY)
    if share < LEAST_SHARE:
        return search, ()
    rival = float(scores[1] / scores[0]) if len(scores) > 1 else 0.0
    off = math.dist(there[:2], X[newest, :2])
    loop = Loop(int(nearest), newest, se2.between(X[nearest], there))
    agree = tuple(other for other in search.candidates if _agree(loop, other, X, way))
    kept = tuple(other for other in search.candidates if way[other.newest] > way[newest] - ALONG)
    believed = len(agree) >= (2 if off > FAR or rival > RIVAL else 1)
    return replace(search, candidates=(*kept, loop)), (*agree, loop) if believed else ()


def bent(graph: KeyframeGraph, closed: tuple[Loop, ...], new: tuple[Loop, ...]) -> KeyframeGraph:
    """Return a graph whose path is bent as little as possible so that new loops close and earlier ones stay closed; its
    landmarks move with the keyframes that saw them last."""
    X_MN, X_MA = graph.X_MN, graph.X_MA
    step = se2.between(X_MN[:-1], X_MN[1:])
    length, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
    variance = np.column_stack([BEND[0] ** 2 * length + 1e-6] * 2 + [BEND[1] ** 2 * (length + turn) + 1e-8])
    ways = tuple(way(one, np.diag(of)) for one, of in zip(step, variance, strict=True))
    loops = (*closed, *new)
    old, newest = (np.array([getattr(loop, end) for loop in loops]) for end in ("old", "newest"))
    X_AB = se2.between(X_MA[old], X_MA[newest])
    X_AB[len(closed) :] = [loop.X_AB for loop in new]
    X_AB = se2.compose(se2.compose(graph.X_AV[old], X_AB), se2.inverse(graph.X_AV[newest]))
    first, second = graph.view_keyframe[old], graph.view_keyframe[newest]
    apart = first != second  # Views of one keyframe, which were fused, lie as they do.
    information = np.tile(np.diag(TIE**-2.0), (int(np.count_nonzero(apart)), 1, 1))
    ties = Ties(first[apart], second[apart], X_AB[apart], information)
    bare = replace(empty_graph(graph.prior), keyframes=ways, X_MN=X_MN, ties=ties)
    bare, _ = solved(bare, np.zeros(0, dtype=np.int64), len(ways))
    last = np.zeros(len(graph.ids), dtype=np.int64)
    for k, one in enumerate(graph.keyframes):
        last[rows_of(one.ids, graph.ids)[0]] = k
    for k in np.unique(last):
        graph = moved_part(graph, last == k, se2.compose(bare.X_MN[k], se2.inverse(X_MN[k])))
    return replace(graph, X_MN=bare.X_MN)


def with_loops_closed(
    search: LoopSearch, graph: KeyframeGraph, estimate: MapEstimate, observation: Observation
) -> tuple[LoopSearch, KeyframeGraph, MapEstimate]:
    """Return the search after a graph's newest view, and graph and estimate after closing its loops, if the solved
    graph agrees with them; otherwise both unchanged."""
    search, loops = searched(search, graph, deviation_of(estimate))
    known = {(loop.old, loop.newest) for loop in search.closed}
    new = tuple(loop for loop in loops if (loop.old, loop.newest) not in known)
    if not new:
        return search, graph, estimate
    asked, there, told = len(new), graph, estimate
    if any(_is_open(graph, loop) for loop in new):
        there = bent(replace(graph, p_ML=estimate.p_ML), search.closed, new)
        for _ in range(2):  # The second solve regroups the pieces of surface that the first has moved.
            there, told = solve(there, estimate.stamp, observation)
    new = tuple(loop for loop in new if not _is_open(there, loop))
    if 2 * len(new) <= asked:
        return replace(search, candidates=()), graph, estimate
    return replace(search, closed=(*search.closed, *new), tied=new[-1].newest), there, told


def _is_open(graph: KeyframeGraph, loop: Loop) -> bool:
    """Return whether a graph disagrees with a loop."""
    X = graph.X_MA
    return not _within(se2.between(loop.X_AB, se2.between(X[loop.old], X[loop.newest])), AGREE)


def _way(X: FloatArray) -> FloatArray:
    """Return the path length (n,), m, up to each of some poses (n, 3)."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(X[:, :2], axis=0).T)))


def _agree(one: Loop, other: Loop, X: FloatArray, way: FloatArray) -> bool:
    """Return whether two loops agree: the motion between their new ends equals that between their old ones."""
    between = way[one.newest] - way[other.newest]
    if between > ALONG:
        return False
    there = se2.compose(one.X_AB, se2.between(X[one.newest], X[other.newest]))
    back = se2.compose(se2.between(X[one.old], X[other.old]), other.X_AB)
    return _within(se2.between(back, there), AGREE + AGREE_SHARE * between)


def _within(X: FloatArray, most: FloatArray) -> bool:
    """Return whether a pose (3,) is within these bounds (2,), m and rad."""
    return bool(math.hypot(X[0], X[1]) <= most[0] and abs(X[2]) <= most[1])

"""Finds where a session is in the map that it began with. Until it is found it maps apart, in a frame of its own.

Hypotheses are the poses from which the tags of both, or the surfaces seen so far, fit the map (`place_search`); one is
believed when the odds that it is wrong are small. Then both maps become one: the older one is a keyframe at the
beginning of the graph, in whose frame all lies from then on, with the names of the session's walls where they are the
same.
"""

from __future__ import annotations

import logging
import math
from typing import Protocol

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import (
    FloatArray,
    Hypotheses,
    IntArray,
    MapEstimate,
    SaidPose,
    TagDetections,
    is_tag,
    replace,
)
from tfg_drake.slam.estimator_state import EstimatorState, KnownMap, Placed, newest_of, opened, reduced_now, unknown_way
from tfg_drake.slam.evidence import TagWatch, renewed, with_doubts
from tfg_drake.slam.keyframe import joined_reach, placed, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map, extended, no_observation
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.slam.lost_robot import Expected, relocalize
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.map_update import deviation_of
from tfg_drake.slam.place_search import (
    WRONG,
    Places,
    Prior,
    Seen,
    find_places,
    is_elsewhere,
    nothing_seen,
    seen_by_views,
)
from tfg_drake.slam.surface_fit import surface_points
from tfg_drake.slam.walls import named, renamed
from tfg_drake.table import concat, empty, take

# A pose that says nothing of where to look.
ANYWHERE = Expected(np.array([1e6, 0.0, 0.0]), None, np.ones(3))
# Tags that must agree.
LEAST_TAGS = 3
# Deviations of a pose by walls, m, m, rad.
BY_WALLS = np.array([0.05, 0.05, 0.005])
# The pose is looked for in the first turn after so many frames, and whenever the robot has turned by so much, rad.
FRAMES, TURNED = 4, 1.0
# And after each of the first views, so many, and then after each of so many.
EACH_VIEW, LATER = 4, 4
# The place that somebody says is so much likelier than others, as a logarithm.
ELSEWHERE = -4.0
# One that was believed is so as long as it is this probable.
STILL = 0.9

_operator = logging.getLogger("tfg_drake.operator")


class Tagged(Protocol):
    """A map with tags."""

    @property
    def ids(self) -> IntArray:
        """(n,) of the tags, ascending."""

    @property
    def p_ML(self) -> FloatArray:
        """(n, 2) places of the tags, m."""

    @property
    def landmark_covariance(self) -> FloatArray:
        """(n, 2, 2) of these, m^2."""


def by_tags(of_A: Tagged, of_B: Tagged) -> Placed | None:
    """How B lies in A by the tags of both, robustly; None where these are too few or do not tell it.

    Raises:
        BadInput: there are enough, and they stand differently.
    """
    common, in_A, in_B = np.intersect1d(of_A.ids, of_B.ids, return_indices=True)
    if len(common) < LEAST_TAGS:
        return None
    # Seen from amid them: far off a small error of heading is a large one of the place.
    middle = of_B.p_ML[in_B].mean(axis=0)
    x, y = (of_B.p_ML[in_B] - middle).T
    both = of_A.landmark_covariance[in_A], of_B.landmark_covariance[in_B]
    sigma, distance = np.sqrt(sum(np.linalg.eigvalsh(one)[:, -1] for one in both)), np.hypot(x, y)
    seen = TagDetections(0.0, common, distance, np.arctan2(y, x), sigma, sigma / np.maximum(distance, 0.1))
    known = replace(empty_map(), ids=of_A.ids, p_ML=of_A.p_ML, landmark_covariance=of_A.landmark_covariance)
    found = relocalize(known, seen, ANYWHERE)
    if found is None:
        raise BadInput(
            f"{len(common)} tags are in both, but fewer than three in five of them stand alike: are both of one place?"
        )
    if not found.is_known:
        return None
    X_AB, J = se2.compose(found.X_MB, np.append(-middle, 0.0)), np.eye(3)
    J[:2, 2] = (found.X_MB[:2] - X_AB[:2])[::-1] * [1.0, -1.0]
    return Placed(X_AB, J @ found.covariance @ J.T, common[~found.agreeing])


def said_to_be(state: EstimatorState, said: SaidPose, X_MB: FloatArray) -> EstimatorState:
    """The state of a session when somebody says where the robot is, which counts as long as it maps apart. X_MB: (3,)
    its pose in the session's frame now."""
    known = state.known
    if known is None or state.at is not None:
        _operator.warning("%.2f s: where the robot is said to be does not count: it does not map apart", state.stamp)
        return state
    X_KB = se2.between(known.X_WK, said.X_WB)
    X_KM, J = se2.compose(X_KB, se2.inverse(X_MB)), np.eye(3)
    J[:2, 2] = (X_KM[:2] - X_KB[:2])[::-1] * [-1.0, 1.0]
    covariance = J @ np.diag(np.square(said.sigma)[[0, 0, 1]]) @ J.T
    return replace(state, known=replace(known, said=Placed(X_KM, covariance)))


def looked_for(state: EstimatorState) -> EstimatorState:
    """The state of a session in its first turn, which may have seen by now where it is."""
    known, turn = state.known, state.turn
    if known is None or turn is None or state.map is not None:
        return state
    count, parts = (
        len(turn.frames),
        [round((frame.X_OB[2] - turn.begin.X_OB[2]) / TURNED) for frame in turn.frames[-2:]],
    )
    if count != FRAMES and (count < FRAMES or parts[0] == parts[1]):
        return state
    newest, shared = newest_of(turn), state.graph.shared
    one, X_MA = reduced_now(state, newest).keyframe, newest.X_MB
    w = one.walls
    y_AL, _, R = one.given(shared.mean)
    rows = 2 * np.arange(w, len(one.ids))[:, None] + [0, 1]
    covariance = R[rows[:, :, None], rows[:, None]]
    tags = replace(empty_map(), ids=one.ids[w:], p_ML=se2.transform(X_MA, y_AL[w:]), landmark_covariance=covariance)
    seen = nothing_seen().with_look(surface_points(one, shared.mean), X_MA)
    return _with_place(state, *_placement(known, tags, seen))


def joined(state: EstimatorState) -> EstimatorState:
    """The state of a session after a view, one with the map that it began with if it knows where in that it is."""
    known, estimate = state.known, state.map
    if known is None or estimate is None or (estimate.stage > EACH_VIEW and estimate.stage % LATER):
        return state
    found, places = _placement(known, estimate.of_tags, seen_by_views(state.graph))
    state = _with_place(state, found, places)
    return state if state.at is None else _with_known(state, known, state.at)


def in_known(
    at: Placed, X_MB: FloatArray, covariance: FloatArray, p_MU: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A session's pose (3,), its covariance (3, 3) and places (u, 2) in the frame of the map that it began with."""
    X_KB, J = se2.compose(at.X, X_MB), np.eye(3)
    J[:2, 2] = (X_KB[:2] - at.X[:2])[::-1] * [-1.0, 1.0]
    turned = np.eye(3)
    turned[:2, :2] = rotation(float(at.X[2]))
    both = J @ at.covariance @ J.T + turned @ covariance @ turned.T
    return X_KB, np.asarray(both), se2.transform(at.X, p_MU)


def _placement(known: KnownMap, tags: MapEstimate, seen: Seen) -> tuple[Placed | None, Places | None]:
    """How a session lies in the map that it began with, by its tags or by its surfaces; the places that it may be."""
    try:
        found = by_tags(known.estimate.of_tags, tags)
    except BadInput:  # Ids that hang elsewhere: in another building they do.
        found = None
    if found is not None:
        return found, None
    prior = None if known.said is None else Prior(known.said.X, np.sqrt(np.diag(known.said.covariance)), ELSEWHERE)
    places = find_places(known.surfaces, seen, prior)
    X = places.found()
    return (None if X is None else Placed(X, np.diag(BY_WALLS**2))), places


def _with_place(state: EstimatorState, found: Placed | None, places: Places | None) -> EstimatorState:
    """The state with where the session is, and what it is to be told of that."""
    if found is None:
        if state.at is not None and places is not None and places.near(state.at.X) > STILL:
            nearest = np.argmin(np.hypot(*(places.X - state.at.X)[:, :2].T))
            return replace(state, at=replace(state.at, X=places.X[nearest]))
        if state.at is not None:
            _operator.warning("%.2f s: what follows contradicts that place: the robot looks for itself", state.stamp)
        hypotheses = _not_refuted(state.known, places)
        count = hypotheses.likely
        if count > 1 and count != state.hypotheses.likely:
            _operator.warning("%.2f s: the robot may be in %d places of its map", state.stamp, count)
        return replace(state, at=None, placed=-math.inf, hypotheses=hypotheses)
    if state.at is None:
        x, y, _ = found.X if state.map is None else se2.compose(found.X, state.map.X_MD)
        by = "surfaces" if places is not None else "tags"
        _operator.warning(
            "%.2f s: the robot has found itself at (%.2f, %.2f) m of its map, by %s", state.stamp, x, y, by
        )
        said = None if state.known is None else state.known.said
        if said is not None and is_elsewhere(found.X[None], said.X)[0]:
            off = math.dist(found.X[:2], said.X[:2])
            _operator.warning("%.2f s: that is %.1f m from where it was said to be", state.stamp, off)
    placed = state.stamp if state.at is None else state.placed
    return replace(state, at=found, placed=placed, hypotheses=empty(Hypotheses))


def _not_refuted(known: KnownMap | None, places: Places | None) -> Hypotheses:
    """Those of the places that keep the session from believing in another one."""
    if known is None or places is None:
        return empty(Hypotheses)
    left = places.probability > WRONG
    return Hypotheses(places.X[left], places.probability[left], known.surfaces)


def _with_known(state: EstimatorState, known: KnownMap, at: Placed) -> EstimatorState:
    """The state of a session that lies so in the map that it began with as one map, in the frame of that."""
    X_KM, graph, stamp = at.X, state.graph, state.stamp
    assert state.map is not None
    told = solve(graph, stamp, no_observation(), joint=known_jointly(graph))[1]
    one = without_tags(known.keyframe, at.moved)
    names, walls = renamed(one, state.walls, told, se2.inverse(X_KM), at.covariance)
    one = named(one, names)
    both = replace(empty_graph(graph.prior, graph.solver), shared=graph.shared)
    both = extended(both, one, known.X_KD, is_view=False)
    way, _ = unknown_way(se2.between(known.X_KD, X_KM), np.sqrt(np.diag(at.covariance)))
    both = extended(both, way.keyframe, X_KM, is_view=False)
    for later, X_MN in zip(graph.keyframes, graph.X_MN[1:], strict=True):
        both = extended(both, later, se2.compose(X_KM, X_MN), is_view=False)
    # Surfaces and free space hang on the views, and on the walls where the session has them.
    rows, w = np.searchsorted(both.ids, graph.ids), int(np.count_nonzero(~is_tag(graph.ids)))
    (p_ML, anchor), reach = placed(X_KM, graph.ids, told.p_ML, graph.anchor), graph.reach.copy()
    reach[:w] = joined_reach(p_ML[:w], anchor[:w], reach[:w], both.anchor[rows[:w]], both.reach[rows[:w]])
    where = {name: getattr(both, name).copy() for name in ("p_ML", "anchor", "reach")}
    for values, of_session in zip(where.values(), (p_ML, anchor, reach), strict=True):
        values[rows] = of_session
    both = replace(
        both,
        **where,
        view_keyframe=graph.view_keyframe + 2,
        X_AV=graph.X_AV,
        tag_error=graph.tag_error,
        unevenness=graph.unevenness,
    )
    both, estimate = solve(both, stamp, state.map.observation)
    others = take(known.evidence, ~np.isin(known.evidence.ids, state.evidence.ids))
    evidence = concat(state.evidence, others)
    whole = with_doubts(replace(estimate, frame_worth=state.map.frame_worth), evidence, both)
    state = replace(
        state,
        graph=both,
        solved=both,
        map=whole,
        published=whole.of_tags,
        walls=walls,
        evidence=evidence,
        watch=_watch(state.watch, whole.of_tags.ids, known, X_KM),
        localizer=start_localizer(estimate, walls),
        known=None,
        at=None,
        deviation=deviation_of(estimate),
    )
    return replace(state, piece=opened(state))


def _watch(watch: TagWatch, ids: IntArray, known: KnownMap, X_KM: FloatArray) -> TagWatch:
    """The watch over the tags (n,) of both maps; of those that only the older has it knows which way they face."""
    watch = renewed(replace(watch, seen_from=watch.seen_from @ rotation(float(X_KM[2])).T), ids)
    row, is_old = rows_of(ids, known.estimate.of_tags.ids)
    only_old = is_old & ~watch.seen_from.any(axis=1)
    seen_from = watch.seen_from.copy()
    seen_from[only_old] = known.facing[row[only_old]]
    return replace(watch, seen_from=seen_from)

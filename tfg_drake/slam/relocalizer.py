"""The relocaliser: finds the pose of a session in its known map, or of a kidnapped robot in its own map.

Hypotheses are the poses at which common tags, or the surfaces seen recently, fit the map (`tag_search`,
`place_search`); one is accepted when its error probability is small.

A session maps apart, in its own frame, until it is found; then both maps become one (`joining`), and are separated
again if later views contradict that. For a robot that may be elsewhere in its own map, everything seen since the first
frame that contradicts its pose is searched: it is where it seemed to be, or elsewhere after an unknown motion, or lost.
A lost robot continues to map, but its new part of the map would stay uncertain by metres, as walls are associated only
where their place is known. So as long as the newest part of the map is adrift each view is searched, and that part is
moved as a whole, farther than a linearisation is valid.
"""

from __future__ import annotations

import logging
import math

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import (
    FloatArray,
    Hypotheses,
    MapEstimate,
    SaidPose,
    TagDetections,
    replace,
)
from tfg_drake.notes import take_note
from tfg_drake.slam.estimator_state import (
    KIDNAPPED,
    EstimatorState,
    KnownMap,
    Placed,
    Stretch,
    newest_of,
    opened,
    reduced_now,
    unknown_way,
)
from tfg_drake.slam.evidence import Sighted
from tfg_drake.slam.joining import OF_KNOWN, with_known, without_known
from tfg_drake.slam.keyframe import Keyframe, is_unknown, moved_points, rows_of
from tfg_drake.slam.keyframe_graph import KeyframeGraph, adrift, empty_map, moved_part, seen_by, tied
from tfg_drake.slam.localizer import Localizer, localized_pose, placed_localizer, without_local
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.place_search import (
    LIKELY,
    WRONG,
    Places,
    Prior,
    Seen,
    find_places,
    fits_near,
    is_elsewhere,
    log_odds,
    nothing_seen,
    seen_by_keyframes,
    tells_place,
)
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW, seen_from_body
from tfg_drake.slam.surface_fit import surface_points
from tfg_drake.slam.tag_search import by_tags
from tfg_drake.table import empty

# The tags and surfaces of a map, or of a look.
Look = tuple[MapEstimate, Seen]
# Deviations of a pose found by surfaces, m, m, rad.
BY_WALLS = np.array([0.05, 0.05, 0.005])
# In the first turn a session searches its place after FRAMES frames, then each time it has turned by TURNED, rad.
FRAMES, TURNED = 4, 1.0
# After that it searches at each of the first EACH_VIEW views, then at every LATER-th. The maps are joined for good
# EACH_VIEW views after they were joined.
EACH_VIEW, LATER = 4, 4
# Log prior odds of a place other than the one that a person has stated.
SAID = -4.0
# An accepted place is kept as long as its probability exceeds STILL. At the end of a search in doubt a place within the
# drift is accepted from this probability on.
STILL = 0.9
# A tag this far from its mapped place, m, contradicts the pose, however long the robot has driven without tags.
ELSEWHERE = 5.0
# The pose is in doubt after this many more frames that contradict it than agree.
CONTRADICTIONS = 3
# In doubt, surfaces are searched at every LOOKS-th frame with lines. The doubt ends if the robot is likelier to have
# drifted than to have been carried, and its pose, within HERE, m, m, rad, and three deviations, may be right. Without a
# place it counts as kidnapped after LONGEST_SEARCH, s.
LOOKS, LONGEST_SEARCH = 5, 5.0
HERE = np.array([0.05, 0.05, 0.02])
# Deviations of a drift, m, m, rad. Log prior odds of a place beyond three of them, that is, of having been carried: a
# constant, and per metre, as the other end of a building, not mapped yet, may look alike.
DRIFTED, CARRIED, A_METRE = np.array([0.5, 0.5, 0.17]), -5.0, -0.3
# DRIFTED and CARRIED of a robot that is known to be elsewhere: of places only the distance counts, by A_METRE.
FROM_HERE = np.zeros(3), 0.0
# A turn contradicts the pose if its log odds against the views within AROUND, m, are at most DOUBTFUL. Of 461 turns of
# robots that nobody carried, two thirds of them among people, the lowest odds are 1.4; of 19 that were carried 16 had
# -2.1 or less at their first or second turn.
DOUBTFUL, AROUND = -0.3, 8.0
# Deviations of a pose found among walls, m, m, rad, wider than BY_WALLS, as what is seen from there counts again.
PLACED = np.array([0.1, 0.1, 0.03])

_log, _operator = logging.getLogger("tfg_drake.slam"), logging.getLogger("tfg_drake.operator")


def said_to_be(state: EstimatorState, said: SaidPose, X_MB: FloatArray) -> EstimatorState:
    """Return the state of a session after a person has stated the robot's pose, which is used while it maps apart.
    X_MB: (3,) its current pose in the session's frame."""
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
    """Return the state of a session in its first turn after a search for its place."""
    known, turn = state.known, state.turn
    if known is None or turn is None or state.map is not None:
        return state
    count = len(turn.frames)
    parts = [round((frame.X_OB[2] - turn.begin.X_OB[2]) / TURNED) for frame in turn.frames[-2:]]
    if count != FRAMES and (count < FRAMES or parts[0] == parts[1]):
        return state
    newest = newest_of(turn)
    return _with_place(state, known, _seen_of(_until_now(state, newest), state, newest.X_MB))


def joined(state: EstimatorState) -> EstimatorState:
    """Return the state of a session after a view: joined with its known map while its place there is known."""
    known, estimate = state.known, state.map
    if known is None or estimate is None or adrift(state.graph) >= 0:
        return state
    views = estimate.stage - known.since
    if views > EACH_VIEW and views % LATER:
        return state
    # All observations of the session itself.
    tags, own = (empty_map(), OF_KNOWN + 1) if known.since else (estimate.of_tags, 0)
    seen = seen_by_keyframes(state.graph, range(own, len(state.graph.keyframes)))
    state = _with_place(state, known, (tags, seen))
    if state.at is None:
        return state
    if not known.since:
        return with_known(state, known, state.at)
    return replace(state, known=None, at=None) if views >= EACH_VIEW else state


def in_known(
    at: Placed, X_MB: FloatArray, covariance: FloatArray, p_MU: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a session's pose (3,), its covariance (3, 3) and places (u, 2) in the frame of its known map."""
    X_KB, J = se2.compose(at.X, X_MB), np.eye(3)
    J[:2, 2] = (X_KB[:2] - at.X[:2])[::-1] * [-1.0, 1.0]
    turned = np.eye(3)
    turned[:2, :2] = rotation(float(at.X[2]))
    both = J @ at.covariance @ J.T + turned @ covariance @ turned.T
    return X_KB, np.asarray(both), se2.transform(at.X, p_MU)


def mapped_elsewhere(state: EstimatorState, localizer: Localizer, seen: TagDetections) -> int:
    """Return the number of a frame's tags that are mapped beyond the localiser's reach and were seen far from there."""
    row, mapped = rows_of(seen.ids, state.graph.ids)
    estimate = localizer.map
    mapped &= ~rows_of(seen.ids, estimate.ids[estimate.local])[1]
    if state.map is None or not mapped.any():
        return 0
    X_MB, _ = localized_pose(localizer, state.noise.now.walks, np.zeros(3), 0.0)
    seen = seen_from_body(seen, state.graph.shared)
    angle = X_MB[2] + seen.bearing[mapped]
    p_ML = X_MB[:2] + seen.range[mapped, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return int(np.count_nonzero(np.hypot(*(p_ML - state.map.p_ML[row[mapped]]).T) > ELSEWHERE))


def find_itself(state: EstimatorState, *, at_last: bool = False) -> EstimatorState:
    """Return the state after a search for the pose in the map, as the robot is lost or too many frames contradict its
    pose. Tags are searched at each frame with tags, surfaces every LOOKS frames and at last.

    at_last: the observations are about to be mapped at the current pose, unless the robot is found or known to be
    elsewhere.
    """
    estimate, suspect, stamp = state.map, state.seen_in_doubt, state.stamp
    if estimate is None or suspect is None or not suspect.frames:
        return state
    by_surfaces = at_last or sum(len(frame.lines) > 0 for frame in suspect.frames) % LOOKS == 0
    if not by_surfaces and not len(suspect.frames[-1].detections.ids):
        return state
    newest = newest_of(suspect)
    seen = _seen_of(_until_now(state, newest), state, np.zeros(3))
    by_surfaces = by_surfaces and tells_place(seen[1].points)
    graph, known = state.graph, estimate.of_landmarks(tied(state.graph)).of_tags
    # Where the map is adrift the newest pose is known among the keyframes behind the unknown way.
    begin = adrift(graph) + 1
    mapped = seen_by_keyframes(graph, range(begin, len(graph.keyframes)) if by_surfaces or at_last else ())
    expected, anywhere = newest.X_MB, math.isnan(state.placed) and not begin
    # A resumed robot most probably stands where it stood; any other place is as unlikely as to be carried there.
    sigma, carried = FROM_HERE if state.is_kidnapped and not math.isnan(state.placed) else (DRIFTED, CARRIED)
    prior = Prior(expected, sigma, carried, A_METRE)
    found, places = _where((known, mapped), seen, prior, is_growing=True)
    if not by_surfaces and found is None:
        by_walls = not (rows_of(seen[0].ids, known.ids)[1].any() or state.is_kidnapped or begin)
        if not (at_last and by_walls):
            return state
        has_drifted = fits_near(mapped, seen[1], expected, 3.0 * DRIFTED)
        return _drifted(state, newest) if has_drifted else _carried(state)
    is_carried = state.is_kidnapped or places.near(expected, 3.0 * DRIFTED) < LIKELY
    here = not is_carried and places.may_be(expected, HERE + 3.0 * suspect.sigma)
    # A robot that is lost already, and maps apart, is not declared lost again.
    if here or (begin and found is None and not state.is_kidnapped):
        return replace(state, contradictions=0.0, suspect=None)
    if found is None:
        if state.is_kidnapped or (stamp - suspect.begin.stamp < LONGEST_SEARCH and not at_last):
            return state
        if is_carried or places.probability[0] < STILL:
            return _carried(state)
        found = Placed(places.X[0], np.diag(BY_WALLS**2))
    if anywhere:
        _operator.warning("%.2f s: the robot has found itself in its map, by %s", stamp, found.by)
    else:
        x, y, turn = found.X - expected
        off = f"{math.hypot(x, y):.2f} m and {abs(float(se2.wrap_angle(turn))):.2f} rad"
        take_note("slip", stamp, f"the robot is {off} from where its wheels have brought it; {found.by} say so")
    X_MB = se2.compose(found.X, se2.between(newest.begin.X_OB, state.instant.X_OB))
    if not estimate.is_joint:
        graph = replace(graph, p_ML=estimate.p_ML)
        node = 1 + int(np.argmin(np.hypot(*(graph.X_MN[1:] - X_MB)[:, :2].T)))
        _, estimate = solve(graph, estimate.stamp, estimate.observation, node=node)
    localizer = placed_localizer(estimate, state.walls, X_MB, PLACED)
    placed = stamp if anywhere else state.placed
    state = replace(state, localizer=localizer, placed=placed, contradictions=0.0, suspect=None)
    return begun_elsewhere(state, replace(newest, X_MB=found.X, sigma=PLACED))


def _carried(state: EstimatorState) -> EstimatorState:
    """Return the state of a robot whose pose is contradicted and that is at no other place for certain."""
    take_note("slip", state.stamp, "what is in view contradicts the pose; the robot looks for itself")
    # Tags met before the robot was moved have another place relative to it now.
    state = replace(state, localizer=without_local(state.localizer))
    return begun_elsewhere(state, replace(opened(state), sigma=KIDNAPPED))


def _drifted(state: EstimatorState, newest: Stretch) -> EstimatorState:
    """Return the state of a robot whose pose walls contradict that do not tell its place, as those of a corridor, but
    fit the map within a drift, which is likelier than that somebody has carried it."""
    estimate = state.map
    assert estimate is not None
    take_note("slip", state.stamp, "walls contradict the pose and do not tell another one; the map may be bent here")
    X_MB = se2.compose(newest.X_MB, se2.between(newest.begin.X_OB, state.instant.X_OB))
    localizer = placed_localizer(estimate, state.walls, X_MB, DRIFTED)
    state = replace(state, localizer=localizer, contradictions=0.0, suspect=None)
    return begun_elsewhere(state, replace(newest, sigma=DRIFTED))


def doubted(state: EstimatorState) -> EstimatorState:
    """Return the state at the end of a turn. If the map contradicts the turn, as one has looked through what the other
    sees, the robot may be elsewhere."""
    turn, graph = state.turn, state.graph
    if turn is None or state.is_kidnapped or not state.may_be_moved or adrift(graph) >= 0:
        return state
    X_BS = graph.shared.mean[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
    looks = [(se2.between(turn.begin.X_OB, frame.X_OB), frame.points) for frame in turn.frames if len(frame.points)]
    points = [moved_points(se2.compose(X_AB, X_BS), some[some[:, 2:].any(axis=1)]) for X_AB, some in looks]
    seen = nothing_seen().with_look(np.vstack([np.empty((0, 4)), *points]), turn.X_MB)
    views = graph.view_keyframe[np.hypot(*(graph.X_MA - turn.X_MB)[:, :2].T) < AROUND]
    mapped = seen_by_keyframes(graph, np.unique(views))
    if not len(mapped.points) or not len(seen.points) or log_odds(mapped, seen) > DOUBTFUL:
        return state
    return replace(state, contradictions=CONTRADICTIONS, suspect=turn)


def begun_elsewhere(state: EstimatorState, begun: Stretch) -> EstimatorState:
    """Return the state of a kidnapped robot: the motion from the last view to the stretch `begun` is unknown."""
    turn = state.turn
    if turn is not None and begun.begin.stamp < turn.begin.stamp:
        begun = replace(opened(state), sigma=begun.sigma)
    # The search goes on with what was seen from the stretch on in which the doubt began.
    before: tuple[Stretch, ...] = ()
    if state.suspect is not None:
        since = state.suspect.begin.stamp
        before = state.log[max((k for k, one in enumerate(state.log) if one.begin.stamp <= since), default=0) :]
    return replace(state, log=(*before, replace(begun, is_turn=turn is not None, is_apart=True)))


def found_again(
    state: EstimatorState, way: tuple[Sighted, ...], view: Keyframe
) -> tuple[KeyframeGraph, MapEstimate, tuple[Sighted, ...], Hypotheses]:
    """Return graph and map before a view, and the motion to it, with an unknown motion replaced if the view determines
    its place. Otherwise returns the hypotheses: poses in M where the adrift part may begin."""
    graph, estimate = state.graph, state.map or state.localizer.map
    j, lost = adrift(graph), any(is_unknown(one.keyframe) for one in way)
    if not lost and j < 0:
        return graph, estimate, way, empty(Hypotheses)
    before, since = seen_by(graph, graph.keyframes[:j]), seen_by(graph, graph.keyframes[j + 1 :])
    before = before if j >= 0 else since
    at = estimate.X_MD
    for one in way:
        at = se2.compose(at, one.keyframe.y_AD)
    # All views of the adrift part together are searched.
    k = len(graph.keyframes)
    seen = _seen_of(view, state, at, None if lost else seen_by_keyframes(graph, range(j + 1, k)))
    known = estimate.of_landmarks(before & (lost | ~since)).of_tags
    mapped = seen_by_keyframes(graph, range(j if j >= 0 else k))
    begun = at if lost else graph.X_MN[j + 1]
    sigma, carried = (DRIFTED, CARRIED) if math.isnan(state.placed) else FROM_HERE
    prior, earlier = Prior(begun, sigma, carried, A_METRE, begun), state.hypotheses.X_KM
    found, places = _where((known, mapped), seen, prior, earlier, is_growing=True)
    if found is None:
        left = places.probability > WRONG
        some = Hypotheses(se2.compose(places.X, begun)[left], places.probability[left], mapped.points)
        return graph, estimate, way, some
    _log.warning("%.2f s: the robot has found itself; what follows is tied to the map before", state.stamp)
    if lost:
        way = (Sighted(unknown_way(se2.between(estimate.X_MD, se2.compose(found.X, at)), PLACED)),)
        return graph, estimate, way, empty(Hypotheses)
    poses = graph.X_MN.copy()
    poses[j + 1 :] = se2.compose(found.X, poses[j + 1 :])
    tie = unknown_way(se2.between(poses[j], poses[j + 1]), PLACED)
    keyframes = (*graph.keyframes[:j], tie, *graph.keyframes[j + 1 :])
    graph = moved_part(replace(graph, keyframes=keyframes, X_MN=poses, p_ML=estimate.p_ML), since, found.X)
    return *solve(graph, estimate.stamp, estimate.observation), way, empty(Hypotheses)


def _until_now(state: EstimatorState, seen: Stretch) -> Keyframe:
    """Return a stretch as a keyframe that ends at the time of the filters."""
    return reduced_now(state, (seen.begin, seen.frames, state.instant)).keyframe


def _seen_of(one: Keyframe, state: EstimatorState, X: FloatArray, before: Seen | None = None) -> Look:
    """Return the tags and surfaces that a keyframe with a start pose (3,) in some frame sees, in that frame, together
    with those seen before."""
    w, shared = one.walls, state.graph.shared.mean
    y_AL, _, R = one.given(shared)
    rows = 2 * np.arange(w, len(one.ids))[:, None] + [0, 1]
    covariance = R[rows[:, :, None], rows[:, None]]
    tags = replace(empty_map(), ids=one.ids[w:], p_ML=se2.transform(X, y_AL[w:]), landmark_covariance=covariance)
    return tags, (before or nothing_seen()).with_look(surface_points(one, shared), X)


def _where(
    known: Look, seen: Look, prior: Prior | None, before: FloatArray | None = None, *, is_growing: bool = False
) -> tuple[Placed | None, Places]:
    """Return the pose of an observation's frame in a map, by common tags or by surfaces, None if unknown; and the
    possible places. before, is_growing: see `find_places`."""
    try:
        found = by_tags(known[0], seen[0])
    except BadInput:  # Ids that hang elsewhere: in another building they do.
        found = None
    if found is not None:
        only = np.ones(1)
        return found, Places(found.X[None], only, only > 0.0)
    places = find_places(known[1], seen[1], prior, before, is_growing=is_growing)
    X = places.found()
    return (None if X is None else Placed(X, np.diag(BY_WALLS**2))), places


def _with_place(state: EstimatorState, known: KnownMap, seen: Look) -> EstimatorState:
    """Return the state of a session with these observations, in its frame, and its place in the known map."""
    said = None if known.since else known.said
    prior = None if said is None else Prior(said.X, np.sqrt(np.diag(said.covariance)), SAID)
    of_map, earlier = known.estimate.of_tags, state.hypotheses.X_KM
    found, places = _where((of_map, known.seen), seen, prior, earlier)
    at = state.at
    if at is not None and (not len(places.X) or places.near(at.X) > STILL):
        if known.since or not len(places.X):
            return state
        nearest = np.argmin(np.hypot(*(places.X - at.X)[:, :2].T))
        return replace(state, at=found or replace(at, X=places.X[nearest]))
    if at is not None:
        _operator.warning("%.2f s: what follows contradicts that place: the robot looks for itself", state.stamp)
        state = replace(state, at=None, placed=-math.inf)
        if known.since:
            return without_known(state, known)
    if found is None:
        left = places.probability > WRONG
        hypotheses = Hypotheses(places.X[left], places.probability[left], known.seen.points)
        count = hypotheses.likely
        if count > 1 and count != state.hypotheses.likely:
            _operator.warning("%.2f s: the robot may be in %d places of its map", state.stamp, count)
        return replace(state, hypotheses=hypotheses)
    X_WM = se2.compose(known.X_WK, found.X)
    x, y, _ = X_WM if state.map is None else se2.compose(X_WM, state.map.X_MD)
    message = "%.2f s: the robot has found itself at (%.2f, %.2f) m in the world of its map, by %s"
    _operator.warning(message, state.stamp, x, y, found.by)
    if said is not None and is_elsewhere(found.X[None], said.X)[0]:
        off = math.dist(found.X[:2], said.X[:2])
        _operator.warning("%.2f s: that is %.1f m from where it was said to be", state.stamp, off)
    return replace(state, at=found, placed=state.stamp, hypotheses=empty(Hypotheses))

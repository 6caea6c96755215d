"""The SLAM estimator as pure functions on one immutable state: odometry and detections in, pose and map out.

Between views a localiser estimates the pose in the map; turns in place and pieces of the way collect frames. At the
end of a turn the turn and the pieces before it are solved separately and join the map, and the localiser restarts at
the departure pose. Frames are processed by their stamps, whatever the order of arrival, each once odometry beyond its
stamp has arrived. Frames with stamps in [begin, end) belong to the turn.

Implausible input is rejected and logged in a line: impossible sightings, tags that contradict the map, a robot that is
suddenly elsewhere (a slip, a push, a kidnapping).
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import (
    FloatArray,
    IntArray,
    LaserScan,
    MapEstimate,
    Observation,
    Odometry,
    PoseEstimate,
    TagDetections,
    is_tag,
    replace,
)
from tfg_drake.notes import take_note
from tfg_drake.slam.estimator_state import (
    KIDNAPPED,
    EstimatorState,
    Stretch,
    opened,
    pose_now,
    reduced_now,
    unknown_way,
    with_map,
)
from tfg_drake.slam.evidence import (
    Evidence,
    Sighted,
    TagWatch,
    believable,
    disputed,
    doubtful,
    forgotten,
    missing,
    overturned,
    reconciled,
    sanitized,
    watched,
    weighed,
    with_doubts,
)
from tfg_drake.slam.finite import kept_finite
from tfg_drake.slam.first_look import Message, held_against_odometry, remedies
from tfg_drake.slam.keyframe import rows_of, without_tags
from tfg_drake.slam.keyframe_graph import UNFUSED, KeyframeGraph, adrift, empty_graph, empty_map, forget, fused, of_tied
from tfg_drake.slam.localizer import corrected_by_walls, new_tags, placed_localizer, start_localizer, step_localizer
from tfg_drake.slam.loop_search import with_loops_closed
from tfg_drake.slam.map_solver import JOINT, SPREAD, known_jointly, solve
from tfg_drake.slam.map_update import finished, is_looser, jointly_known, needs_solve, updated
from tfg_drake.slam.odometry_model import BREAK, BREAK_RATE, DeadReckoning, arc, first_reckoning, reckon, reckoned_at
from tfg_drake.slam.relocalizer import (
    CONTRADICTIONS,
    DRIFTED,
    PLACED,
    begun_elsewhere,
    doubted,
    find_itself,
    found_again,
    in_known,
    joined,
    looked_for,
    mapped_elsewhere,
)
from tfg_drake.slam.scan_lines import on_uneven, scan_lines, surface_seen, unevenness_after
from tfg_drake.slam.scan_points import scan_points
from tfg_drake.slam.scan_ranges import compared, great_error, scan_information
from tfg_drake.slam.shared import CAMERA_YAW, CLOCK, SHARED, Shared
from tfg_drake.slam.turn import SAME_INSTANT, Reduced, Source, TurnFrame, no_detections, reduced
from tfg_drake.slam.walls import Walls, beside_walls, identified, named, no_lines, same_walls

# Without frames the localiser is moved on once it lags behind odometry by more than this, s.
LONGEST_STEP = 0.25
# A frame contradicts the pose if more than the share MOST_IGNORED of its known landmarks do. If more than this share of
# a keyframe's known tags, LEAST_KNOWN or more, contradict the map, only those that agree count as evidence.
LEAST_KNOWN = 3
MOST_IGNORED = 0.5
# After an unknown motion the robot is lost if a deviation of its pose exceeds these, m, m, rad; otherwise the pose is
# corrected as usual.
FOUND_WITHIN = np.array([0.2, 0.2, 0.15])
# Frames seen while the pose is in doubt wait to be mapped, at most for this time, s.
LONGEST_DOUBT = 60.0
# A keyframe is reduced anew if a shared parameter has moved by more than this share of its deviation then.
REDUCED_WITHIN = 0.5
# It is also reduced anew if a level of the noise, see `LearntNoise`, has changed by more than this.
LEVEL_WITHIN = 0.2
# The last map is solved until the deviation of the tags' errors changes by at most this share, or MOST_SOLVES times.
SAME_TAG_ERROR = 0.05
MOST_SOLVES = 6
# A frame's ranges are compared with a scan if the robot has moved by at most this in between, m and rad.
SAME_PLACE = 0.004
# A scan tells whether something hid the tags of a frame if the robot has moved by at most this in between, m and rad.
NEARLY_THERE = 0.05
# Number of the newest scans that are kept for both comparisons.
SCANS = 4
# Period at which a turn or piece takes a scan's lines, s: more of them would not reduce the error that all looks at a
# wall share. A recording, for which each scan's pose is wanted, takes the lines of each scan.
LINES_EVERY = 0.2
# Of these scans it takes the points, too, when the robot has moved on by more than this, m or rad.
POINTS_WAY, POINTS_TURN = 0.3, 0.3
# Greatest number of messages kept of the first look, and of scans that wait for odometry: two minutes of them.
MOST_KEPT = 5000
# The operator is told not to rely on walls if, of more than ENOUGH_SEEN, m, of surface, less than LEAST_STRAIGHT is
# straight; each later scan multiplies a scan's weight by FORGET. The share is 0.8 to 0.9 in offices, 0.45 to 0.6 in
# recorded logs of cluttered ones, 0.55 in a nave with an apse, none in a round room.
FORGET, ENOUGH_SEEN, LEAST_STRAIGHT = 1.0 - 1.0 / 600.0, 500.0, 0.4

# Lines and points of a scan.
Scanned = tuple[FloatArray, FloatArray]
NO_SCAN: Scanned = no_lines(), np.empty((0, 4))

_log = logging.getLogger("tfg_drake.slam")
# Faults that a person can fix are also shown on the terminal.
_remarks = logging.getLogger("tfg_drake.slam.sensors")


def carried(state: EstimatorState) -> EstimatorState:
    """Return the state of a robot that may have been carried anywhere in its map, with new odometry and clocks."""
    before_any: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(state)}
    of_drive = ("newest", "odometry", "pending", "scans", "unread", "looked", "suspect", "log")
    anew = {name: before_any[name] for name in of_drive}
    return replace(state, contradictions=math.inf, placed=math.nan, **anew)


@kept_finite
def process_odometry(state: EstimatorState, odometry: Odometry) -> EstimatorState:
    """Return the state after an odometry message, which is ignored if it is not newer than the last."""
    if state.newest is None:
        if odometry.stamp < state.stamp:
            return state  # From before the robot was carried.
        state = _kept(state, odometry)
        first = first_reckoning(odometry)
        state = replace(state, newest=odometry, odometry=(first,), instant=_instant(first))
        piece = opened(state)
        if math.isnan(state.placed):
            piece = replace(piece, sigma=KIDNAPPED, is_apart=True)
        return replace(state, log=(piece,))
    if odometry.stamp <= state.newest.stamp:
        return state
    if odometry.breaks != state.newest.breaks:
        return _with_way_unknown(state, odometry)
    reckoning = reckon(state.odometry[-1], state.newest, odometry)
    state = replace(_kept(state, odometry), newest=odometry, odometry=(*state.odometry, reckoning))
    state = _process_pending(state)
    before = state.odometry[-2].stamp
    if before - state.stamp > LONGEST_STEP:
        state = _step(state, no_detections(before))
    return state


def _with_way_unknown(state: EstimatorState, odometry: Odometry) -> EstimatorState:
    """Return the state if odometry only guesses the way from the newest message to this one: the current view begins
    anew, as the way to it is unknown. What was seen in between is dropped."""
    assert state.newest is not None
    before = _step_to(state, state.odometry[-1].stamp)
    dt = odometry.stamp - state.newest.stamp
    reckoning = reckon(state.odometry[-1], state.newest, replace(odometry, at_rest=False))
    state = replace(
        _kept(before, odometry),
        newest=odometry,
        odometry=(*before.odometry, reckoning),
        pending=tuple(one for one in before.pending if one.stamp - before.offset > odometry.stamp),
        unread=tuple(one for one in before.unread if one.stamp > odometry.stamp),
    )
    state = _step_to(state, odometry.stamp)
    X_MB, covariance = pose_now(state)
    if state.map is None:  # The map begins here.
        state = replace(state, localizer=start_localizer(state.localizer.map, state.walls))
        return replace(state, log=(replace(opened(state), is_turn=state.turn is not None),))
    sigma = np.minimum(np.sqrt(np.diag(covariance) + np.square(BREAK + dt * BREAK_RATE)), KIDNAPPED)
    state = replace(state, localizer=placed_localizer(state.map, state.walls, X_MB, sigma))
    state = replace(state, contradictions=math.inf if np.any(sigma > FOUND_WITHIN) else 0.0, suspect=None)
    return begun_elsewhere(state, replace(opened(state), sigma=sigma))


@kept_finite
def process_detections(state: EstimatorState, detections: TagDetections) -> EstimatorState:
    """Return the state after a frame of tags, or with the frame queued for odometry; a frame older than the filters is
    ignored."""
    state = _kept(state, detections)
    if not detections.stamp - state.offset >= state.stamp or state.landmarks == "walls":
        return state
    detections, impossible = sanitized(detections)
    if impossible:
        _log.warning("%.2f s: %d impossible or ambiguous sightings ignored", detections.stamp, impossible)
    pending = (*state.pending, detections)
    if state.pending and detections.stamp < state.pending[-1].stamp:
        pending = tuple(sorted(pending, key=lambda frame: frame.stamp))
    return _process_pending(replace(state, pending=pending))


@kept_finite
def process_scan(state: EstimatorState, scan: LaserScan) -> EstimatorState:
    """Return the state with one more scan, queued to be compared with the frame of its instant."""
    if not math.isfinite(scan.stamp) or (state.scans and scan.stamp <= state.scans[-1].stamp):
        return state
    state = replace(_kept(state, scan), scans=(*state.scans, scan)[-SCANS:])
    return state if state.landmarks == "tags" else replace(state, unread=(*state.unread, scan)[-MOST_KEPT:])


@kept_finite
def begin_turn(state: EstimatorState, stamp: float) -> EstimatorState:
    """Open a turn at a stamp, which ends the way; the pose at that time is the arrival pose A.

    The stamp is limited to the span of the available odometry. Raises ValueError before any odometry or while a turn is
    open.
    """
    if not state.odometry:
        raise ValueError("A turn cannot begin before the first odometry message.")
    if state.turn is not None:
        raise ValueError("A turn is open already.")
    return _cut(_step_to(state, stamp), is_turn=True)


@kept_finite
def end_turn(state: EstimatorState, stamp: float, *, explored: bool = False) -> EstimatorState:
    """Solve the open turn, add it to the map as a view, and restart the localiser at the departure pose D.

    explored: everything is explored, so landmarks all over a large map become jointly known. The stamp is limited to
    the span of the available odometry. Raises ValueError if no turn is open.
    """
    if state.turn is None:
        raise ValueError("No turn is open.")
    state = doubted(_step_to(_first_looked(state), stamp))
    if state.contradictions >= CONTRADICTIONS:
        state = find_itself(state, at_last=True)
    return _add_view(state, SPREAD if explored else 0)


@kept_finite
def close_piece(state: EstimatorState, stamp: float, *, at_last: bool = False) -> EstimatorState:
    """Add the piece of the way since the last call to the map as a view, as if it were a turn.

    For recorded drives without turns; needs path_keyframe_period = inf. While the pose is in doubt the piece stays
    open, except at the end. The stamp is limited to the span of the available odometry. Raises ValueError before any
    odometry, or if no piece is open.
    """
    if not state.log or state.turn is not None or not math.isinf(state.path_keyframe_period):
        raise ValueError("No piece of the way is open: path_keyframe_period must be inf, and odometry have arrived.")
    state = _step_to(state, stamp)
    suspect, in_doubt = state.suspect, state.contradictions >= CONTRADICTIONS
    if in_doubt and not at_last and suspect is not None and state.stamp - suspect.begin.stamp < LONGEST_DOUBT:
        return state
    return _add_view(state, 0)


def pose_estimate(state: EstimatorState) -> PoseEstimate:
    """Return the pose at the newest odometry message; before the first, the origin with stamp 0."""
    stamp, speed = 0.0, np.zeros(2)
    increment, dt = np.zeros(3), 0.0
    if state.odometry:
        newest = state.odometry[-1]
        stamp, speed = newest.stamp, newest.V_B
        if stamp > state.stamp:
            increment, dt = arc(state.instant.X_OB, newest.X_OB), newest.clock - state.instant.clock
    X_MB, covariance = pose_now(state, increment, dt)
    if state.is_kidnapped:
        covariance = covariance + np.diag(np.square(state.mapped[0].sigma))
    if CONTRADICTIONS <= state.contradictions < math.inf:
        covariance = covariance + np.diag(np.square(DRIFTED))
    estimate = state.map or state.localizer.map
    new_ids, p_MU = new_tags(state.localizer, estimate.ids)
    if state.at is not None:
        # The map will be in the frame of the one that the session began with.
        X_MB, covariance, p_MU = in_known(state.at, X_MB, covariance, p_MU)
    is_lost = estimate.is_adrift if state.known is None else state.at is None
    return PoseEstimate(
        stamp=stamp,
        X_MB=X_MB,
        covariance=covariance,
        speed=speed,
        stage=estimate.stage,
        new_ids=new_ids,
        p_MU=p_MU,
        places=state.hypotheses.likely if is_lost else -1,
    )


@kept_finite
def finished_map(state: EstimatorState) -> EstimatorState:
    """Return the state at the end of a mission, with the map solved and jointly known as a whole, if memory allows.

    Every sighting is tested again, and those that contradict the whole map are removed.
    """
    estimate = state.map
    if estimate is None:
        return state
    graph = fused(replace(state.graph, p_ML=estimate.p_ML, prior=_prior(state)))
    for _ in range(MOST_SOLVES):
        before = graph.tag_error
        graph, estimate = solve(graph, estimate.stamp, estimate.observation, joint=known_jointly(graph))
        if np.allclose(graph.tag_error, before, rtol=SAME_TAG_ERROR):
            break
    graph, estimate, wrong = reconciled(graph, estimate)
    for tag in wrong.tolist():
        _log.warning("%.2f s: taken back, for the map contradicts it: a sighting of tag %d", state.stamp, tag)
    evidence = disputed(state.evidence, wrong)
    estimate = with_doubts(estimate, evidence, graph)
    return replace(state, graph=graph, solved=graph, map=estimate, evidence=evidence)


def _kept(state: EstimatorState, message: Message) -> EstimatorState:
    """Return the state with one message more in its first look, unless that is over."""
    return state if state.look is None else replace(state, look=(*state.look, message)[-MOST_KEPT:])


def _first_looked(state: EstimatorState) -> EstimatorState:
    """Return the state at the end of the first turn, after reporting sensor faults. If the camera's clock is wrong, all
    messages are processed again with the right one, as filters that lost the robot cannot be repaired."""
    look, turn = state.look, state.turn
    if look is None or turn is None:
        return state
    tags, scan = held_against_odometry(look, state.offset)
    for line in remedies(tags, scan):
        _remarks.warning("%.2f s: %s", state.stamp, line)
    if scan.lines:
        # The walls of such a scanner would distort the map.
        frames = tuple(replace(frame, lines=NO_SCAN[0]) for frame in turn.frames)
        state = replace(state, landmarks="tags", log=(replace(turn, frames=frames),), unread=())
    if tags.lag:
        process: dict[type, Callable[[EstimatorState, Any], EstimatorState]]
        process = {Odometry: process_odometry, TagDetections: process_detections, LaserScan: process_scan}
        state = _begun_anew(state, tags.lag)
        for message in look:
            state = process[type(message)](state, message)
            if state.turn is None and state.newest is not None and state.newest.stamp >= turn.begin.stamp:
                state = begin_turn(state, turn.begin.stamp)
    return replace(state, look=None)


def _begun_anew(state: EstimatorState, ahead: float) -> EstimatorState:
    """Return the initial state of an estimator that has mapped nothing yet, with the camera's clock ahead of its data
    sheet by `ahead`, s, and the first look over."""
    prior = replace(state.sheet, mean=state.sheet.mean + ahead * np.eye(SHARED)[CLOCK])
    graph = empty_graph(prior, state.graph.solver)
    return EstimatorState(
        noise=state.noise,
        sheet=prior,
        path_keyframe_period=state.path_keyframe_period,
        localizer=start_localizer(empty_map(prior), state.walls),
        graph=graph,
        solved=graph,
        landmarks=state.landmarks,
        walls=state.walls,
        watch=state.watch,
        may_be_moved=state.may_be_moved,
        known=state.known,
    )


def _process_pending(state: EstimatorState) -> EstimatorState:
    """Return the state after all queued frames that odometry has passed."""
    while state.odometry:
        scan = state.unread[0].stamp if state.unread else math.inf
        frame = state.pending[0].stamp - state.offset if state.pending else math.inf
        if not min(scan, frame) < state.odometry[-1].stamp:
            break
        first, scanned = no_detections(scan), NO_SCAN
        if frame <= scan + SAME_INSTANT:
            first, state = replace(state.pending[0], stamp=frame), replace(state, pending=state.pending[1:])
        if scan <= frame + SAME_INSTANT:
            newest = state.unread[0]
            lines, _ = scanned = scan_lines(newest), scan_points(newest)
            unevenness = unevenness_after(newest, lines, state.graph.unevenness)
            state = replace(state, unread=state.unread[1:], graph=replace(state.graph, unevenness=unevenness))
            state = _with_straightness(state, newest, lines)
        if first.stamp >= state.stamp:
            state = _step(state, first, scanned, only_scan=scan < frame - SAME_INSTANT)
    return state


def _with_straightness(state: EstimatorState, scan: LaserScan, lines: FloatArray) -> EstimatorState:
    """Return the state after a note to the operator if too little of the surfaces in view is straight for walls."""
    seen = np.array([np.sum(lines[:, 3] - lines[:, 2]), surface_seen(scan)])
    straight = state.straight * FORGET + seen
    by_walls = state.map is not None and not is_tag(state.map.ids).any()
    if by_walls and straight[1] > ENOUGH_SEEN and straight[0] < LEAST_STRAIGHT * straight[1]:
        share, advice = f"{LEAST_STRAIGHT:.0%}", "" if state.landmarks == "walls" else "; hang tags"
        told = f"less than {share} of the surfaces in view are straight; deviations may not hold{advice}"
        take_note("walls", scan.stamp, told)
        straight = np.full(2, np.nan)
    return replace(state, straight=straight)


def _step_to(state: EstimatorState, stamp: float) -> EstimatorState:
    stamp = min(max(stamp, state.stamp), state.odometry[-1].stamp)
    return _step(state, no_detections(stamp)) if stamp > state.stamp else state


def _step(
    state: EstimatorState, frame: TagDetections, scanned: Scanned = NO_SCAN, *, only_scan: bool = False
) -> EstimatorState:
    """Return the state with the localiser and the open turn or piece brought to a frame's stamp, and given the frame
    and a scan's lines and points.

    The stamp lies within the odometry at hand.
    """
    stamp, (lines, points) = frame.stamp, scanned
    after = next(k for k, reckoned in enumerate(state.odometry) if reckoned.stamp >= stamp)
    begin = max(after - 1, 0)
    earlier, later = state.odometry[begin], state.odometry[after]
    now = reckoned_at(earlier, later, stamp)
    increment, dt = arc(state.instant.X_OB, now.X_OB), now.clock - state.instant.clock
    span = later.stamp - earlier.stamp
    twist = arc(earlier.X_OB, later.X_OB)[::2] / span if span > 0.0 else np.zeros(2)
    scan, one_of_many = _scan_beside(state, frame, twist, SAME_PLACE), state.noise.now.in_a_row(frame)
    ranges = state.ranges if scan is None else compared(state.ranges, frame, scan, state.graph.shared)
    seen, every = state.log[-1], 0.0 if math.isinf(state.path_keyframe_period) else LINES_EVERY
    looks = (len(lines) > 0 or len(points) > 0) and stamp >= state.looked + every - SAME_INSTANT
    here = points if looks and _is_elsewhere(seen, now.X_OB) else NO_SCAN[1]
    taken = TurnFrame(stamp, now.clock, now.X_OB, frame, state.offset, lines if looks else NO_SCAN[0], only_scan, here)
    if looks or not only_scan:
        seen = replace(seen, frames=(*seen.frames, taken))
    localizer, known, ignored = step_localizer(
        state.localizer, (increment, dt, state.noise.now.walks), one_of_many, (twist, state.offset)
    )
    if len(lines):
        distance, heading, _ = state.noise.now.walks
        variance = np.array([distance**2 * abs(twist[0]), heading**2]) / max(span, SAME_INSTANT)
        localizer, *of_walls = corrected_by_walls(localizer, on_uneven(lines, state.graph.unevenness), twist, variance)
        # Tags decide if there are any, as their ids identify them.
        known, ignored = (known, ignored) if known or not looks else of_walls
    if state.map is not None and not state.map.is_joint:
        elsewhere = mapped_elsewhere(state, localizer, frame)
        known, ignored = known + elsewhere, ignored + elsewhere
    contradictions = state.contradictions
    if ignored > MOST_IGNORED * known:
        contradictions += state.may_be_moved or state.is_kidnapped
    elif known and math.isfinite(contradictions):
        contradictions = max(contradictions - 1.0, 0.0)
    state = replace(
        state,
        odometry=state.odometry[begin:],
        ranges=ranges,
        instant=_instant(now),
        localizer=localizer,
        contradictions=contradictions,
        log=(*state.log[:-1], seen),
        looked=stamp if looks else state.looked,
    )
    state = replace(state, suspect=_suspect(state, taken), watch=_watched(state, frame, twist))
    if contradictions >= CONTRADICTIONS and (len(frame.ids) or looks):
        state = find_itself(state)
    state = looked_for(state)
    period = state.path_keyframe_period
    is_over = period and state.turn is None and stamp - state.log[-1].begin.stamp >= period
    return _cut(state) if is_over else state


def _instant(now: DeadReckoning) -> TurnFrame:
    """Return an instant at which nothing is seen."""
    return TurnFrame(now.stamp, now.clock, now.X_OB, no_detections(now.stamp))


def _is_elsewhere(seen: Stretch, X_OB: FloatArray) -> bool:
    """Return whether the robot has moved on since the newest points of a turn or piece."""
    for frame in reversed(seen.frames):
        if len(frame.points):
            moved = se2.between(frame.X_OB, X_OB)
            return bool(math.hypot(moved[0], moved[1]) > POINTS_WAY or abs(moved[2]) > POINTS_TURN)
    return True


def _scan_beside(state: EstimatorState, frame: TagDetections, twist: FloatArray, most: float) -> LaserScan | None:
    """Return the scan nearest in time to a frame with tags. None without one, or if the robot moves by more than
    `most`, m and rad, between the two; twist (2,): its speeds at the frame."""
    if not (len(frame.ids) and state.scans):
        return None
    scan = min(state.scans, key=lambda scan: abs(scan.stamp - frame.stamp))
    return scan if abs(scan.stamp - frame.stamp) * max(map(abs, twist.tolist())) <= most else None


def _watched(state: EstimatorState, frame: TagDetections, twist: FloatArray) -> TagWatch:
    """Return the watch over expected tags after a frame at the state's stamp, with the robot's twist (2,)."""
    scan = _scan_beside(state, frame, twist, NEARLY_THERE)
    if scan is None or state.map is None or state.contradictions or state.is_kidnapped:
        return state.watch
    yaw = float(state.graph.shared.mean[CAMERA_YAW])
    X_MC = state.localizer.X_MB + np.array([0.0, 0.0, yaw])
    return watched(state.watch, state.map.p_ML[is_tag(state.map.ids)], X_MC, yaw, frame, scan)


def _suspect(state: EstimatorState, taken: TurnFrame) -> Stretch | None:
    """Return the stretch since the pose came into doubt, which a new frame may end or begin; None without doubt."""
    suspect = state.suspect if state.contradictions else None
    if (
        suspect is not None
        and taken.stamp - suspect.begin.stamp > LONGEST_DOUBT
        and math.isfinite(state.contradictions)
    ):
        suspect = None
    if suspect is None and state.contradictions and (len(taken.detections.ids) or len(taken.lines)):
        return opened(state)
    return suspect


def _cut(state: EstimatorState, *, is_turn: bool = False) -> EstimatorState:
    """Return the state with the open piece of the way solved, and the next one or a turn open. The way to the first
    view is not mapped."""
    piece, before = state.log[-1], state.log[:-1]
    if state.stamp <= piece.begin.stamp:
        return replace(state, log=(*before, replace(piece, is_turn=is_turn)))
    if state.map is not None:
        learnt, _, seen = _reduced(state, piece)
        # The motion of a robot that was carried says nothing about the noise of its wheels.
        state = state if state.is_kidnapped else learnt
        if not state.path_keyframe_period:
            seen = seen.only(np.zeros(len(seen.frames), dtype=bool))
        before = (*before, replace(piece, solved=seen))
    return replace(state, log=(*before, replace(opened(state), is_turn=is_turn)))


def _reduced(state: EstimatorState, seen: Stretch) -> tuple[EstimatorState, Reduced, Sighted]:
    """Solve a stretch of the log that ends now: return the state with its noise sample, the solution, the keyframe."""
    piece = (seen.begin, seen.frames, state.instant)
    solution = reduced_now(state, piece)
    source = Source(piece, state.graph.shared, state.noise.level, state.walls.floor)
    one = Sighted(solution.keyframe, solution.sightings, source)
    return replace(state, noise=state.noise.with_sample(solution.sample)), solution, one


def _prior(state: EstimatorState) -> Shared:
    """Return the parameters as known without any keyframe: from data sheets and scans."""
    if not state.ranges.pairs:
        return state.sheet
    return state.sheet.with_information(*scan_information(state.ranges, state.noise.now.worth))


def _reduced_anew(
    state: EstimatorState, graph: KeyframeGraph, sources: tuple[Source | None, ...]
) -> tuple[KeyframeGraph, tuple[Source | None, ...]]:
    """Return the graph with those of its newest keyframes reduced again that were reduced with other parameters or
    noise, and their sources."""
    keyframes, kept, shared, noise = list(graph.keyframes), list(sources), graph.shared, state.noise
    for k, source in enumerate(sources):
        at = k - len(sources)
        if source is None or (
            np.all(np.abs(shared.mean - source.shared.mean) <= REDUCED_WITHIN * source.shared.sigma)
            and np.all(np.abs(noise.level - source.level) <= LEVEL_WITHIN)
        ):
            continue
        floor = state.walls.floor
        one = reduced(noise.now, source.piece, shared, floor, graph.unevenness).keyframe
        if source.names is not None:
            one = beside_walls(named(one, source.names))
        one = without_tags(one, np.setdiff1d(one.ids, keyframes[at].ids))
        if np.array_equal(one.ids, keyframes[at].ids) and same_walls(one, keyframes[at]):
            keyframes[at], kept[k] = one, replace(source, shared=shared, level=noise.level, floor=floor)
    if tuple(kept) == sources:
        return graph, sources
    return replace(graph, keyframes=tuple(keyframes)), tuple(kept)


def _with_scale_reported(state: EstimatorState) -> EstimatorState:
    """Return the state after a note to the operator if ranges are so wrong that a setting must be."""
    share = 0.0 if state.ranges.reported else great_error(state.ranges, state.graph.shared)
    if not share:
        return state
    _remarks.warning(
        "%.2f s: the tags' ranges are %.3g times the scan's: are the tags %.2g times as large as was said "
        "(camera.tag_size), or is the calibration another camera's?",
        state.stamp,
        1.0 + share,
        1.0 / (1.0 + share),
    )
    return replace(state, ranges=replace(state.ranges, reported=True))


def _add_view(state: EstimatorState, spread: int) -> EstimatorState:
    """Return the state with the open turn or piece added to the map as a view, and the localiser at its end. spread:
    see `solve`."""
    first, seen = state.mapped[0], state.log[-1]
    way = tuple(one.solved for one in state.mapped if one.solved is not None)
    state, solution, view = _reduced(state, seen)
    state = _with_scale_reported(replace(state, noise=state.noise.learnt()))
    keyframe = view.keyframe
    observation = Observation(keyframe.ids[is_tag(keyframe.ids)], solution.stamps, solution.X_AB)
    if first.is_apart and state.map is not None:
        first = first if seen.is_turn else _found_meanwhile(state, first)
        way = (Sighted(unknown_way(se2.between(state.map.X_MD, first.X_MB), first.sigma)), *way)
    before, known, way, hypotheses = found_again(state, way, keyframe)
    graph, estimate, evidence, moved = before, known, state.evidence, False
    sources, walls = state.sources, state.walls
    for one in (*way, view):
        is_view = one is view
        one, walls = _with_names(one, walls, graph, estimate)
        sources = (*sources, one.source)[-UNFUSED:]
        graph, estimate, evidence, rejected, anew = _with_keyframe(graph, estimate, evidence, one, is_view=is_view)
        _tell("mapped anew, for more was seen of them elsewhere", state, anew)
        moved = moved or len(anew) > 0
    _tell("left out of the map, for they contradict it", state, rejected[is_tag(rejected)])
    gone = np.setdiff1d(state.watch.ids[missing(state.watch)], doubtful(evidence))
    _tell("not seen where the map has them", state, gone)
    evidence = disputed(evidence, gone)
    solved = state.solved
    anew_graph, sources = _reduced_anew(state, graph, sources)
    if (
        moved
        or anew_graph is not graph
        or state.is_kidnapped
        or before is not state.graph
        or adrift(graph) >= 0  # The effect of an unknown heading is far from linear.
        or needs_solve(graph, solved, estimate)
        or is_looser(graph, estimate, state.deviation)
        or len(estimate.local) < min(len(graph.ids), JOINT + spread)
    ):
        graph = fused(
            replace(anew_graph, p_ML=estimate.p_ML, prior=_prior(replace(state, walls=walls))), len(solved.keyframes)
        )
        graph, estimate = solve(graph, state.stamp, observation, spread=spread)
        solved = graph
    else:
        graph, estimate = finished(graph, estimate, state.stamp, observation)
    loops = state.loops
    if adrift(graph) < 0:  # A part that is adrift is left to the relocaliser.
        loops, closed, estimate = with_loops_closed(loops, graph, estimate, observation)
        if closed is not graph:
            graph = solved = closed
    j = adrift(graph)
    if j >= 0:
        hypotheses = replace(hypotheses, X_KM=se2.compose(hypotheses.X_KM, se2.inverse(graph.X_MN[j + 1])))
    state = replace(
        state,
        hypotheses=state.hypotheses if state.known is not None else hypotheses,
        placed=state.stamp if math.isnan(state.placed) and j < 0 else state.placed,
        contradictions=0.0,
        suspect=None,
        walls=walls,
        evidence=evidence,
        sources=sources,
        loops=loops,
    )
    return joined(with_map(state, graph, estimate, solved))


def _found_meanwhile(state: EstimatorState, begun: Stretch) -> Stretch:
    """Return a piece that began after an unknown way, with its first pose inferred from the current pose if that is
    better known, as the robot has relocalised meanwhile. Its observations, which gave that pose, count once more."""
    X_MB, covariance = pose_now(state)
    sigma = np.maximum(np.sqrt(np.diag(covariance)), PLACED)
    if np.all(sigma >= begun.sigma) or math.isinf(state.contradictions):
        return begun
    way = se2.between(begun.begin.X_OB, state.instant.X_OB)
    return replace(begun, X_MB=se2.compose(X_MB, se2.inverse(way)), sigma=sigma)


def _with_names(seen: Sighted, walls: Walls, graph: KeyframeGraph, estimate: MapEstimate) -> tuple[Sighted, Walls]:
    """Return a keyframe that begins at the map's newest pose, with the map's names for its walls, and the updated
    walls."""
    one, source, tags = seen.keyframe, seen.source, is_tag(seen.keyframe.ids)
    if source is None or tags.all():
        return seen, walls
    names, walls = identified(one, seen.frames, walls, of_tied(estimate, graph), source.floor)
    one = beside_walls(named(one, names))
    frames = np.append(np.zeros(one.walls, dtype=np.int64), seen.frames[tags])
    return Sighted(one, frames, replace(source, names=names)), walls


def _with_keyframe(
    graph: KeyframeGraph, estimate: MapEstimate, evidence: Evidence, seen: Sighted, *, is_view: bool
) -> tuple[KeyframeGraph, MapEstimate, Evidence, IntArray, IntArray]:
    """Return graph, map and evidence with one keyframe more, which begins at the map's newest pose; the ids of its
    rejected known tags, and of the tags that were removed and mapped again.

    is_view: whether it is a turn or glance, not a piece of the way.
    """
    ids = seen.keyframe.ids
    tags = is_tag(ids)
    far = ids[~jointly_known(estimate, ids)]
    if len(far):
        graph = replace(graph, p_ML=estimate.p_ML)
        graph, estimate = solve(graph, estimate.stamp, estimate.observation, also=rows_of(far, graph.ids)[0])
    known = rows_of(ids, graph.ids)[1]
    believed = seen.only(~tags | known | believable(evidence, seen, estimate.X_MD, graph))
    longer, after, rejected = updated(graph, estimate, believed.keyframe, is_view=is_view)
    agrees, counted = np.isin(ids, np.setdiff1d(believed.keyframe.ids, rejected))[tags], seen.only(tags)
    known, rejected = known[tags], rejected[is_tag(rejected)]
    if np.count_nonzero(known) >= LEAST_KNOWN and len(rejected) > MOST_IGNORED * np.count_nonzero(known):
        # The robot may be elsewhere, so this is no evidence against the places of the tags.
        counted, agrees = counted.only(agrees), agrees[agrees]
    weighed_up = weighed(evidence, counted, agrees, longer) if len(counted.frames) else evidence
    anew = np.intersect1d(overturned(weighed_up), rejected) if len(rejected) else rejected
    if not len(anew):
        return longer, after, weighed_up, rejected, anew
    graph = forget(replace(graph, p_ML=estimate.p_ML), anew)
    graph, estimate = solve(graph, estimate.stamp, estimate.observation)
    evidence = forgotten(evidence, anew)
    graph, estimate, evidence, rejected, others = _with_keyframe(graph, estimate, evidence, seen, is_view=is_view)
    return graph, estimate, evidence, rejected, np.union1d(anew, others)


def _tell(what: str, state: EstimatorState, tags: IntArray) -> None:
    if len(tags):
        _log.warning("%.2f s: %s: tags %s", state.stamp, what, ", ".join(str(int(tag)) for tag in tags))

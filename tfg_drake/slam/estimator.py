"""The SLAM estimator as pure steps on one immutable state: odometry and detections in, pose and map out.

Between goals a segment filter measures the motion and a localiser estimates the pose in the map; a turn in place
collects frames; at its end the turn is solved, its goal joins the graph, and both filters start anew at the departure
pose. Frames are taken by their stamps, whatever the order of arrival: one is processed when odometry beyond its stamp
has arrived. Those with stamps in [begin, end) belong to the turn.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.messages import (
    BoolArray,
    FloatArray,
    IntArray,
    MapEstimate,
    Odometry,
    PoseEstimate,
    TagDetections,
    message,
)
from tfg_drake.slam import goal_graph
from tfg_drake.slam.goal_graph import GoalGraph
from tfg_drake.slam.localizer import Localizer, local_tags, localized_pose, start_localizer, step_localizer
from tfg_drake.slam.odometry_model import (
    DeadReckoning,
    OdometryModel,
    arc,
    first_reckoning,
    interpolate,
    interpolate_clock,
    odometry_model,
    reckon,
)
from tfg_drake.slam.pose_filter import PoseFilter
from tfg_drake.slam.segment import segment_factor, start_segment, step_segment
from tfg_drake.slam.turn import TurnFrame, no_detections, solve_turn

# Without frames the filters follow odometry in steps of this length, s.
LONGEST_STEP = 0.25


@message
class OpenTurn:
    """A turn under way. begin: its first instant. frames: those seen since. X_DA (3,), segment_covariance (3, 3): the
    segment that led to it."""

    begin: TurnFrame
    frames: tuple[TurnFrame, ...]
    X_DA: FloatArray
    segment_covariance: FloatArray


@message
class EstimatorState:
    """All the estimator knows.

    newest: the last odometry message. odometry: dead reckoning from the filters' instant on. pending: frames that
    wait for odometry. stamp (s), clock (s), X_OB (3,): the filters' instant and the dead reckoning then. map: None
    before the first goal. rejected: (r,) ids of known tags left out of the newest goal, dropped: sightings left out of
    its turn.
    """

    model: OdometryModel
    newest: Odometry | None
    odometry: tuple[DeadReckoning, ...]
    pending: tuple[TagDetections, ...]
    stamp: float
    clock: float
    X_OB: FloatArray
    localizer: Localizer
    segment: PoseFilter
    turn: OpenTurn | None
    graph: GoalGraph
    map: MapEstimate | None
    rejected: IntArray
    dropped: int


def initial_state(config: OdometryConfig) -> EstimatorState:
    """The estimator at the map's origin, before any message."""
    model = odometry_model(config)
    return EstimatorState(
        model=model,
        newest=None,
        odometry=(),
        pending=(),
        stamp=-np.inf,
        clock=-np.inf,
        X_OB=np.zeros(3),
        localizer=start_localizer(model, None),
        segment=start_segment(model),
        turn=None,
        graph=goal_graph.empty_graph(),
        map=None,
        rejected=np.empty(0, dtype=np.int64),
        dropped=0,
    )


def process_odometry(state: EstimatorState, odometry: Odometry) -> EstimatorState:
    """The state after one odometry message; one that is not newer than the last is ignored."""
    if state.newest is None:
        first = first_reckoning(odometry)
        return dataclasses.replace(
            state, newest=odometry, odometry=(first,), stamp=first.stamp, clock=first.clock, X_OB=first.X_OB
        )
    if odometry.stamp <= state.newest.stamp:
        return state
    reckoning = reckon(state.odometry[-1], state.newest, odometry)
    state = dataclasses.replace(state, newest=odometry, odometry=(*state.odometry, reckoning))
    state = _process_pending(state)
    before = state.odometry[-2].stamp
    if before - state.stamp > LONGEST_STEP:
        state = _step(state, no_detections(before), state.pending)
    return state


def process_detections(state: EstimatorState, detections: TagDetections) -> EstimatorState:
    """The state after one frame of tags, or with the frame waiting for odometry; one older than the filters is
    ignored."""
    if detections.stamp < state.stamp:
        return state
    pending = sorted((*state.pending, detections), key=lambda frame: frame.stamp)
    return _process_pending(dataclasses.replace(state, pending=tuple(pending)))


def begin_turn(state: EstimatorState, stamp: float) -> EstimatorState:
    """The state with a turn opened at a stamp, which ends the segment; the pose then is the arrival pose A.

    The stamp is brought into the span of the odometry at hand. Raises ValueError before any odometry or while a turn
    is open.
    """
    if not state.odometry:
        raise ValueError("A turn cannot begin before the first odometry message.")
    if state.turn is not None:
        raise ValueError("A turn is open already.")
    state = _step_to(state, stamp)
    X_DA, covariance = segment_factor(state.segment)
    begin = TurnFrame(stamp=state.stamp, clock=state.clock, X_OB=state.X_OB, detections=no_detections(state.stamp))
    turn = OpenTurn(begin=begin, frames=(), X_DA=X_DA, segment_covariance=covariance)
    return dataclasses.replace(state, turn=turn)


def end_turn(state: EstimatorState, stamp: float) -> EstimatorState:
    """The state with the open turn solved as a goal, the graph solved, and both filters at the departure pose D.

    The stamp is brought into the span of the odometry at hand. Raises ValueError where no turn is open.
    """
    if state.turn is None:
        raise ValueError("No turn is open.")
    state = _step_to(state, stamp)
    turn = state.turn
    assert turn is not None
    end = TurnFrame(stamp=state.stamp, clock=state.clock, X_OB=state.X_OB, detections=no_detections(state.stamp))
    solution = solve_turn(state.model, turn.begin, turn.frames, end)
    graph, rejected = goal_graph.add_goal(
        state.graph, state.map, solution.observation, turn.X_DA, turn.segment_covariance
    )
    graph, map_estimate = goal_graph.solve(graph, state.stamp, solution.observation)
    return dataclasses.replace(
        state,
        turn=None,
        graph=graph,
        map=map_estimate,
        localizer=start_localizer(state.model, map_estimate),
        segment=start_segment(state.model),
        rejected=rejected,
        dropped=solution.dropped,
    )


def pose_estimate(state: EstimatorState) -> PoseEstimate:
    """The pose at the newest odometry message; at the origin, stamp 0, before the first."""
    stamp, speed = 0.0, np.zeros(2)
    increment, dt = np.zeros(3), 0.0
    if state.odometry:
        newest = state.odometry[-1]
        stamp, speed = newest.stamp, newest.V_B
        if stamp > state.stamp:
            increment, dt = arc(state.X_OB, newest.X_OB), newest.clock - state.clock
    X_MB, covariance = localized_pose(state.localizer, state.model, increment, dt)
    new_ids, p_MU = state.localizer.filter.local_ids, local_tags(state.localizer)
    if len(new_ids) > 0:
        new = _absent(new_ids, state.graph.ids)
        new_ids, p_MU = new_ids[new], p_MU[new]
    return PoseEstimate(
        stamp=stamp,
        X_MB=X_MB,
        covariance=covariance,
        speed=speed,
        stage=len(state.graph.observations),
        new_ids=new_ids,
        p_MU=p_MU,
    )


def map_estimate(state: EstimatorState) -> MapEstimate | None:
    """The map after the newest goal, None before the first."""
    return state.map


def _absent(ids: IntArray, known: IntArray) -> BoolArray:
    """(n,) which ids are not among the known ones (ascending)."""
    if len(known) == 0:
        return np.ones(len(ids), dtype=bool)
    row = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return np.asarray(known[row] != ids)


def _process_pending(state: EstimatorState) -> EstimatorState:
    """The state after all waiting frames that odometry has passed."""
    while state.pending and state.odometry and state.pending[0].stamp < state.odometry[-1].stamp:
        frame, pending = state.pending[0], state.pending[1:]
        if frame.stamp >= state.stamp:
            state = _step(state, frame, pending)
        else:
            state = dataclasses.replace(state, pending=pending)
    return state


def _step_to(state: EstimatorState, stamp: float) -> EstimatorState:
    stamp = min(max(stamp, state.stamp), state.odometry[-1].stamp)
    return _step(state, no_detections(stamp), state.pending) if stamp > state.stamp else state


def _step(state: EstimatorState, frame: TagDetections, pending: tuple[TagDetections, ...]) -> EstimatorState:
    """Both filters, or the open turn and the localiser, brought to a frame's stamp and given the frame.

    The stamp lies within the odometry at hand; `pending` are the frames that wait after it.
    """
    stamp = frame.stamp
    after = next(i for i, odometry in enumerate(state.odometry) if odometry.stamp >= stamp)
    before = max(after - 1, 0)
    X_OB = interpolate(state.odometry[before], state.odometry[after], stamp)
    clock = interpolate_clock(state.odometry[before], state.odometry[after], stamp)
    increment, dt = arc(state.X_OB, X_OB), clock - state.clock
    segment, turn = state.segment, state.turn
    if turn is None:
        segment = step_segment(segment, state.model, increment, dt, frame)
    else:
        turn = dataclasses.replace(turn, frames=(*turn.frames, TurnFrame(stamp, clock, X_OB, frame)))
    return dataclasses.replace(
        state,
        odometry=state.odometry[before:],
        pending=pending,
        stamp=stamp,
        clock=clock,
        X_OB=X_OB,
        localizer=step_localizer(state.localizer, state.model, increment, dt, frame),
        segment=segment,
        turn=turn,
    )

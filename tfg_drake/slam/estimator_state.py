"""The whole state of the SLAM estimator, as one immutable object."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import (
    FloatArray,
    Hypotheses,
    IntArray,
    LaserScan,
    MapEstimate,
    Odometry,
    TagDetections,
    message,
    replace,
)
from tfg_drake.slam.evidence import Evidence, Sighted, TagWatch, renewed, watch_of, with_doubts
from tfg_drake.slam.first_look import Message
from tfg_drake.slam.keyframe import Keyframe, way
from tfg_drake.slam.keyframe_graph import KeyframeGraph, empty_graph, empty_map, of_tied
from tfg_drake.slam.localizer import Localizer, localized_pose, start_localizer
from tfg_drake.slam.loop_search import LoopSearch
from tfg_drake.slam.map_update import deviation_of
from tfg_drake.slam.noise import LearntNoise, noise_by_data_sheet
from tfg_drake.slam.odometry_model import DeadReckoning, random_walks
from tfg_drake.slam.place_search import Seen
from tfg_drake.slam.scan_ranges import ScanRanges, none_compared
from tfg_drake.slam.shared import CLOCK, LEAST_SIGMA, Shared, by_data_sheet
from tfg_drake.slam.turn import Piece, Reduced, Source, TurnFrame, no_detections, reduced
from tfg_drake.slam.walls import Walls, no_lines, no_walls
from tfg_drake.table import empty

# Standard deviations, m, m, rad, of the unknown motion between two views when the robot was kidnapped on the way.
KIDNAPPED = np.array([100.0, 100.0, 10.0])
# An increment of odometry.
NO_MOTION = np.zeros(3)
# The search for the robot's place uses at most this number of the newest frames.
MOST_FRAMES = 50
# A camera whose mount, clock and range scale are exactly as stated.
EXACT_CAMERA = TagSensorConfig(yaw_deviation=0.0, clock_deviation=0.0, mount_deviation=0.0, range_scale_deviation=0.0)


@message
class Stretch:
    """A stretch of the log: a turn, or a piece of the way that is mapped like one.

    begin: its first instant, X_MB: (3,) the localiser's pose then, sigma: (3,) its deviations, m, m, rad. frames: the
    frames seen since. is_apart: the motion to it from the last view is known only by X_MB and sigma, as the robot was
    moved by something other than its wheels. solved: as a keyframe, None while it is open.
    """

    begin: TurnFrame
    X_MB: FloatArray
    sigma: FloatArray
    frames: tuple[TurnFrame, ...] = ()
    is_turn: bool = False
    is_apart: bool = False
    solved: Sighted | None = None


@message
class Placed:
    """The pose of a map's frame in another map, such as M of a session in its known map K: X_KM (3,) and its covariance
    (3, 3). moved: ids of the tags that have moved, tags: number of tags that agree, 0 if surfaces decided."""

    X: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]
    moved: IntArray = dataclasses.field(default_factory=lambda: np.empty(0, dtype=np.int64))
    tags: int = 0

    @property
    def by(self) -> str:
        """The name of the landmarks that decided, in the plural."""
        return f"{self.tags} tags" if self.tags else "surfaces"


@message
class KnownMap:
    """The map K that a session began with, while the session maps apart or the join may be withdrawn.

    keyframe: the whole map, seen from its origin, to the pose X_KD (3,). estimate: its landmarks. seen: the surfaces
    that its views have seen. evidence: for the places of its tags, facing: (n, 2) unit vectors in which these face.
    said: the start of the session as stated by a person. X_WK: (3,) pose of K in its world. since: the stage at which
    both became one, 0 while they are apart. sessions: (s,) of K, see `KeyframeGraph`.
    """

    keyframe: Keyframe
    X_KD: FloatArray
    estimate: MapEstimate
    seen: Seen
    evidence: Evidence
    facing: FloatArray
    said: Placed | None = None
    X_WK: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    since: int = 0
    sessions: IntArray = dataclasses.field(default_factory=lambda: np.empty(0, dtype=np.int64))


@message
class EstimatorState:
    """The whole state of the estimator; the defaults are those before any message.

    noise: of odometry and tags. sheet: the shared parameters by the data sheets. path_keyframe_period: duration of a
    piece of the way, s; 0 if only the motion is kept. graph: with landmarks at their values of the last solve or first
    sighting, solved: the graph at that solve. ranges: comparison of the tags' ranges with those of scans. evidence: for
    and against the places of the tags. watch: over the tags that should have been seen. newest: the last odometry
    message. odometry: dead reckoning from the localiser's instant on. pending: frames that wait for odometry. scans:
    the newest scans. instant: the localiser's, with nothing seen. contradictions: number of frames that contradict the
    pose, less those that agree since; inf if the pose is a guess until the robot has relocalised. suspect: the stretch
    that begins at the first contradicting frame, without frames; None without contradiction. log: the stretches since
    the last view, pieces of the way and then the turn; the newest is open. placed: time, s, since when the robot knows
    its place in a map that it began with or in which it may have been carried; in the latter nan until it does. map:
    the updated estimate since the last solve, None before the first view. look: the newest messages in the order of
    arrival, None once the first turn is over. sources: of the newest keyframes, None for one without. walls: statistics
    of the map's walls. landmarks: their kind, one of `config.LANDMARKS`. unread: scans that wait for odometry. looked:
    time, s, when lines were last taken for a stretch. may_be_moved: whether something other than its wheels may move
    the robot. straight: (2,) m of straight walls and of all surfaces in the scans of the last minutes, nan once it was
    reported that too little is straight. loops: the loop search. deviation: (2,) of the newest pose at the last solve,
    m and rad. known: the map that the session began with, until the join is final; at: the session's place in it, once
    known; hypotheses: the possible places in it, empty if these are everywhere or nowhere.
    """

    noise: LearntNoise
    sheet: Shared
    path_keyframe_period: float
    localizer: Localizer
    graph: KeyframeGraph
    solved: KeyframeGraph
    ranges: ScanRanges = dataclasses.field(default_factory=none_compared)
    evidence: Evidence = dataclasses.field(default_factory=lambda: empty(Evidence))
    watch: TagWatch = dataclasses.field(default_factory=lambda: empty(TagWatch))
    newest: Odometry | None = None
    odometry: tuple[DeadReckoning, ...] = ()
    pending: tuple[TagDetections, ...] = ()
    scans: tuple[LaserScan, ...] = ()
    instant: TurnFrame = TurnFrame(-np.inf, -np.inf, np.zeros(3), no_detections(-np.inf))
    contradictions: float = 0.0
    suspect: Stretch | None = None
    placed: float = -np.inf
    log: tuple[Stretch, ...] = ()
    map: MapEstimate | None = None
    look: tuple[Message, ...] | None = None
    sources: tuple[Source | None, ...] = ()
    walls: Walls = dataclasses.field(default_factory=no_walls)
    landmarks: str = "both"
    unread: tuple[LaserScan, ...] = ()
    looked: float = -np.inf
    may_be_moved: bool = True
    straight: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    loops: LoopSearch = dataclasses.field(default_factory=LoopSearch)
    deviation: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    known: KnownMap | None = None
    at: Placed | None = None
    hypotheses: Hypotheses = dataclasses.field(default_factory=lambda: empty(Hypotheses))

    @property
    def stamp(self) -> float:
        """The time of the filters, s."""
        return self.instant.stamp

    @property
    def offset(self) -> float:
        """The estimated offset of the camera's clock, ahead, s."""
        return float(self.graph.shared.mean[CLOCK])

    @property
    def turn(self) -> Stretch | None:
        """The open turn, None while the way is mapped."""
        return self.log[-1] if self.log and self.log[-1].is_turn else None

    @property
    def mapped(self) -> tuple[Stretch, ...]:
        """The part of the log that the next view maps: all of it, or the stretches since the robot was moved by
        something other than its wheels."""
        return self.log[max((k for k, one in enumerate(self.log) if one.is_apart), default=0) :]

    @property
    def is_kidnapped(self) -> bool:
        """Whether the robot was moved by something other than its wheels since the last view."""
        return any(one.is_apart for one in self.log)

    @property
    def seen_in_doubt(self) -> Stretch | None:
        """The frames since the pose became doubtful, as one stretch; None if it is not."""
        if self.suspect is None:
            return None
        begin = self.suspect.begin.stamp
        frames = tuple(frame for one in self.log for frame in one.frames if frame.stamp >= begin)
        return replace(self.suspect, frames=frames)


def initial_state(
    config: OdometryConfig,
    path_keyframe_period: float = 0.0,
    prior: Shared | None = None,
    solver: str = "dissection",
    landmarks: str = "both",
    walls: Walls | None = None,
    tags: TagSensorConfig = EXACT_CAMERA,
    *,
    may_be_moved: bool = True,
) -> EstimatorState:
    """Return the state at the map's origin, before any message.

    prior: of the shared parameters; by default from the odometry's data sheet and EXACT_CAMERA. path_keyframe_period:
    s; the way between views is mapped in pieces of this length, inf: in those that `close_piece` ends. 0: of the way
    only its motion is mapped, and path sightings localise (the paper's Sec. III-C). solver: of the keyframe graph, one
    of `config.SOLVERS`. landmarks: the kind that is mapped, one of `config.LANDMARKS`. walls: their initial statistics.
    tags: the camera's data sheet. may_be_moved: whether the robot may be elsewhere if sightings contradict its pose;
    otherwise the sightings are wrong, unless odometry reports an unknown motion.
    """
    prior = prior or by_data_sheet(config, EXACT_CAMERA)
    graph = empty_graph(prior, solver)
    return EstimatorState(
        noise=noise_by_data_sheet(random_walks(config)),
        sheet=prior,
        path_keyframe_period=path_keyframe_period,
        localizer=start_localizer(empty_map(prior)),
        graph=graph,
        solved=graph,
        landmarks=landmarks,
        walls=walls or no_walls(),
        watch=watch_of(tags.max_incidence),
        may_be_moved=may_be_moved,
        # A recorded drive has pieces, no turns, and so no first look.
        look=None if np.isinf(path_keyframe_period) else (),
    )


def pose_now(
    state: EstimatorState, increment: FloatArray = NO_MOTION, dt: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return X_MB (3,) and its covariance (3, 3) an odometry increment (3,), over dt s, after the filters' instant."""
    return localized_pose(state.localizer, state.noise.now.walks, increment, dt)


def opened(state: EstimatorState) -> Stretch:
    """Return a piece of the way that begins now."""
    X_MB, covariance = pose_now(state)
    return Stretch(state.instant, X_MB, np.sqrt(np.maximum(np.diag(covariance), LEAST_SIGMA**2)))


def with_map(
    state: EstimatorState, graph: KeyframeGraph, estimate: MapEstimate, solved: KeyframeGraph
) -> EstimatorState:
    """Return the state after a view, with the new graph and map, from which the way continues. solved: the graph at its
    last solve."""
    worth = min(state.noise.now.frame_worth, 1.0)
    whole = with_doubts(replace(estimate, frame_worth=worth), state.evidence, graph)
    state = replace(
        state,
        graph=graph,
        solved=solved,
        map=whole,
        watch=renewed(state.watch, whole.of_tags.ids),
        localizer=start_localizer(of_tied(estimate, graph), state.walls),
        deviation=deviation_of(estimate) if solved is graph else state.deviation,
    )
    return replace(state, log=(opened(state),))


def unknown_way(X_DA: FloatArray, sigma: FloatArray = KIDNAPPED) -> Keyframe:
    """Return the keyframe of an unknown motion: to X_DA (3,), with deviations sigma (3,), m, m, rad."""
    return way(X_DA, np.diag(sigma**2))


def reduced_now(state: EstimatorState, piece: Piece) -> Reduced:
    """Return a turn or piece of the way, solved by itself."""
    return reduced(state.noise.now, piece, state.graph.shared, state.walls.floor, state.graph.unevenness)


def newest_of(seen: Stretch) -> Stretch:
    """Return the newest frames of a stretch as one of their own, without the sightings at its beginning, as the robot
    may have been moved then."""
    frames = seen.frames[-MOST_FRAMES:]
    begin = replace(frames[0], detections=no_detections(frames[0].stamp), lines=no_lines())
    return Stretch(begin, se2.compose(seen.X_MB, se2.between(seen.begin.X_OB, begin.X_OB)), seen.sigma, frames)

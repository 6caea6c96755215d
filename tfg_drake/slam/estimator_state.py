"""All that the SLAM estimator knows, as one immutable object."""

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
from tfg_drake.slam.evidence import Evidence, Sighted, TagWatch, renewed, with_doubts
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

# Standard deviations, m, m, rad, of the motion between two views when the robot was kidnapped on the way: unknown.
KIDNAPPED = np.array([100.0, 100.0, 10.0])
# An increment of odometry.
NO_MOTION = np.zeros(3)
# So many of the newest frames tell where the robot is.
MOST_FRAMES = 50
# A camera that is mounted, and whose clock runs, as is believed.
EXACT_CAMERA = TagSensorConfig(yaw_deviation=0.0, clock_deviation=0.0, mount_deviation=0.0, range_scale_deviation=0.0)


@message
class Stretch:
    """A stretch of the log: a turn, or a piece of the way that is mapped like one.

    begin: its first instant, X_MB: (3,) the localiser's pose then, sigma: (3,) its deviations, m, m, rad. frames: those
    seen since. is_apart: the way to it from the last view is not known better than that: the robot was moved by
    something else than its wheels. solved: as a keyframe, None while it is under way.
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
    """How the frame of a map lies in another, as M of a session in the map K that it began with: X_KM (3,) and its
    covariance (3, 3). moved: ids of the tags that stand elsewhere by now, tags: how many agree, 0 where surfaces say
    so."""

    X: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]
    moved: IntArray = dataclasses.field(default_factory=lambda: np.empty(0, dtype=np.int64))
    tags: int = 0

    @property
    def by(self) -> str:
        """The landmarks that say so, in the plural."""
        return f"{self.tags} tags" if self.tags else "surfaces"


@message
class KnownMap:
    """The map K that a session began with, as long as it maps apart from that, or that they are one may be taken back.

    keyframe: all of it, seen from its origin, to the pose X_KD (3,). estimate: its landmarks. seen: what its
    views have seen. evidence: for the places of its tags, facing: (n, 2) which way these face. said: where somebody
    says that the session begins. X_WK: (3,) where K lies in its world. since: the stage at which both became one, 0 as
    long as they are apart. sessions: (s,) that K is of, as of `KeyframeGraph`.
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
    """All the estimator knows; the defaults are before any message.

    noise: of odometry and tags. sheet: the shared parameters by the data sheets. path_keyframe_period: s of way that
    are mapped as one piece; 0 where only its motion is. graph: its landmarks as they lay at its last solve or when they
    were first seen, solved: the graph at that solve. ranges: how the tags' ranges compare with those of scans.
    evidence: for the places where it has its tags, and against them. watch: which of them should have been seen since.
    newest: the last odometry message. odometry: dead reckoning from the localiser's instant on. pending: frames that
    wait for it. scans: the newest scans. instant: the localiser's, nothing seen. contradictions: frames that contradict
    the pose, less those that agree since, inf where it is a guess until the robot has found itself. suspect: where the
    first that contradicts it was seen, without frames; None where none does. log: what was seen since the last view,
    the pieces of the way and the turn after them; the newest is under way. placed: s, since when the robot knows where
    it is in a map that it began with, or in which it may have been carried while nobody looked; nan as long as it does
    not in the latter. map: what has become of the solved graph since, None before
    the first view. look: the newest messages in the order of their arrival, None once the first turn is over. sources:
    of the newest keyframes, None of one that has none. walls: of the map. landmarks: what it is made of, one of
    `config.LANDMARKS`. unread: scans that wait for odometry. looked: s, when lines were last taken for a stretch.
    may_be_moved: by something else than its wheels. straight: (2,) m of straight walls and of all surfaces that the
    scans of the last minutes have seen, nan once it was told that too little is straight. loops: the search for them.
    deviation: (2,) of the newest pose at the last solve, m and rad. known: the map that the session began with, until
    it is part of this one for good; at: where in it that is, once it is known; hypotheses: where in it that may be,
    none where that is anywhere or nowhere.
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
        """The filters' instant, s."""
        return self.instant.stamp

    @property
    def offset(self) -> float:
        """The camera's clock is taken to be so much ahead, s."""
        return float(self.graph.shared.mean[CLOCK])

    @property
    def turn(self) -> Stretch | None:
        """The open turn, None while the way is mapped."""
        return self.log[-1] if self.log and self.log[-1].is_turn else None

    @property
    def mapped(self) -> tuple[Stretch, ...]:
        """The part of the log that the next view maps: all, or where the robot was moved by something else than its
        wheels the stretches since."""
        return self.log[max((k for k, one in enumerate(self.log) if one.is_apart), default=0) :]

    @property
    def is_kidnapped(self) -> bool:
        """Whether the robot was moved since the last view by something else than its wheels."""
        return any(one.is_apart for one in self.log)

    @property
    def seen_in_doubt(self) -> Stretch | None:
        """The frames since the pose came into doubt, as one stretch; None where it is in none."""
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
    *,
    may_be_moved: bool = True,
) -> EstimatorState:
    """The estimator at the map's origin, before any message.

    prior: what is known of the shared parameters beforehand; none: what the odometry's data sheet says, and of the
    camera that all is as it is believed to be. path_keyframe_period: s; the way between views is mapped in pieces of
    this length, inf: in those that `close_piece` ends. 0: of the way only its motion is mapped, and path sightings
    localise (the paper's Sec. III-C). solver: what solves the keyframe graph, one of `config.SOLVERS`. landmarks: what
    the map is made of, one of `config.LANDMARKS`. walls: none yet, and what is believed of them. may_be_moved: whether
    the robot may be elsewhere where what is seen contradicts its pose; else that is a fault of what is seen, unless
    odometry says that the way is unknown.
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
        may_be_moved=may_be_moved,
        # Pieces of a recorded drive are no turns, of which the first is looked at once more.
        look=None if np.isinf(path_keyframe_period) else (),
    )


def pose_now(
    state: EstimatorState, increment: FloatArray = NO_MOTION, dt: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) and its covariance (3, 3) at the filters' instant, or an odometry increment (3,) later, over dt s."""
    return localized_pose(state.localizer, state.noise.now.walks, increment, dt)


def opened(state: EstimatorState) -> Stretch:
    """A piece of the way that begins now."""
    X_MB, covariance = pose_now(state)
    return Stretch(state.instant, X_MB, np.sqrt(np.maximum(np.diag(covariance), LEAST_SIGMA**2)))


def with_map(
    state: EstimatorState, graph: KeyframeGraph, estimate: MapEstimate, solved: KeyframeGraph
) -> EstimatorState:
    """The state after a view, with the graph and the map of all that it has seen, from where the way goes on. solved:
    the graph at its last solve."""
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
    """The motion of a kidnapped robot: it seems to have led to X_DA (3,), with deviations sigma (3,), m, m, rad."""
    return way(X_DA, np.diag(sigma**2))


def reduced_now(state: EstimatorState, piece: Piece) -> Reduced:
    """A turn or piece of the way, solved by itself."""
    return reduced(state.noise.now, piece, state.graph.shared, state.walls.floor, state.graph.unevenness)


def newest_of(seen: Stretch) -> Stretch:
    """The newest frames of a stretch as one of their own, but for what was seen as it began: the robot may have
    been moved then."""
    frames = seen.frames[-MOST_FRAMES:]
    begin = replace(frames[0], detections=no_detections(frames[0].stamp), lines=no_lines())
    return Stretch(begin, se2.compose(seen.X_MB, se2.between(seen.begin.X_OB, begin.X_OB)), seen.sigma, frames)

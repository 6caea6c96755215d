"""All that the SLAM estimator knows, as one immutable object."""

from __future__ import annotations

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.messages import (
    FloatArray,
    IntArray,
    LaserScan,
    MapEstimate,
    Odometry,
    TagDetections,
    message,
    replace,
)
from tfg_drake.slam.camera_model import LEAST_SIGMA, CameraModel, exact_camera
from tfg_drake.slam.doubt import Evidence, Sighted, no_evidence
from tfg_drake.slam.first_look import Message
from tfg_drake.slam.keyframe_graph import KeyframeGraph, empty_graph, empty_map
from tfg_drake.slam.localizer import Localizer, localized_pose, start_localizer
from tfg_drake.slam.missing_tags import TagWatch, no_watch
from tfg_drake.slam.noise_correlation import NoiseCorrelation, no_correlation
from tfg_drake.slam.odometry_model import DeadReckoning, OdometryModel, odometry_model
from tfg_drake.slam.range_scale import Compared, RangeScale, none_compared, unknown_scale
from tfg_drake.slam.turn import TurnFrame, no_detections

# Standard deviations, m, m, rad, of the motion between two views when the robot was kidnapped on the way: unknown.
KIDNAPPED = np.array([100.0, 100.0, 10.0])


@message
class OpenObservation:
    """An observation under way: a turn, or a piece of the way that is mapped like one.

    begin: its first instant, X_MB: (3,) the localiser's pose then, sigma: (3,) its deviations, m, m, rad. frames: those
    seen since. unwatched: s before it in which no tag confirmed the pose.
    """

    begin: TurnFrame
    X_MB: FloatArray
    sigma: FloatArray
    frames: tuple[TurnFrame, ...]
    unwatched: float = 0.0


@message
class FirstLook:
    """The newest messages before the first turn is over, in the order of their arrival, and the state before any."""

    start: EstimatorState
    messages: tuple[Message, ...] = ()


@message
class EstimatorState:
    """All the estimator knows.

    camera, correlation: what is known of the camera and of the noise of tags. path_keyframe_period: s of way that are
    mapped as one piece; 0 where only its motion is. newest: the last odometry message. odometry: dead reckoning from
    the localiser's instant on. pending: frames that wait for it. scans: the newest scans. scale, compared: what they
    say of the tags' ranges, and by which frames. stamp (s), clock (s), X_OB (3,): the localiser's instant and the dead
    reckoning then. contradictions:
    frames that contradict the pose, less those that agree since. agreed: s, when the last one agreed. suspect: what was
    seen since the first that contradicts it, None where none does. lost: where the robot is since then is a guess.
    kidnapped: the robot was moved since the last view by something else than its wheels. turn, piece: the open turn and
    piece of the way, way: those before it since the last view. graph: its landmarks as they lay at its last solve or
    when they were first seen, solved: the graph at that solve. map: what has become of it since, None before the first
    view. rejected: (r,) ids of known tags left out of the newest view, dropped: sightings left out of its turn.
    evidence: for the places where it has its tags, and against them. watch: which of them should have been seen since.
    look: the first look, None once it is over.
    """

    model: OdometryModel
    camera: CameraModel
    correlation: NoiseCorrelation
    path_keyframe_period: float
    newest: Odometry | None
    odometry: tuple[DeadReckoning, ...]
    pending: tuple[TagDetections, ...]
    scans: tuple[LaserScan, ...]
    scale: RangeScale
    compared: Compared
    stamp: float
    clock: float
    X_OB: FloatArray
    localizer: Localizer
    contradictions: int
    agreed: float
    suspect: OpenObservation | None
    lost: bool
    kidnapped: bool
    turn: OpenObservation | None
    piece: OpenObservation | None
    way: tuple[Sighted, ...]
    graph: KeyframeGraph
    solved: KeyframeGraph
    map: MapEstimate | None
    evidence: Evidence
    watch: TagWatch
    rejected: IntArray
    dropped: int
    look: FirstLook | None = None


def initial_state(
    config: OdometryConfig, path_keyframe_period: float = 0.0, camera: CameraModel | None = None
) -> EstimatorState:
    """The estimator at the map's origin, before any message.

    camera: what is known of it beforehand; none: that it looks ahead and its clock is right.
    path_keyframe_period: s; the way between views is mapped in pieces of this length, inf: in those that `close_piece`
    ends. 0: of the way only its motion is mapped, and path sightings localise (the paper's Sec. III).
    """
    model, camera = odometry_model(config), camera or exact_camera()
    yaw = np.array([camera.yaw, camera.sigma[0]])
    state = EstimatorState(
        model=model,
        camera=camera,
        correlation=no_correlation(),
        path_keyframe_period=path_keyframe_period,
        newest=None,
        odometry=(),
        pending=(),
        scans=(),
        scale=unknown_scale(),
        compared=none_compared(),
        stamp=-np.inf,
        clock=-np.inf,
        X_OB=np.zeros(3),
        localizer=start_localizer(model, None),
        contradictions=0,
        agreed=-np.inf,
        suspect=None,
        lost=False,
        kidnapped=False,
        turn=None,
        piece=None,
        way=(),
        graph=empty_graph(yaw),
        solved=empty_graph(yaw),
        map=None,
        evidence=no_evidence(),
        watch=no_watch(),
        rejected=np.empty(0, dtype=np.int64),
        dropped=0,
    )
    return replace(state, look=FirstLook(state))


def known_camera(state: EstimatorState) -> CameraModel:
    """The camera as known from everything: its clock from the observations, its yaw from the whole graph."""
    return state.camera.with_yaw(state.graph.yaw)


def camera_prior(state: EstimatorState) -> CameraModel:
    """The camera as known from each observation by itself, without how the keyframes fit together."""
    return state.camera.with_yaw(state.graph.yaw_prior)


def instant(state: EstimatorState) -> TurnFrame:
    """The filters' instant, nothing seen."""
    return TurnFrame(state.stamp, state.clock, state.X_OB, no_detections(state.stamp))


def opened(state: EstimatorState) -> OpenObservation:
    """A turn or piece of the way that begins now."""
    X_MB, covariance = localized_pose(state.localizer, state.model, np.zeros(3), 0.0)
    return OpenObservation(instant(state), X_MB, np.sqrt(np.maximum(np.diag(covariance), LEAST_SIGMA**2)), ())


def unknown_way(X_DA: FloatArray, sigma: FloatArray = KIDNAPPED) -> Sighted:
    """The motion of a kidnapped robot: it seems to have led to X_DA (3,), with deviations sigma (3,), m, m, rad."""
    observation = replace(empty_map().observation, X_AD=X_DA, covariance=np.diag(sigma**2))
    return Sighted(observation, np.empty(0, dtype=np.int64))

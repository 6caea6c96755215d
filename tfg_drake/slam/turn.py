"""One turn in place at a goal: a small graph of the turn's poses and tags, solved and reduced to what the map needs.

The tags of a goal are tied together by the turn's uncertain headings, so they enter the map as one joint factor on
goal poses and tags, the turn's other poses eliminated (the paper's sec. III, "measurements at a goal are combined").
"""

from __future__ import annotations

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import B, C, L

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, GoalObservation, IntArray, TagDetections, message, replace
from tfg_drake.slam.odometry_factor import odometry_factor
from tfg_drake.slam.odometry_model import OdometryModel, arc

# A detection this far off, in sigmas of its two whitened components together, is an outlier.
OUTLIER_SIGMAS = 5.5
# Huber threshold, in sigmas, of the pass that looks for outliers.
HUBER_SIGMAS = 1.5
# Random walks, as OdometryModel.noise, of a robot whose wheels slip or which somebody pushes meanwhile.
SLIPPING = np.array([0.2, 0.1, 0.2])
# It did if that explains at least so many sightings that are outliers else, and leaves at most this share of them.
SLIP_EXPLAINS = 3
SLIP_LEAVES = 1 / 3
# The arrival pose is the origin.
ORIGIN_SIGMA = 1e-7

# Clock (t,) and odometry (t, 3) of the poses; pose, id and measurement (m, 4) of each of the sightings (m,).
_Problem = tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]


@message
class TurnFrame:
    """What was seen at one instant of a turn. stamp: s. clock (s), X_OB: (3,): dead reckoning then. detections: the
    frame's tags."""

    stamp: float
    clock: float
    X_OB: FloatArray
    detections: TagDetections


def no_detections(stamp: float) -> TagDetections:
    """A frame in which nothing was seen."""
    nothing = np.empty(0)
    return TagDetections(
        stamp=stamp,
        ids=np.empty(0, dtype=np.int64),
        range=nothing,
        bearing=nothing,
        sigma_range=nothing,
        sigma_bearing=nothing,
    )


@message
class TurnSolution:
    """observation: the turn's result. sightings: (n,) detections behind each of its tags. dropped: number of detections
    left out as outliers. calibration: (3,) of the odometry, calibration_covariance: (3, 3), see OdometryModel."""

    observation: GoalObservation
    sightings: IntArray
    dropped: int
    calibration: FloatArray
    calibration_covariance: FloatArray


def solve_turn(model: OdometryModel, begin: TurnFrame, frames: tuple[TurnFrame, ...], end: TurnFrame) -> TurnSolution:
    """The tags seen during a turn and the departure pose D (at end), in the arrival frame A (at begin).

    frames: in the order of their stamps, within [begin, end]; begin and end carry no detections. Without any
    detection n is 0 and X_AD comes from odometry alone. Where the sightings agree with each other but not with the
    odometry, the wheels have slipped: then the sightings are believed.
    """
    stamps, clock, X_OB, node = _nodes(begin, frames, end)
    seen = [frame.detections for frame in frames]
    counts = [len(detections.ids) for detections in seen]
    detection_node = np.repeat(np.array(node, dtype=np.int64), counts)
    all_ids = np.concatenate([np.empty(0, dtype=np.int64), *(detections.ids for detections in seen)])
    z = np.empty((len(all_ids), 4))
    if len(all_ids) > 0:
        z[:, 0] = np.concatenate([detections.bearing for detections in seen])
        z[:, 1] = np.concatenate([detections.range for detections in seen])
        z[:, 2] = np.concatenate([detections.sigma_bearing for detections in seen])
        z[:, 3] = np.concatenate([detections.sigma_range for detections in seen])

    problem = clock, X_OB, detection_node, all_ids, z
    initial = _initial_value(X_OB, detection_node, all_ids, z)
    kept = np.ones(len(all_ids), dtype=bool)
    values = _solve(_graph(model, *problem, kept, robust=False), initial)
    if len(all_ids) > 0 and np.any(_outliers(values, detection_node, all_ids, z)):
        values, kept = _without_outliers(model, problem, initial)
        unexplained = int(np.sum(~kept))
        if unexplained >= SLIP_EXPLAINS:
            # A push moves a robot at rest, too: by the time that passed, not by that of its motion.
            slipping = replace(model, noise=np.maximum(model.noise, SLIPPING)), (stamps, *problem[1:])
            other_values, other_kept = _without_outliers(*slipping, initial)
            left = int(np.sum(~other_kept))
            if left <= min(unexplained - SLIP_EXPLAINS, SLIP_LEAVES * unexplained):
                (model, problem), values, kept = slipping, other_values, other_kept
    graph = _graph(model, *problem, kept, robust=False)

    ids, sightings = np.unique(all_ids[kept], return_counts=True)
    X_AB = np.array([_pose(values, i) for i in range(len(stamps))])
    covariance = _joint_covariance(graph, values, ids, len(stamps))
    observation = GoalObservation(
        ids=ids,
        p_AL=np.array([values.atPoint2(L(int(tag))) for tag in ids]).reshape(-1, 2),
        X_AD=X_AB[-1],
        covariance=covariance[3:, 3:],
        stamps=stamps,
        X_AB=X_AB,
    )
    return TurnSolution(
        observation=observation,
        sightings=sightings,
        dropped=int(np.sum(~kept)),
        calibration=values.atVector(C(0)),
        calibration_covariance=covariance[:3, :3],
    )


def _without_outliers(model: OdometryModel, problem: _Problem, initial: gtsam.Values) -> tuple[gtsam.Values, BoolArray]:
    """The solution without the sightings that lie too far from a robust one, and which of them it keeps."""
    _, _, node, ids, z = problem
    everything = np.ones(len(ids), dtype=bool)
    values = _solve(_graph(model, *problem, everything, robust=True), initial)
    kept = ~_outliers(values, node, ids, z)
    values = _without_lost_tags(values, ids, kept)
    return _solve(_graph(model, *problem, kept, robust=False), values), kept


def _nodes(
    begin: TurnFrame, frames: tuple[TurnFrame, ...], end: TurnFrame
) -> tuple[FloatArray, FloatArray, FloatArray, list[int]]:
    """Stamps and clock (t,) and odometry (t, 3) of the graph's poses, and the pose of each frame; coinciding stamps
    share one."""
    stamps, clock, X_OB, node = [begin.stamp], [begin.clock], [begin.X_OB], []
    for frame in (*frames, end):
        if frame.stamp - stamps[-1] > 1e-9:
            stamps.append(frame.stamp)
            clock.append(frame.clock)
            X_OB.append(frame.X_OB)
        node.append(len(stamps) - 1)
    if len(stamps) == 1:
        stamps.append(begin.stamp + 1e-6)
        clock.append(begin.clock + 1e-6)
        X_OB.append(end.X_OB)
    return np.array(stamps), np.array(clock), np.array(X_OB), node[:-1]


def _initial_value(X_OB: FloatArray, node: IntArray, ids: IntArray, z: FloatArray) -> gtsam.Values:
    X_AB = se2.between(X_OB[0], X_OB)
    values = gtsam.Values()
    for i, pose in enumerate(X_AB):
        values.insert(B(i), gtsam.Pose2(*pose))
    values.insert(C(0), np.zeros(3))
    angle = X_AB[node, 2] + z[:, 0]
    points = X_AB[node, :2] + z[:, 1:2] * np.column_stack([np.cos(angle), np.sin(angle)])
    for tag in np.unique(ids):
        values.insert(L(int(tag)), points[ids == tag].mean(axis=0))
    return values


def _graph(
    model: OdometryModel,
    clock: FloatArray,
    X_OB: FloatArray,
    node: IntArray,
    ids: IntArray,
    z: FloatArray,
    kept: BoolArray,
    *,
    robust: bool,
) -> gtsam.NonlinearFactorGraph:
    """Poses B(i), calibration C(0), tags L(id): prior at A, odometry between poses, bearing and range of tags."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPose2(B(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, ORIGIN_SIGMA)))
    prior = gtsam.noiseModel.Gaussian.Covariance(model.calibration_covariance)
    graph.add(gtsam.PriorFactorVector(C(0), model.calibration, prior))
    for i in range(len(clock) - 1):
        increment, dt = arc(X_OB[i], X_OB[i + 1]), clock[i + 1] - clock[i]
        graph.add(odometry_factor(B(i), B(i + 1), C(0), increment, dt, model.noise))
    huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER_SIGMAS)
    for j in np.flatnonzero(kept):
        bearing, distance, sigma_bearing, sigma_range = z[j]
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma_bearing, sigma_range]))
        if robust:
            noise = gtsam.noiseModel.Robust.Create(huber, noise)
        graph.add(
            gtsam.BearingRangeFactor2D(B(int(node[j])), L(int(ids[j])), gtsam.Rot2.fromAngle(bearing), distance, noise)
        )
    return graph


def _solve(graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-6)
    parameters.setMaxIterations(30)
    return gtsam.LevenbergMarquardtOptimizer(graph, initial, parameters).optimize()


def _outliers(values: gtsam.Values, node: IntArray, ids: IntArray, z: FloatArray) -> BoolArray:
    """(m,) True where a detection lies too far from the solution."""
    X_AB = np.array([_pose(values, i) for i in range(int(node.max()) + 1)])[node]
    tags, row = np.unique(ids, return_inverse=True)
    p_AL = np.array([values.atPoint2(L(int(tag))) for tag in tags])[row]
    d = p_AL - X_AB[:, :2]
    bearing = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - X_AB[:, 2] - z[:, 0]) / z[:, 2]
    distance = (np.hypot(d[:, 0], d[:, 1]) - z[:, 1]) / z[:, 3]
    return np.asarray(bearing**2 + distance**2 > OUTLIER_SIGMAS**2)


def _without_lost_tags(values: gtsam.Values, ids: IntArray, kept: BoolArray) -> gtsam.Values:
    for tag in np.setdiff1d(ids, ids[kept]):
        values.erase(L(int(tag)))
    return values


def _pose(values: gtsam.Values, i: int) -> tuple[float, float, float]:
    pose = values.atPose2(B(i))
    return pose.x(), pose.y(), pose.theta()


def _joint_covariance(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, ids: IntArray, nodes: int) -> FloatArray:
    """(2n + 6, 2n + 6) covariance of (calibration, tags, X_AD) given A: the other poses eliminated.

    A Schur complement of GTSAM's linearised system; GTSAM's pose increments are in the body's frame, so that of D is
    rotated into A.
    """
    ordering = gtsam.Ordering()
    for i in range(nodes - 1):
        ordering.push_back(B(i))
    ordering.push_back(C(0))
    for tag in ids:
        ordering.push_back(L(int(tag)))
    ordering.push_back(B(nodes - 1))
    information = graph.linearize(values).hessian(ordering)[0][3:, 3:]
    split = 3 * (nodes - 2)
    reduced = information[split:, split:]
    if split > 0:
        factor = scipy.linalg.cholesky(information[:split, :split], lower=True, check_finite=False)
        half = scipy.linalg.solve_triangular(factor, information[:split, split:], lower=True, check_finite=False)
        reduced = reduced - half.T @ half
    covariance = scipy.linalg.cho_solve(
        scipy.linalg.cho_factor(reduced, check_finite=False), np.eye(len(reduced)), check_finite=False
    )
    R_AD = se2.rotation(_pose(values, nodes - 1)[2])
    covariance[-3:-1] = R_AD @ covariance[-3:-1]
    covariance[:, -3:-1] = covariance[:, -3:-1] @ R_AD.T
    return np.asarray(0.5 * (covariance + covariance.T))

"""The reference for any online estimator: every pose, landmark and the odometry's calibration, solved from all data.

A pose at every frame, odometry between them, bearing and range with a robust kernel. The graph is first built up by
iSAM2, for dead reckoning alone would start metres off, then solved to convergence; sightings that the robust solution
contradicts grossly are left out of the last solve. Where the run was estimated online before, the same is done from
those poses and the better solution taken: a few misread ids can lead iSAM2 astray.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Odometry, TagDetections, message
from tfg_drake.slam.odometry_factor import odometry_factor
from tfg_drake.slam.odometry_model import (
    OdometryModel,
    arc,
    first_reckoning,
    interpolate,
    interpolate_clock,
    odometry_model,
    predict_increment,
    reckon,
)

# A sighting this far off, in sigmas of its two whitened components together, is an outlier.
OUTLIER_SIGMAS = 4.0
# Huber threshold, sigmas.
HUBER_SIGMAS = 1.3
# Rounds of solving and looking for outliers, at most.
MOST_ROUNDS = 6
# Without frames a pose at least this often while the robot moves, s of the odometry's clock.
LONGEST_GAP = 0.5
# Steps of one solve, at most, and the relative decrease of the error after which no other is needed.
MOST_STEPS = 100
SMALL_DECREASE = 1e-7
# Poses that enter iSAM2 at a time.
POSES_AT_ONCE = 10
# The first pose is where odometry has it.
ORIGIN_SIGMA = 1e-6

# Called with the share of the work done, 0 to 1.
OnProgress = Callable[[float], None]


@message
class SmoothedRun:
    """The solution. stamps: (k,) s and X_MB: (k, 3), a pose at least at every frame; M is the odometry's origin.

    ids: (n,) ascending, p_ML: (n, 2) m. calibration: (3,) scale of distance, bias (rad/s) and scale of the gyro.
    half_chi_square: half the sum of squared whitened errors, the Huber kernel on sightings applied. used, rejected:
    numbers of sightings.
    """

    stamps: FloatArray
    X_MB: FloatArray
    ids: IntArray
    p_ML: FloatArray
    calibration: FloatArray
    half_chi_square: float
    used: int
    rejected: int


@message
class _Problem:
    """stamps (k,), clock (k,), X_OB (k, 3): the graph's poses. node (m,), ids (m,), z (m, 4): sightings as their pose,
    landmark, and bearing, range, sigma of bearing, sigma of range."""

    stamps: FloatArray
    clock: FloatArray
    X_OB: FloatArray
    node: IntArray
    ids: IntArray
    z: FloatArray


def smooth(
    odometry: tuple[Odometry, ...],
    detections: tuple[TagDetections, ...],
    config: OdometryConfig,
    on_progress: OnProgress | None = None,
    guess: tuple[FloatArray, FloatArray] | None = None,
) -> SmoothedRun:
    """Solve a whole run; messages in the order of their stamps, frames outside the span of the odometry left out.

    guess: stamps (g,), s, and poses X_MB (g, 3) as they were estimated before.

    Raises ValueError without odometry.
    """
    if not odometry:
        raise ValueError("A run without odometry cannot be smoothed.")
    report = on_progress or (lambda _share: None)
    model = odometry_model(config)
    problem = _problem(odometry, detections)
    starts = [_incremental(model, problem, lambda share: report(0.4 * share))]
    if guess is not None and len(guess[0]):
        starts.append(_guessed(problem, *guess))
    solutions = []
    for values in starts:
        solutions.append(_solution(model, problem, values))
        report(0.4 + 0.6 * len(solutions) / len(starts))
    # A sighting left out costs what one costs that is just not.
    values, kept, error = min(solutions, key=lambda one: one[2] + 0.5 * OUTLIER_SIGMAS**2 * np.count_nonzero(~one[1]))
    ids = np.unique(problem.ids[kept])
    return SmoothedRun(
        stamps=problem.stamps,
        X_MB=_poses(values, len(problem.stamps)),
        ids=ids,
        p_ML=np.array([values.atPoint2(L(int(tag))) for tag in ids]).reshape(-1, 2),
        calibration=values.atVector(C(0)),
        half_chi_square=error,
        used=int(np.sum(kept)),
        rejected=int(np.sum(~kept)),
    )


def _solution(model: OdometryModel, problem: _Problem, values: gtsam.Values) -> tuple[gtsam.Values, BoolArray, float]:
    """The values, from some poses on, which sightings (m,) they rest on, and the error of the graph of those."""
    kept = np.ones(len(problem.ids), dtype=bool)
    for rounds in range(1, MOST_ROUNDS + 1):
        values = _with_landmarks(values, problem, kept)
        graph = _graph(model, problem, kept)
        values = converge(graph, values)
        near = ~_outliers(values, problem, kept)
        if rounds == MOST_ROUNDS or np.array_equal(near, kept):
            break
        kept = near
    return values, kept, graph.error(values)


def _guessed(problem: _Problem, stamps: FloatArray, X_MB: FloatArray) -> gtsam.Values:
    """The poses of a guess, moved so that the first is where odometry has it."""
    columns = [np.interp(problem.stamps, stamps, x) for x in (X_MB[:, 0], X_MB[:, 1], np.unwrap(X_MB[:, 2]))]
    poses = np.stack(columns, axis=1)
    to_M = se2.compose(problem.X_OB[0], se2.inverse(poses[0]))
    values = gtsam.Values()
    for i, pose in enumerate(se2.compose(to_M, poses)):
        values.insert(X(i), gtsam.Pose2(*pose))
    values.insert(C(0), np.zeros(3))
    return values


def _problem(odometry: tuple[Odometry, ...], detections: tuple[TagDetections, ...]) -> _Problem:
    reckoned = [first_reckoning(odometry[0])]
    for before, after in itertools.pairwise(odometry):
        reckoned.append(reckon(reckoned[-1], before, after))
    at = np.array([one.stamp for one in reckoned])
    frames = [one for one in detections if at[0] <= one.stamp <= at[-1]]

    stamps, clock, X_OB = [reckoned[0].stamp], [reckoned[0].clock], [reckoned[0].X_OB]
    node = []

    def add(stamp: float) -> None:
        if stamp > stamps[-1]:
            i = max(int(np.searchsorted(at, stamp)), 1)
            stamps.append(stamp)
            clock.append(interpolate_clock(reckoned[i - 1], reckoned[i], stamp))
            X_OB.append(interpolate(reckoned[i - 1], reckoned[i], stamp))

    row = 0
    for frame in frames:
        while row < len(reckoned) and reckoned[row].stamp < frame.stamp:
            if reckoned[row].clock - clock[-1] >= LONGEST_GAP:
                add(reckoned[row].stamp)
            row += 1
        add(frame.stamp)
        node.append(len(stamps) - 1)
    for one in reckoned[row:]:
        if one.clock - clock[-1] >= LONGEST_GAP:
            add(one.stamp)
    add(reckoned[-1].stamp)

    counts = [len(frame.ids) for frame in frames]
    z = np.empty((sum(counts), 4))
    for column, name in enumerate(("bearing", "range", "sigma_bearing", "sigma_range")):
        z[:, column] = np.concatenate([np.empty(0), *(getattr(frame, name) for frame in frames)])
    return _Problem(
        stamps=np.array(stamps),
        clock=np.array(clock),
        X_OB=np.array(X_OB),
        node=np.repeat(np.array(node, dtype=np.int64), counts),
        ids=np.concatenate([np.empty(0, dtype=np.int64), *(frame.ids for frame in frames)]),
        z=z,
    )


def _incremental(model: OdometryModel, problem: _Problem, report: OnProgress) -> gtsam.Values:
    """Poses by iSAM2; the calibration is not a variable here but part of every increment's covariance."""
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")  # A robot at rest ties poses so tightly that Cholesky finds them singular.
    solver = gtsam.ISAM2(parameters)
    poses = len(problem.stamps)
    X_MB = problem.X_OB[0]
    estimate = gtsam.Values()
    graph, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(_origin(problem))
    new.insert(X(0), gtsam.Pose2(*X_MB))
    known: set[int] = set()
    sightings = np.searchsorted(problem.node, np.arange(poses + 1))
    calibration = np.diag(model.calibration_sigma**2)
    for i in range(poses):
        if i > 0:
            increment = arc(problem.X_OB[i - 1], problem.X_OB[i])
            dt = problem.clock[i] - problem.clock[i - 1]
            motion, on_calibration, covariance = predict_increment(increment, dt, np.zeros(3), model.noise)
            covariance = covariance + on_calibration @ calibration @ on_calibration.T
            R = se2.rotation(float(motion[2]))  # GTSAM wants it in the frame of the pose that is reached.
            covariance[:2] = R.T @ covariance[:2]
            covariance[:, :2] = covariance[:, :2] @ R
            noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))
            graph.add(gtsam.BetweenFactorPose2(X(i - 1), X(i), gtsam.Pose2(*motion), noise))
            X_MB = se2.compose(X_MB, motion)
            new.insert(X(i), gtsam.Pose2(*X_MB))
        for j in range(sightings[i], sightings[i + 1]):
            tag = int(problem.ids[j])
            if tag not in known:
                known.add(tag)
                new.insert(L(tag), _sighted(X_MB[None], problem.z[j][None])[0])
            graph.add(_sighting(problem, j))
        if (i + 1) % POSES_AT_ONCE == 0 or i == poses - 1:
            solver.update(graph, new)
            graph, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
            estimate = solver.calculateEstimate()
            X_MB = _pose(estimate, i)
            report((i + 1) / poses)
    estimate.insert(C(0), np.zeros(3))
    return estimate


def _with_landmarks(values: gtsam.Values, problem: _Problem, kept: BoolArray) -> gtsam.Values:
    """The poses and calibration of some values, and every landmark where most of its sightings put it."""
    poses = _poses(values, len(problem.stamps))
    fresh = gtsam.Values()
    for i, X_MB in enumerate(poses):
        fresh.insert(X(i), gtsam.Pose2(*X_MB))
    fresh.insert(C(0), values.atVector(C(0)))
    points = _sighted(poses[problem.node], problem.z)
    for tag in np.unique(problem.ids[kept]):
        fresh.insert(L(int(tag)), np.median(points[kept & (problem.ids == tag)], axis=0))
    return fresh


def _graph(model: OdometryModel, problem: _Problem, kept: BoolArray) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.add(_origin(problem))
    prior = gtsam.noiseModel.Diagonal.Sigmas(model.calibration_sigma.copy())
    graph.add(gtsam.PriorFactorVector(C(0), np.zeros(3), prior))
    for i in range(len(problem.stamps) - 1):
        increment, dt = arc(problem.X_OB[i], problem.X_OB[i + 1]), problem.clock[i + 1] - problem.clock[i]
        graph.add(odometry_factor(X(i), X(i + 1), C(0), increment, dt, model.noise))
    for j in np.flatnonzero(kept):
        graph.add(_sighting(problem, int(j)))
    return graph


def _origin(problem: _Problem) -> gtsam.PriorFactorPose2:
    return gtsam.PriorFactorPose2(
        X(0), gtsam.Pose2(*problem.X_OB[0]), gtsam.noiseModel.Isotropic.Sigma(3, ORIGIN_SIGMA)
    )


def _sighting(problem: _Problem, j: int) -> gtsam.BearingRangeFactor2D:
    bearing, distance, sigma_bearing, sigma_range = problem.z[j]
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(HUBER_SIGMAS),
        gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma_bearing, sigma_range])),
    )
    pose, landmark = X(int(problem.node[j])), L(int(problem.ids[j]))
    return gtsam.BearingRangeFactor2D(pose, landmark, gtsam.Rot2.fromAngle(bearing), distance, noise)


def converge(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The graph's least-squares values: Gauss-Newton steps, Levenberg-Marquardt where one fails to lower the error.

    GTSAM's own loop gives the same at ten times the cost: Python's factors are slow to call from inside it.
    """
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
    error = graph.error(values)
    for _ in range(MOST_STEPS):
        before = error
        moved = None
        with contextlib.suppress(RuntimeError):
            moved = values.retract(graph.linearize(values).optimize(ordering))
        if moved is None or not graph.error(moved) < error:
            moved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        error = graph.error(moved)
        if not error < before:
            break
        values = moved
        if before - error < SMALL_DECREASE * before:
            break
    return values


def _outliers(values: gtsam.Values, problem: _Problem, kept: BoolArray) -> BoolArray:
    """(m,) True where a sighting lies too far from the solution, or its landmark is not in it."""
    known = np.isin(problem.ids, problem.ids[kept])
    outlier = ~known
    if not known.any():
        return outlier
    X_MB = _poses(values, len(problem.stamps))[problem.node[known]]
    tags, row = np.unique(problem.ids[known], return_inverse=True)
    d = np.array([values.atPoint2(L(int(tag))) for tag in tags])[row] - X_MB[:, :2]
    z = problem.z[known]
    bearing = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - X_MB[:, 2] - z[:, 0]) / z[:, 2]
    distance = (np.hypot(d[:, 0], d[:, 1]) - z[:, 1]) / z[:, 3]
    outlier[known] = bearing**2 + distance**2 > OUTLIER_SIGMAS**2
    return outlier


def _sighted(X_MB: FloatArray, z: FloatArray) -> FloatArray:
    """(m, 2) where sightings z (m, 4) from poses (m, 3) put their landmarks."""
    angle = X_MB[:, 2] + z[:, 0]
    return np.asarray(X_MB[:, :2] + z[:, 1:2] * np.column_stack([np.cos(angle), np.sin(angle)]))


def _poses(values: gtsam.Values, count: int) -> FloatArray:
    return np.array([_pose(values, i) for i in range(count)])


def _pose(values: gtsam.Values, i: int) -> FloatArray:
    pose = values.atPose2(X(i))
    return np.array([pose.x(), pose.y(), pose.theta()])

"""The reference for any online estimator: every pose, landmark and the odometry's calibration, solved from all data.

A pose at every frame, odometry between them, bearing and range with a robust kernel: GTSAM's stock factors. The graph
is solved from the way that an online estimator found; sightings that the robust solution contradicts grossly are left
out of the last solve. No stock factor knows the calibration, so after each solve it takes a step of the linear system
that does.
"""

from __future__ import annotations

import itertools

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.evaluation import by_odometry
from tfg_drake.datasets.recording import OnProgress
from tfg_drake.geometry import se2
from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Odometry, TagDetections, message
from tfg_drake.slam.odometry_model import arc, first_reckoning, interpolate, predict_increment, random_walks, reckon
from tfg_drake.slam.shared import LEAST_SIGMA, calibration_sigma

# A sighting is an outlier if the norm of its two whitened residuals exceeds this.
OUTLIER_SIGMAS = 4.0
# Huber threshold, sigmas.
HUBER_SIGMAS = 1.3
# Greatest number of solves; outliers are searched once the calibration moves by less than SMALL_STEP prior deviations.
MOST_ROUNDS = 12
SMALL_STEP = 0.05
# Relative decrease of the cost after which a solve ends.
SMALL_DECREASE = 1e-6
# Greatest time between two poses of a moving robot, s of the odometry's clock.
LONGEST_GAP = 0.5


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


def smooth(
    odometry: tuple[Odometry, ...],
    detections: tuple[TagDetections, ...],
    config: OdometryConfig,
    on_progress: OnProgress = lambda _share: None,
    way: tuple[FloatArray, FloatArray] | None = None,
) -> SmoothedRun:
    """Solve a whole run; messages in the order of their stamps, frames outside the span of the odometry left out.

    way: where the poses are nearly: stamps (n,), s, and X_MB (n, 3); None: where the odometry has them, which may be
    too far astray. Raises ValueError without odometry.
    """
    if not odometry:
        raise ValueError("A run without odometry cannot be smoothed.")
    batch = _Batch(odometry, detections, config)
    X_MB = batch.X_OB
    if way is not None and len(way[0]):
        X_MB = by_odometry(batch.stamps, *way, batch.stamps, batch.X_OB)
    calibration, kept = np.zeros(3), np.ones(len(batch.landmark), dtype=bool)
    for rounds in range(1, MOST_ROUNDS + 1):
        X_MB, p_ML, error, step = batch.solved(X_MB, kept, calibration)
        calibration = calibration + step
        is_small = bool(np.all(np.abs(step) < SMALL_STEP * batch.calibration_sigma))
        near = batch.near(X_MB, p_ML) if is_small else kept
        if rounds == MOST_ROUNDS or (is_small and np.array_equal(near, kept)):
            break
        kept = near
        on_progress(rounds / MOST_ROUNDS)
    on_progress(1.0)
    seen = np.unique(batch.landmark[kept])
    return SmoothedRun(
        stamps=batch.stamps,
        X_MB=X_MB,
        ids=batch.ids[seen],
        p_ML=p_ML[seen],
        calibration=calibration,
        half_chi_square=error,
        used=int(np.sum(kept)),
        rejected=int(np.sum(~kept)),
    )


class _Batch:
    """The factors of a run. stamps: (k,) of the poses, X_OB: (k, 3) these by odometry. node, landmark: (s,) the rows of
    each sighting's; ids: (n,)."""

    def __init__(
        self, odometry: tuple[Odometry, ...], detections: tuple[TagDetections, ...], config: OdometryConfig
    ) -> None:
        reckoned = [first_reckoning(odometry[0])]
        for before, after in itertools.pairwise(odometry):
            reckoned.append(reckon(reckoned[-1], before, after))
        at, by_clock = np.array([[one.stamp, one.clock] for one in reckoned]).T
        frames = [one for one in detections if at[0] <= one.stamp <= at[-1]]
        ends = np.unique([at[0], *(frame.stamp for frame in frames), at[-1]])
        # Where messages are missing, all between them is one motion.
        between = at[np.searchsorted(at[:-1], np.interp(np.arange(0.0, by_clock[-1], LONGEST_GAP), by_clock, at))]
        next_end = np.clip(np.searchsorted(ends, between), 1, len(ends) - 1)
        room = np.minimum(between - ends[next_end - 1], ends[next_end] - between)
        self.stamps: FloatArray = np.unique(np.append(ends, between[room > 0.5 * LONGEST_GAP]))
        after_it = np.clip(np.searchsorted(at, self.stamps), min(1, len(at) - 1), len(at) - 1).tolist()
        X_OB = [
            interpolate(reckoned[max(i - 1, 0)], reckoned[i], stamp)
            for i, stamp in zip(after_it, self.stamps.tolist(), strict=True)
        ]
        self.X_OB = np.array(X_OB)
        self._increment = np.array([arc(*pair) for pair in itertools.pairwise(X_OB)]).reshape(-1, 3)
        self._dt = np.diff(np.interp(self.stamps, at, by_clock))
        self.calibration_sigma = np.maximum(calibration_sigma(config), LEAST_SIGMA)
        X_ij, _, covariance = self._predicted(np.zeros(3), random_walks(config))
        # GTSAM has the error as it is seen from the measured pose.
        self._R_ji = np.array([se2.rotation(float(-angle)) for angle in X_ij[:, 2]]).reshape(-1, 2, 2)
        covariance[:, :2] = self._R_ji @ covariance[:, :2]
        covariance[:, :, :2] = covariance[:, :, :2] @ self._R_ji.transpose(0, 2, 1)
        self._noise = [gtsam.noiseModel.Gaussian.Covariance(one) for one in covariance]
        first = gtsam.Pose2(*X_OB[0])
        self._first = gtsam.PriorFactorPose2(X(0), first, gtsam.noiseModel.Constrained.All(3))

        frame_rows = np.searchsorted(self.stamps, [frame.stamp for frame in frames])
        self.node: IntArray = np.repeat(frame_rows, [len(frame.ids) for frame in frames])
        z = [np.stack([one.bearing, one.range, one.sigma_bearing, one.sigma_range], axis=1) for one in frames]
        self._z = np.concatenate([np.empty((0, 4)), *z])
        self.ids, self.landmark = np.unique(
            np.concatenate([np.empty(0, dtype=np.int64), *(one.ids for one in frames)]), return_inverse=True
        )
        huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER_SIGMAS)
        self._sightings = []
        for i, j, (bearing, distance, *sigmas) in zip(self.node.tolist(), self.landmark.tolist(), self._z, strict=True):
            noise = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
            self._sightings.append(gtsam.BearingRangeFactor2D(X(i), L(j), gtsam.Rot2(bearing), distance, noise))
        bearing, distance = self._z[:, 0], self._z[:, 1]
        self._p_BL = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])

    def _predicted(self, calibration: FloatArray, walks: FloatArray) -> list[FloatArray]:
        """`predict_increment` of all motions: (k - 1, 3), (k - 1, 3, 3) and (k - 1, 3, 3)."""
        each = [predict_increment(*one, calibration, walks) for one in zip(self._increment, self._dt, strict=True)]
        return [
            np.array([one[i] for one in each]).reshape(-1, *shape) for i, shape in enumerate([(3,), (3, 3), (3, 3)])
        ]

    def _motions(self, calibration: FloatArray) -> tuple[list[gtsam.BetweenFactorPose2], FloatArray]:
        """Odometry factors with a calibration (3,), and their Jacobian by it, (k - 1, 3, 3)."""
        X_ij, on_calibration, _ = self._predicted(calibration, np.zeros(3))
        motions = [
            gtsam.BetweenFactorPose2(X(i), X(i + 1), gtsam.Pose2(*one), noise)
            for i, (one, noise) in enumerate(zip(X_ij, self._noise, strict=True))
        ]
        return motions, on_calibration

    def solved(
        self, X_MB: FloatArray, kept: BoolArray, calibration: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, FloatArray]:
        """Poses (k, 3) and landmarks (n, 2), nan where no sighting is kept, of least cost with a calibration (3,), that
        cost, and the step (3,) of Gauss and Newton that the calibration takes from there; the others have taken it.

        X_MB: (k, 3) poses to begin from; each landmark begins where most of its kept (s,) sightings put it.
        """
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        motions, on_calibration = self._motions(calibration)
        rows = np.flatnonzero(kept)
        for factor in (self._first, *motions, *(self._sightings[row] for row in rows.tolist())):
            factors.add(factor)
        for i, pose in enumerate(X_MB):
            values.insert(X(i), gtsam.Pose2(*pose))
        seen, p_ML = np.unique(self.landmark[rows]), np.full((len(self.ids), 2), np.nan)
        points = X_MB[self.node[rows], :2] + turned(self._p_BL[rows], X_MB[self.node[rows], 2])
        for j in seen.tolist():
            values.insert(L(j), np.median(points[self.landmark[rows] == j], axis=0))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(SMALL_DECREASE)
        values = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
        error = factors.error(values) + 0.5 * np.sum((calibration / self.calibration_sigma) ** 2)
        step = self._step(factors.linearize(values), calibration, on_calibration)
        values = values.retract(step)
        for j in seen.tolist():
            p_ML[j] = values.atPoint2(L(j))
        return np.asarray(gtsam.utilities.extractPose2(values)), p_ML, float(error), np.asarray(step.at(C(0)))

    def _step(
        self, linear: gtsam.GaussianFactorGraph, calibration: FloatArray, on_calibration: FloatArray
    ) -> gtsam.VectorValues:
        """Gauss-Newton step of `solved` with motions that depend on the calibration, too."""
        system, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(3)
        on_calibration[:, :2] = self._R_ji @ on_calibration[:, :2]
        for i, (noise, on) in enumerate(zip(self._noise, on_calibration, strict=True)):
            motion = gtsam.JacobianFactor(linear.at(i + 1))
            A, b = motion.getA(), motion.getb()
            system.push_back(gtsam.JacobianFactor(X(i), A[:, :3], X(i + 1), A[:, 3:], C(0), -noise.R() @ on, b, unit))
        for i in (0, *range(len(self._noise) + 1, linear.size())):
            system.push_back(linear.at(i))
        whitener = np.diag(1.0 / self.calibration_sigma)
        system.push_back(gtsam.JacobianFactor(C(0), whitener, -whitener @ calibration, unit))
        return system.optimize()

    def near(self, X_MB: FloatArray, p_ML: FloatArray) -> BoolArray:
        """(s,) True where a sighting lies near the solution, and its landmark is in it."""
        X_MB, bearing, distance = X_MB[self.node], self._z[:, 0], self._z[:, 1]
        x, y = (p_ML[self.landmark] - X_MB[:, :2]).T
        turn = se2.wrap_angle(np.arctan2(y, x) - X_MB[:, 2] - bearing)
        error = np.column_stack([turn, np.hypot(x, y) - distance]) / self._z[:, 2:]
        return np.asarray(np.linalg.norm(error, axis=1) <= OUTLIER_SIGMAS)

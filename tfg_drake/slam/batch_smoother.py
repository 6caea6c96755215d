"""The reference for any online estimator: every pose, landmark and the odometry's calibration, solved from all data.

A pose at every frame, odometry between them, bearing and range with a robust kernel. The graph is grown pose by pose,
then solved to convergence; sightings that the robust solution contradicts grossly are left out of the last solve.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Odometry, TagDetections, message
from tfg_drake.slam.odometry_model import (
    arc,
    first_reckoning,
    interpolate,
    interpolate_clock,
    predict_increments,
    random_walks,
    reckon,
)
from tfg_drake.slam.planar_graph import Motions, OnProgress, PlanarGraph, Sightings, in_body, in_map
from tfg_drake.slam.shared import LEAST_SIGMA, calibration_sigma

# A sighting this far off, in sigmas of its two whitened components together, is an outlier.
OUTLIER_SIGMAS = 4.0
# Huber threshold, sigmas.
HUBER_SIGMAS = 1.3
# Rounds of solving and looking for outliers, at most.
MOST_ROUNDS = 6
# Without frames a pose at least this often while the robot moves, s of the odometry's clock.
LONGEST_GAP = 0.5
# A landmark nearer than this, m, has no bearing.
LEAST_RANGE = 1e-6


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
class _Run:
    """stamps (k,), clock (k,), X_OB (k, 3): the graph's poses. node (s,), ids (s,), z (s, 4): sightings as their pose,
    landmark, and bearing, range, sigma of bearing, sigma of range."""

    stamps: FloatArray
    clock: FloatArray
    X_OB: FloatArray
    node: IntArray
    ids: IntArray
    z: FloatArray


@dataclass(frozen=True)
class _Odometry(Motions):
    """Motions by odometry. increment: (m, 3) of `odometry_model.arc` over dt (m,), s."""

    increment: FloatArray
    dt: FloatArray

    def measured(self, calibration: FloatArray) -> tuple[FloatArray, FloatArray]:
        return predict_increments(self.increment, self.dt, calibration, np.zeros(3))[:2]


@dataclass(frozen=True)
class _BearingRange(Sightings):
    """Sightings by bearing, rad, and range, m. z: (s, 4) the two and their sigmas."""

    z: FloatArray
    huber: ClassVar[float] = HUBER_SIGMAS

    def error(self, p_BL: FloatArray) -> tuple[FloatArray, FloatArray]:
        bearing, distance, sigma_bearing, sigma_range = self.z.T
        x, y = p_BL.T
        r = np.maximum(np.hypot(x, y), LEAST_RANGE)
        turn = se2.wrap_angle(np.arctan2(y, x) - bearing)
        error = np.column_stack([turn / sigma_bearing, (r - distance) / sigma_range])
        on_bearing = np.column_stack([-y, x]) / (r**2 * sigma_bearing)[:, None]
        return error, np.stack([on_bearing, p_BL / (r * sigma_range)[:, None]], axis=1)


def smooth(
    odometry: tuple[Odometry, ...],
    detections: tuple[TagDetections, ...],
    config: OdometryConfig,
    on_progress: OnProgress = lambda _share: None,
) -> SmoothedRun:
    """Solve a whole run; messages in the order of their stamps, frames outside the span of the odometry left out.

    Raises ValueError without odometry.
    """
    if not odometry:
        raise ValueError("A run without odometry cannot be smoothed.")
    run = _run(odometry, detections)
    graph = _graph(run, config)
    start = np.full((graph.poses, 3), np.nan)
    start[0] = run.X_OB[0]
    x = graph.unknowns(start, np.full((graph.landmarks, 2), np.nan))
    x = graph.grown(x, lambda share: on_progress(0.7 * share))
    kept = np.ones(len(run.ids), dtype=bool)
    for rounds in range(1, MOST_ROUNDS + 1):
        x = _with_landmarks(graph, x, kept)
        x, error = replace(graph, sightings=graph.sightings.take(kept)).solved(x)
        near = _near(graph, x, kept)
        if rounds == MOST_ROUNDS or np.array_equal(near, kept):
            break
        kept = near
        on_progress(0.7 + 0.3 * rounds / MOST_ROUNDS)
    on_progress(1.0)
    X_MB, p_ML, calibration = graph.parts(x)
    seen = np.unique(graph.sightings.landmark[kept])
    return SmoothedRun(
        stamps=run.stamps,
        X_MB=np.column_stack([X_MB[:, :2], se2.wrap_angle(X_MB[:, 2])]),
        ids=np.unique(run.ids)[seen],
        p_ML=p_ML[seen],
        calibration=calibration,
        half_chi_square=error,
        used=int(np.sum(kept)),
        rejected=int(np.sum(~kept)),
    )


def _run(odometry: tuple[Odometry, ...], detections: tuple[TagDetections, ...]) -> _Run:
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
    return _Run(
        stamps=np.array(stamps),
        clock=np.array(clock),
        X_OB=np.array(X_OB),
        node=np.repeat(np.array(node, dtype=np.int64), counts),
        ids=np.concatenate([np.empty(0, dtype=np.int64), *(frame.ids for frame in frames)]),
        z=z,
    )


def _graph(run: _Run, config: OdometryConfig) -> PlanarGraph:
    """The first pose is held where odometry has it."""
    k = len(run.stamps)
    increment = np.array([arc(*pair) for pair in itertools.pairwise(run.X_OB)]).reshape(-1, 3)
    dt = np.diff(run.clock)
    X_ij, _, covariance = predict_increments(increment, dt, np.zeros(3), random_walks(config))
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    tags, landmark = np.unique(run.ids, return_inverse=True)
    bearing, distance = run.z[:, 0], run.z[:, 1]
    p_BL = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return PlanarGraph(
        poses=k,
        landmarks=len(tags),
        motions=_Odometry(np.arange(k - 1), np.arange(1, k), X_ij, whitener, increment, dt),
        sightings=_BearingRange(run.node, landmark, p_BL, run.z),
        held=np.zeros(1, dtype=np.int64),
        calibration_sigma=np.maximum(calibration_sigma(config), LEAST_SIGMA),
    )


def _with_landmarks(graph: PlanarGraph, x: FloatArray, kept: BoolArray) -> FloatArray:
    """The poses and calibration of x, and every landmark where most of its sightings put it."""
    seen = graph.sightings.take(kept)
    x = x.copy()
    X_MB, p_ML, _ = graph.parts(x)
    points = in_map(X_MB[seen.pose], seen.p_BL)
    for landmark in np.unique(seen.landmark):
        p_ML[landmark] = np.median(points[seen.landmark == landmark], axis=0)
    return x


def _near(graph: PlanarGraph, x: FloatArray, kept: BoolArray) -> BoolArray:
    """(s,) True where a sighting lies near the solution, and its landmark is in it."""
    seen = graph.sightings
    X_MB, p_ML, _ = graph.parts(x)
    error, _ = seen.error(in_body(X_MB[seen.pose], p_ML[seen.landmark])[0])
    known = np.isin(seen.landmark, seen.landmark[kept])
    return np.asarray(known & (np.linalg.norm(error, axis=1) <= OUTLIER_SIGMAS))

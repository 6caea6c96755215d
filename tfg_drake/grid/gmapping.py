"""GMapping: SLAM by a Rao-Blackwellised particle filter over occupancy grids, as pure functions on one state.

Grisetti, Stachniss and Burgard, "Improved techniques for grid mapping with Rao-Blackwellized particle filters", IEEE
Transactions on Robotics 23(1), 2007. Every particle has a pose and a grid. A scan moves each to a draw from a proposal
that knows the scan (`scan_matcher`), weights it by how well the scan was to be expected, and goes into its grid
(`occupancy`); particles are resampled only where the weights have become uneven.

Frames: M map (the start pose), O odometry, B the robot's body, U the body when the newest scan was put in.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit

from tfg_drake.config import GridConfig, OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.grid.occupancy import TileMaps, empty_maps, insert_scan, log_odds, probability, reach_of
from tfg_drake.grid.scan_matcher import end_points, propose
from tfg_drake.messages import FloatArray, GridMap, IntArray, LaserScan, Odometry, PoseEstimate, message, replace
from tfg_drake.slam.odometry_model import (
    BREAK,
    BREAK_RATE,
    DeadReckoning,
    arc,
    first_reckoning,
    predict_increment,
    random_walks,
    reckon,
    reckoned_at,
)
from tfg_drake.slam.shared import calibration_sigma

# Number of odometry messages kept for late scans; time over which odometry is extrapolated for early scans, s.
KEPT = 16
LONGEST_EXTRAPOLATION = 0.2
# Particles are resampled when the effective number is below this share of them (section III-C).
LEAST_EFFECTIVE = 0.5
# Least deviations of a pose, m and rad, so that the covariance of a robot at rest is regular.
POSE_FLOOR = np.array([1e-3, 1e-3, 5e-4])


@message
class GmappingState:
    """All that the filter knows, n particles; immutable, so that a copy of a state goes on as the state does.

    config: never changed. noise, sigma: (3,) of the odometry, see `random_walks` and `calibration_sigma`. seed,
    updates: of the random generator and of the scans put in; each draws from its own stream. odometry: newest message,
    None before the first. reckonings: the newest, in order. stamp: s, of the newest scan put in, -inf before the first.
    clock: s, X_OU: (3,) odometry then. motion_noise: (3, 3) random covariance of X_UB, of (x, y) in U and theta,
    motion_calibration: (3, 3) its Jacobian on the constants of the odometry's calibration. X_MU: (n, 3). log_weight:
    (n,), normalised. score: (n,) sum of all log weights of a particle's history. parents: (n,) each particle's row
    before the newest scan. waiting: the newest scan, if odometry has not come as far. maps: n grids.
    """

    config: GridConfig
    noise: FloatArray
    sigma: FloatArray
    seed: int
    X_MU: FloatArray
    log_weight: FloatArray
    score: FloatArray
    parents: IntArray
    maps: TileMaps
    updates: int = 0
    odometry: Odometry | None = None
    reckonings: tuple[DeadReckoning, ...] = ()
    stamp: float = -math.inf
    clock: float = -math.inf
    X_OU: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    motion_noise: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))
    motion_calibration: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))
    waiting: LaserScan | None = None


def initial_state(config: GridConfig, odometry: OdometryConfig, seed: int) -> GmappingState:
    """The filter before any message. odometry: what it believes of it. seed: at least 0."""
    n = config.particles
    return GmappingState(
        config=dataclasses.replace(config),
        noise=random_walks(odometry),
        sigma=np.maximum(calibration_sigma(odometry), 1e-6),
        seed=seed,
        X_MU=np.zeros((n, 3)),
        log_weight=np.full(n, -math.log(n)),
        score=np.zeros(n),
        parents=np.arange(n),
        maps=empty_maps(n, config.resolution),
    )


def process_odometry(state: GmappingState, odometry: Odometry) -> GmappingState:
    """The state after an odometry message; one that is not newer than the last, or not finite, changes nothing.

    A scan that has waited for it may go in.
    """
    if not (math.isfinite(odometry.stamp) and np.isfinite(odometry.X_OB).all() and np.isfinite(odometry.V_B).all()):
        return state
    if state.odometry is None:
        first = first_reckoning(odometry)
        return replace(state, odometry=odometry, reckonings=(first,), clock=first.clock, X_OU=first.X_OB)
    if odometry.stamp <= state.odometry.stamp:
        return state
    before, told = state.reckonings[-1], state.odometry
    newest = reckon(before, told, odometry)
    reckonings = (*state.reckonings[1 - KEPT :], newest)
    if before.stamp < state.stamp:
        # A scan was put in before the odometry round it was known: where the robot was then, is known better now.
        state = _since(replace(state, odometry=odometry, reckonings=reckonings), state.stamp)
    else:
        noise, jacobian = _accumulate(
            state.motion_noise,
            state.motion_calibration,
            se2.between(state.X_OU, before.X_OB),
            arc(before.X_OB, newest.X_OB),
            newest.clock - before.clock,
            state.noise,
        )
        if odometry.breaks != told.breaks:
            noise = noise + np.diag(np.square(BREAK + (odometry.stamp - told.stamp) * BREAK_RATE))
        state = replace(
            state, odometry=odometry, reckonings=reckonings, motion_noise=noise, motion_calibration=jacobian
        )
    if state.waiting is None or state.waiting.stamp > newest.stamp:
        return state
    return process_scan(replace(state, waiting=None), state.waiting)


def process_scan(state: GmappingState, scan: LaserScan, force: bool = False) -> GmappingState:
    """The state after a scan, which is put in if the robot has moved enough since the last one that was, or if forced.

    Enough is GridConfig's update_period, of motion (a robot at rest learns nothing from looking again), update_distance
    or update_angle. A scan newer than the newest odometry waits for the next, as the robot may brake or turn meanwhile;
    if forced, it goes in at once, the motion taken to go on. A scan that is not newer than the last one put in, says
    nothing at all, or that no odometry of its time is known for, changes nothing.
    """
    if not scan.stamp > state.stamp or not state.reckonings or reach_of(scan) == 0.0:
        return state
    if not state.reckonings[0].stamp <= scan.stamp <= state.reckonings[-1].stamp + LONGEST_EXTRAPOLATION:
        return state
    if scan.stamp > state.reckonings[-1].stamp and not force:
        return replace(state, waiting=scan)
    here = _reckoning_at(state.reckonings, scan.stamp)
    X_UB = se2.between(state.X_OU, here.X_OB)
    config = state.config
    enough = (
        here.clock - state.clock >= config.update_period
        or math.hypot(X_UB[0], X_UB[1]) >= config.update_distance
        or abs(X_UB[2]) >= config.update_angle
    )
    if not (enough or force or state.updates == 0):
        return state
    return _since(_put_in(state, scan, X_UB), scan.stamp)


def pose_estimate(state: GmappingState, stage: int) -> PoseEstimate:
    """Where the best particle is, carried on by odometry since the newest scan that was put in.

    Its covariance is that of the weighted particles, their headings taken as angles, and of the odometry since.
    stage: number of views, for the message.
    """
    X_OB = state.reckonings[-1].X_OB if state.reckonings else np.zeros(3)
    X_UB = se2.between(state.X_OU, X_OB)
    X_MB = se2.compose(state.X_MU, X_UB)
    weight = np.exp(state.log_weight)
    heading = math.atan2(weight @ np.sin(X_MB[:, 2]), weight @ np.cos(X_MB[:, 2]))
    mean = np.append(weight @ X_MB[:, :2], heading)
    d = np.column_stack([X_MB[:, :2] - mean[:2], se2.wrap_angle(X_MB[:, 2] - heading)])
    best = best_particle(state)
    motion = _motion_covariance(state, state.X_MU[best : best + 1])[0]
    return PoseEstimate(
        stamp=state.odometry.stamp if state.odometry else 0.0,  # the mission begins at M's origin
        X_MB=X_MB[best],
        covariance=(weight[:, None] * d).T @ d + motion,
        speed=state.odometry.V_B if state.odometry else np.zeros(2),
        stage=stage,
        new_ids=np.zeros(0, dtype=np.int64),
        p_MU=np.zeros((0, 2)),
    )


def grid_map(state: GmappingState, stage: int) -> GridMap:
    """The best particle's grid. stage: number of views, for the message."""
    origin, steps = log_odds(state.maps, best_particle(state))
    return GridMap(stage, state.stamp, state.maps.resolution, origin, probability(steps))


def best_particle(state: GmappingState) -> int:
    """The particle whose whole history explains the scans best."""
    return int(np.argmax(state.score))


def effective_number(log_weight: FloatArray) -> float:
    """How many particles of equal weight would be worth as much as these, of log weights (n,) (eq. 20)."""
    weight = np.exp(log_weight - log_weight.max())
    return float(weight.sum() ** 2 / (weight**2).sum())


def resample(log_weight: FloatArray, share: float) -> IntArray:
    """Rows (n,), ascending, drawn in proportion to the weights with one random number, share in [0, 1).

    Systematic: a row of normalised weight w comes floor(n w) or ceil(n w) times.
    """
    weight = np.exp(log_weight - log_weight.max())
    total = np.cumsum(weight)
    n = len(weight)
    rows = np.searchsorted(total, (np.arange(n) + share) / n * total[-1], side="right")
    # Rounding may lead past the last row that weighs anything.
    return np.asarray(np.minimum(rows, np.flatnonzero(weight)[-1]))


def _put_in(state: GmappingState, scan: LaserScan, X_UB: FloatArray) -> GmappingState:
    """Algorithm 1 of Grisetti et al., from one scan to the next."""
    n = len(state.X_MU)
    rng = np.random.default_rng((state.seed, state.updates))
    standard_normal, share = rng.standard_normal((n, 3)), float(rng.random())
    X_MB = se2.compose(state.X_MU, X_UB)
    p_BP = end_points(scan, state.config.resolution)
    drawn, gain = propose(state.maps, X_MB, _motion_covariance(state, state.X_MU), p_BP, standard_normal)
    log_weight = state.log_weight + gain
    log_weight = log_weight - log_weight.max()
    log_weight -= math.log(np.exp(log_weight).sum())
    parents = np.arange(n)
    if effective_number(log_weight) < LEAST_EFFECTIVE * n:
        parents = resample(log_weight, share)
        log_weight = np.full(n, -math.log(n))
    return replace(
        state,
        updates=state.updates + 1,
        X_MU=drawn[parents],
        log_weight=log_weight,
        score=(state.score + gain)[parents],
        parents=parents,
        maps=insert_scan(state.maps, parents, drawn, scan),
    )


def _since(state: GmappingState, stamp: float) -> GmappingState:
    """The state whose newest scan is of this stamp: the motion since begins there."""
    here, newest = _reckoning_at(state.reckonings, stamp), state.reckonings[-1]
    noise, jacobian = np.zeros((3, 3)), np.zeros((3, 3))
    if newest.stamp > stamp:
        noise, jacobian = _accumulate(
            noise, jacobian, np.zeros(3), arc(here.X_OB, newest.X_OB), newest.clock - here.clock, state.noise
        )
    return replace(
        state,
        stamp=stamp,
        clock=here.clock,
        X_OU=here.X_OB,
        motion_noise=noise,
        motion_calibration=jacobian,
    )


def _reckoning_at(reckonings: tuple[DeadReckoning, ...], stamp: float) -> DeadReckoning:
    """Odometry at a stamp not before the first; past the last the motion is taken to go on."""
    if len(reckonings) == 1:
        only = reckonings[0]
        return DeadReckoning(stamp, only.clock, only.X_OB, only.V_B)
    after = next((i for i in range(1, len(reckonings)) if stamp <= reckonings[i].stamp), len(reckonings) - 1)
    return reckoned_at(reckonings[after - 1], reckonings[after], stamp)


def _motion_covariance(state: GmappingState, X_MU: FloatArray) -> FloatArray:
    """(n, 3, 3) of the motion since the newest scan for particles at X_MU (n, 3), of (x, y) in M and theta.

    The calibration's constants are drawn afresh with every scan: what earlier scans told of them is in the poses.
    """
    calibration = state.motion_calibration * state.sigma
    covariance = state.motion_noise + calibration @ calibration.T + np.diag(POSE_FLOOR**2)
    R = np.zeros((len(X_MU), 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(X_MU[:, 2])
    R[:, 1, 0] = np.sin(X_MU[:, 2])
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return np.asarray(R @ covariance @ np.swapaxes(R, 1, 2))


@read_only_arguments
@njit(cache=True)
def _accumulate(
    noise: FloatArray, jacobian: FloatArray, X_UB: FloatArray, increment: FloatArray, dt: float, model: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance and Jacobian on the calibration of X_UB, an increment (3,) and dt (s) later."""
    X, step_jacobian, step_noise = predict_increment(increment, dt, np.zeros(3), model)
    c, s = math.cos(X_UB[2]), math.sin(X_UB[2])
    on_pose, on_step = np.eye(3), np.eye(3)
    on_pose[0, 2], on_pose[1, 2] = -s * X[0] - c * X[1], c * X[0] - s * X[1]
    on_step[0, 0], on_step[0, 1], on_step[1, 0], on_step[1, 1] = c, -s, s, c
    noise = on_pose @ noise @ on_pose.T + on_step @ step_noise @ on_step.T
    return noise, on_pose @ jacobian + on_step @ step_jacobian

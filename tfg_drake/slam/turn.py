"""One turn in place, or a piece of the way: its poses and tags, solved and reduced to what the map needs.

The tags of a turn are tied together by the turn's uncertain headings, so they enter the map as one joint factor on
its poses and tags, the turn's other poses eliminated (the paper's sec. III, "measurements at a goal are combined").
Damped Gauss-Newton steps on the poses in A, a chain, and on what all of them touch, calibration and tags, its border:
the chain is eliminated pose by pose, what is left is dense and small.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import lapack

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Observation, TagDetections, message, replace
from tfg_drake.slam.camera_model import CameraModel, exact_camera
from tfg_drake.slam.noise_correlation import (
    LONG_RUN,
    NoiseCorrelation,
    compared,
    no_correlation,
)
from tfg_drake.slam.odometry_model import OdometryModel, arc, predict_increment, wrap

# A detection this far off, in sigmas of its two whitened components together, is an outlier.
OUTLIER_SIGMAS = 5.5
# Huber threshold, in sigmas, of the pass that looks for outliers.
HUBER_SIGMAS = 1.5
# Random walks, as OdometryModel.noise, of a robot whose wheels slip or which somebody pushes meanwhile.
SLIPPING = np.array([0.2, 0.1, 0.2])
# It did if that explains at least so many sightings that are outliers else, and leaves at most this share of them.
SLIP_EXPLAINS = 3
SLIP_LEAVES = 1 / 3
# Instants closer than this are one, s.
SAME_INSTANT = 1e-6
# Steps at most; one shorter than this (m, rad) is the last: what it leaves is a hundredth of it or less.
MOST_STEPS = 50
LAST_STEP = 1e-8
# Where a step raises the cost by more than this, of it and of one, half of it is tried.
ROUNDING = 1e-9
# Least pivot of a factorisation: rounding may leave none.
LEAST_PIVOT = 1e-30

# Where the border's entries begin: the odometry's calibration (3), the camera's (2), the tags.
CAMERA, TAGS = 3, 5

# Clock (t,) and odometry (t, 3) of the poses; pose, id and measurement (m, 7) of each of the sightings (m,).
_Problem = tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]


class _Solution(NamedTuple):
    """ids (n,) and positions (n, 2) of the tags, how often each was seen, poses (t, 3), calibration (5,) of odometry
    and camera, covariance (2n + 8, 2n + 8) of calibration, tags and last pose, and the squared error of each sighting,
    in sigmas."""

    ids: IntArray
    p_AL: FloatArray
    sightings: IntArray
    X_AB: FloatArray
    calibration: FloatArray
    covariance: FloatArray
    squared: FloatArray


@message
class TurnFrame:
    """What was seen at one instant of a turn. stamp: s. clock (s), X_OB: (3,): dead reckoning then. detections: the
    frame's tags. twist: (2,) forward speed (m/s) and turn rate (rad/s) then. offset: s, the camera's clock was taken to
    be so much ahead: the frame's own stamp is later by that."""

    stamp: float
    clock: float
    X_OB: FloatArray
    detections: TagDetections
    twist: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    offset: float = 0.0


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
    left out as outliers. calibration: (3,) of the odometry, calibration_covariance: (3, 3), see OdometryModel. camera,
    correlation: what is known of the camera and of the noise now."""

    observation: Observation
    sightings: IntArray
    dropped: int
    calibration: FloatArray
    calibration_covariance: FloatArray
    camera: CameraModel
    correlation: NoiseCorrelation


def solve_turn(
    model: OdometryModel,
    begin: TurnFrame,
    frames: tuple[TurnFrame, ...],
    end: TurnFrame,
    camera: CameraModel | None = None,
    correlation: NoiseCorrelation | None = None,
) -> TurnSolution:
    """The tags seen during a turn and the departure pose D (at end), in the arrival frame A (at begin).

    frames: in the order of their stamps, within [begin, end]; begin and end carry no detections. Without any detection
    n is 0 and X_AD comes from odometry alone. The heading of all poses is the camera's; camera: what is known of it
    before, none: that it looks ahead and its clock is right. correlation: what earlier turns say of the noise's from
    frame to frame; the turn counts its frames by that and by what it says itself. Where the sightings agree with each
    other but not with the odometry, the wheels have slipped: then the sightings are believed.
    """
    stamps, clock, X_OB, node = _nodes(begin, frames, end)
    seen = [frame.detections for frame in (*frames, end)]
    counts = [len(detections.ids) for detections in seen]
    z = np.empty((sum(counts), 7))
    z[:, 0] = np.concatenate([detections.bearing for detections in seen])
    z[:, 1] = np.concatenate([detections.range for detections in seen])
    z[:, 2] = np.concatenate([detections.sigma_bearing for detections in seen])
    z[:, 3] = np.concatenate([detections.sigma_range for detections in seen])
    z[:, 4:6] = np.repeat([frame.twist for frame in (*frames, end)], counts, axis=0)
    z[:, 6] = np.repeat([frame.offset for frame in (*frames, end)], counts)
    ids = np.concatenate([detections.ids for detections in seen])

    camera = camera or exact_camera()
    known = model, camera
    problem = clock, X_OB, np.repeat(node, counts), ids, z
    X_AB = se2.between(X_OB[0], X_OB)
    kept = np.ones(len(ids), dtype=bool)
    solution = _solved(known, problem, X_AB, kept)
    if np.any(_outliers(solution)):
        solution, kept = _without_outliers(known, problem, X_AB)
        unexplained = int(np.sum(~kept))
        if unexplained >= SLIP_EXPLAINS:
            # A push moves a robot at rest, too: by the time that passed, not by that of its motion.
            slipping = replace(model, noise=np.maximum(model.noise, SLIPPING)), camera
            other, other_kept = _without_outliers(slipping, (stamps, *problem[1:]), X_AB)
            left = int(np.sum(~other_kept))
            if left <= min(unexplained - SLIP_EXPLAINS, SLIP_LEAVES * unexplained):
                solution, kept = other, other_kept
                known, problem = slipping, (stamps, *problem[1:])
    correlation = _compared(correlation or no_correlation(), solution, problem, kept)
    if correlation.frame_worth < 1.0:
        solution = _solved(known, _less_certain(problem, kept, correlation), solution.X_AB, kept)

    # All the turn tells given the yaw, which it shares with all others; what it tells of the yaw goes beside it.
    of_yaw = solution.covariance[TAGS:, CAMERA] / solution.covariance[CAMERA, CAMERA]
    given_yaw = solution.covariance[TAGS:, TAGS:] - np.outer(of_yaw, solution.covariance[TAGS:, CAMERA])
    observation = Observation(
        ids=solution.ids,
        p_AL=solution.p_AL,
        X_AD=solution.X_AB[-1],
        covariance=given_yaw,
        stamps=stamps,
        X_AB=solution.X_AB,
        yaw=float(solution.calibration[CAMERA]),
        on_yaw=of_yaw,
        on_error=_on_error(solution, problem, kept),
    )
    return TurnSolution(
        observation=observation,
        sightings=solution.sightings,
        dropped=int(np.sum(~kept)),
        calibration=solution.calibration[:CAMERA],
        calibration_covariance=solution.covariance[:CAMERA, :CAMERA],
        camera=CameraModel(solution.calibration[CAMERA:], solution.covariance[CAMERA:TAGS, CAMERA:TAGS]),
        correlation=correlation,
    )


def _on_error(solution: _Solution, problem: _Problem, kept: BoolArray) -> FloatArray:
    """(n, 2, 2) derivative of each tag's place in A on its constant errors of range and bearing: along the line of
    sight and across it, in the mean of the frames that saw it."""
    tag, X = np.searchsorted(solution.ids, problem[3][kept]), solution.X_AB[problem[2][kept]]
    d = solution.p_AL[tag] - X[:, :2]
    ahead = d / np.maximum(np.hypot(*d.T), 1e-6)[:, None]
    columns = np.stack([-ahead[:, 0], d[:, 1], -ahead[:, 1], -d[:, 0]])
    each = np.stack([np.bincount(tag, column, len(solution.ids)) for column in columns], axis=1)
    return np.asarray(each.reshape(-1, 2, 2) / np.maximum(solution.sightings, 1)[:, None, None])


def _compared(
    correlation: NoiseCorrelation, solution: _Solution, problem: _Problem, kept: BoolArray
) -> NoiseCorrelation:
    """The noise's correlation after the sightings kept (m,) of a solution."""
    if np.max(solution.sightings, initial=0) < LONG_RUN:
        return correlation
    _, _, node, ids, z = problem
    tag, node, z = np.searchsorted(solution.ids, ids[kept]), node[kept], z[kept]
    X, earlier = solution.X_AB[node], solution.calibration[CAMERA + 1] - z[:, 6]
    way = earlier * z[:, 4]
    d = solution.p_AL[tag] - X[:, :2] + way[:, None] * np.stack([np.cos(X[:, 2]), np.sin(X[:, 2])], axis=1)
    bearing = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - X[:, 2] + earlier * z[:, 5] - z[:, 0])
    errors = np.stack([bearing / z[:, 2], (np.hypot(d[:, 0], d[:, 1]) - z[:, 1]) / z[:, 3]], axis=1)
    return compared(correlation, errors, tag, node)


def _less_certain(problem: _Problem, kept: BoolArray, correlation: NoiseCorrelation) -> _Problem:
    """The problem with the standard deviations that make those frames in a row that are kept (m,) count as much as they
    tell."""
    clock, X_OB, node, ids, z = problem
    z = z.copy()
    z[kept, 2:4] *= correlation.worth(ids[kept], node[kept])[:, None] ** -0.5
    return clock, X_OB, node, ids, z


def _without_outliers(
    known: tuple[OdometryModel, CameraModel], problem: _Problem, X_AB: FloatArray
) -> tuple[_Solution, BoolArray]:
    """The solution without the sightings that lie too far from a robust one, and which of them it keeps."""
    robust = _solved(known, problem, X_AB, np.ones(len(problem[3]), dtype=bool), HUBER_SIGMAS)
    kept = ~_outliers(robust)
    return _solved(known, problem, robust.X_AB, kept), kept


def _outliers(solution: _Solution) -> BoolArray:
    """(m,) True where a detection lies too far from the solution."""
    return solution.squared > OUTLIER_SIGMAS**2


def _solved(
    known: tuple[OdometryModel, CameraModel],
    problem: _Problem,
    X_AB: FloatArray,
    kept: BoolArray,
    huber: float = math.inf,
) -> _Solution:
    """The solution by the sightings kept (m,), from poses X_AB (t, 3) on. huber: the threshold of a robust one, in
    sigmas."""
    (model, camera), (clock, X_OB, node, ids, z) = known, problem
    node, z, X_AB = node[kept], z[kept], X_AB.copy()
    ids, tag, sightings = np.unique(ids[kept], return_inverse=True, return_counts=True)
    border = np.empty(TAGS + 2 * len(ids))
    border[:CAMERA], border[CAMERA:TAGS] = model.calibration, camera.mean
    information = np.zeros((TAGS, TAGS))
    information[:CAMERA, :CAMERA] = np.linalg.inv(model.calibration_covariance)
    information[CAMERA:, CAMERA:] = np.linalg.inv(camera.covariance)
    angle = X_AB[node, 2] + z[:, 0]
    for i, direction in enumerate((np.cos(angle), np.sin(angle))):
        border[TAGS + i :: 2] = np.bincount(tag, X_AB[node, i] + z[:, 1] * direction, len(ids)) / sightings
    last, rest, squared = _optimise(
        X_AB,
        np.diff(clock),
        X_OB,
        model.noise,
        border[:TAGS].copy(),
        information,
        node,
        tag,
        z,
        border,
        huber,
    )
    X_AB[:, 2] = se2.wrap_angle(X_AB[:, 2])
    # The factor of (last pose, border): of the inverse, too, the upper triangle counts.
    factor = np.zeros((3 + len(rest), 3 + len(rest)))
    factor[:3, :3], factor[:3, 3:], factor[3:, 3:] = last[:, :3], last[:, 6:-1], rest[:, :-1]
    upper = np.triu(lapack.dpotri(factor)[0])
    covariance = np.roll(upper + np.triu(upper, 1).T, (-3, -3), (0, 1))
    return _Solution(ids, border[TAGS:].reshape(-1, 2), sightings, X_AB, border[:TAGS], covariance, squared)


def _nodes(
    begin: TurnFrame, frames: tuple[TurnFrame, ...], end: TurnFrame
) -> tuple[FloatArray, FloatArray, FloatArray, list[int]]:
    """Stamps and clock (t,) and odometry (t, 3) of the poses, and the pose of each frame and of the end; coinciding
    stamps share one."""
    stamps, clock, X_OB, node = [begin.stamp], [begin.clock], [begin.X_OB], []
    for frame in (*frames, end):
        if frame.stamp - stamps[-1] > SAME_INSTANT:
            stamps.append(frame.stamp)
            clock.append(frame.clock)
            X_OB.append(frame.X_OB)
        node.append(len(stamps) - 1)
    if len(stamps) == 1:
        stamps.append(begin.stamp + SAME_INSTANT)
        clock.append(begin.clock + SAME_INSTANT)
        X_OB.append(end.X_OB)
    return np.array(stamps), np.array(clock), np.array(X_OB), node


@njit(cache=True)
def _optimise(
    X: FloatArray,
    dt: FloatArray,
    X_OB: FloatArray,
    noise: FloatArray,
    calibration: FloatArray,
    information: FloatArray,
    node: IntArray,
    tag: IntArray,
    z: FloatArray,
    border: FloatArray,
    huber: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bring the poses X (t, 3), the first of which is fixed, and the border (TAGS + 2n,), calibration and tags, to the
    least squares, in place.

    dt: (t - 1,) s between the poses. calibration, information: (TAGS,), (TAGS, TAGS) of the prior. node, tag: (m,) pose
    and tag of each sighting, z: (m, 7) its bearing, range, their sigmas, twist and offset. Other arguments as in
    OdometryModel and TurnFrame. Returns the factored rows of the last pose and of the border, see `_eliminate`, and the
    squared errors (m,) of the sightings, in sigmas.
    """
    poses, size = len(X), len(border)
    increments, covariance = np.empty((poses - 1, 3)), np.empty((poses - 1, 3, 3))
    for i in range(poses - 1):
        increment = arc(X_OB[i], X_OB[i + 1])
        _, _, random = predict_increment(increment, dt[i], np.zeros(3), noise)
        for a in range(3):
            increments[i, a] = increment[a]
            for b in range(3):
                covariance[i, a, b] = random[a, b]
    # The normal equations, of which the upper triangle counts: each pose has three rows of `chain`, with columns for
    # itself, the next pose, the border and the gradient; `rest` are the border's rows.
    chain, rest, squared = np.empty((poses, 3, 7 + size)), np.empty((size, size + 1)), np.empty(len(node))
    step_X, step = np.zeros((poses, 3)), np.zeros(size)
    cost, share = math.inf, 1.0
    for attempt in range(MOST_STEPS):
        chain.fill(0.0)
        rest.fill(0.0)
        new_cost = _add_prior(border, calibration, information, rest)
        new_cost += _add_odometry(X, border, increments, dt, noise, covariance, chain, rest)
        new_cost += _add_sightings(X, border, node, tag, z, huber, chain, rest, squared)
        if 0 < attempt < MOST_STEPS - 1 and not new_cost <= cost + ROUNDING * (1.0 + cost):
            share *= 0.5
            _move(X, border, step_X, step, -share)
            continue
        cost, share = new_cost, 1.0
        _eliminate(chain, rest)
        longest = _back_substitute(chain, rest, step_X, step)
        _move(X, border, step_X, step, share)
        if longest < LAST_STEP:
            break
    return chain[-1], rest, squared


@njit(cache=True)
def _move(X: FloatArray, border: FloatArray, step_X: FloatArray, step: FloatArray, share: float) -> None:
    for i in range(len(X)):
        for a in range(3):
            X[i, a] += share * step_X[i, a]
    for a in range(len(border)):
        border[a] += share * step[a]


@njit(cache=True)
def _add_prior(border: FloatArray, calibration: FloatArray, information: FloatArray, rest: FloatArray) -> float:
    """Add the normal equations of what was known of the calibration before; returns the cost."""
    cost = 0.0
    for a in range(TAGS):
        for b in range(TAGS):
            force = information[a, b] * (border[b] - calibration[b])
            rest[a, b] += information[a, b]
            rest[a, -1] += force
            cost += 0.5 * force * (border[a] - calibration[a])
    return cost


@njit(cache=True)
def _add_odometry(
    X: FloatArray,
    border: FloatArray,
    increments: FloatArray,
    dt: FloatArray,
    noise: FloatArray,
    covariance: FloatArray,
    chain: FloatArray,
    rest: FloatArray,
) -> float:
    """Add the normal equations of the odometry between poses (t, 3); returns the cost.

    increments: (t - 1, 3) of `arc`, dt: (t - 1,) s, covariance: (t - 1, 3, 3).
    """
    cost = 0.0
    # The covariance, to whiten by, beside the Jacobians on both poses, calibration and yaw, and the error.
    rows, last = np.empty((3, 14)), 13
    c_yaw, s_yaw = math.cos(border[CAMERA]), math.sin(border[CAMERA])
    for i in range(len(X) - 1):
        ahead, on_calibration, _ = predict_increment(increments[i], dt[i], border[:3], noise)
        # The body drives where the camera's yaw says, seen from the camera.
        to_x, to_y = c_yaw * ahead[0] + s_yaw * ahead[1], -s_yaw * ahead[0] + c_yaw * ahead[1]
        c, s = math.cos(X[i, 2]), math.sin(X[i, 2])
        dx, dy = X[i + 1, 0] - X[i, 0], X[i + 1, 1] - X[i, 1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        rows.fill(0.0)
        rows[0, 3], rows[0, 4], rows[0, 5], rows[0, 6], rows[0, 7] = -c, -s, y, c, s
        rows[1, 3], rows[1, 4], rows[1, 5], rows[1, 6], rows[1, 7] = s, -c, -x, -s, c
        rows[2, 5], rows[2, 8] = -1.0, 1.0
        for a in range(3):
            for b in range(3):
                rows[a, b] = covariance[i, a, b]
        for b in range(3):
            u, v = on_calibration[0, b], on_calibration[1, b]
            rows[0, 9 + b], rows[1, 9 + b] = -c_yaw * u - s_yaw * v, s_yaw * u - c_yaw * v
            rows[2, 9 + b] = -on_calibration[2, b]
        rows[0, 12], rows[1, 12] = -to_y, to_x
        rows[0, last], rows[1, last] = x - to_x, y - to_y
        rows[2, last] = wrap(X[i + 1, 2] - X[i, 2] - ahead[2])
        _factor(rows)
        for a in range(3):
            for b in range(10):
                chain[i, a, b] += _dot(rows, 3 + a, 3 + b)
            for b in range(3):
                chain[i + 1, a, b] += _dot(rows, 6 + a, 6 + b)
            for b in range(4):
                chain[i + 1, a, 6 + b] += _dot(rows, 6 + a, 9 + b)
            chain[i, a, -1] += _dot(rows, 3 + a, last)
            chain[i + 1, a, -1] += _dot(rows, 6 + a, last)
        for a in range(4):
            for b in range(4):
                rest[a, b] += _dot(rows, 9 + a, 9 + b)
            rest[a, -1] += _dot(rows, 9 + a, last)
        cost += 0.5 * _dot(rows, last, last)
    return cost


@njit(cache=True)
def _add_sightings(
    X: FloatArray,
    border: FloatArray,
    node: IntArray,
    tag: IntArray,
    z: FloatArray,
    huber: float,
    chain: FloatArray,
    rest: FloatArray,
    squared: FloatArray,
) -> float:
    """Add the normal equations of the sightings and set their squared errors (m,), in sigmas; returns the cost."""
    cost = 0.0
    # Jacobians on pose, clock and tag, and the error, of bearing and range.
    rows = np.zeros((2, 7))
    for j in range(len(node)):
        i, k = node[j], TAGS + 2 * tag[j]
        # Where the robot was when the frame was taken, if the clock is otherwise than it was taken to be.
        earlier, speed, rate = border[CAMERA + 1] - z[j, 6], z[j, 4], z[j, 5]
        v_x, v_y = speed * math.cos(X[i, 2]), speed * math.sin(X[i, 2])
        dx, dy = border[k] - X[i, 0] + earlier * v_x, border[k + 1] - X[i, 1] + earlier * v_y
        r2 = max(dx * dx + dy * dy, 1e-12)
        r = math.sqrt(r2)
        bearing = wrap(math.atan2(dy, dx) - X[i, 2] + earlier * rate - z[j, 0]) / z[j, 2]
        distance = (r - z[j, 1]) / z[j, 3]
        squared[j] = bearing * bearing + distance * distance
        sigmas, weight = math.sqrt(squared[j]), 1.0
        if sigmas > huber:
            # Farther off than the threshold it pulls with a constant force.
            weight = math.sqrt(huber / sigmas)
            cost += huber * (sigmas - 0.5 * huber)
        else:
            cost += 0.5 * squared[j]
        u, v = weight / (z[j, 2] * r2), weight / (z[j, 3] * r)
        rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 4], rows[0, 5] = u * dy, -u * dx, -u * r2, -u * dy, u * dx
        rows[1, 0], rows[1, 1], rows[1, 4], rows[1, 5] = -v * dx, -v * dy, v * dx, v * dy
        # The heading turns the velocity, too.
        rows[0, 2] += earlier * u * (dy * v_y + dx * v_x)
        rows[1, 2] = earlier * v * (dy * v_x - dx * v_y)
        rows[0, 3], rows[1, 3] = u * (r2 * rate - dy * v_x + dx * v_y), v * (dx * v_x + dy * v_y)
        rows[0, 6], rows[1, 6] = weight * bearing, weight * distance
        for a in range(3):
            for b in range(3):
                chain[i, a, b] += _dot(rows, a, b)
            chain[i, a, 6 + CAMERA + 1] += _dot(rows, a, 3)
            for b in range(2):
                chain[i, a, 6 + k + b] += _dot(rows, a, 4 + b)
            chain[i, a, -1] += _dot(rows, a, 6)
        clock = rest[CAMERA + 1]
        clock[CAMERA + 1] += _dot(rows, 3, 3)
        clock[-1] += _dot(rows, 3, 6)
        for a in range(2):
            clock[k + a] += _dot(rows, 3, 4 + a)
            for b in range(2):
                rest[k + a, k + b] += _dot(rows, 4 + a, 4 + b)
            rest[k + a, -1] += _dot(rows, 4 + a, 6)
    return cost


@njit(cache=True)
def _eliminate(chain: FloatArray, rest: FloatArray) -> None:
    """Factor the normal equations in place: the poses after the first, which is fixed, one by one, then the border."""
    for i in range(1, len(chain)):
        rows = chain[i]
        _factor(rows)
        for a in range(3 if i + 1 < len(chain) else 0):
            _subtract(chain[i + 1, a], 0, rows, 3 + a, 3, 6)
            _subtract(chain[i + 1, a], 6, rows, 3 + a, 6, rows.shape[1])
        for a in range(len(rest)):
            _subtract(rest[a], a, rows, 6 + a, 6 + a, rows.shape[1])
    _factor(rest)


@njit(cache=True)
def _factor(rows: FloatArray) -> None:
    """Turn (S, B) with a positive definite S = U^T U into (U, U^-T B), in place; of S the upper triangle counts."""
    for j in range(len(rows)):
        pivot = math.sqrt(max(rows[j, j], LEAST_PIVOT))
        for q in range(j, rows.shape[1]):
            rows[j, q] /= pivot
        for a in range(j + 1, len(rows)):
            factor = rows[j, a]
            if factor != 0.0:
                for q in range(a, rows.shape[1]):
                    rows[a, q] -= factor * rows[j, q]


@njit(cache=True)
def _subtract(target: FloatArray, at: int, rows: FloatArray, column: int, begin: int, end: int) -> None:
    """Take three rows' columns [begin, end), each times its row's entry in another, off the target from `at` on."""
    u, v, w = rows[0, column], rows[1, column], rows[2, column]
    if u != 0.0 or v != 0.0 or w != 0.0:
        for q in range(end - begin):
            target[at + q] -= u * rows[0, begin + q] + v * rows[1, begin + q] + w * rows[2, begin + q]


@njit(cache=True)
def _dot(rows: FloatArray, a: int, b: int) -> float:
    """Two columns' product."""
    value = 0.0
    for k in range(len(rows)):
        value += rows[k, a] * rows[k, b]
    return value


@njit(cache=True)
def _back_substitute(chain: FloatArray, rest: FloatArray, step_X: FloatArray, step: FloatArray) -> float:
    """Set the Gauss-Newton step of poses (t, 3) and border from the factors; returns the largest entry's size."""
    longest = 0.0
    for a in range(len(step) - 1, -1, -1):
        value = -rest[a, -1]
        for b in range(a + 1, len(step)):
            value -= rest[a, b] * step[b]
        step[a] = value / rest[a, a]
        longest = max(longest, abs(step[a]))
    for i in range(len(chain) - 1, 0, -1):
        rows = chain[i]
        for a in range(2, -1, -1):
            value = -rows[a, -1]
            for b in range(len(step)):
                value -= rows[a, 6 + b] * step[b]
            for b in range(a + 1, 3):
                value -= rows[a, b] * step_X[i, b]
            if i + 1 < len(chain):
                for b in range(3):
                    value -= rows[a, 3 + b] * step_X[i + 1, b]
            step_X[i, a] = value / rows[a, a]
            longest = max(longest, abs(step_X[i, a]))
    return longest

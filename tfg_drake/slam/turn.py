"""The frame smoother: solves the frames of a turn or piece of the way and reduces them to one Gaussian, a keyframe.

It makes damped Gauss-Newton steps on the poses in A, a chain, and on the variables that all poses share, parameters and
landmarks, the border. The chain is eliminated pose by pose, as the paper's Sec. III-C marginalises poses out; the rest
is dense and small. If scans saw walls, lengths are metres; otherwise they are in the unit of the tags' ranges, or of
odometry, so that only the ratio of the odometry's scale to theirs is a parameter here.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, TagDetections, message, replace
from tfg_drake.slam.keyframe import Keyframe, keyframe, moved_points
from tfg_drake.slam.measurement import (
    CAMERA,
    COLUMNS,
    ERROR,
    OF_SENSOR,
    OF_TWIST,
    SCANNER,
    linearise_tag,
    linearise_wall,
)
from tfg_drake.slam.noise import Noise
from tfg_drake.slam.odometry_model import arc, predict_increment, wrap
from tfg_drake.slam.scan_lines import on_uneven
from tfg_drake.slam.shared import (
    DISTANCE_SCALE,
    GYRO_BIAS,
    GYRO_SCALE,
    METRES,
    RANGE_SCALE,
    SHARED,
    Shared,
    scale_of,
)
from tfg_drake.slam.surfaces import Ties, put_together
from tfg_drake.slam.walls import Looks, Names, grouped, no_lines, seen_walls, with_floor
from tfg_drake.table import concat, empty

# A sighting is an outlier if the norm of its two whitened residuals exceeds this.
OUTLIER_SIGMAS = 5.5
# Huber threshold, in sigmas, of the pass that looks for outliers.
HUBER_SIGMAS = 1.5
# Random walks, as `random_walks`, of a robot whose wheels slip or that is pushed.
SLIPPING = np.array([0.2, 0.1, 0.2])
# The robot has slipped if these random walks explain at least SLIP_EXPLAINS of the outliers and leave at most the share
# SLIP_LEAVES of them.
SLIP_EXPLAINS = 3
SLIP_LEAVES = 1 / 3
# Instants closer than this are one, s.
SAME_INSTANT = 1e-6
# The robot's twist at a frame is averaged over this time to either side, s.
TWIST_SPAN = 0.12
# Prior information on the scale that defines the chain's unit of length, whose error in that unit is zero.
HELD = 1e12
# Where the parameters and the tags begin in the dense rest, after D. The parameters are the shared ones, with the
# scales of distance and range divided by that of the chain's unit.
CALIBRATION, TAGS = 3, 3 + SHARED
SCALES = np.array([DISTANCE_SCALE, RANGE_SCALE])
# Greatest number of steps. A step below LAST_STEP (m, rad) is the last, as the next would be at most a hundredth of it.
MOST_STEPS = 50
LAST_STEP = 1e-8
# A step is halved if it raises the cost by more than this, relative to the cost and absolutely.
ROUNDING = 1e-9
# Least pivot of a factorisation, against rounding.
LEAST_PIVOT = 1e-30


# Increments and covariances of odometry; or normal equations: three rows a pose of the chain, with columns for itself,
# the next pose, the border and the gradient, of which the upper triangle counts; and the rest, D and the border.
Pair = tuple[FloatArray, FloatArray]


class _Problem(NamedTuple):
    """Noise and parameters as currently estimated, clock (t,) and odometry (t, 3) of the poses; pose, id and
    measurement (m, 8) of each of the sightings (m,)."""

    noise: Noise
    shared: Shared
    clock: FloatArray
    X_OB: FloatArray
    node: IntArray
    ids: IntArray
    z: FloatArray
    looks: Looks


class _Ties(NamedTuple):
    """Ties between t poses, m sightings and the parameters, for given noise.

    X_OB: (t, 3) odometry, dt: (t - 1,) s between the poses, walks: (3,) of `random_walks`. prior, of_prior: (13,) and
    information (13, 13) of the parameters. node, tag: (m,) pose and tag of each sighting, z: (m, 8) its bearing, range,
    their sigmas, the robot's twist then, the clock offset with which its stamp was interpreted, s, and the frame's
    number. before: (m,) the earlier sighting with which each one's noise is correlated, or -1, left: (m,) the
    correlation. looks: at walls.
    """

    X_OB: FloatArray
    dt: FloatArray
    walks: FloatArray
    prior: FloatArray
    of_prior: FloatArray
    node: IntArray
    tag: IntArray
    z: FloatArray
    before: IntArray
    left: FloatArray
    looks: Looks


@message
class TurnFrame:
    """The sightings of one instant of a turn. stamp: s. clock (s), X_OB: (3,): dead reckoning then. detections: the
    frame's tags. offset: s, assumed offset of the camera's clock, by which the frame's own stamp is later. lines: (k,
    11) of a scan of that instant, see `scan_lines`, points: (p, 4), see `scan_points`. only_scan: True if the camera
    took no frame then."""

    stamp: float
    clock: float
    X_OB: FloatArray
    detections: TagDetections
    offset: float = 0.0
    lines: FloatArray = dataclasses.field(default_factory=no_lines)
    only_scan: bool = False
    points: FloatArray = dataclasses.field(default_factory=lambda: np.empty((0, 4)))


# Where a turn or piece of the way begins, its frames in the order of their stamps, and where it ends; the first and the
# last carry no detections.
Piece = tuple[TurnFrame, tuple[TurnFrame, ...], TurnFrame]


@message
class Source:
    """Frames and parameters from which a keyframe was reduced, to reduce it again.

    piece: its first instant, frames and last instant. shared: the parameters then. level: (5,) of the noise, floor: of
    looks at walls, both then. names: of its walls, None without walls.
    """

    piece: Piece
    shared: Shared
    level: FloatArray
    floor: float = 1.0
    names: Names | None = None


def no_detections(stamp: float) -> TagDetections:
    """Return a frame without tags."""
    return empty(TagDetections, stamp=stamp)


@message
class Reduced:
    """A reduced turn or piece. sightings: (n,) number of detections or looks of each of its landmarks; walls have
    provisional ids, see `walls`. stamps: (t,) s and X_AB: (t, 3) its poses in A. sample: for learning the noise, None
    if nothing was seen or the wheels slipped."""

    keyframe: Keyframe
    sightings: IntArray
    stamps: FloatArray
    X_AB: FloatArray
    sample: Sample | None


@message
class Sample:
    """A turn or piece at its solution for some noise; `misfit` evaluates other noise. clock (t,), X_OB and X_AB (t, 3),
    border (13 + 2n + 2w,). node, tag, z, prior, of_prior, looks: see `_Ties`, z with the sensor's sigmas."""

    clock: FloatArray
    X_OB: FloatArray
    X_AB: FloatArray
    node: IntArray
    tag: IntArray
    z: FloatArray
    border: FloatArray
    prior: FloatArray
    of_prior: FloatArray
    looks: Looks

    def misfit(self, noise: Noise) -> float:
        """Return the negative log likelihood of its frames, up to a constant, with all poses, landmarks and parameters
        marginalised out."""
        ties = _ties(noise, self)
        own = float(np.sum(np.log(ties.z[:, 2] * ties.z[:, 3] * (1.0 - ties.left**2))))
        own += float(np.sum(np.log(ties.looks.seen[:, 7:9])))
        return own + misfit_of_chain(ties, self.X_AB.copy(), self.border.copy())


class _Solution(NamedTuple):
    """ids (n,) of the tags, number of sightings of each, all values, information (16 + 2n + 2w, 16 + 2n + 2w) and
    gradient (16 + 2n + 2w,) of (D, parameters, tags, walls), the squared error of each sighting and of each look at a
    wall, in sigmas, and the unit of lengths."""

    ids: IntArray
    sightings: IntArray
    at: Sample
    information: FloatArray
    gradient: FloatArray
    squared: FloatArray
    unit: int

    @property
    def parameters(self) -> FloatArray:
        """The parameters (13,)."""
        return self.at.border[:SHARED]

    @property
    def y_AL(self) -> FloatArray:
        """The places (n, 2) of the tags."""
        return self.at.border[SHARED : SHARED + 2 * len(self.ids)].reshape(-1, 2)

    @property
    def walls(self) -> FloatArray:
        """The angle of the normal and the distance from the anchor (w, 2) of each wall."""
        return self.at.border[SHARED + 2 * len(self.ids) :].reshape(-1, 2)


def reduced(noise: Noise, piece: Piece, shared: Shared, floor: float = 1.0, unevenness: float = 0.0) -> Reduced:
    """Reduce a turn or piece to the landmarks seen and the departure pose D at its end, in the arrival frame A at its
    beginning.

    shared: the estimate of the parameters, at which the solution is linearised. floor: of looks at walls, see
    `walls.Walls`, unevenness: m, of the walls of the frames' lines, by the current estimate. If the sightings agree
    with each other but not with the odometry, the wheels have slipped and the sightings are used.
    """
    stamps, clock, X_OB, node = _nodes(piece)
    every = (*piece[1], piece[2])
    X_AB = se2.between(X_OB[0], X_OB)
    twist = twists(stamps, X_AB, shared.mean)
    seen, counts = concat(*(frame.detections for frame in every)), [len(frame.detections.ids) for frame in every]
    of_frames = np.column_stack(
        [twist[node], [frame.offset for frame in every], np.cumsum([not frame.only_scan for frame in every])]
    )
    measured = seen.bearing, seen.range, seen.sigma_bearing, seen.sigma_range
    ids, z = seen.ids, np.column_stack([*measured, np.repeat(of_frames, counts, axis=0)])
    lines = [frame.lines for frame in every]
    of_line = np.repeat(np.array(node, dtype=np.int64), [len(one) for one in lines])
    looked = of_line, on_uneven(np.concatenate(lines), unevenness), twist[of_line]
    looks = grouped(*looked, X_AB)
    problem = _Problem(noise, shared, clock, X_OB, np.repeat(node, counts), ids, z, looks)
    solution, dropped, slipped = _solved(problem, X_AB), 0, False
    # By the odometry's poses a wall that is seen again after a full turn may seem to be another one.
    again = grouped(*looked, solution.at.X_AB)
    if len(again.anchor) < len(looks.anchor):
        problem = problem._replace(looks=again)
        solution = _solved(problem, solution.at.X_AB)
    if np.any(solution.squared > OUTLIER_SIGMAS**2):
        solution, dropped = _without_outliers(problem, X_AB)
        if dropped >= SLIP_EXPLAINS:
            # A push also moves a robot at rest: its random walk grows with time, not with the time in motion.
            slipping = replace(noise, walks=np.maximum(noise.walks, SLIPPING))
            other, left = _without_outliers(problem._replace(noise=slipping, clock=stamps), X_AB)
            if left <= min(dropped - SLIP_EXPLAINS, SLIP_LEAVES * dropped):
                solution, dropped, slipped = other, left, True
    scale = scale_of(solution.unit, shared.mean)
    one, walls = _keyframe(solution, shared, floor)
    X_AB = solution.at.X_AB / np.array([scale, scale, 1.0])
    scanned = [k for k, frame in enumerate(every) if len(frame.points)]
    at = np.array(node, dtype=np.int64)[scanned]
    of_scans = [in_body(every[k].points, solution.parameters, twist[node[k]]) for k in scanned]
    points, scatter = put_together(of_scans, X_AB[at], _ways(problem, X_AB, at), unevenness)
    return Reduced(
        keyframe=replace(one, points=points, scatter=scatter),
        sightings=np.append(walls, solution.sightings),
        stamps=stamps,
        X_AB=X_AB,
        sample=solution.at if solution.unit != DISTANCE_SCALE and not slipped else None,
    )


def in_body(points: FloatArray, parameters: FloatArray, twist: FloatArray) -> FloatArray:
    """Return points (p, 4) of a scan in B at its stamp, with each ray's origin corrected for the motion during the
    scan. parameters: (13,), twist: (2,) of the robot, m/s and rad/s."""
    yaw, ahead, left, clock, sweep = parameters[SCANNER : SCANNER + OF_SENSOR]
    earlier = clock + sweep * np.arctan2(points[:, 1], points[:, 0])
    X_BB = -earlier[:, None] * [twist[0], 0.0, twist[1]]
    return moved_points(se2.compose(X_BB, np.array([ahead, left, yaw])), points)


def _ways(problem: _Problem, X_AB: FloatArray, at: IntArray) -> Ties:
    """Return ties between consecutive poses among X_AB (t, 3), at (m,), by the odometry's noise and scales."""
    information, heading = np.empty((max(len(at) - 1, 0), 3, 3)), np.unwrap(problem.X_OB[:, 2])
    shared = problem.shared
    for i, (k, later) in enumerate(itertools.pairwise(at)):
        increment, dt = arc(problem.X_OB[k], problem.X_OB[later]), problem.clock[later] - problem.clock[k]
        increment[2] = heading[later] - heading[k]
        _, on, covariance = predict_increment(increment, dt, shared.mean[:CALIBRATION], problem.noise.walks)
        covariance += on @ shared.covariance[:CALIBRATION, :CALIBRATION] @ on.T
        information[i] = np.linalg.inv(covariance)
    first = np.arange(len(information))
    return Ties(first, first + 1, se2.between(X_AB[at[:-1]], X_AB[at[1:]]), information)


def twists(stamps: FloatArray, X_AB: FloatArray, shared: FloatArray) -> FloatArray:
    """Return forward speed (m/s) and turn rate (rad/s) (t, 2) at each of the odometry's poses (t, 3), averaged over
    TWIST_SPAN to either side, for the parameters `shared` (13,).

    The noise of single steps would bias the clock offset.
    """
    first = np.searchsorted(stamps, stamps - TWIST_SPAN)
    last = np.searchsorted(stamps, stamps + TWIST_SPAN, "right") - 1
    span = np.maximum(stamps[last] - stamps[first], SAME_INSTANT)
    moved = np.array([arc(X_AB[i], X_AB[j]) for i, j in zip(first, last, strict=True)])
    scale = 1.0 + shared[[DISTANCE_SCALE, GYRO_SCALE]]
    return np.asarray((moved[:, ::2] / span[:, None] - [0.0, shared[GYRO_BIAS]]) / scale)


def _by_shared(mean: FloatArray, unit: int) -> tuple[FloatArray, FloatArray]:
    """Return a chain's parameters (13,) for the shared ones `mean` (13,), and their derivative (13, 13) on these."""
    parameters, on, scale = mean.copy(), np.eye(SHARED), scale_of(unit, mean)
    parameters[SCALES] = (1.0 + mean[SCALES]) / scale - 1.0
    on[SCALES, SCALES] = 1.0 / scale
    if unit != METRES:
        on[SCALES, unit] -= (1.0 + mean[SCALES]) / scale**2
    return parameters, on


def _keyframe(solution: _Solution, shared: Shared, level: float) -> tuple[Keyframe, IntArray]:
    """Return the keyframe, and the number of looks (w,) at each of its walls."""
    n, unit = len(solution.ids), solution.unit
    seen = seen_walls(solution.at.looks, solution.walls, solution.at.X_AB)
    w, at = len(seen.ids), TAGS + 2 * (n + seen.order)
    # From (D, parameters, tags, walls) to (walls by their own anchors, tags, D, shared parameters).
    J = np.zeros((len(solution.information), 2 * (w + n) + 3 + SHARED))
    J[at, 2 * np.arange(w)] = J[at + 1, 2 * np.arange(w) + 1] = 1.0
    J[at + 1, 2 * np.arange(w)] = seen.shift
    J[TAGS : TAGS + 2 * n, 2 * w : 2 * (w + n)] = np.eye(2 * n)
    J[:3, 2 * (w + n) : -SHARED] = np.eye(3)
    J[3:TAGS, -SHARED:] = _by_shared(shared.mean, unit)[1]
    parameters = solution.parameters.copy()
    parameters[SCALES] = (1.0 + parameters[SCALES]) * scale_of(unit, shared.mean) - 1.0
    walls = np.column_stack([solution.walls[seen.order, 0], np.zeros(w)])
    y = np.concatenate([walls.ravel(), solution.y_AL.ravel(), solution.at.X_AB[-1]])
    W, g = with_floor(J.T @ solution.information @ J, J.T @ solution.gradient, w, level)
    on_error = np.concatenate([np.zeros((w, 2, 2)), _on_error(solution)])
    anchor, reach = (np.vstack([of_walls, np.zeros((n, 2))]) for of_walls in (seen.anchor, seen.reach))
    landmarks = np.append(seen.ids, solution.ids), anchor, reach, on_error
    return keyframe(landmarks, y, parameters, unit, W, g), seen.looks


def _on_error(solution: _Solution) -> FloatArray:
    """Return the derivatives (n, 2, 2) of each tag's place on its constant errors of range and bearing: along the line
    of sight and across it, averaged over the frames that saw it."""
    tag, X = solution.at.tag, solution.at.X_AB[solution.at.node]
    d = solution.y_AL[tag] - X[:, :2]
    ahead = d / np.maximum(np.hypot(*d.T), 1e-6)[:, None]
    columns = np.stack([ahead[:, 0], -d[:, 1], ahead[:, 1], d[:, 0]])
    each = np.stack([np.bincount(tag, column, len(solution.ids)) for column in columns], axis=1)
    return np.asarray(each.reshape(-1, 2, 2) / np.maximum(solution.sightings, 1)[:, None, None])


def _ties(noise: Noise, frames: Sample) -> _Ties:
    """Return the ties between the poses of some frames, for some noise."""
    node, tag, frame = frames.node, frames.tag, frames.z[:, 7]
    before, left = np.full(len(node), -1), np.zeros(len(node))
    if noise.correlation != 0.0:
        order = np.lexsort([node, tag])
        again = np.flatnonzero(np.diff(tag[order]) == 0)
        after = order[again + 1]
        before[after] = order[again]
        left[after] = noise.correlation ** (frame[after] - frame[order[again]])
    z, seen, dt = frames.z.copy(), frames.looks.seen.copy(), np.diff(frames.clock)
    z[:, 2:4] *= noise.tags
    seen[:, 7:9] *= noise.looks
    looks = frames.looks._replace(seen=seen)
    return _Ties(frames.X_OB, dt, noise.walks, frames.prior, frames.of_prior, node, tag, z, before, left, looks)


def _without_outliers(problem: _Problem, X_AB: FloatArray) -> tuple[_Solution, int]:
    """Return the solution without the sightings and looks that lie too far from a robust one, and the number of these
    sightings."""
    robust = _solved(problem, X_AB, huber=HUBER_SIGMAS)
    tags, looks = np.split(~(robust.squared > OUTLIER_SIGMAS**2), [len(problem.ids)])
    ids, node, z = problem.ids[tags], problem.node[tags], problem.z[tags]
    kept = problem._replace(ids=ids, node=node, z=z, looks=problem.looks.kept(looks))
    return _solved(kept, robust.at.X_AB), len(tags) - len(ids)


def _solved(problem: _Problem, X_AB: FloatArray, huber: float = math.inf) -> _Solution:
    """Return the solution from initial poses X_AB (t, 3). huber: threshold of a robust solution, in sigmas, for which
    all noise is white."""
    noise, shared, node, z, looks = problem.noise, problem.shared, problem.node, problem.z, problem.looks
    ids, tag, sightings = np.unique(problem.ids, return_inverse=True, return_counts=True)
    unit = METRES if len(looks.node) else RANGE_SCALE if len(ids) else DISTANCE_SCALE
    prior, on = _by_shared(shared.mean, unit)
    covariance = on @ shared.covariance @ on.T
    if unit != METRES:
        covariance[unit, unit] = 1.0 / HELD
    of_prior = np.asarray(np.linalg.inv(covariance), dtype=float)
    border = np.append(prior, np.empty(2 * len(ids)))
    angle = X_AB[node, 2] + z[:, 0]
    for i, direction in enumerate((np.cos(angle), np.sin(angle))):
        border[SHARED + i :: 2] = np.bincount(tag, X_AB[node, i] + z[:, 1] * direction, len(ids)) / sightings
    border = np.append(border, looks.first(X_AB).ravel())
    noise = replace(noise, correlation=0.0) if math.isfinite(huber) else noise
    at = Sample(problem.clock, problem.X_OB, X_AB, node, tag, z, border, prior, of_prior, looks)
    X_AB, border = X_AB.copy(), border.copy()
    information, gradient, squared = solved_chain(_ties(noise, at), X_AB, border, huber)
    X_AB[:, 2] = se2.wrap_angle(X_AB[:, 2])
    return _Solution(ids, sightings, replace(at, X_AB=X_AB, border=border), information, gradient, squared, unit)


def _nodes(piece: Piece) -> tuple[FloatArray, FloatArray, FloatArray, list[int]]:
    """Return stamps and clock (t,) and odometry (t, 3) of the poses, and the pose index of each frame and of the end;
    coinciding stamps share a pose."""
    begin, frames, end = piece
    poses, node = [begin], []
    for frame in (*frames, end):
        if frame.stamp - poses[-1].stamp > SAME_INSTANT:
            poses.append(frame)
        node.append(len(poses) - 1)
    if len(poses) == 1:
        poses.append(replace(end, stamp=begin.stamp + SAME_INSTANT, clock=begin.clock + SAME_INSTANT))
    stamps, clock = np.array([[one.stamp, one.clock] for one in poses]).T
    return stamps, clock, np.array([one.X_OB for one in poses]), node


@njit(cache=True)
def solved_chain(
    ties: _Ties, X: FloatArray, border: FloatArray, huber: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move the poses X (t, 3), the first of which is fixed, and the border (13 + 2n + 2w,), parameters, tags and walls,
    to the least squares solution, in place. huber: threshold of a robust solution, in sigmas, which requires
    uncorrelated noise.

    Returns the information (16 + 2n + 2w, 16 + 2n + 2w) of the frames alone on (D, parameters, tags, walls), the
    gradient there, and the squared errors of the sightings and of the looks, in sigmas.
    """
    size, motions, prior, of_prior = 3 + len(border), _motions(ties), ties.prior, ties.of_prior
    chain, rest = equations = np.zeros((len(X), 3, 4 + size)), np.zeros((size, size + 1))
    squared, step_X, step = np.empty(len(ties.node) + len(ties.looks.node)), np.zeros((len(X), 3)), np.zeros(size)
    cost, share, last = math.inf, 1.0, False
    for attempt in range(MOST_STEPS):
        chain.fill(0.0)
        rest.fill(0.0)
        new_cost = _add_odometry(ties, X, border, motions, equations)
        new_cost += _add_measurements(ties, X, border, huber, equations, squared)
        for a in range(SHARED):
            for b in range(SHARED):
                new_cost += 0.5 * of_prior[a, b] * (border[a] - prior[a]) * (border[b] - prior[b])
        if 0 < attempt < MOST_STEPS - 1 and not last and not new_cost <= cost + ROUNDING * (1.0 + cost):
            share *= 0.5
            X -= share * step_X
            border -= share * step[3:]
            continue
        _eliminate(chain, rest)
        if last:
            break
        cost, share = new_cost, 1.0
        with_prior = rest.copy()
        _add_prior(with_prior, border, prior, of_prior)
        _factor(with_prior)
        last = _back_substitute(chain, with_prior, step_X, step) < LAST_STEP
        X += share * step_X
        border += share * step[3:]
    whole = np.empty((size, size))
    for a in range(size):
        for b in range(a, size):
            whole[a, b], whole[b, a] = rest[a, b], rest[a, b]
    return whole, rest[:, -1].copy(), squared


@njit(cache=True)
def misfit_of_chain(ties: _Ties, X: FloatArray, border: FloatArray) -> float:
    """Return the negative log likelihood of odometry and sightings, linearised at X and border, which are marginalised
    out; without terms of the sightings' own deviations only. Arguments: see `solved_chain`."""
    motions, prior, of_prior = _motions(ties), ties.prior, ties.of_prior
    size = 3 + len(border)
    chain, rest = equations = np.zeros((len(X), 3, 4 + size)), np.zeros((size, size + 1))
    misfit = _add_odometry(ties, X, border, motions, equations)
    for one in motions[1]:
        misfit += 0.5 * math.log(np.linalg.det(one))
    squared = np.empty(len(ties.node) + len(ties.looks.node))
    misfit += _add_measurements(ties, X, border, math.inf, equations, squared)
    for a in range(SHARED):
        for b in range(SHARED):
            misfit += 0.5 * of_prior[a, b] * (border[a] - prior[a]) * (border[b] - prior[b])
    _add_prior(rest, border, prior, of_prior)
    _eliminate(chain, rest)
    _factor(rest)
    for i in range(1, len(X) - 1):
        for a in range(3):
            misfit += math.log(chain[i, a, a]) - 0.5 * chain[i, a, -1] ** 2
    for a in range(len(rest)):
        misfit += math.log(rest[a, a]) - 0.5 * rest[a, -1] ** 2
    return misfit


@njit(cache=True)
def _motions(ties: _Ties) -> Pair:
    """Return the increments (t - 1, 3) of `arc` between the odometry's poses, and the covariance (t - 1, 3, 3) of
    each."""
    X_OB, dt = ties.X_OB, ties.dt
    increments, covariance = np.empty((len(dt), 3)), np.empty((len(dt), 3, 3))
    for i in range(len(dt)):
        increments[i] = arc(X_OB[i], X_OB[i + 1])
        covariance[i] = predict_increment(increments[i], dt[i], np.zeros(3), ties.walks)[2]
    return increments, covariance


@njit(cache=True)
def _add(rows: FloatArray, first: int, poses: int, at: IntArray, equations: Pair) -> None:
    """Add the products of rows' columns from `first` on with each other and with the last, the error. at: (c,) the
    unknown of each column but the last, ascending: three per pose, D's last of them, for the first `poses` columns, and
    then the border's."""
    (chain, rest), d = equations, 3 * len(equations[0]) - 3
    for a in range(first, len(at)):
        i = at[a] // 3
        # Offsets of the poses' and of the border's columns in the row; the latter follow the next pose's.
        row, of_pose, border = (chain[i, at[a] - 3 * i], 3 * i, d - 3) if at[a] < d else (rest[at[a] - d], d, d)
        for b in range(a, poses):
            row[at[b] - of_pose] += _dot(rows, a, b)
        for b in range(max(a, poses), len(at)):
            row[at[b] - border] += _dot(rows, a, b)
        row[-1] += _dot(rows, a, len(at))


@njit(cache=True)
def _add_prior(rest: FloatArray, border: FloatArray, prior: FloatArray, of_prior: FloatArray) -> None:
    for a in range(SHARED):
        for b in range(SHARED):
            rest[3 + a, 3 + b] += of_prior[a, b]
            rest[3 + a, -1] += of_prior[a, b] * (border[b] - prior[b])


@njit(cache=True)
def _add_odometry(ties: _Ties, X: FloatArray, border: FloatArray, motions: Pair, equations: Pair) -> float:
    """Add the normal equations of the odometry between poses (t, 3); returns the cost. motions: of `_motions`."""
    cost, (increments, covariance) = 0.0, motions
    # The covariance, to whiten by, beside the Jacobians on both poses and the calibration, and the error.
    rows, last, at = np.empty((3, 13)), 12, np.arange(12)
    at[9:] = 3 * len(X) + np.arange(3)
    for i in range(len(X) - 1):
        ahead, on_calibration, _ = predict_increment(increments[i], ties.dt[i], border[:3], ties.walks)
        c, s = math.cos(X[i, 2]), math.sin(X[i, 2])
        dx, dy = X[i + 1, 0] - X[i, 0], X[i + 1, 1] - X[i, 1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        rows.fill(0.0)
        rows[:, :3] = covariance[i]
        rows[0, 3], rows[0, 4], rows[0, 5], rows[0, 6], rows[0, 7] = -c, -s, y, c, s
        rows[1, 3], rows[1, 4], rows[1, 5], rows[1, 6], rows[1, 7] = s, -c, -x, -s, c
        rows[2, 5], rows[2, 8] = -1.0, 1.0
        rows[:, 9:12] = -on_calibration
        rows[0, last], rows[1, last] = x - ahead[0], y - ahead[1]
        rows[2, last] = wrap(X[i + 1, 2] - X[i, 2] - ahead[2])
        # Noise belongs to the measured increment, so residuals are in its units; otherwise the scales would be biased.
        for a in range(3):
            scale = 1.0 + (border[0] if a < 2 else border[2])
            by_scale = rows[a, last]
            rows[a, 3:] *= scale
            rows[a, 9 if a < 2 else 11] += by_scale
        _factor(rows)
        for a in range(6):
            at[3 + a] = 3 * i + a
        _add(rows, 3, 9, at, equations)
        cost += 0.5 * _dot(rows, last, last)
    return cost


@njit(cache=True)
def _add_measurements(
    ties: _Ties, X: FloatArray, border: FloatArray, huber: float, equations: Pair, squared: FloatArray
) -> float:
    """Add the normal equations of m sightings and q looks at walls and set their squared errors (m + q,), in sigmas;
    returns the cost.

    The noise of a tag's sightings is a first-order autoregression: a sighting minus the correlated part of the previous
    one is white. The previous sighting's pose is taken for the chain's previous pose, which it is unless the tag was
    not seen for some frames.
    """
    cost, z, looks, sightings = 0.0, ties.z, ties.looks, len(ties.node)
    first_wall = len(border) - 2 * len(looks.anchor)
    # Rows of every measurement; and those of its white part, with the previous pose in front.
    every, fresh, last = np.zeros((len(squared), 2, COLUMNS)), np.zeros((2, 3 + OF_TWIST)), 3 + ERROR
    at = np.empty(last, dtype=np.int64)
    for j in range(len(squared)):
        rows, before = every[j], -1
        if j < sightings:
            i, k, of_sensor, before = ties.node[j], SHARED + 2 * ties.tag[j], CAMERA, ties.before[j]
            mount, p_AL = border[of_sensor : of_sensor + OF_SENSOR], border[k : k + 2]
            linearise_tag(rows, X[i], mount, z[j, 6], z[j, 4:6], z[j, 0], z[j, 1], p_AL)
            squared[j], more = _whiten(rows, z[j, 2], z[j, 3], huber)
        else:
            of_look, seen = j - sightings, looks.seen[j - sightings]
            wall = looks.wall[of_look]
            i, k, of_sensor = looks.node[of_look], first_wall + 2 * wall, SCANNER
            mount = border[of_sensor : of_sensor + OF_SENSOR]
            linearise_wall(rows, X[i], mount, seen[9:], seen[:7], border[k : k + 2], looks.anchor[wall])
            squared[j], more = _whiten(rows, seen[7], seen[8], huber)
        for a in range(6 + OF_SENSOR):
            at[a] = 3 * i - 3 + a if a < 6 else 3 * len(X) + of_sensor + a - 6
        at[last - 2], at[last - 1] = 3 * len(X) + k, 3 * len(X) + k + 1
        fresh[:, :3], fresh[:, 3:] = 0.0, rows[:, :OF_TWIST]
        if before >= 0:
            left, rows_before = ties.left[j], every[before]
            whitener = 1.0 / math.sqrt(1.0 - left * left)
            fresh[:, :3] = -left * whitener * rows_before[:, :3]
            fresh[:, 3:6] = whitener * rows[:, :3]
            fresh[:, 6:] = whitener * (rows[:, 3:OF_TWIST] - left * rows_before[:, 3:OF_TWIST])
        cost += more + 0.5 * _dot(fresh, last, last)
        _add(fresh, 0 if before >= 0 else 3, 6, at, equations)
    return cost


@njit(cache=True)
def _whiten(rows: FloatArray, sigma_first: float, sigma_second: float, huber: float) -> tuple[float, float]:
    """Divide a measurement's rows by their deviations, in place; returns its squared error, and its cost minus half the
    squared norm of its rows. Beyond `huber`, in sigmas, its loss is linear."""
    first, second = rows[0, ERROR] / sigma_first, rows[1, ERROR] / sigma_second
    squared, more, weight = first * first + second * second, 0.0, 1.0
    sigmas = math.sqrt(squared)
    if sigmas > huber:
        weight, more = math.sqrt(huber / sigmas), 0.5 * huber * (sigmas - huber)
    rows[0, :OF_TWIST] *= weight / sigma_first
    rows[1, :OF_TWIST] *= weight / sigma_second
    return squared, more


@njit(cache=True)
def _eliminate(chain: FloatArray, rest: FloatArray) -> None:
    """Eliminate, in place, the poses between the first, which is fixed, and D one by one from the others and the
    rest."""
    for i in range(1, len(chain) - 1):
        rows = chain[i]
        _factor(rows)
        before_d = i + 2 == len(chain)
        for a in range(3):
            if before_d:
                _subtract(rest[a], 0, rows, 3 + a, 3, rows.shape[1])
            else:
                _subtract(chain[i + 1, a], 0, rows, 3 + a, 3, 6)
                _subtract(chain[i + 1, a], 6, rows, 3 + a, 6, rows.shape[1])
        for a in range(3, len(rest)):
            _subtract(rest[a], a, rows, 3 + a, 3 + a, rows.shape[1])


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
    """Return the product of two columns."""
    value = 0.0
    for k in range(len(rows)):
        value += rows[k, a] * rows[k, b]
    return value


@njit(cache=True)
def _back_substitute(chain: FloatArray, rest: FloatArray, step_X: FloatArray, step: FloatArray) -> float:
    """Set the Gauss-Newton step of poses (t, 3) and of D and border from the factors; returns the largest entry."""
    longest = 0.0
    for a in range(len(step) - 1, -1, -1):
        value = -rest[a, -1]
        for b in range(a + 1, len(step)):
            value -= rest[a, b] * step[b]
        step[a] = value / rest[a, a]
        longest = max(longest, abs(step[a]))
    step_X[-1] = step[:3]
    for i in range(len(chain) - 2, 0, -1):
        rows = chain[i]
        for a in range(2, -1, -1):
            value = -rows[a, -1]
            for b in range(3, len(step)):
                value -= rows[a, 3 + b] * step[b]
            for b in range(a + 1, 3):
                value -= rows[a, b] * step_X[i, b]
            for b in range(3):
                value -= rows[a, 3 + b] * step_X[i + 1, b]
            step_X[i, a] = value / rows[a, a]
            longest = max(longest, abs(step_X[i, a]))
    return longest

"""Values and covariances of the goal graph: maximum a posteriori by GTSAM (the paper's sec. III).

A small map is solved as a whole at every goal. Of a large one only the window round the newest goal is free, with the
factors of the goals beyond it that see the same landmarks and everything else held: one step of a coordinate descent on
the whole graph's error, at a cost that does not grow with the map. Where it moves what other goals rest on, as when a
loop closes, the whole graph is solved, values only. The covariance is that of the window's landmarks: of the window's
factors, of what goals beyond it have seen of them, the links, and the absolute covariance of the goal in the window
that is known best.
"""

from __future__ import annotations

import contextlib
import math

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import A, D, L

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, GoalObservation, IntArray, MapEstimate, replace
from tfg_drake.slam.goal_factors import factor_graph, held_pose, joint_factor, pose_prior, segment_factor, values_of
from tfg_drake.slam.goal_graph import WITNESSES, GoalGraph, forgetting, rows_of
from tfg_drake.slam.map_window import (
    anchor_goal,
    boundary_goals,
    link,
    nearest_observer,
    seen_by,
    smoothed_block,
    travelled_about_origin,
    travelled_covariance,
    window_goals,
    with_travel,
)

# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 1e-3
# Where a whole Gauss-Newton step goes too far, as where a long loop has just closed, a part of it may do, in seconds;
# Levenberg-Marquardt takes minutes.
SHARES = (0.5, 0.25, 0.125)
# Where a part of a step, or Levenberg-Marquardt, has lowered the error by less than this share, no more is asked for.
CREEPING = 1e-4
# Landmarks that goals outside the window have seen too may move this far, m, before the whole graph is solved.
RIM_STEP = 0.01
# As good as zero.
NOTHING = 1e-150
# What hangs looser than this, m or rad, may as well hang by this.
LOOSEST = 100.0
# A block of the way adds at least this share of its own uncertainty to that of the way before it: rounding, and errors
# of two blocks that make up for each other, may leave less than nothing of it.
LEAST_ADDED = 0.01
# Poses and landmarks of more unknowns than this are never known jointly: it would take gigabytes.
MOST_JOINT = 12_000


def solve(graph: GoalGraph, stamp: float, observation: GoalObservation) -> tuple[GoalGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map: the joint Gaussian round the newest goal.

    stamp: s, observation: the newest goal's, with its trajectory; both go into the MapEstimate.
    """
    goals = window_goals(graph, graph.X_MA[-1, :2])
    if len(goals) == len(graph.observations):
        graph = settle(graph)
    else:
        settled, rim = _settle_window(graph, goals)
        graph = settled if rim <= RIM_STEP else settle(settled)
        # The goal may turn out to lie elsewhere, as after the robot was carried.
        goals = window_goals(graph, graph.X_MA[-1, :2])
    rows, covariance, entropy = _joint(graph, goals)
    if len(goals) < len(graph.observations):
        entropy += graph.entropy - _entropy_before(graph, goals)
    # A small map, too: when it has grown large, what lies beyond its windows is known by what was told until then.
    block = smoothed_block(graph, goals)
    if block:
        _, joint, _ = _joint(graph, goals, ends=block)
        ends = slice(-3 * len(block) - 3, -3)
        graph = with_travel(graph, block[-2], block[-1], _added_by_last(graph, block, joint[ends, ends]))
    return _noted(graph, rows, covariance, entropy, stamp, observation)


def with_landmarks(graph: GoalGraph, estimate: MapEstimate, rows: IntArray, place: FloatArray) -> MapEstimate:
    """The estimate with a joint covariance that covers these rows (m,) too and what lies round a place (2,), m in M."""
    goals = window_goals(graph, place)
    for row in rows:
        if not any(np.isin(graph.ids[row], graph.observations[k].ids) for k in goals):
            goals = np.union1d(goals, nearest_observer(graph, int(row)))
    rows, covariance, _ = _joint(graph, goals)
    return replace(estimate, local=rows, covariance=covariance)


def seen_from(graph: GoalGraph, estimate: MapEstimate, goal: int) -> MapEstimate:
    """The estimate as a goal has it: X_MD is that goal's departure pose, the covariance that of the landmarks round it
    and of that pose."""
    goals = np.union1d(window_goals(graph, graph.X_MD[goal, :2]), goal)
    rows, covariance, _ = _joint(graph, goals, goal)
    return replace(estimate, X_MD=graph.X_MD[goal], local=rows, covariance=covariance)


def restored(graph: GoalGraph, stamp: float, observation: GoalObservation) -> MapEstimate:
    """The map of a graph that is solved already; arguments as in `solve`."""
    rows, covariance, _ = _joint(graph, window_goals(graph, graph.X_MA[-1, :2]))
    return _estimate(graph, stamp, observation, rows, covariance)


def whole(graph: GoalGraph, stamp: float, observation: GoalObservation) -> tuple[GoalGraph, MapEstimate]:
    """As `solve`, but of the whole graph and with the joint covariance of all landmarks; of more than MOST_JOINT
    unknowns with that of each landmark by itself.

    For the end of a mission: its cost grows with the map, the joint covariance's with the third power.
    """
    graph = settle(graph)
    if 6 * len(graph.observations) + 2 * len(graph.ids) > MOST_JOINT:
        graph = replace(graph, landmark_covariance=_each_by_itself(graph))
        return graph, restored(graph, stamp, observation)
    rows, covariance, entropy = _joint(graph, np.arange(len(graph.observations)))
    return _noted(graph, rows, covariance, entropy, stamp, observation)


def _each_by_itself(graph: GoalGraph) -> FloatArray:
    """The covariance (n, 2, 2) of each landmark, m^2, from GTSAM's Bayes tree of the whole graph."""
    marginals = gtsam.Marginals(factor_graph(graph), values_of(graph))
    return np.array([marginals.marginalCovariance(L(int(tag))) for tag in graph.ids]).reshape(-1, 2, 2)


def _noted(
    graph: GoalGraph,
    rows: IntArray,
    covariance: FloatArray,
    entropy: float,
    stamp: float,
    observation: GoalObservation,
) -> tuple[GoalGraph, MapEstimate]:
    """The graph with what the joint covariance of some rows (m,) and X_MD says, and the estimate."""
    departure_covariance, landmark_covariance = graph.departure_covariance.copy(), graph.landmark_covariance.copy()
    departure_covariance[-1] = 0.5 * (covariance[-3:, -3:] + covariance[-3:, -3:].T)
    m = np.arange(len(rows))
    landmark_covariance[rows] = covariance[:-3, :-3].reshape(len(m), 2, len(m), 2)[m, :, m, :]
    graph = replace(
        graph, departure_covariance=departure_covariance, landmark_covariance=landmark_covariance, entropy=entropy
    )
    return graph, _estimate(graph, stamp, observation, rows, covariance)


def _estimate(
    graph: GoalGraph, stamp: float, observation: GoalObservation, rows: IntArray, covariance: FloatArray
) -> MapEstimate:
    return MapEstimate(
        stage=int(np.count_nonzero(graph.is_goal)),
        stamp=stamp,
        ids=graph.ids,
        p_ML=graph.p_ML,
        X_MD=graph.X_MD[-1],
        local=rows,
        covariance=covariance,
        landmark_covariance=graph.landmark_covariance,
        X_MA=graph.X_MA[graph.is_goal],
        observation=observation,
        entropy=graph.entropy,
    )


def settle(graph: GoalGraph) -> GoalGraph:
    """The whole graph at its maximum a posteriori values."""
    values = _optimum(factor_graph(graph), values_of(graph))
    k = len(graph.observations)
    X_MA = np.array([_pose(values, A(i)) for i in range(k)])
    X_MA[0] = 0.0
    return replace(
        graph,
        X_MA=X_MA,
        X_MD=np.array([_pose(values, D(i)) for i in range(k)]),
        p_ML=np.array([values.atPoint2(L(int(tag))) for tag in graph.ids]).reshape(-1, 2),
    )


def _settle_window(graph: GoalGraph, goals: IntArray) -> tuple[GoalGraph, float]:
    """The graph with the window's goals (w,) and their landmarks at the optimum, all else held, and how far (m) a
    landmark moved on which goals beyond rest.

    A landmark is free if all goals that have seen it take part.
    """
    boundary = boundary_goals(graph, goals, graph.X_MA[-1, :2])
    taking_part, mine = np.zeros(len(graph.ids), dtype=np.int64), seen_by(graph, goals)
    for k in (*goals, *boundary):
        taking_part[rows_of(graph.observations[k].ids, graph.ids)[0]] += 1
    free = mine & (taking_part == graph.sightings)
    shared = np.zeros(len(graph.ids), dtype=bool)

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in goals:
        factors.add(joint_factor(graph, k, free=free))
        values.insert(A(k), gtsam.Pose2(*graph.X_MA[k]))
        values.insert(D(k), gtsam.Pose2(*graph.X_MD[k]))
    for k in boundary:
        rows = rows_of(graph.observations[k].ids, graph.ids)[0]
        if free[rows].any():
            shared[rows] = True
            factors.add(joint_factor(graph, k, pose_free=False, free=free))
    for row in np.flatnonzero(free):
        values.insert(L(int(graph.ids[row])), graph.p_ML[row])
    for j in np.union1d(goals, goals - 1):
        if not 0 <= j < len(graph.X_DA):
            continue
        for key, i, X in ((D(j), j, graph.X_MD[j]), (A(j + 1), j + 1, graph.X_MA[j + 1])):
            if i not in goals:
                factors.add(held_pose(key, X))
                values.insert(key, gtsam.Pose2(*X))
        factors.add(segment_factor(j, j + 1, graph.X_DA[j], graph.segment_covariance[j]))
    if goals[0] == 0:
        factors.add(held_pose(A(0), np.zeros(3)))

    values = _optimum(factors, values)
    X_MA, X_MD, p_ML = graph.X_MA.copy(), graph.X_MD.copy(), graph.p_ML.copy()
    for k in goals:
        X_MA[k], X_MD[k] = _pose(values, A(k)), _pose(values, D(k))
    if goals[0] == 0:
        X_MA[0] = 0.0
    for row in np.flatnonzero(free):
        p_ML[row] = values.atPoint2(L(int(graph.ids[row])))
    rim = np.hypot(*(p_ML - graph.p_ML)[shared & free].T)
    return replace(graph, X_MA=X_MA, X_MD=X_MD, p_ML=p_ML), float(rim.max(initial=0.0))


def _optimum(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Gauss-Newton steps by GTSAM's multifrontal elimination; a part of one where the whole fails to lower the error,
    and Levenberg-Marquardt where every part does."""
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(factors)
    error = factors.error(values)
    for _ in range(MOST_STEPS):
        linear = factors.linearize(values)
        step, moved = None, values
        # Without landmarks a long chain of loose segments from an exact origin may look singular to the elimination.
        with contextlib.suppress(RuntimeError):
            step = linear.optimize(ordering)
            moved = values.retract(step)
        moved_error, creeps = factors.error(moved), False
        if step is None or not moved_error <= error + 1e-6 * (1.0 + error):
            shorter = None if step is None else _shortened(factors, values, step, error)
            moved = shorter or gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
            moved_error = factors.error(moved)
            if not moved_error <= error + 1e-6 * (1.0 + error):
                break
            creeps = error - moved_error < CREEPING * error
        values, error = moved, moved_error
        if step is None or creeps or np.max(np.abs(step.vector())) < SMALL_STEP:
            break
    return values


def _shortened(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, step: gtsam.VectorValues, error: float
) -> gtsam.Values | None:
    """The values moved by a part of the step that lowers the error, None where none of SHARES does."""
    for share in SHARES:
        moved = values.retract(step.scale(share))
        if factors.error(moved) < error:
            return moved
    return None


def _joint(
    graph: GoalGraph, goals: IntArray, pose: int | None = None, ends: tuple[int, ...] = ()
) -> tuple[IntArray, FloatArray, float]:
    """Rows (m,) of the landmarks that some goals (w,) have seen; the covariance (2m + 3, 2m + 3) of those and the
    departure pose of one of the goals, by default the last, of (x, y) in M and theta; and the landmarks' entropy,
    nats.

    ends: e more goals whose departure poses come before that pose, (2m + 3e + 3, 2m + 3e + 3).
    """
    pose = int(goals[-1]) if pose is None else pose
    poses = (*ends, pose)
    rows, information = _information(graph, goals, boundary_goals(graph, goals, graph.X_MD[pose, :2]), poses)
    factor = _cholesky(information)
    entropy = _entropy(factor, 2 * len(rows))
    upper, _ = scipy.linalg.lapack.dpotri(factor)
    covariance = upper + upper.T
    np.fill_diagonal(covariance, np.diag(upper))
    # Pose2 increments are in the body's frame.
    for place, k in enumerate(poses):
        R_MD = se2.rotation(float(graph.X_MD[k, 2]))
        at = slice(2 * len(rows) + 3 * place, 2 * len(rows) + 3 * place + 2)
        covariance[at] = R_MD @ covariance[at]
        covariance[:, at] = covariance[:, at] @ R_MD.T
    return rows, np.asarray(covariance), entropy


def _cholesky(information: FloatArray) -> FloatArray:
    """The upper factor of an information matrix (n, n).

    A map that hangs on its origin by kilometres, as where the robot was carried and the tags before were moved, is not
    held at all by what is left of a double beside joints of hundredths of a millimetre: it hangs by LOOSEST then.
    """
    try:
        return np.asarray(scipy.linalg.cholesky(information, check_finite=False))
    except scipy.linalg.LinAlgError:
        held = information + np.eye(len(information)) / LOOSEST**2
        return np.asarray(scipy.linalg.cholesky(held, check_finite=False))


def _between(graph: GoalGraph, i: int, j: int, covariance: FloatArray) -> FloatArray:
    """The covariance (3, 3) of D_j seen from D_i, of (x, y) in D_i and theta, from that of both (6, 6) in M."""
    lever = graph.X_MD[j, :2] - graph.X_MD[i, :2]
    J = np.hstack([-np.eye(3), np.eye(3)])
    J[:2, 2] = lever[1], -lever[0]
    J[:2] = se2.rotation(float(graph.X_MD[i, 2])).T @ J[:2]
    return np.asarray(J @ covariance @ J.T)


def _added_by_last(graph: GoalGraph, block: tuple[int, ...], covariance: FloatArray) -> FloatArray:
    """(3, 3) what travel from D_i to D_j adds, about M's origin, to that from D_h to D_i, where the block is (h, i, j),
    or by itself where it is (i, j); from the covariance of those poses (9, 9) or (6, 6) in M.

    On arrival a leg is known by what came before alone; what is seen afterwards makes it surer, and the errors of legs
    and blocks make up for each other.
    """

    def travelled(i: int, j: int) -> FloatArray:
        both = np.r_[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        between = _between(graph, block[i], block[j], covariance[np.ix_(both, both)])
        return travelled_about_origin(graph, block[i], block[j], between)

    if len(block) == 2:
        return travelled(0, 1)
    alone = travelled(1, 2)
    try:
        share, mode = scipy.linalg.eigh(travelled(0, 2) - travelled(0, 1), alone)
    except scipy.linalg.LinAlgError:
        return alone
    mode = alone @ mode
    return np.asarray(mode * np.clip(share, LEAST_ADDED, 1.0) @ mode.T)


def _entropy(factor: FloatArray, n: int) -> float:
    """1/2 log|2 pi e Sigma_L|, nats, from the upper Cholesky factor of the information on landmarks, n numbers, and
    poses."""
    diagonal = np.diag(factor)
    # The determinant of the whole is that of the poses given the landmarks times that of the landmarks alone.
    log_pose = float(np.linalg.slogdet(factor[:, n:].T @ factor[:, n:])[1])
    log_information = 2.0 * float(np.sum(np.log(diagonal))) - log_pose
    return 0.5 * (n * math.log(2.0 * math.pi * math.e) - log_information) if n else 0.0


def _entropy_before(graph: GoalGraph, goals: IntArray) -> float:
    """The entropy, nats, before the newest goal, of those of the window's landmarks that were known then."""
    boundary = boundary_goals(graph, goals, graph.X_MD[-1, :2])
    # Without the newest goal and the pieces of the way to it.
    goals = goals[goals <= np.flatnonzero(graph.is_goal[:-1])[-1]]
    rows, information = _information(graph, goals, boundary, (int(goals[-1]),))
    known = np.zeros(len(graph.ids), dtype=bool)
    known[rows_of(graph.observations[-1].ids, graph.ids)[0]] = True
    known &= graph.landmark_covariance[:, 0, 0] > 0.0
    known[rows] = False
    # Seen before from elsewhere only.
    others = np.linalg.slogdet(2.0 * math.pi * math.e * graph.landmark_covariance[known])[1]
    before = _entropy(_cholesky(information), 2 * len(rows))
    return before + 0.5 * float(np.sum(others))


def _window_factors(graph: GoalGraph, goals: IntArray) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factors of some goals (w,), with links where they are not consecutive and the anchor's prior or the origin,
    and the values of all that is in them."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in goals:
        factors.add(joint_factor(graph, k))
        values.insert(A(k), gtsam.Pose2(*graph.X_MA[k]))
        values.insert(D(k), gtsam.Pose2(*graph.X_MD[k]))
    for row in np.flatnonzero(seen_by(graph, goals)):
        values.insert(L(int(graph.ids[row])), graph.p_ML[row])
    gaps = np.diff(goals) > 1
    travelled = travelled_covariance(graph) if gaps.any() else np.zeros((0, 3, 3))
    for i, j, gap in zip(goals[:-1], goals[1:], gaps, strict=True):
        if gap:
            factors.add(segment_factor(i, j, *link(graph, travelled, i, j)))
        else:
            factors.add(segment_factor(i, j, graph.X_DA[i], graph.segment_covariance[i]))
    if len(goals) < len(graph.observations):
        anchor = anchor_goal(graph, goals)
        factors.add(pose_prior(D(anchor), graph.X_MD[anchor], graph.departure_covariance[anchor]))
    else:
        factors.add(held_pose(A(0), np.zeros(3)))
    return factors, values


def _information(
    graph: GoalGraph, goals: IntArray, boundary: IntArray, poses: tuple[int, ...]
) -> tuple[IntArray, FloatArray]:
    """Rows (m,) of the landmarks that some goals (w,) have seen, and the information (2m + 3p, 2m + 3p) on them and the
    departure poses of p of the goals, each in its own frame. The goals of the boundary (b,) tell how those of the
    landmarks that they have seen lie to each other.

    The other poses, a chain, are eliminated from GTSAM's linear system by a Schur complement: with the inversion a
    third of the time of gtsam.Marginals at n = 274.
    """
    seen = seen_by(graph, goals)
    factors, values = _window_factors(graph, goals)
    ordering = gtsam.Ordering()
    for k in boundary:
        ids = graph.observations[k].ids
        partly = forgetting(graph.observations[k], ids[~seen[rows_of(ids, graph.ids)[0]]])
        if len(partly.ids) >= WITNESSES:
            factors.add(joint_factor(graph, k, observation=partly))
            values.insert(A(k), gtsam.Pose2(*graph.X_MA[k]))
            values.insert(D(k), gtsam.Pose2(*graph.X_MD[k]))
            ordering.push_back(A(k))
            ordering.push_back(D(k))
    for k in goals:
        ordering.push_back(A(k))
        if k not in poses:
            ordering.push_back(D(k))
    rows = np.flatnonzero(seen)
    for row in rows:
        ordering.push_back(L(int(graph.ids[row])))
    for k in poses:
        ordering.push_back(D(k))
    # A known origin's rows are left out.
    first = 0 if len(goals) < len(graph.observations) else 3
    information = factors.linearize(values).hessian(ordering)[0][first:, first:]
    split = len(information) - 2 * len(rows) - 3 * len(poses)
    if split == 0:
        return rows, np.asarray(information)
    # Only consecutive poses share a factor.
    band = np.zeros((6, split))
    for i in range(min(6, split)):
        band[i, : split - i] = np.diagonal(information[:split, :split], -i)
    factor = scipy.linalg.cholesky_banded(band, lower=True, check_finite=False)
    half, _ = scipy.linalg.lapack.dtbtrs(factor, information[:split, split:], uplo="L")
    # What a goal says of landmarks far behind dies out; numbers with squares too small for a double cost most time.
    half[np.abs(half) < NOTHING] = 0.0
    return rows, np.asarray(information[split:, split:] - half.T @ half)


def _pose(values: gtsam.Values, key: int) -> tuple[float, float, float]:
    pose = values.atPose2(key)
    return pose.x(), pose.y(), pose.theta()

"""A keyframe: one Gaussian, in information form, of all measurements of a turn or a piece of the way.

Its lengths are kept in their unit of measurement: metres if scans saw walls, otherwise metres times (1 + the scale of
ranges), or times (1 + the scale of distance) if no tag was seen. In metres a scale would be one more direction of the
information, valid only at the linearisation point: as soon as other keyframes move the tags a little, it would bias the
scale, always with the same sign.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, BoolArray, FloatArray, IntArray, is_tag, message, replace
from tfg_drake.slam.odometry_model import wrap
from tfg_drake.slam.shared import METRES, SHARED, scale_of
from tfg_drake.table import take

# A fusion is iterated until no unknown moves by more than SMALL_STEP, m or rad, or MOST_STEPS times.
SMALL_STEP = 1e-6
MOST_STEPS = 5
# A keyframe without landmarks whose heading has at least this deviation, rad, is an unknown motion.
OPEN_HEADING = 1.0


class Measured(NamedTuple):
    """Landmarks of a keyframe: the number of walls, which come first, y_AL (n, 2), the anchors (n, 2) of the walls,
    y_AD (3,) and the unit of lengths, see Keyframe."""

    walls: int
    y_AL: FloatArray
    p_AC: FloatArray
    y_AD: FloatArray
    unit: int


# ids, anchor, reach and on_error of a keyframe, see there.
Landmarks = tuple[IntArray, FloatArray, FloatArray, FloatArray]
# Places and anchors of landmarks, or the poses A and D.
Pair = tuple[FloatArray, FloatArray]
# The error of a keyframe and its Jacobians, see `residual`.
Linear = tuple[FloatArray, FloatArray, FloatArray]


@message
class Keyframe:
    """The Gaussian of n landmarks seen from the pose A at its beginning to D at its end, of D, and of the parameters.

    With y = (the landmarks in A row by row, D in A) in the keyframe's unit and the shared parameters s, it costs e^T W
    e / 2 + v^T s, e = (y - y_0, s). ids: (n,) ascending, so that walls come first; none: odometry's way. y_AL: (n, 2),
    y_AD: (3,), y_0. anchor, reach: (n, 2) of walls, as of `messages.MapEstimate`, in A. unit: the parameter that is the
    scale of its lengths, or METRES, which it is where there are walls. information: W, (2n + 16, 2n + 16). vector: v,
    (13,). on_error: (n, 2, 2) derivative of each tag's y_AL on its constant errors of range, m, and bearing, rad. If
    on_error does not describe all of their effect, they are parameters behind s: W is (4n + 16, 4n + 16), and pull (n,
    2) their part of v. points: (p, 4) of its scans that are in no wall, with their normals, in A, see `scan_points`.
    scatter: (3, 3) covariance of the deviation of each scan's points from those of all, as moves of A.
    """

    ids: Annotated[IntArray, "n"]
    y_AL: Annotated[FloatArray, "n", 2]
    anchor: Annotated[FloatArray, "n", 2]
    reach: Annotated[FloatArray, "n", 2]
    y_AD: Annotated[FloatArray, 3]
    unit: int
    information: Annotated[FloatArray, "m", "m"]
    vector: Annotated[FloatArray, SHARED]
    on_error: Annotated[FloatArray, "n", 2, 2]
    pull: Annotated[FloatArray, "n", 2]
    points: Annotated[FloatArray, "p", 4] = dataclasses.field(default_factory=lambda: np.empty((0, 4)))
    scatter: Annotated[FloatArray, 3, 3] = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))

    @property
    def walls(self) -> int:
        """The number of its landmarks that are walls."""
        return int(np.searchsorted(self.ids, WALLS_BELOW))

    @property
    def measured(self) -> Measured:
        """Its landmarks and D, as the kernels take them."""
        return Measured(self.walls, self.y_AL, self.anchor, self.y_AD, self.unit)

    @property
    def without_errors(self) -> FloatArray:
        """W (2n + 16, 2n + 16) for zero constant errors of tags."""
        size = 2 * len(self.ids) + 3 + SHARED
        return np.ascontiguousarray(self.information[:size, :size])

    def with_errors(self) -> FloatArray:
        """Return W with the rows of the tags' errors, (4n + 16, 4n + 16)."""
        n, i = len(self.ids), np.arange(len(self.ids))
        if len(self.information) > 2 * n + 3 + SHARED:
            return self.information
        J = np.eye(2 * n + 3 + SHARED, 4 * n + 3 + SHARED)
        J[: 2 * n, 2 * n + 3 + SHARED :].reshape(n, 2, n, 2)[i, :, i, :] = self.on_error
        return np.asarray(J.T @ self.information @ J)

    def given(self, shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return p_AL (n, 2) and X_AD (3,), m and rad, and their covariance (2n + 3, 2n + 3), given the parameters
        (13,)."""
        covariance, by_shared = self.conditional()
        y = np.append(self.y_AL.ravel(), self.y_AD) + by_shared @ shared
        scale = np.append(np.full(len(y) - 1, 1.0 / scale_of(self.unit, shared)), 1.0)
        y *= scale
        return y[:-3].reshape(-1, 2), y[-3:], covariance * np.outer(scale, scale)

    def conditional(self) -> tuple[FloatArray, FloatArray]:
        """Covariance (2n + 3, 2n + 3) of y given the parameters, and derivative (2n + 3, 13) of its mean on them."""
        m, W = 2 * len(self.ids) + 3, self.without_errors
        # Scaled, as entries of angles and distances, or of well and hardly known ones, differ by many powers of ten.
        unit = 1.0 / np.sqrt(np.diag(W)[:m])
        covariance = unit[:, None] * np.linalg.inv(unit[:, None] * W[:m, :m] * unit) * unit
        covariance = 0.5 * (covariance + covariance.T)
        return covariance, -covariance @ W[:m, m:]

    def alone(self) -> tuple[FloatArray, FloatArray]:
        """Information (13, 13) of this keyframe alone on the parameters, and its gradient (13,) where they are zero."""
        m, W = 2 * len(self.ids) + 3, self.without_errors
        own = W[m:, m:] + W[m:, :m] @ self.conditional()[1]
        return 0.5 * (own + own.T), self.vector


def keyframe(
    landmarks: Landmarks, y: FloatArray, shared: FloatArray, unit: int, W: FloatArray, g: FloatArray
) -> Keyframe:
    """Return the keyframe of a cost with gradient g (u,) and Hessian W (u, u) at (y, shared), y: (2n + 3,), shared:
    (13,), and at zero errors of the tags, if they are among the u unknowns."""
    (ids, anchor, reach, on_error), m = landmarks, len(y)
    parameters = np.append(shared, np.zeros(len(W) - m - SHARED))
    back = np.linalg.solve(W[:m, :m], W[:m, m:] @ parameters - g[:m])
    y_AL, y_AD = (y + back)[:-3].reshape(-1, 2), (y + back)[-3:]
    vector = g[m:] + W[m:, :m] @ back - W[m:, m:] @ parameters
    pull = vector[SHARED:].reshape(-1, 2) if len(vector) > SHARED else np.zeros_like(y_AL)
    return Keyframe(ids, y_AL, anchor, reach, y_AD, unit, W, vector[:SHARED], on_error, pull)


def placed(X_FA: FloatArray, ids: IntArray, y_AL: FloatArray, anchor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return landmarks (n, 2) of A, and the anchors (n, 2) of the walls among them, in F: X_FA (3,)."""
    walls = ~is_tag(ids)
    y_FL, moved = se2.transform(X_FA, y_AL), np.where(walls[:, None], se2.transform(X_FA, anchor), 0.0)
    y_FL[walls] = y_AL[walls] + [X_FA[2], 0.0]
    return y_FL, moved


def joined_reach(
    wall: FloatArray, anchor: FloatArray, reach: FloatArray, at: FloatArray, other: FloatArray
) -> FloatArray:
    """Return the reach (n, 2) of walls (n, 2) from their anchors (n, 2), united with another reach (n, 2) from points
    at (n, 2)."""
    further = other + np.sum((at - anchor) * along_walls(wall), axis=1)[:, None]
    return np.column_stack([np.minimum(reach[:, 0], further[:, 0]), np.maximum(reach[:, 1], further[:, 1])])


def is_unknown(one: Keyframe) -> bool:
    """Return whether a keyframe is an unknown motion, as of a kidnapped robot."""
    return not len(one.ids) and bool(one.information[2, 2] <= OPEN_HEADING**-2)


def moved_points(X_FA: FloatArray, points: FloatArray) -> FloatArray:
    """Return points with normals (p, 4) of A, or each of its own frame, in F: X_FA (3,), or (p, 3)."""
    return np.hstack([se2.transform(X_FA, points[:, :2]), se2.transform(X_FA * [0.0, 0.0, 1.0], points[:, 2:])])


def moves_of_origin(X_AB: FloatArray) -> FloatArray:
    """Return the derivatives (k, 3, 3) of the origin A, fixed to B, on a move of B by x, y (m) and theta (rad) in A, at
    X_AB (k, 3)."""
    moves = np.tile(np.eye(3), (len(X_AB), 1, 1))
    moves[:, 0, 2], moves[:, 1, 2] = X_AB[:, 1], -X_AB[:, 0]
    return moves


def along_walls(wall: FloatArray) -> FloatArray:
    """Return unit vectors (n, 2) along walls (n, 2): their normals turned left by 90 degrees."""
    return np.column_stack([-np.sin(wall[:, 0]), np.cos(wall[:, 0])])


def without_tags(one: Keyframe, ids: IntArray) -> Keyframe:
    """Return the keyframe with some tags marginalised out."""
    keep = ~np.isin(one.ids, ids)
    return one if keep.all() else of_landmarks(one, np.flatnonzero(keep))


def of_landmarks(one: Keyframe, rows: IntArray) -> Keyframe:
    """Return the keyframe with only its landmarks in these rows (k,), in this order; the others are marginalised out,
    with zero constant errors."""
    n, pairs = len(one.ids), (2 * rows[:, None] + [0, 1]).ravel()
    errors = 2 * n + 3 + SHARED + pairs if len(one.information) > 2 * n + 3 + SHARED else pairs[:0]
    keep, gone = np.concatenate([pairs, 2 * n + np.arange(3 + SHARED), errors]), np.setdiff1d(np.arange(2 * n), pairs)
    across = one.information[np.ix_(keep, gone)]
    taken_off = across @ np.linalg.solve(one.information[np.ix_(gone, gone)], across.T)
    information = one.information[np.ix_(keep, keep)] - 0.5 * (taken_off + taken_off.T)
    return replace(take(one, n=rows), information=information)


def way(X_AD: FloatArray, covariance: FloatArray) -> Keyframe:
    """Return a keyframe of a motion that is not known from odometry: X_AD (3,) and its covariance (3, 3), m and rad."""
    none = np.empty((0, 2))
    return of_places(np.empty(0, dtype=np.int64), none, none, none, X_AD, covariance)


def of_places(
    ids: IntArray, p_AL: FloatArray, anchor: FloatArray, reach: FloatArray, X_AD: FloatArray, covariance: FloatArray
) -> Keyframe:
    """Return a keyframe without information on the parameters: p_AL (n, 2) of landmarks (n,), ascending, and X_AD (3,),
    m and rad, at zero parameters, with their covariance (2n + 3, 2n + 3). anchor, reach: of walls."""
    n = len(ids)
    information = np.zeros((2 * n + 3 + SHARED, 2 * n + 3 + SHARED))
    information[:-SHARED, :-SHARED] = np.linalg.inv(covariance)
    none = np.zeros((n, 2, 2)), np.zeros((n, 2))
    return Keyframe(ids, p_AL, anchor, reach, X_AD, METRES, information, np.zeros(SHARED), *none)


def fusion(first: Keyframe, second: Keyframe, shared: FloatArray) -> tuple[Keyframe, FloatArray, float]:
    """Fuse two consecutive keyframes, linearised at the parameters (13,). Returns also the pose (3,) between them in
    the first one's frame, m and rad, and the standard deviation of its position, m.

    Both have the same unit, so their relative pose contains no scale.
    """
    ids = np.union1d(first.ids, second.ids)
    rows = np.searchsorted(ids, first.ids), np.searchsorted(ids, second.ids)
    n = len(ids)
    (y_1, B, _), (y_2, X_BD, _) = (replace(one, unit=METRES).given(shared) for one in (first, second))
    y_AL, anchor, reach, D, A = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), se2.compose(B, X_BD), np.zeros(3)
    y_AL[rows[1]], anchor[rows[1]] = placed(B, second.ids, y_2, second.anchor)
    reach[rows[1]] = second.reach
    both = rows[0][: first.walls][np.isin(first.ids[: first.walls], second.ids)]
    also = anchor[both], reach[both]
    y_AL[rows[0]], anchor[rows[0]], reach[rows[0]] = y_1, first.anchor, first.reach
    reach[both] = joined_reach(y_AL[both], anchor[both], reach[both], *also)
    m, e, i = 2 * n + 3, 2 * n + 3 + SHARED, np.arange(n)

    def joined(errors: int) -> tuple[FloatArray, FloatArray]:
        """Hessian and gradient of both costs by landmarks, D, the parameters, `errors` tag errors, B; A is fixed."""
        size = e + errors + 3
        H, g = np.zeros((size + 3, size + 3)), np.zeros(size + 3)
        at = _places(rows[0], n, size - 3, size), _places(rows[1], n, 2 * n, size - 3)
        for one, row, place, ends in zip((first, second), rows, at, ((A, B), (B, D)), strict=True):
            at_zero = np.zeros(2 * len(row)) if errors else None
            H_k, g_k, _ = linearised(replace(one, unit=METRES), (y_AL[row], anchor[row]), ends, shared, at_zero)
            place = place[: len(g_k)]
            H[np.ix_(place, place)] += H_k
            g[place] += g_k
        return H[:size, :size], g[:size]

    free = np.append(np.arange(m), np.arange(e, e + 3))
    for _ in range(MOST_STEPS):
        H, g = joined(0)
        step = np.linalg.solve(H[np.ix_(free, free)], -g[free])
        y_AL += step[: 2 * n].reshape(-1, 2)
        D, B = D + step[2 * n : m], B + step[m:]
        if np.max(np.abs(step)) < SMALL_STEP:
            break
    covariance = np.linalg.inv(H[np.ix_(free, free)])
    H, g = joined(2 * n)
    across, of_B = H[:-3, -3:], np.linalg.inv(H[-3:, -3:])
    W, gradient = H[:-3, :-3] - across @ of_B @ across.T, g[:-3] - across @ of_B @ g[-3:]
    W = 0.5 * (W + W.T)
    moved = np.linalg.solve(W[:m, :m], W[:m, e:])[: 2 * n].reshape(n, 2, n, 2)
    y = np.append(y_AL.ravel(), D)
    on_error = np.asarray(moved[i, :, i, :], dtype=float)
    one = keyframe((ids, anchor, reach, on_error), y, shared, first.unit, W, gradient)
    y_AD = np.append(one.y_AD[:2], wrap(float(one.y_AD[2])))
    share = 1.0 / scale_of(first.unit, shared)
    deviation = share * math.sqrt(covariance[-3, -3] + covariance[-2, -2])
    X_AB = B * np.array([share, share, 1.0])
    points = np.vstack([first.points, moved_points(X_AB, second.points)])
    R, on_A = np.eye(3), moves_of_origin(X_AB[None])[0]
    R[:2, :2], of_B = se2.rotation(float(X_AB[2])), on_A @ covariance[-3:, -3:] @ on_A.T
    # Each half deviates from their mean by half of its deviation from the other.
    scatter = 0.5 * (first.scatter + on_A @ R @ second.scatter @ R.T @ on_A.T) + 0.25 * of_B
    return replace(one, y_AD=y_AD, points=points, scatter=scatter), X_AB, deviation


def _places(rows: IntArray, n: int, D: int, A: int) -> IntArray:
    """Return the indices of tags, D, A, the parameters and the tags' errors of a keyframe in a fusion of n tags."""
    tags, shared = (2 * rows[:, None] + [0, 1]).ravel(), 2 * n + 3 + np.arange(SHARED)
    return np.concatenate([tags, D + np.arange(3), A + np.arange(3), shared, 2 * n + 3 + SHARED + tags])


def linearised(
    one: Keyframe, landmarks: Pair, ends: Pair, shared: FloatArray, errors: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, float]:
    """Return Hessian, gradient and twice the cost of a keyframe, see `gradient_of`. landmarks: p_ML and p_MC, ends: A
    and D, see `residual`. errors: (2n,) of the tags, if these are parameters."""
    linear = residual(*landmarks, one.measured, *ends, shared)
    vector, parameters, information = one.vector, shared, one.without_errors
    if errors is not None:
        linear = with_errors(linear, errors)
        vector, parameters = np.append(vector, one.pull), np.append(shared, errors)
        information = one.with_errors()
    g, cost = gradient_of(linear, information, vector, parameters)
    return hessian(linear, information), g, cost


@njit(cache=True)
def wall_off(
    wall: FloatArray, p_MC: FloatArray, seen: FloatArray, p_AC: FloatArray, A: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return angle, rad, and distance, m, of a wall (2,) of the map with anchor p_MC (2,), less the measured ones (2,)
    with anchor p_AC (2,) from A (3,); and the derivatives of the distance on the wall's angle and on A's x, y, theta.
    Those of the angle are 1 on the wall's and -1 on A's."""
    c, s, n_x, n_y = math.cos(A[2]), math.sin(A[2]), math.cos(wall[0]), math.sin(wall[0])
    lever_x, lever_y = c * p_AC[0] - s * p_AC[1], s * p_AC[0] + c * p_AC[1]
    x, y = A[0] + lever_x - p_MC[0], A[1] + lever_y - p_MC[1]
    turn, off = wrap(wall[0] - A[2] - seen[0]), wall[1] - n_x * x - n_y * y - seen[1]
    return turn, off, n_y * x - n_x * y, -n_x, -n_y, n_x * lever_y - n_y * lever_x


@njit(cache=True)
def residual(
    p_ML: FloatArray, p_MC: FloatArray, measured: Measured, A: FloatArray, D: FloatArray, shared: FloatArray
) -> Linear:
    """Return the error (2n + 16,) of a keyframe, see Keyframe, its Jacobian `on` (2n + 16, 16) A and the parameters,
    and the Jacobians `by_landmark` (n + 1, 2, 2) on its landmarks and on D's position.

    p_ML: (n, 2) its landmarks, p_MC: (n, 2) the anchors of the walls among them.
    """
    walls, y_AL, p_AC, y_AD, unit = measured
    n, scale = len(p_ML), scale_of(unit, shared)
    c, s = math.cos(A[2]), math.sin(A[2])
    m = 2 * n + 3
    error, on, by_landmark = np.empty(m + SHARED), np.zeros((m + SHARED, 3 + SHARED)), np.empty((n + 1, 2, 2))
    for i in range(n + 1):
        a, b = 2 * i, 2 * i + 1
        if i < walls:
            error[a], error[b], by_angle, by_x, by_y, by_theta = wall_off(p_ML[i], p_MC[i], y_AL[i], p_AC[i], A)
            on[a, 2], on[b, 0], on[b, 1], on[b, 2] = -1.0, by_x, by_y, by_theta
            by_landmark[i, 0, 0], by_landmark[i, 0, 1] = 1.0, 0.0
            by_landmark[i, 1, 0], by_landmark[i, 1, 1] = by_angle, 1.0
            continue
        if i < n:
            dx, dy = p_ML[i, 0] - A[0], p_ML[i, 1] - A[1]
            seen_x, seen_y = y_AL[i, 0], y_AL[i, 1]
        else:
            dx, dy, seen_x, seen_y = D[0] - A[0], D[1] - A[1], y_AD[0], y_AD[1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        error[a], error[b] = scale * x - seen_x, scale * y - seen_y
        on[a, 0], on[a, 1], on[a, 2] = -scale * c, -scale * s, scale * y
        on[b, 0], on[b, 1], on[b, 2] = scale * s, -scale * c, -scale * x
        by_landmark[i, 0, 0], by_landmark[i, 0, 1] = scale * c, scale * s
        by_landmark[i, 1, 0], by_landmark[i, 1, 1] = -scale * s, scale * c
        if unit != METRES:
            on[a, 3 + unit], on[b, 3 + unit] = x, y
    error[m - 1] = wrap(D[2] - A[2] - y_AD[2])
    on[m - 1, 2] = -1.0
    error[m:], on[m:, 3:] = shared, np.eye(SHARED)
    return error, on, by_landmark


@njit(cache=True)
def with_errors(linear: Linear, errors: FloatArray) -> Linear:
    """Return a keyframe's error with the tags' errors (2n,) among the parameters, after the others."""
    error, on, by_landmark = linear
    m, k = len(error), len(errors)
    whole, wide = np.empty(m + k), np.zeros((m + k, on.shape[1] + k))
    whole[:m], whole[m:], wide[:m, : on.shape[1]] = error, errors, on
    wide[m:, on.shape[1] :] = np.eye(k)
    return whole, wide, by_landmark


@njit(cache=True)
def gradient_of(
    linear: Linear, information: FloatArray, vector: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, float]:
    """Return the gradient (u,) of a keyframe's cost, in the order landmarks, D, A, parameters (p,), and twice the cost.

    vector: (p,) as of Keyframe.
    """
    error, on, by_landmark = linear
    weighted, m, p = information @ error, len(error) - len(parameters), len(parameters)
    g = np.empty((m + 3 + p, 1))
    for i in range(0, m - 1, 2):
        turned(g, i, 0, weighted[i], weighted[i + 1], by_landmark[i // 2])
    g[m - 1, 0] = weighted[m - 1]
    g[m:, 0] = on.T @ weighted
    cost = float(error @ weighted)
    for i in range(p):
        g[m + 3 + i, 0] += vector[i]
        cost += 2.0 * vector[i] * parameters[i]
    return g[:, 0].copy(), cost


@njit(cache=True)
def hessian(linear: Linear, information: FloatArray) -> FloatArray:
    """Return the Hessian (u, u) of a keyframe's cost, in the order of `gradient_of`."""
    _, on, by_landmark = linear
    m, size = 2 * len(by_landmark) + 1, 2 * len(by_landmark) + 1 + on.shape[1]
    weighted_on = information @ on
    H, half = np.empty((size, size)), np.empty((m, m))
    for i in range(0, m - 1, 2):
        L = by_landmark[i // 2]
        for j in range(m):
            turned(half, i, j, information[i, j], information[i + 1, j], L)
        for j in range(on.shape[1]):
            turned(H, i, m + j, weighted_on[i, j], weighted_on[i + 1, j], L)
    half[m - 1] = information[m - 1, :m]
    H[m - 1, m:] = weighted_on[m - 1]
    for j in range(0, m - 1, 2):
        L = by_landmark[j // 2]
        for i in range(m):
            H[i, j] = half[i, j] * L[0, 0] + half[i, j + 1] * L[1, 0]
            H[i, j + 1] = half[i, j] * L[0, 1] + half[i, j + 1] * L[1, 1]
    for i in range(m):
        H[i, m - 1] = half[i, m - 1]
        H[m:, i] = H[i, m:]
    H[m:, m:] = on.T @ weighted_on
    return H


@njit(cache=True)
def turned(into: FloatArray, i: int, j: int, a: float, b: float, L: FloatArray) -> None:
    """Put L^T (a, b), by a landmark's Jacobian L (2, 2), into rows i and i + 1 of column j."""
    into[i, j], into[i + 1, j] = L[0, 0] * a + L[1, 0] * b, L[0, 1] * a + L[1, 1] * b


def rows_of(ids: IntArray, known: IntArray) -> tuple[IntArray, BoolArray]:
    """Return rows (m,) of some ids among the known ones (n,), ascending, and a mask (m,) of those that are known."""
    if len(known) == 0:
        return np.zeros(len(ids), dtype=np.int64), np.zeros(len(ids), dtype=bool)
    row = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return row, np.asarray(known[row] == ids)

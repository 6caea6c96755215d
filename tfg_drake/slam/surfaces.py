"""Pieces of surface, which tie the poses from which they are seen.

The scan points of all keyframes that lie on no wall are sorted into cells of the map and, within a cell, grouped by
normal. Each group is taken as a straight piece of surface. Its offset and slope are eliminated at once, which leaves
ties between the poses of the keyframes that see it. Groups and weights follow from the initial values of a solve; the
origin of the cells varies from solve to solve, so that no surface lies on a border permanently.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe import moved_points, moves_of_origin
from tfg_drake.slam.odometry_model import wrap

# Side of a cell, m. Points of a cell are one piece if their normals, sorted by direction, differ by at most SAME_WAY,
# rad, from one to the next, and the normals' mean is longer than COMMON.
CELL = 0.3
SAME_WAY, COMMON = 0.45, 0.8
# Number of intervals of a full turn by which directions are sorted.
TURNS = 4096
# Deviations. POINT: of a point, m. FLOOR: the error common to all points of one look at a piece, m. SLOPE: of a piece's
# slope to the mean of its points' normals.
POINT, FLOOR, SLOPE = 0.02, 0.01, 0.15
# The weight of a point on an edge, as the edge seen varies with the place it is seen from.
EDGE = 0.25
# Scale of the Cauchy weights, m, and the iterations after which they have converged.
ROBUST, ROUNDS = 0.04, 5
# Gauss-Newton steps that align the scans of one keyframe.
STEPS = 2


class Points(NamedTuple):
    """p scan points of k keyframes. keyframe: (p,) ascending. p_AP: (p, 4) place, m, and unit normal, in its A. part:
    (k,) ascending numbers of the map's parts, which are separated by unknown motions. scatter: (k, 3, 3) see
    `Keyframe`."""

    keyframe: IntArray
    p_AP: FloatArray
    part: IntArray
    scatter: FloatArray


class Pieces(NamedTuple):
    """g pieces of surface. Piece i has the looks looks[i]:looks[i + 1], each of one keyframe, keyframe (l,). frame:
    (g, 4) origin in M, m, and unit normal of its offset. moments: (l, 6) sums of the weights, 1/m^2, of a look's
    points, times 1, x, y, x^2, xy and y^2 in A.
    """

    frame: FloatArray
    looks: IntArray
    keyframe: IntArray
    moments: FloatArray

    @property
    def piece(self) -> IntArray:
        """The piece (l,) of each look."""
        return np.repeat(np.arange(len(self.frame)), np.diff(self.looks))


def pieces_of(points: Points, X_MN: FloatArray, seed: int, unevenness: float = 0.0) -> Pieces:
    """Return the pieces of surface that two or more keyframes of a part see, with poses X_MN (k, 3). unevenness: m, see
    `scan_lines.unevenness_after`: an error common to all points of one look."""
    if not len(points.keyframe):
        none = np.zeros(0, dtype=np.int64)
        return Pieces(np.zeros((0, 4)), np.zeros(1, dtype=np.int64), none, np.zeros((0, 6)))
    rng = np.random.default_rng(seed)
    # An edge is a piece in either direction.
    edge = ~points.p_AP[:, 2:].any(axis=1)
    of_kind = [np.flatnonzero(~edge), np.flatnonzero(edge), np.flatnonzero(edge)]
    kind, every = np.repeat(np.arange(3), [len(some) for some in of_kind]), np.concatenate(of_kind)
    points = points._replace(keyframe=points.keyframe[every], p_AP=points.p_AP[every])
    p_MP = moved_points(X_MN[points.keyframe], points.p_AP)
    p_MP[kind > 0, 2:] = np.eye(2)[kind[kind > 0] - 1]
    cell = np.floor((p_MP[:, :2] + rng.uniform(0.0, CELL, 2)) / CELL).astype(np.int64)
    cell -= cell.min(axis=0)
    column = points.part[points.keyframe] * (cell[:, 0].max() + 1) + cell[:, 0]
    of_cell = 3 * (column * (cell[:, 1].max() + 1) + cell[:, 1]) + kind
    # Directions from a random one on.
    direction = (np.arctan2(p_MP[:, 3], p_MP[:, 2]) - rng.uniform(0.0, 2.0 * math.pi)) % (2.0 * math.pi)
    turn = np.minimum((direction * (TURNS / (2.0 * math.pi))).astype(np.int64), TURNS - 1)
    order = _order(of_cell * TURNS + turn)
    new = (np.diff(of_cell[order], prepend=-1) != 0) | (np.diff(direction[order], prepend=0.0) > SAME_WAY)
    piece = np.empty(len(order), dtype=np.int64)
    piece[order] = np.cumsum(new) - 1
    rows = _order(piece)  # Keyframes are in order before.
    piece, keyframe = piece[rows], points.keyframe[rows]
    begin = np.flatnonzero((np.diff(piece, prepend=-1) != 0) | (np.diff(keyframe, prepend=-1) != 0))
    piece, keyframe, begin = piece[begin], keyframe[begin], np.append(begin, len(rows))
    looks = np.append(np.flatnonzero(np.diff(piece, prepend=-1) != 0), len(piece))
    mean = np.add.reduceat(p_MP[rows], begin[looks[:-1]], axis=0) / np.diff(begin[looks])[:, None]
    length = np.hypot(mean[:, 2], mean[:, 3])
    mean[:, 2:] /= np.maximum(length, COMMON)[:, None]
    # A piece of one keyframe alone ties nothing; points with normals in all directions are no surface.
    kept = (np.diff(looks) > 1) & (length > COMMON)
    some, worth, floor = np.repeat(kept, np.diff(looks)), np.where(kind > 0, EDGE, 1.0), FLOOR**2 + unevenness**2
    placed = p_MP[rows], points.p_AP[rows], worth[rows]
    moments = _weighed(np.flatnonzero(kept), mean, looks, begin, placed, floor)[some]
    normal, keyframe = np.repeat(mean[:, 2:], np.diff(looks), axis=0)[some], keyframe[some]
    moments *= _worth(keyframe, normal, moments, X_MN, points.scatter)[:, None]
    return Pieces(mean[kept], np.append(0, np.cumsum(np.diff(looks)[kept])), keyframe, moments)


def _worth(
    keyframe: IntArray, normal: FloatArray, moments: FloatArray, X_MN: FloatArray, scatter: FloatArray
) -> FloatArray:
    """Return the share (l,) of its weight with which a look at a piece with a normal (l, 2) in M counts, given the
    scatter of its keyframe's scans: it shifts all n looks of the keyframe together, so each gets n times that
    variance."""
    c, s, (n_x, n_y) = np.cos(X_MN[keyframe, 2]), np.sin(X_MN[keyframe, 2]), normal.T
    a_x, a_y, M, Q = c * n_x + s * n_y, c * n_y - s * n_x, moments.T, scatter[keyframe]
    # The points' sums of weights, times how far they go along the normal with a turn of A, and times its square.
    lever, turn = a_y * M[1] - a_x * M[2], a_y * a_y * M[3] - 2.0 * a_x * a_y * M[4] + a_x * a_x * M[5]
    moved = a_x * a_x * Q[:, 0, 0] + 2.0 * a_x * a_y * Q[:, 0, 1] + a_y * a_y * Q[:, 1, 1]
    over = M[0] * moved + 2.0 * lever * (a_x * Q[:, 0, 2] + a_y * Q[:, 1, 2]) + turn * Q[:, 2, 2]
    return np.asarray(1.0 / (1.0 + np.bincount(keyframe)[keyframe] * over))


def _order(keys: IntArray) -> IntArray:
    """Return the stable order (n,) of integers (n,): the keys are made distinct, as the fastest sort is five times as
    fast as a stable one."""
    return np.asarray(np.argsort(keys * len(keys) + np.arange(len(keys))))


# p_MP (p, 4) and p_AP (p, 4) of some points, and what each is worth (p,).
PlacedPoints = tuple[FloatArray, FloatArray, FloatArray]


class Ties(NamedTuple):
    """t pairs of keyframes, first and second (t,), the second at X_AB (t, 3) of the first, by information (t, 3, 3)."""

    first: IntArray
    second: IntArray
    X_AB: FloatArray
    information: FloatArray


def no_ties() -> Ties:
    """Return no ties."""
    none = np.zeros(0, dtype=np.int64)
    return Ties(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)))


@njit(cache=True)
def scatter(H: FloatArray, g: FloatArray, at: IntArray, block: FloatArray, gradient: FloatArray) -> None:
    """Add a Hessian (k, k) to the block, if it has rows, and a gradient (k,) to the gradient, at the unknowns `at`
    (k,), negative for none."""
    for i in range(len(at)):
        if at[i] >= 0:
            gradient[at[i]] += g[i]
            for j in range(len(at) if len(block) else 0):
                if at[j] >= 0:
                    block[at[i], at[j]] += H[i, j]


@njit(cache=True)
def add_ties(
    which: IntArray, ties: Ties, X_MN: FloatArray, node_at: IntArray, block: FloatArray, gradient: FloatArray
) -> float:
    """Add Hessian and gradient of some ties, which (q,); arguments and result as of `add_pieces`."""
    total, J, e, at = 0.0, np.zeros((3, 6)), np.empty(3), np.empty(6, dtype=np.int64)
    for t in which:
        first, second, X_AB, information = ties.first[t], ties.second[t], ties.X_AB[t], ties.information[t]
        A, B = X_MN[first], X_MN[second]
        c, s, dx, dy = math.cos(A[2]), math.sin(A[2]), B[0] - A[0], B[1] - A[1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        e[0], e[1], e[2] = x - X_AB[0], y - X_AB[1], wrap(B[2] - A[2] - X_AB[2])
        J[0, 0], J[0, 1], J[0, 2], J[0, 3], J[0, 4] = -c, -s, y, c, s
        J[1, 0], J[1, 1], J[1, 2], J[1, 3], J[1, 4] = s, -c, -x, -s, c
        J[2, 2], J[2, 5] = -1.0, 1.0
        weighted = information @ e
        total += float(e @ weighted)
        for a in range(3):
            at[a] = node_at[first] + a if node_at[first] >= 0 else -1
            at[3 + a] = node_at[second] + a if node_at[second] >= 0 else -1
        scatter(J.T @ information @ J, J.T @ weighted, at, block, gradient)
    return total


@njit(cache=True)
def _weighed(
    which: IntArray, frame: FloatArray, looks: IntArray, begin: IntArray, placed: PlacedPoints, floor: float
) -> FloatArray:
    """Return the moments (l, 6) of the looks at some pieces. Look j has the points begin[j]:begin[j + 1]. floor: m^2,
    the variance that they have in common."""
    moments, (p_MP, p_AP, worth) = np.zeros((looks[-1], 6)), placed
    for g in which:
        first, last = begin[looks[g]], begin[looks[g + 1]]
        m_x, m_y, n_x, n_y = frame[g]
        weight, offset, slope = np.empty(last - first), 0.0, 0.0
        for _ in range(ROUNDS):
            S0, S1, S2, g0, g1 = 0.0, 0.0, 1.0 / SLOPE**2, 0.0, 0.0
            for j in range(looks[g], looks[g + 1]):
                of_look = 1.0 / (POINT**2 + (begin[j + 1] - begin[j]) * floor)
                for i in range(begin[j], begin[j + 1]):
                    d_x, d_y = p_MP[i, 0] - m_x, p_MP[i, 1] - m_y
                    across, along = n_x * d_x + n_y * d_y, n_x * d_y - n_y * d_x
                    w = worth[i] * of_look / (1.0 + ((across - offset - slope * along) / ROBUST) ** 2)
                    weight[i - first] = w
                    S0, S1, S2 = S0 + w, S1 + w * along, S2 + w * along * along
                    g0, g1 = g0 + w * across, g1 + w * across * along
            det = S0 * S2 - S1 * S1
            offset, slope = (S2 * g0 - S1 * g1) / det, (S0 * g1 - S1 * g0) / det
        for j in range(looks[g], looks[g + 1]):
            for i in range(begin[j], begin[j + 1]):
                w, x, y = weight[i - first], p_AP[i, 0], p_AP[i, 1]
                of = moments[j]
                of[0], of[1], of[2] = of[0] + w, of[1] + w * x, of[2] + w * y
                of[3], of[4], of[5] = of[3] + w * x * x, of[4] + w * x * y, of[5] + w * y * y
    return moments


@njit(cache=True)
def add_pieces(
    which: IntArray, pieces: Pieces, X_MN: FloatArray, node_at: IntArray, block: FloatArray, gradient: FloatArray
) -> float:
    """Add Hessian and gradient of some pieces of surface, which (q,), to a block (u, u), if it has rows, and gradient
    (u,) of unknowns; the pose of keyframe k begins at node_at[k], negative for none. Returns twice the cost.
    """
    total, own, (frame, looks, keyframe, moments) = 0.0, np.empty((3, 3)), pieces
    for g in which:
        first, m = looks[g], looks[g + 1] - looks[g]
        m_x, m_y, n_x, n_y = frame[g]
        # Of each look: the normal in its frame A, and A's distances across and along the piece.
        of = np.empty((m, 4))
        S0, S1, S2, g0, g1 = 0.0, 0.0, 1.0 / SLOPE**2, 0.0, 0.0
        for k in range(m):
            X, M = X_MN[keyframe[first + k]], moments[first + k]
            c, s = math.cos(X[2]), math.sin(X[2])
            a_x, a_y, d_x, d_y = c * n_x + s * n_y, -s * n_x + c * n_y, X[0] - m_x, X[1] - m_y
            across, along = n_x * d_x + n_y * d_y, n_x * d_y - n_y * d_x
            of[k, 0], of[k, 1], of[k, 2], of[k, 3] = a_x, a_y, across, along
            # Sums of the points' distances across and along, weighted.
            by_x, by_y = a_x * M[1] + a_y * M[2], a_x * M[2] - a_y * M[1]
            of_across, of_along = by_x + across * M[0], by_y + along * M[0]
            xx, xy, yy = M[3], M[4], M[5]
            both = a_x * a_y * (yy - xx) + (a_x * a_x - a_y * a_y) * xy
            S0, S1 = S0 + M[0], S1 + of_along
            S2 += a_x * a_x * yy - 2.0 * a_x * a_y * xy + a_y * a_y * xx + 2.0 * along * by_y + along * along * M[0]
            g0 += of_across
            g1 += both + along * by_x + across * by_y + across * along * M[0]
        det = S0 * S2 - S1 * S1
        I00, I01, I11 = S2 / det, -S1 / det, S0 / det
        offset, slope = I00 * g0 + I01 * g1, I01 * g0 + I11 * g1
        total += (slope / SLOPE) ** 2
        # A point is off by q . p - offset; the pose moves it by q, and turns it by h . p of its place in A.
        q_x, q_y = n_x + slope * n_y, n_y - slope * n_x
        by_piece = np.empty((m, 6))
        for k in range(m):
            M, at = moments[first + k], node_at[keyframe[first + k]]
            a_x, a_y, along = of[k, 0], of[k, 1], of[k, 3]
            u_x, u_y = a_x + slope * a_y, a_y - slope * a_x
            h_x, h_y, d = u_y, -u_x, of[k, 2] - slope * along - offset
            e0 = u_x * M[1] + u_y * M[2] + d * M[0]
            e_x, e_y = u_x * M[3] + u_y * M[4] + d * M[1], u_x * M[4] + u_y * M[5] + d * M[2]
            total += u_x * e_x + u_y * e_y + d * e0
            lever = h_x * M[1] + h_y * M[2]
            t0 = a_x * M[2] - a_y * M[1] + along * M[0]
            t_x, t_y = a_x * M[4] - a_y * M[3] + along * M[1], a_x * M[5] - a_y * M[4] + along * M[2]
            by_piece[k] = -q_x * M[0], -q_y * M[0], -lever, -q_x * t0, -q_y * t0, -(h_x * t_x + h_y * t_y)
            if at < 0:
                continue
            gradient[at] += q_x * e0
            gradient[at + 1] += q_y * e0
            gradient[at + 2] += h_x * e_x + h_y * e_y
            if len(block):
                turn = h_x * h_x * M[3] + 2.0 * h_x * h_y * M[4] + h_y * h_y * M[5]
                own[0] = q_x * q_x * M[0], q_x * q_y * M[0], q_x * lever
                own[1] = q_x * q_y * M[0], q_y * q_y * M[0], q_y * lever
                own[2] = q_x * lever, q_y * lever, turn
                block[at : at + 3, at : at + 3] += own
        for k in range(m if len(block) else 0):
            at = node_at[keyframe[first + k]]
            for q in range(m if at >= 0 else 0):
                other = node_at[keyframe[first + q]]
                if other < 0:
                    continue
                for a in range(3):
                    u = by_piece[k, a] * I00 + by_piece[k, 3 + a] * I01
                    v = by_piece[k, a] * I01 + by_piece[k, 3 + a] * I11
                    for b in range(3):
                        block[at + a, other + b] -= u * by_piece[q, b] + v * by_piece[q, 3 + b]
    return total


def put_together(
    seen: Sequence[FloatArray], X_AB: FloatArray, ties: Ties, unevenness: float
) -> tuple[FloatArray, FloatArray]:
    """Align the points (p_i, 4), in B, of m scans by their common surfaces and by ties between neighbours; returns the
    points (p, 4) in A and the remaining `Keyframe.scatter`. X_AB: (m, 3) initial poses; the first is fixed.
    unevenness: see `pieces_of`."""
    m, X, scatter = len(seen), X_AB.copy(), np.zeros((3, 3))
    keyframe, p_BP = np.repeat(np.arange(m), [len(some) for some in seen]), np.vstack([np.empty((0, 4)), *seen])
    if m > 1:
        points = Points(keyframe, p_BP, np.zeros(m, dtype=np.int64), np.zeros((m, 3, 3)))
        node_at, covariance = 3 * np.arange(m) - 3, np.zeros((3 * m, 3 * m))
        for step in range(STEPS):
            pieces = pieces_of(points, X, step, unevenness)
            H, g = np.zeros((3 * m - 3, 3 * m - 3)), np.zeros(3 * m - 3)
            add_pieces(np.arange(len(pieces.frame)), pieces, X, node_at, H, g)
            add_ties(np.arange(m - 1), ties, X, node_at, H, g)
            covariance[3:, 3:] = np.linalg.inv(H)
            X[1:] -= (covariance[3:, 3:] @ g).reshape(-1, 3)
        on_A = moves_of_origin(X)
        moves = np.einsum("iab,ibjc,jdc->iajd", on_A, covariance.reshape(m, 3, m, 3), on_A)
        scatter = np.einsum("iaib->ab", moves) / m - moves.sum(axis=(0, 2)) / m**2
    return moved_points(X[keyframe], p_BP), np.asarray(scatter)

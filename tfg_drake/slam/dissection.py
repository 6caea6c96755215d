"""The default solver: nested dissection of the keyframe graph, dense fronts eliminated by LAPACK.

The keyframes are bisected recursively; the unknowns that two halves share are eliminated last. A front is a half at
some depth: the unknowns eliminated in it, which no keyframe outside uses, and its boundary, which the fronts above
eliminate. All fronts are dense, so LAPACK does the work. See George, "Nested dissection of a regular finite element
mesh" (1973), and Liu, "The multifrontal method for sparse matrix solution" (1992). The work grows with the cube of the
number of shared unknowns, so each part is cut where they are fewest.

One elimination serves all steps as long as the values do not move far. The result is exact, as each gradient is
computed anew. The shared parameters are eliminated last.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import scipy.linalg
from numba import njit
from scipy.linalg import blas, lapack

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import NONE, Unknowns, Values, assemble, factors_of
from tfg_drake.slam.surfaces import add_pieces, add_ties

# Greatest number of keyframes of a leaf.
LEAF = 32
# A part is bisected along the best of DIRECTIONS directions; the smaller half holds at least LEAST_SHARE of it.
DIRECTIONS = 8
LEAST_SHARE = 0.4


@dataclasses.dataclass(frozen=True)
class Front:
    """A part of the graph. unknowns: (f,) ascending, the first `own` of them, which are consecutive, are eliminated
    here. halves: indices of its two halves among the fronts, empty in a leaf. keyframes: (q,) of a leaf. above: (f -
    own,) indices of the others among the unknowns of the front above. pieces: those of surface, assembled here."""

    unknowns: IntArray
    own: int
    halves: tuple[int, ...]
    keyframes: IntArray
    above: IntArray
    pieces: IntArray

    @property
    def eliminated(self) -> slice:
        """The slice of the unknowns that are eliminated here."""
        return slice(int(self.unknowns[0]), int(self.unknowns[0]) + self.own) if self.own else slice(0, 0)

    @property
    def boundary(self) -> IntArray:
        """(f - own,) the unknowns that are eliminated above."""
        return self.unknowns[self.own :]


@dataclasses.dataclass(frozen=True)
class Dissection:
    """Fronts, each after its halves, and the numbering of the unknowns. at: (g,) the first unknown of each of g
    variables, NONE for an omitted one. size: number of unknowns."""

    fronts: tuple[Front, ...]
    at: IntArray
    size: int


@dataclasses.dataclass(frozen=True)
class Elimination:
    """The Cholesky factor of the information. parts: each front, the (own, own) factor and (f - own, own) its rows for
    the boundary. log_determinant: of the information."""

    parts: tuple[tuple[Front, FloatArray, FloatArray], ...]
    log_determinant: float

    def solution(self, vector: FloatArray) -> FloatArray:
        """Return the solution x (u,) of information times x = vector (u,)."""
        x = vector.copy()
        for front, lower, below in self.parts:
            if front.own:
                x[front.eliminated] = lapack.dtrtrs(lower, x[front.eliminated], lower=1)[0]
                x[front.boundary] -= below @ x[front.eliminated]
        for front, lower, below in reversed(self.parts):
            if front.own:
                known = below.T @ x[front.boundary]
                x[front.eliminated] = lapack.dtrtrs(lower, x[front.eliminated] - known, lower=1, trans=1)[0]
        return x

    def covariance(self, at: IntArray) -> FloatArray:
        """Return the joint covariance (c, c) of some unknowns (c,): R^T R with R = L^-1 times their columns of the
        identity, which is zero but in the fronts where the unknowns are eliminated and in those above."""
        order = np.argsort(at, kind="stable")
        columns, joint = at[order], np.zeros((len(at), len(at)))
        left: dict[int, FloatArray] = {}
        done = 0
        for p, (front, lower, below) in enumerate(self.parts):
            # The columns of the unknowns eliminated below, half by half, precede those of the front's own unknowns.
            halves = [(self.parts[half][0].above, left.pop(half)) for half in front.halves]
            first, last = np.searchsorted(columns, [done, done + front.own])
            begin = first - sum(part.shape[1] for _, part in halves)
            right, column = np.zeros((len(front.unknowns), last - begin), order="F"), 0
            for above, part in halves:
                right[above, column : column + part.shape[1]] = part
                column += part.shape[1]
            right[columns[first:last] - done, np.arange(first, last) - begin] = 1.0
            left[p] = right[front.own :]
            if front.own and last > begin:
                root_part = blas.dtrsm(1.0, lower, right[: front.own], lower=1)
                joint[begin:last, begin:last] += root_part.T @ root_part
                left[p] = left[p] - below @ root_part
            done += front.own
        back = np.argsort(order, kind="stable")
        return np.asarray(joint[np.ix_(back, back)])


@dataclasses.dataclass(frozen=True)
class System(Elimination):
    """A graph's linearised and eliminated system. gradient: (u,) of the cost, error: twice the cost.
    places: (., 2, 3) Hessian and gradient of each keyframe on each of its tags."""

    gradient: FloatArray
    error: float
    places: FloatArray


def leaves(points: FloatArray, variable: IntArray, keyframe: IntArray, most: int = LEAF) -> IntArray:
    """Return the leaf (k,) of each of k keyframes: 2^d leaves of at most `most` keyframes, such that leaves 2 i and
    2 i + 1 are halves of one part.

    Args:
        points: (k, 2) positions of the keyframes.
        variable, keyframe: (e,) pairs of a variable and a keyframe that uses it.
    """
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    along = points @ np.stack([np.cos(angle), np.sin(angle)])
    order = np.argsort(variable, kind="stable")
    parts = [(np.arange(len(points)), variable[order], keyframe[order])]
    while max(len(part) for part, _, _ in parts) > most:
        parts = [half for part in parts for half in _halves(along, *part)]
    leaf = np.zeros(len(points), dtype=np.int64)
    for number, (part, _, _) in enumerate(parts):
        leaf[part] = number
    return leaf


def _halves(
    along: FloatArray, part: IntArray, variable: IntArray, keyframe: IntArray
) -> list[tuple[IntArray, IntArray, IntArray]]:
    """Return both halves of a part of the keyframes (q,), cut so that the fewest variables are on both sides, each with
    its variables.

    along: (k, d) coordinates of all keyframes in each direction. variable, keyframe: (e,) as in `leaves`, ascending by
    variable, only of variables that no keyframe outside the part has.
    """
    q, directions = len(part), along.shape[1]
    order = np.argsort(along[part], axis=0, kind="stable")
    place = np.empty((len(along), directions), dtype=np.int64)
    place[part[order], np.arange(directions)] = np.arange(q)[:, None]
    least = math.ceil(LEAST_SHARE * q)
    cuts = np.arange(least, max(least, q - least) + 1)
    begins = np.flatnonzero(np.diff(variable, prepend=-1))
    first = last = np.empty((0, directions), dtype=np.int64)
    if len(begins):
        first, last = (each.reduceat(place[keyframe], begins, axis=0) for each in (np.minimum, np.maximum))
    # A cut is crossed by the variables that begin before it minus those that end before it.
    column, count = np.arange(directions), directions * (q + 1)
    begun, ended = (np.bincount((directions * (of + 1) + column).ravel(), minlength=count) for of in (first, last))
    shared = np.cumsum((begun - ended).reshape(q + 1, directions), axis=0)[cuts]
    best, direction = np.unravel_index(np.argmin(shared), shared.shape)
    cut, first, last = cuts[best], first[:, direction], last[:, direction]
    number = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(variable))))
    before, after = (last < cut)[number], (first >= cut)[number]
    ordered = part[order[:, direction]]
    return [
        (ordered[:cut], variable[before], keyframe[before]),
        (ordered[cut:], variable[after], keyframe[after]),
    ]


def dissected(
    leaf: IntArray, variable: IntArray, keyframe: IntArray, width: IntArray, tied: IntArray, piece: IntArray
) -> Dissection:
    """Return the dissection of a graph.

    Args:
        leaf: (k,) of each keyframe, as of `leaves`.
        variable, keyframe: (e,) pairs of a variable, from 0 to g - 1, and a keyframe that uses it.
        width: (g,) number of unknowns of each variable, 0 if it is omitted.
        tied, piece: (t,) pairs of a variable and a piece of surface that ties it.
    """
    depth = int(leaf.max(initial=0)).bit_length()
    number = len(width)
    first, last = np.full(number, 2**depth), np.full(number, -1)
    np.minimum.at(first, variable, leaf[keyframe])
    np.maximum.at(last, variable, leaf[keyframe])
    lowest = first[tied], last[tied]
    pieces = int(piece.max(initial=-1)) + 1
    lower, upper = np.full(pieces, 2**depth), np.full(pieces, -1)
    np.minimum.at(lower, piece, lowest[0])
    np.maximum.at(upper, piece, lowest[1])
    np.minimum.at(first, tied, lower[piece])
    np.maximum.at(last, tied, upper[piece])
    # Variables of no keyframe go to the first leaf.
    unseen = np.flatnonzero(last < 0)
    first[unseen] = last[unseen] = 0
    # A variable is eliminated in the lowest front that has all of its keyframes, `up` levels above the leaves.
    up = np.frexp((first ^ last).astype(float))[1]
    # A complete binary tree of fronts, each after its halves.
    place = {(level, i): p for p, (level, i) in enumerate(_in_order(depth, 0))}
    table = np.full((depth + 1, 2**depth), -1)
    for (level, i), p in place.items():
        table[level, i] = p
    of = table[up, first >> up]
    level = np.frexp((lower ^ upper).astype(float))[1]
    of_piece = table[level, lower >> level] if pieces else np.zeros(0, dtype=np.int64)
    order = np.argsort(of, kind="stable")
    order = order[width[order] > 0]
    at = np.full(number, NONE)
    at[order] = np.cumsum(width[order]) - width[order]

    by_leaf = np.argsort(leaf[keyframe], kind="stable")
    variable_of = np.split(variable[by_leaf], np.searchsorted(leaf[keyframe][by_leaf], np.arange(1, 2**depth)))
    nothing = np.empty(0, dtype=np.int64)
    fronts: list[Front] = []
    for (level, i), p in place.items():
        halves: tuple[int, ...] = ()
        if level == 0:
            some = np.unique(np.append(variable_of[i], unseen) if i == 0 else variable_of[i])
            some = some[width[some] > 0]
            each = np.repeat(at[some], width[some])
            has = np.sort(each + np.arange(len(each)) - np.repeat(np.cumsum(width[some]) - width[some], width[some]))
        else:
            halves = (place[level - 1, 2 * i], place[level - 1, 2 * i + 1])
            has = np.union1d(*(fronts[half].boundary for half in halves))
        for half in halves:
            fronts[half] = dataclasses.replace(fronts[half], above=np.searchsorted(has, fronts[half].boundary))
        keyframes = nothing if halves else np.flatnonzero(leaf == i)
        fronts.append(Front(has, int(width[of == p].sum()), halves, keyframes, nothing, np.flatnonzero(of_piece == p)))
    return Dissection(tuple(fronts), at, int(width.sum()))


def _in_order(level: int, i: int) -> list[tuple[int, int]]:
    """Return level and number of a front and of all below it, each after its halves."""
    if level == 0:
        return [(0, i)]
    return [*_in_order(level - 1, 2 * i), *_in_order(level - 1, 2 * i + 1), (level, i)]


def eliminated(dissection: Dissection, block: Callable[[Front], FloatArray], damping: float = 0.0) -> Elimination:
    """Eliminate the system.

    block: returns the information (f, f) assembled in a front. damping: added to that of each unknown.
    Raises numpy.linalg.LinAlgError if it is singular.
    """
    parts: list[tuple[Front, FloatArray, FloatArray]] = []
    left: dict[int, FloatArray] = {}
    log_determinant = 0.0
    for p, front in enumerate(dissection.fronts):
        size, own = len(front.unknowns), front.own
        # Only the upper triangle in row-major order is filled, which is LAPACK's lower one.
        whole = block(front)
        for half in front.halves:
            extend_add(whole, left.pop(half).T, dissection.fronts[half].above)
        if damping:
            whole[np.arange(own), np.arange(own)] += damping
        whole = whole.T
        root, failed = lapack.dpotrf(whole[:own, :own], lower=1, clean=0) if own else (np.zeros((0, 0)), 0)
        if failed:
            raise scipy.linalg.LinAlgError(f"Front {p} of {len(dissection.fronts)} is singular.")
        rest = whole[own:, :own]
        if own and size > own:
            rest = blas.dtrsm(1.0, root, rest, side=1, lower=1, trans_a=1)
            left[p] = blas.dsyrk(-1.0, rest, beta=1.0, c=whole[own:, own:], lower=1)
        else:
            left[p] = np.asfortranarray(whole[own:, own:])
        parts.append((front, root, rest))
        log_determinant += 2.0 * float(np.sum(np.log(np.diag(root))))
    return Elimination(tuple(parts), log_determinant)


@njit(cache=True)
def extend_add(whole: FloatArray, part: FloatArray, at: IntArray) -> None:
    """Add the upper triangle of a part (p, p) to the rows and columns at (p,), ascending, of a whole."""
    for i in range(len(at)):
        row = whole[at[i]]
        for j in range(i, len(at)):
            row[at[j]] += part[i, j]


class DissectionSolver:
    """Linearises and eliminates one graph. An elimination serves until the values have moved by keeps_for, m or rad."""

    keeps_for = 0.05

    def __init__(self, graph: KeyframeGraph, *, landmarks: bool = True) -> None:
        """landmarks: True if they are unknowns."""
        self.factors = factors_of(graph)
        n, k, rows = len(graph.ids), len(graph.keyframes), self.factors.keyframes.rows
        seen_by = np.repeat(np.arange(k), np.diff(self.factors.keyframes.offsets))
        # Landmarks, their errors, nodes 1 to k, the parameters.
        nodes = 2 * n + np.append(np.arange(k), np.arange(k - 1))
        variable = np.concatenate([rows, n + rows, nodes, np.full(k, 2 * n + k)])
        keyframe = np.concatenate([seen_by, seen_by, np.arange(k), np.arange(1, k), np.arange(k)])
        # Cuts ignore the tags' errors, which share the keyframes of their tags, and the parameters, which are in all.
        cut = (variable < n) | ((variable >= 2 * n) & (variable < 2 * n + k))
        pieces = self.factors.pieces
        ties, count = self.factors.ties, len(pieces.frame)
        of_ties = count + np.arange(len(ties.first))
        piece = np.concatenate([pieces.piece, of_ties, of_ties])
        by = np.concatenate([pieces.keyframe, ties.first, ties.second])
        leaf = leaves(
            graph.X_MN[:-1, :2],
            np.append(variable[cut], 2 * n + k + 1 + piece),
            np.append(keyframe[cut], by),
        )
        free = by > 0
        width = np.repeat([2 * landmarks, 2 * self.factors.has_errors, 3, SHARED], [n, n, k, 1])
        tied = 2 * n + by[free] - 1
        self._dissection = dissected(leaf, variable, keyframe, width, tied, piece[free])
        landmark_at, error_at, node_at, shared_at = np.split(self._dissection.at, [n, 2 * n, 2 * n + k])
        self.unknowns = Unknowns(landmark_at, np.append(NONE, node_at), int(shared_at[0]), error_at)

    def linearised(self, values: Values, damping: float) -> System:
        """Return the system at some values, with `damping` added to the information on each unknown.

        Raises numpy.linalg.LinAlgError if it is singular.
        """
        factors, u, size = self.factors, self.unknowns, self._dissection.size
        gradient, error = np.zeros(size), 0.0
        places = np.empty((len(factors.keyframes.rows), 2, 3))
        # The last entries are those of NONE.
        entry, has_prior = np.full(size - NONE, NONE), np.ones(len(u.error_at), dtype=bool)

        def block(front: Front) -> FloatArray:
            """Return the information (f, f) of keyframes, pieces and priors in a front; add to gradient and error."""
            nonlocal error
            f = len(front.unknowns)
            whole, own = np.zeros((f, f)), np.zeros(f)
            entry[front.unknowns] = np.arange(f)
            at = Unknowns(entry[u.landmark_at], entry[u.node_at], int(entry[u.shared_at]), entry[u.error_at])
            entry[front.unknowns] = NONE
            error += assemble(front.keyframes, factors.keyframes, values, at, whole, own, places)
            if len(front.pieces):
                of_ties = front.pieces >= len(factors.pieces.frame)
                some = front.pieces[~of_ties], front.pieces[of_ties] - len(factors.pieces.frame)
                error += add_pieces(some[0], factors.pieces, values.X_MN, at.node_at, whole, own)
                error += add_ties(some[1], factors.ties, values.X_MN, at.node_at, whole, own)
            gradient[front.unknowns] += own
            if front is first:
                whole[at.shared_at : at.shared_at + SHARED, at.shared_at : at.shared_at + SHARED] += factors.information
            rows = np.flatnonzero((at.error_at >= 0) & has_prior)
            if len(rows):
                has_prior[rows] = False
                i = at.error_at[rows][:, None] + [0, 1]
                whole[i, i] += factors.of_errors
            return whole

        first = next(front for front in self._dissection.fronts if not front.halves)
        elimination = eliminated(self._dissection, block, damping)
        error += factors.priors(values, u, gradient)
        return System(elimination.parts, elimination.log_determinant, gradient, error, places)

    def gradient(self, values: Values) -> tuple[FloatArray, float]:
        """Return the gradient (u,) of the cost and twice the cost at some values."""
        factors, u, gradient, none = self.factors, self.unknowns, np.zeros(self._dissection.size), np.zeros((0, 0))
        every, pieces, ties = (np.arange(len(of)) for of in (values.X_MN[1:], factors.pieces.frame, factors.ties.first))
        error = assemble(every, factors.keyframes, values, u, none, gradient, np.zeros((0, 2, 3)))
        error += add_pieces(pieces, factors.pieces, values.X_MN, u.node_at, none, gradient)
        error += add_ties(ties, factors.ties, values.X_MN, u.node_at, none, gradient)
        return gradient, error + factors.priors(values, u, gradient)

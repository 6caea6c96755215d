"""Nested dissection of a large keyframe graph: keyframes in halves of halves, what two halves share eliminated last.

A front is a half at some depth: the unknowns eliminated in it, which no keyframe outside it has, and its boundary,
which the fronts above eliminate. All fronts are dense, so LAPACK does the work. See George, "Nested dissection of a
regular finite element mesh" (1973), and Liu, "The multifrontal method for sparse matrix solution" (1992).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy.linalg
from numba import njit
from scipy.linalg import blas, lapack

from tfg_drake.messages import FloatArray, IntArray

# Keyframes of a front that has no halves, at most.
LEAF = 12


@dataclasses.dataclass(frozen=True)
class Front:
    """A part of the graph. unknowns: (f,) ascending, the first `own` of them, which follow each other, are eliminated
    here. halves: places of its two halves among the fronts, none in a leaf. keyframes: (q,) of a leaf. above: (f -
    own,) where the others are among the unknowns of the front above."""

    unknowns: IntArray
    own: int
    halves: tuple[int, ...]
    keyframes: IntArray
    above: IntArray

    @property
    def eliminated(self) -> slice:
        """The unknowns that are."""
        return slice(int(self.unknowns[0]), int(self.unknowns[0]) + self.own) if self.own else slice(0, 0)


@dataclasses.dataclass(frozen=True)
class Dissection:
    """Fronts, each after its halves, and where the unknowns are. at: (g,) the first unknown of each of g variables, -1
    of one left out. size: how many unknowns there are, kept: how many of them, the last, are not eliminated."""

    fronts: tuple[Front, ...]
    at: IntArray
    size: int
    kept: int


@dataclasses.dataclass(frozen=True)
class Elimination:
    """What is left when all but the kept unknowns are eliminated. information: (d, d) of the kept. lower, below: of
    each front, (own, own) the Cholesky factor and (f - own, own) its rows for the boundary. log_determinant: of the
    information on the others given the kept."""

    information: FloatArray
    lower: tuple[FloatArray, ...]
    below: tuple[FloatArray, ...]
    log_determinant: float


def leaves(points: FloatArray, most: int = LEAF) -> IntArray:
    """(k,) the leaf of each of the points (k, 2): halves of halves across their longer side, 2^d leaves of at most so
    many points, such that leaves 2 i and 2 i + 1 are halves of one part."""
    leaf = np.zeros(len(points), dtype=np.int64)
    parts = [np.arange(len(points))]
    while max(len(part) for part in parts) > most:
        halves = []
        for part in parts:
            some = points[part]
            order = part[np.argsort(some[:, np.argmax(np.ptp(some, axis=0))], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        parts = halves
    for number, part in enumerate(parts):
        leaf[part] = number
    return leaf


def dissected(leaf: IntArray, variable: IntArray, keyframe: IntArray, width: IntArray, kept: IntArray) -> Dissection:
    """The dissection of a graph.

    Args:
        leaf: (k,) of each keyframe, as of `leaves`.
        variable, keyframe: (e,) the variables, from 0 to g - 1, that each keyframe has, and which that is.
        width: (g,) unknowns of each variable, 0 where it is left out.
        kept: variables that are not eliminated, in their order.
    """
    depth = int(leaf.max(initial=0)).bit_length()
    number = len(width)
    first, last = np.full(number, 2**depth), np.full(number, -1)
    np.minimum.at(first, variable, leaf[keyframe])
    np.maximum.at(last, variable, leaf[keyframe])
    # What no keyframe has is told of by none: the first leaf has it.
    alone = np.flatnonzero(last < 0)
    first[alone] = last[alone] = 0
    # Up to the first front that has all of its keyframes.
    up = np.frexp((first ^ last).astype(float))[1]
    # A complete tree, each front after its halves: so many fronts are below one on a level.
    place = {(level, i): p for p, (level, i) in enumerate(_in_order(depth, 0))}
    table = np.full((depth + 1, 2**depth), -1)
    for (level, i), p in place.items():
        table[level, i] = p
    of = table[up, first >> up]
    of[kept] = len(place) + np.arange(len(kept))
    order = np.argsort(of, kind="stable")
    order = order[width[order] > 0]
    at = np.full(number, -1)
    at[order] = np.cumsum(width[order]) - width[order]
    size, dense = int(width.sum()), int(width[kept].sum())

    by_leaf = np.argsort(leaf[keyframe], kind="stable")
    variable_of = np.split(variable[by_leaf], np.searchsorted(leaf[keyframe][by_leaf], np.arange(1, 2**depth)))
    keyframes_of = [np.flatnonzero(leaf == i) for i in range(2**depth)]
    unknowns: list[IntArray] = []
    own: list[int] = []
    halves: list[tuple[int, ...]] = []
    for (level, i), p in place.items():
        parts: tuple[int, ...] = ()
        if level == 0:
            some = np.unique(np.append(variable_of[i], alone) if i == 0 else variable_of[i])
            some = some[width[some] > 0]
            has = np.concatenate([at[some[width[some] == w]][:, None] + np.arange(w) for w in (2, 3)], axis=None)
            has = np.sort(has)
        else:
            parts = (place[level - 1, 2 * i], place[level - 1, 2 * i + 1])
            has = np.union1d(*(unknowns[half][own[half] :] for half in parts))
        unknowns.append(has)
        halves.append(parts)
        mine = np.flatnonzero(of == p)
        own.append(int(width[mine].sum()))
    root = np.arange(size - dense, size)
    above: list[IntArray] = [np.empty(0, dtype=np.int64)] * len(place)
    for p, parts in enumerate(halves):
        for half in parts:
            above[half] = np.searchsorted(unknowns[p], unknowns[half][own[half] :])
    above[-1] = np.searchsorted(root, unknowns[-1][own[-1] :])
    fronts = tuple(
        Front(unknowns[p], own[p], halves[p], keyframes_of[i] if level == 0 else np.empty(0, dtype=np.int64), above[p])
        for (level, i), p in place.items()
    )
    return Dissection(fronts, at, size, dense)


def _in_order(level: int, i: int) -> list[tuple[int, int]]:
    """Level and number of a front and of all below it, each after its halves."""
    if level == 0:
        return [(0, i)]
    return [*_in_order(level - 1, 2 * i), *_in_order(level - 1, 2 * i + 1), (level, i)]


def eliminated(dissection: Dissection, block: Callable[[Front], FloatArray], damping: float = 0.0) -> Elimination:
    """The system with all but the kept unknowns eliminated.

    block: the information (f, f) that the keyframes of a leaf have on its unknowns. damping: added to each unknown's.
    Raises numpy.linalg.LinAlgError where it is singular.
    """
    lower: list[FloatArray] = []
    below: list[FloatArray] = []
    left: dict[int, FloatArray] = {}
    log_determinant = 0.0
    for p, front in enumerate(dissection.fronts):
        size, own = len(front.unknowns), front.own
        # Of a parent only the upper triangle, row by row, is filled: LAPACK's lower one.
        whole = np.zeros((size, size)) if front.halves else block(front)
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
        lower.append(root)
        below.append(rest)
        log_determinant += 2.0 * float(np.sum(np.log(np.diag(root))))
    information = np.zeros((dissection.kept, dissection.kept))
    extend_add(information, left[len(dissection.fronts) - 1].T, dissection.fronts[-1].above)
    information[np.arange(dissection.kept), np.arange(dissection.kept)] += damping
    information = np.triu(information) + np.triu(information, 1).T
    return Elimination(information, tuple(lower), tuple(below), log_determinant)


def solution(dissection: Dissection, elimination: Elimination, root: FloatArray, vector: FloatArray) -> FloatArray:
    """(u,) what times the information is the vector (u,). root: (d, d) lower Cholesky factor of that on the kept."""
    x = vector.copy()
    for front, lower, below in zip(dissection.fronts, elimination.lower, elimination.below, strict=True):
        if front.own:
            x[front.eliminated] = lapack.dtrtrs(lower, x[front.eliminated], lower=1)[0]
            x[front.unknowns[front.own :]] -= below @ x[front.eliminated]
    if dissection.kept:
        last = slice(dissection.size - dissection.kept, dissection.size)
        x[last] = scipy.linalg.cho_solve((root, True), x[last], check_finite=False)
    for p in range(len(dissection.fronts) - 1, -1, -1):
        front = dissection.fronts[p]
        if front.own:
            known = elimination.below[p].T @ x[front.unknowns[front.own :]]
            x[front.eliminated] = lapack.dtrtrs(elimination.lower[p], x[front.eliminated] - known, lower=1, trans=1)[0]
    return x


@njit(cache=True)
def extend_add(whole: FloatArray, part: FloatArray, at: IntArray) -> None:
    """Add the upper triangle of a part (p, p) to the rows and columns at (p,), ascending, of a whole."""
    for i in range(len(at)):
        row = whole[at[i]]
        for j in range(i, len(at)):
            row[at[j]] += part[i, j]

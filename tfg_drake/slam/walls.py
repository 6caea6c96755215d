"""Walls as landmarks: the lines that single scans see, tracked through a turn, and found again in the map.

In a turn's solution a wall is a line (angle of its normal, distance from an anchor). In keyframe and map it is two
points on it, of which each look tells the distance normal to the wall alone: so a wall moves, turns and is eliminated
as tags are. Along the wall its first keyframe holds the points where they were first seen, which tells nothing else;
others leave them free there. What a scan does not tell, as its way along a corridor, stays open.

The points of wall w have the ids WALLS_BELOW - 2w - 2 and WALLS_BELOW - 2w - 1; in a turn, before it is known which
walls they are, ids below PROVISIONAL. A normal points away from where the wall was seen from, so the two faces of one
differ by pi.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, BoolArray, FloatArray, IntArray, MapEstimate, is_tag, message, replace
from tfg_drake.slam.keyframe import Keyframe, keyframe, rows_of, without_tags
from tfg_drake.slam.odometry_model import wrap
from tfg_drake.slam.shared import SHARED

if TYPE_CHECKING:
    from tfg_drake.slam.keyframe_graph import KeyframeGraph

PROVISIONAL = 2 * WALLS_BELOW
# Two looks of a turn are at one wall where their directions differ by no more than this, rad, the middle of one is off
# the other's line by no more than this, m, each beside three deviations, and what was seen overlaps.
SAME_ANGLE, SAME_LINE = 0.05, 0.05
# And beside this share of the distance, by which the heading may have wandered since.
DRIFT = 0.02
# What all looks of a keyframe at one wall share: its direction (rad) and distance (m) as a scanner sees it, no surface
# being quite a plane. How walls agree that are seen again says which of some multiples it is; their prior.
FLOOR = np.array([1e-3, 2e-3])
FLOORS = np.array([0.5, 1.0, 2.0, 4.0])
PRIOR = np.array([0.25, 0.4, 0.25, 0.1])
# Deviation (m) along a wall of its points, in the keyframe that they are of and in others.
HELD, FREE = 0.01, 30.0
# A wall is the map's where the squared error of both points is less than this (2 freedoms: 1 in 3000), its direction
# differs by less than this (cosine) and what was seen overlaps by this, m, or half of what was seen.
GATE = 16.0
SAME_DIRECTION = 0.9
OVERLAP = 0.3
# And where it must be is known better than this, m: else anything may be it.
MOST_DEVIATION = 0.5
# One that is off by no more than this, m, is neither that wall nor a new one: what is unclear waits.
UNCLEAR = 0.4
# Two walls of the map so near to each other, m, are one for whoever looks at both.
ONE_WALL = 0.05
# A new wall has been seen by so many looks, so long, m.
LEAST_LOOKS, LEAST_LENGTH = 3, 0.6


class Looks(NamedTuple):
    """q looks of a turn at w walls.

    node, wall: (q,) pose and wall of each. seen: (q, 11) the look (7,) of `measurement.look_of`, the deviations of its
    direction and of its distance, and the robot's twist then. ends: (q, 2) along the wall, from the middle of what was
    seen. anchor: (w, 2) in A. name: (w,) of each wall.
    """

    node: IntArray
    wall: IntArray
    seen: FloatArray
    ends: FloatArray
    anchor: FloatArray
    name: IntArray

    def kept(self, keep: BoolArray) -> Looks:
        """Some of the looks (q,)."""
        walls, wall = np.unique(self.wall[keep], return_inverse=True)
        return Looks(self.node[keep], wall, self.seen[keep], self.ends[keep], self.anchor[walls], self.name[walls])

    def first(self, X_AB: FloatArray) -> FloatArray:
        """(w, 2) the walls by the best look at each, from poses (t, 3)."""
        X, walls = X_AB[self.node], np.empty((len(self.anchor), 2))
        order = np.argsort(-self.seen[:, 7], kind="stable")
        angle = X[:, 2] + self.seen[:, 0]
        off = _in_frames(X, self.seen[:, 1:3]) - self.anchor[self.wall]
        distance = np.cos(angle) * off[:, 0] + np.sin(angle) * off[:, 1]
        walls[self.wall[order]] = np.column_stack([angle, distance])[order]
        return walls


@message
class Walls:
    """The walls of a map. first: (w,) ids of the first point of each, reach: (w, 2) how far each has been seen, m from
    that point towards the second. by_floor: (4,) logarithm of the likelihood of what was seen again by each of FLOORS,
    floor: of these the most likely, between them. unevenness: m, how far single looks are off the same wall beside the
    noise of their rays, as of `scan_lines`. least_looks: that a new wall needs."""

    first: Annotated[IntArray, "w"]
    reach: Annotated[FloatArray, "w", 2]
    by_floor: Annotated[FloatArray, 4]
    floor: float = 1.0
    unevenness: float = 0.0
    least_looks: int = LEAST_LOOKS

    def seen_again(self, off: FloatArray, S: FloatArray, floor: FloatArray, level: float) -> Walls:
        """With points that were seen off (2q,) their walls, m, with covariance S (2q, 2q), in which there is floor (2q,
        2q), times the square of its level then."""
        by_floor = self.by_floor.copy()
        for i, other in enumerate(FLOORS):
            root = np.linalg.cholesky(S + (other**2 - level**2) * floor)
            nu = np.linalg.solve(root, off)
            by_floor[i] -= 0.5 * float(nu @ nu) + float(np.sum(np.log(np.diag(root))))
        weight = PRIOR * np.exp(by_floor - by_floor.max())
        return replace(self, by_floor=by_floor, floor=float(np.exp2(np.log2(FLOORS) @ weight / weight.sum())))


def no_walls(unevenness: float = 0.0, least_looks: int = LEAST_LOOKS) -> Walls:
    """None yet."""
    none = np.empty(0, dtype=np.int64), np.empty((0, 2)), np.zeros(len(FLOORS))
    return Walls(*none, unevenness=unevenness, least_looks=least_looks)


def no_lines() -> FloatArray:
    """(0, 11) of a scan that saw none."""
    return np.empty((0, 11))


def whole_walls(known: MapEstimate, walls: Walls) -> FloatArray:
    """(w, 2, 2) m, the ends of a map's walls as far as they have been seen."""
    first, p_ML, _ = known_walls(known)
    order = np.argsort(walls.first)
    reach = walls.reach[order[np.searchsorted(walls.first, first, sorter=order)]]
    return np.asarray(p_ML[:, :1] + reach[:, :, None] * directions(p_ML)[0][:, None])


def known_walls(known: MapEstimate | KeyframeGraph) -> tuple[IntArray, FloatArray, FloatArray]:
    """The walls among some landmarks: ids (w,) of their first points, both points (w, 2, 2) in M, m, and the deviations
    normal to the wall there (w, 2), m. Along a wall its points tell nothing."""
    rows = ~is_tag(known.ids)
    p_ML, covariance = known.p_ML[rows].reshape(-1, 2, 2), known.landmark_covariance[rows].reshape(-1, 2, 2, 2)
    _, normal, _ = directions(p_ML)
    variance = np.einsum("wi,wkij,wj->wk", normal, covariance, normal)
    return known.ids[rows][::2], p_ML, np.sqrt(np.maximum(variance, 0.0))


def least_known(known: MapEstimate | KeyframeGraph) -> tuple[float, FloatArray] | None:
    """The greatest standard deviation of a landmark's place, m, of a wall's normal to it, and the place (2,) in M, m;
    None without landmarks."""
    tags = is_tag(known.ids)
    _, of_walls, by_walls = known_walls(known)
    by_tags = np.sqrt(np.linalg.eigvalsh(known.landmark_covariance[tags])[:, -1])
    deviation, places = np.append(by_tags, by_walls), np.vstack([known.p_ML[tags], of_walls.reshape(-1, 2)])
    if not len(deviation):
        return None
    worst = int(np.argmax(deviation))
    return float(deviation[worst]), places[worst]


def directions(pairs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors (q, 2) along and normal to the walls through pairs of points (q, 2, 2), and the points' distances
    (q,), m."""
    along = pairs[:, 1] - pairs[:, 0]
    length = np.hypot(*along.T)
    along = along / np.maximum(length, 1e-9)[:, None]
    return along, np.column_stack([along[:, 1], -along[:, 0]]), length


def _diagonal(blocks: Sequence[ArrayLike], rows: int, columns: int) -> FloatArray:
    """The matrix of q blocks (rows, columns) on its diagonal, (q rows, q columns)."""
    q = len(blocks)
    whole = np.zeros((q, rows, q, columns))
    whole[np.arange(q), :, np.arange(q)] = np.array(blocks, dtype=float).reshape(q, rows, columns)
    return whole.reshape(q * rows, q * columns)


def _in_frames(X: FloatArray, p: FloatArray) -> FloatArray:
    """Points (q, 2) of frames (q, 3), where these are given."""
    c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
    return np.column_stack([X[:, 0] + c * p[:, 0] - s * p[:, 1], X[:, 1] + s * p[:, 0] + c * p[:, 1]])


def grouped(node: IntArray, lines: FloatArray, twist: FloatArray, X_AB: FloatArray) -> Looks:
    """The lines (q, 11) of scans at some poses, see `scan_lines`, as looks at walls. twist: (q, 2) of the
    robot."""
    angle, (offset, begin, end, middle, deviation) = lines[:, 0], lines[:, [1, 2, 3, 4, 6]].T
    c, s = np.cos(angle), np.sin(angle)
    middles = c * offset - s * middle, s * offset + c * middle
    seen = np.column_stack([angle, *middles, lines[:, 7:], lines[:, 5], deviation, twist])
    ends = np.column_stack([begin - middle, end - middle])
    wall, newest = _grouped(X_AB[node, 2] + angle, _in_frames(X_AB[node], seen[:, 1:3]), ends, lines[:, 5], deviation)
    anchor = _in_frames(X_AB[node[newest]], seen[newest, 1:3])
    return Looks(node, wall, seen, ends, anchor, np.arange(len(newest)))


@njit(cache=True)
def _grouped(
    angle: FloatArray, p_AM: FloatArray, ends: FloatArray, sigma_angle: FloatArray, sigma: FloatArray
) -> tuple[IntArray, IntArray]:
    """The wall (q,) of each look in A, and the newest look (w,) at each wall."""
    q = len(angle)
    wall, newest, reach, walls = np.empty(q, dtype=np.int64), np.empty(q, dtype=np.int64), np.empty((q, 2)), 0
    for j in range(q):
        wall[j], nearest = -1, np.inf
        for w in range(walls):
            b = newest[w]
            turned = abs(wrap(angle[j] - angle[b]))
            if turned > SAME_ANGLE + 3.0 * math.hypot(sigma_angle[j], sigma_angle[b]):
                continue
            c, s = math.cos(angle[b]), math.sin(angle[b])
            x, y = p_AM[j, 0] - p_AM[b, 0], p_AM[j, 1] - p_AM[b, 1]
            off, along = abs(c * x + s * y), -s * x + c * y
            drifted = SAME_LINE + DRIFT * math.hypot(p_AM[j, 0], p_AM[j, 1])
            if off > drifted + 3.0 * (math.hypot(sigma[j], sigma[b]) + abs(along) * sigma_angle[b]):
                continue
            if along + ends[j, 1] < reach[w, 0] or along + ends[j, 0] > reach[w, 1]:
                continue
            if off < nearest:
                nearest, wall[j] = off, w
        w = wall[j]
        if w < 0:
            wall[j], newest[walls], reach[walls] = walls, j, ends[j]
            walls += 1
            continue
        b = newest[w]
        c, s = math.cos(angle[b]), math.sin(angle[b])
        along = -s * (p_AM[j, 0] - p_AM[b, 0]) + c * (p_AM[j, 1] - p_AM[b, 1])
        reach[w, 0], reach[w, 1] = min(reach[w, 0], along + ends[j, 0]), max(reach[w, 1], along + ends[j, 1])
        newest[w] = j
        reach[w] -= along
    return wall, newest[:walls].copy()


def pairs_of(
    looks: Looks, walls: FloatArray, X_AB: FloatArray, level: float
) -> tuple[IntArray, FloatArray, FloatArray, IntArray, FloatArray]:
    """The walls (w, 2) of a solution as pairs of points, where each was seen to begin and to end: ids (2w,) ascending,
    p_AL (2w, 2), derivative (2w, 4w) of the walls on the points, the number of looks (2w,) at each, and the covariance
    (2w, 2w) of the walls' floor, level times FLOOR."""
    w = len(walls)
    n = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    along = np.column_stack([-n[:, 1], n[:, 0]])
    middle = _in_frames(X_AB[looks.node], looks.seen[:, 1:3]) - looks.anchor[looks.wall]
    s = np.einsum("qi,qi->q", middle, along[looks.wall])
    reach = np.column_stack([np.full(w, np.inf), np.full(w, -np.inf)])
    np.minimum.at(reach[:, 0], looks.wall, s + looks.ends[:, 0])
    np.maximum.at(reach[:, 1], looks.wall, s + looks.ends[:, 1])
    order = np.argsort(-looks.name)
    ids = PROVISIONAL - 2 * np.repeat(looks.name[order], 2) - np.tile([2, 1], w)
    p_AL = (looks.anchor + walls[:, 1:] * n)[:, None] + reach[:, :, None] * along[:, None]
    # A point at s along the wall moves by c - s angle normal to it.
    length, on, floor = reach[:, 1] - reach[:, 0], np.zeros((2 * w, 4 * w)), np.zeros((2 * w, 2 * w))
    for i, k in enumerate(order):
        (begin, end), rows, columns = reach[k], slice(2 * k, 2 * k + 2), slice(4 * i, 4 * i + 4)
        on[rows, columns] = np.kron([[1.0, -1.0], [end, -begin]], n[k]) / length[k]
        at_middle = np.array([[1.0, 0.0], [0.5 * (begin + end), 1.0]])
        floor[rows, rows] = at_middle @ np.diag(np.square(level * FLOOR)) @ at_middle.T
    return ids, p_AL[order].reshape(-1, 2), on, np.repeat(np.bincount(looks.wall, minlength=w)[order], 2), floor


def with_floor(
    information: FloatArray, gradient: FloatArray, floor: FloatArray, of_walls: slice
) -> tuple[FloatArray, FloatArray]:
    """Information (u, u) and gradient (u,) on walls that are what a turn saw only but for a floor (2w, 2w)."""
    if not len(floor):
        return information, gradient
    taken = np.linalg.solve(information[of_walls, of_walls] + np.linalg.inv(floor), information[of_walls])
    anew = information - information[:, of_walls] @ taken
    return 0.5 * (anew + anew.T), gradient - taken.T @ gradient[of_walls]


def along_walls(p_AL: FloatArray, deviation: float = HELD) -> FloatArray:
    """Information (4w, 4w) that holds pairs of points (2w, 2) along their walls."""
    along = np.repeat(directions(p_AL.reshape(-1, 2, 2))[0], 2, axis=0)
    return _diagonal([np.outer(one, one) / deviation**2 for one in along], 2, 2)


def floor_of_points(p_AL: FloatArray, level: float = 1.0) -> FloatArray:
    """Covariance (4w, 4w) of pairs of points (2w, 2) by the floor, level times FLOOR, of what a keyframe tells of their
    walls."""
    _, normals, lengths = directions(p_AL.reshape(-1, 2, 2))
    across = zip(normals, lengths, strict=True)
    return _diagonal([np.kron(level**2 * _floor_across(length), np.outer(n, n)) for n, length in across], 4, 4)


def _floor_across(length: float) -> FloatArray:
    """Covariance (2, 2), normal to the wall, of the ends of a piece of this length, m, by FLOOR in its middle."""
    by = np.array([[-0.5 * length, 1.0], [0.5 * length, 1.0]]) * FLOOR
    return np.asarray(by @ by.T)


@message
class Names:
    """Which walls of the map those of a turn are. provisional: (v,) ids of their first points, first: (v,) the map's,
    p_AL: (v, 2, 2) m, the places of the points, is_new: (v,) whether the keyframe holds them along the wall."""

    provisional: IntArray
    first: IntArray
    p_AL: FloatArray
    is_new: BoolArray


def named(one: Keyframe, names: Names, shared: FloatArray) -> Keyframe:
    """A keyframe with its walls by their names, linearised at some parameters (13,); those without a name are
    marginalised out."""
    firsts = one.ids[~is_tag(one.ids)][::2]
    nameless = firsts[~np.isin(firsts, names.provisional)]
    one = without_tags(one, np.append(nameless, nameless + 1))
    v = int(np.count_nonzero(~is_tag(one.ids))) // 2
    if not v:
        return one
    at = [int(np.flatnonzero(names.provisional == id_)[0]) for id_ in one.ids[: 2 * v : 2]]
    J, W, ids = np.eye(len(one.information)), one.information, one.ids.copy()
    m, held = len(W) - SHARED, np.zeros(W.shape)
    y = np.append(one.y_AL.ravel(), one.y_AD) + one.conditional()[1] @ shared
    error = np.append(y - np.append(one.y_AL.ravel(), one.y_AD), shared)
    g = W @ error + np.append(np.zeros(m), one.vector)
    for k, row in enumerate(at):
        of_wall = slice(4 * k, 4 * k + 4)
        q = y[of_wall].reshape(2, 2)
        (along,), (normal,), (length,) = directions(q[None])
        s = (names.p_AL[row] - q[0]) @ along
        # How far the points seen are between those named.
        share = (np.array([0.0, length]) - s[0]) / (s[1] - s[0])
        J[of_wall, of_wall] = np.kron(np.column_stack([1.0 - share, share]), np.outer(normal, normal))
        y[of_wall] = (q[0] + s[:, None] * along).ravel()
        held[of_wall, of_wall] = along_walls(y[of_wall].reshape(2, 2), HELD if names.is_new[row] else FREE)
        ids[2 * k], ids[2 * k + 1] = names.first[row], names.first[row] + 1
    order = np.argsort(ids, kind="stable")
    rows = np.append((2 * order[:, None] + [0, 1]).ravel(), np.arange(2 * len(ids), len(J)))
    W, g = J.T @ W @ J + held, J.T @ g
    return keyframe(
        ids[order], y[rows[:m]], shared, one.unit, (0.5 * (W + W.T))[np.ix_(rows, rows)], g[rows], one.on_error[order]
    )


def identified(
    one: Keyframe, counts: IntArray, walls: Walls, estimate: MapEstimate, floor: float = 1.0
) -> tuple[Names, Walls]:
    """Which walls of the map those of a keyframe are that begins at its newest pose, and which are new; the walls then.

    counts: (n,) looks behind each landmark of the keyframe. floor: that it was reduced with. What is unclear has no
    name.
    """
    p_AL, _, covariance = one.given(estimate.shared)
    seen = np.flatnonzero(~is_tag(one.ids))[::2]
    length = directions(p_AL[seen[:, None] + [0, 1]])[2]
    row, known = rows_of(walls.first, estimate.ids)
    known &= estimate.is_local[row] if len(row) else known
    at = np.flatnonzero(known)
    entry = estimate.local_entry[row[at]]
    P, reach, first = estimate.local_p_ML[entry[:, None] + [0, 1]], walls.reach.copy(), list(walls.first)
    p_AL_known = se2.transform(se2.inverse(estimate.X_MD), P.reshape(-1, 2)).reshape(-1, 2, 2)
    names: list[tuple[int, int, FloatArray, bool]] = []
    again: list[tuple[int, int]] = []
    taken, new_reach, next_id = np.zeros(len(at), dtype=bool), [], int(walls.first.min(initial=WALLS_BELOW)) - 2
    # The longest first: of two pieces of one wall it is the wall.
    for k in np.argsort(-length, kind="stable"):
        pair, provisional = p_AL[seen[k] : seen[k] + 2], int(one.ids[seen[k]])
        R = covariance[2 * seen[k] : 2 * seen[k] + 4, 2 * seen[k] : 2 * seen[k] + 4]
        squared, off, s, overlap = _compared(pair, R, P, reach[at], entry, estimate)
        agrees = squared < GATE
        if agrees.any():
            best = int(np.argmax(np.where(agrees, overlap, -np.inf)))
            rivals = agrees & (np.abs(off - off[best]) > ONE_WALL)
            if not rivals.any() and not taken[best]:
                taken[best] = True
                again.append((k, best))
                reach[at[best]] = min(reach[at[best], 0], s[best, 0]), max(reach[at[best], 1], s[best, 1])
                names.append((provisional, first[at[best]], p_AL_known[best], False))
        elif not np.any(off < UNCLEAR) and counts[seen[k]] >= walls.least_looks and length[k] >= LEAST_LENGTH:
            names.append((provisional, next_id, pair, True))
            first.append(next_id)
            new_reach.append((0.0, length[k]))
            next_id -= 2
    if again:
        k, best = np.array(again).T
        rows = (2 * seen[k, None] + np.arange(4)).ravel()
        of_these = p_AL[seen[k, None] + [0, 1]], covariance[np.ix_(rows, rows)], P[best], entry[best]
        walls = walls.seen_again(*_off(*of_these, estimate), floor)
    walls = replace(
        walls, first=np.array(first, dtype=np.int64), reach=np.vstack([reach, np.reshape(new_reach, (-1, 2))])
    )
    return Names(
        provisional=np.array([name[0] for name in names], dtype=np.int64),
        first=np.array([name[1] for name in names], dtype=np.int64),
        p_AL=np.reshape([name[2] for name in names], (-1, 2, 2)),
        is_new=np.array([name[3] for name in names], dtype=bool),
    ), walls


def _off(
    p_AL: FloatArray, R: FloatArray, P: FloatArray, entry: IntArray, estimate: MapEstimate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far off (2q,) m pairs of points (q, 2, 2), seen from the newest pose with covariance R (4q, 4q), are from
    walls of the map, at P (q, 2, 2), along their normals; the covariance (2q, 2q) of that, and of one floor. entry:
    (q,) of each first point among the landmarks known jointly."""
    X_MD, (_, normal, _) = estimate.X_MD, directions(P)
    Q = se2.transform(X_MD, p_AL.reshape(-1, 2)).reshape(-1, 2, 2)
    by_walls, by_pose = zip(*(_on_wall(Q[k], P[k], X_MD) for k in range(len(P))), strict=True)
    J = np.column_stack([_diagonal(by_walls, 2, 4), np.vstack(by_pose)])
    columns = np.append((2 * entry[:, None] + np.arange(4)).ravel(), len(estimate.covariance) - np.arange(3, 0, -1))
    N = _diagonal([np.kron(np.eye(2), n @ se2.rotation(float(X_MD[2]))) for n in normal], 2, 4)
    floor = _diagonal([_floor_across(length) for length in directions(p_AL)[2]], 2, 2)
    off = np.sum((Q - P[:, :1]) * normal[:, None], axis=2).ravel()
    return off, J @ estimate.covariance[np.ix_(columns, columns)] @ J.T + N @ R @ N.T, floor


def _on_wall(Q: FloatArray, P: FloatArray, X_MD: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives (2, 4) and (2, 3) of how far points Q (2, 2) are off a wall through P (2, 2), on that and on the pose
    X_MD (3,) that they are seen from."""
    (along,), (normal,), (length,) = directions(P[None])
    u, lever = (Q - P[0]) @ along / length, Q - X_MD[:2]
    turned = lever[:, 0] * normal[1] - lever[:, 1] * normal[0]
    on_wall = np.hstack([np.outer(u - 1.0, normal), np.outer(-u, normal)])
    return on_wall, np.column_stack([np.tile(normal, (2, 1)), turned])


def _compared(
    p_AL: FloatArray, R: FloatArray, P: FloatArray, reach: FloatArray, entry: IntArray, estimate: MapEstimate
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A pair of points (2, 2) seen from the newest pose, with covariance R (4, 4), and k walls of the map, at P
    (k, 2, 2): the squared error (k,) in deviations and how far off (k,) m, infinite where they look another way or
    hardly overlap, the error also where it is surely beyond GATE; where along the wall (k, 2) m, and how much they
    overlap (k,) m. reach: as of Walls. entry: (k,) of each first point among the landmarks known jointly."""
    Q = se2.transform(estimate.X_MD, p_AL)
    along, normal, _ = directions(P)
    apart, seen = Q - P[:, :1], Q[1] - Q[0]
    s, e = np.einsum("kji,ki->kj", apart, along), np.einsum("kji,ki->kj", apart, normal)
    overlap = np.minimum(reach[:, 1], s[:, 1]) - np.maximum(reach[:, 0], s[:, 0])
    seen_length = float(np.hypot(*seen))
    candidates = (along @ seen > SAME_DIRECTION * seen_length) & (overlap > min(OVERLAP, 0.5 * seen_length))
    squared, off = np.full(len(P), np.inf), np.where(candidates, np.abs(e).max(axis=1), np.inf)
    # No S with that trace lets in what is farther off.
    for k in np.flatnonzero(candidates & (np.sum(e * e, axis=1) < 2.0 * MOST_DEVIATION**2 * GATE)):
        _, S, _ = _off(p_AL[None], R, P[[k]], entry[[k]], estimate)
        if np.trace(S) < 2.0 * MOST_DEVIATION**2:
            squared[k] = e[k] @ np.linalg.solve(S, e[k])
    return squared, off, s, overlap

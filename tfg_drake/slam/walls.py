"""Walls as landmarks: lines of single scans, tracked through a turn and associated with the map.

A wall is a landmark of two numbers: the angle of its normal, and its distance along the normal from an anchor, which is
fixed where the wall was first seen. Each keyframe has its own anchor in the middle of what it saw, where the errors of
angle and distance are independent. The reach of a wall is stored but not estimated: directions that scans do not
determine, such as that along a corridor, stay undetermined.

Wall w has the id WALLS_BELOW - w - 1; in a turn, before association, ids are below PROVISIONAL. A normal points away
from where the wall was seen from, so the two faces of a wall differ by pi.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, BoolArray, FloatArray, IntArray, MapEstimate, is_tag, message, replace
from tfg_drake.slam.keyframe import Keyframe, along_walls, of_landmarks, wall_off
from tfg_drake.slam.odometry_model import wrap

if TYPE_CHECKING:
    from tfg_drake.slam.keyframe_graph import KeyframeGraph

PROVISIONAL = 2 * WALLS_BELOW
# Two looks of a turn are at one wall if their directions differ by at most SAME_ANGLE, rad, and the middle of one is
# off the other's line by at most SAME_LINE, m, each plus three deviations, and the seen pieces overlap.
SAME_ANGLE, SAME_LINE = 0.05, 0.05
# SAME_LINE grows by this share of the look's distance from A, as the heading may have drifted between the looks.
DRIFT = 0.02
# FLOOR: the error of angle (rad) and distance (m) common to all looks of a keyframe at one wall, as no surface is a
# plane. FLOORS: its candidate multiples, weighted by how well walls agree that are seen again; PRIOR: their prior.
FLOOR = np.array([1e-3, 2e-3])
FLOORS = np.exp2(np.arange(-1.0, 6.0))
PRIOR = np.array([0.25, 0.4, 0.25, 0.1, 0.1, 0.1, 0.1])
# A seen wall is associated with one of the map if the squared Mahalanobis distance of angle and distance is below GATE
# (2 degrees of freedom: exceeded once in 3000), the cosine between their normals is at least SAME_DIRECTION, and they
# overlap by more than OVERLAP, m, or half of the seen piece.
GATE = 16.0
SAME_DIRECTION = 0.9
# A point within this distance of a wall, m, is on it.
ON_WALL = 0.1
OVERLAP = 0.3
# No wall is associated whose predicted place has a greater deviation than this, m: anything could be it.
MOST_DEVIATION = 0.5
# A wall within this distance of one of the map, m, that fails the gate is neither that wall nor a new one.
UNCLEAR = 0.4
# Two walls of the map within this distance, m, at the seen piece are no rivals in an association.
ONE_WALL = 0.05
# Number of looks and length, m, that a new wall needs.
LEAST_LOOKS, LEAST_LENGTH = 3, 0.6
# A keyframe reduced anew replaces the old one unless one of its walls has moved by more than this, m and rad.
SAME_WALL = 0.3


_NONE = np.empty((0, 2))


class WallSet(NamedTuple):
    """w walls in some frame: angle and distance (w, 2), anchors (w, 2), m, and reaches (w, 2), m."""

    wall: FloatArray = _NONE
    anchor: FloatArray = _NONE
    reach: FloatArray = _NONE


class Looks(NamedTuple):
    """q looks of a turn at w walls.

    node, wall: (q,) pose and wall of each. seen: (q, 11) the look (7,) of `measurement.look_of`, the deviations of its
    direction and of its distance, and the robot's twist then. ends: (q, 2) along the wall, from the middle of the seen
    line. anchor: (w, 2) in A. name: (w,) of each wall.
    """

    node: IntArray
    wall: IntArray
    seen: FloatArray
    ends: FloatArray
    anchor: FloatArray
    name: IntArray

    def kept(self, keep: BoolArray) -> Looks:
        """Return some of the looks (q,)."""
        walls, wall = np.unique(self.wall[keep], return_inverse=True)
        return Looks(self.node[keep], wall, self.seen[keep], self.ends[keep], self.anchor[walls], self.name[walls])

    def first(self, X_AB: FloatArray) -> FloatArray:
        """Return the walls (w, 2) by the best look at each, from poses (t, 3)."""
        X, walls = X_AB[self.node], np.empty((len(self.anchor), 2))
        order = np.argsort(-self.seen[:, 7], kind="stable")
        angle = X[:, 2] + self.seen[:, 0]
        off = se2.transform(X, self.seen[:, 1:3]) - self.anchor[self.wall]
        distance = np.cos(angle) * off[:, 0] + np.sin(angle) * off[:, 1]
        walls[self.wall[order]] = np.column_stack([angle, distance])[order]
        return walls


@message
class Walls:
    """The straightness of walls, learnt from repeated looks. by_floor: (7,) log likelihood of repeated looks for each
    of FLOORS, floor: the most likely one, interpolated. least_looks: number of looks that a new wall needs."""

    by_floor: Annotated[FloatArray, 7]
    floor: float = 1.0
    least_looks: int = LEAST_LOOKS

    def seen_again(self, off: FloatArray, S: FloatArray, level: float) -> Walls:
        """Return it after q walls were seen again with errors off (2q,) of angle and distance and covariances S (2q,
        2q), which include the floor at a level."""
        floor = np.diag(np.tile(np.square(FLOOR), len(off) // 2))
        by_floor = self.by_floor.copy()
        for i, other in enumerate(FLOORS):
            root = np.linalg.cholesky(S + (other**2 - level**2) * floor)
            nu = np.linalg.solve(root, off)
            by_floor[i] -= 0.5 * float(nu @ nu) + float(np.sum(np.log(np.diag(root))))
        weight = PRIOR * np.exp(by_floor - by_floor.max())
        return replace(self, by_floor=by_floor, floor=float(np.exp2(np.log2(FLOORS) @ weight / weight.sum())))


def no_walls(least_looks: int = LEAST_LOOKS) -> Walls:
    """Return the statistics before any wall."""
    return Walls(np.zeros(len(FLOORS)), least_looks=least_looks)


def no_lines() -> FloatArray:
    """Return the lines (0, 11) of a scan without any."""
    return np.empty((0, 11))


def known_walls(known: MapEstimate | KeyframeGraph) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the walls among some landmarks: ids (w,), `wall_ends` (w, 2, 2), m in M, and the deviations normal to the
    wall there (w, 2), m."""
    walls = ~is_tag(known.ids)
    reach, covariance = known.reach[walls], known.landmark_covariance[walls]
    by = np.stack([-reach, np.ones_like(reach)], axis=2)
    variance = np.einsum("wki,wij,wkj->wk", by, covariance, by)
    return known.ids[walls], wall_ends(known), np.sqrt(np.maximum(variance, 0.0))


def wall_ends(known: MapEstimate | KeyframeGraph) -> FloatArray:
    """Return both ends (w, 2, 2), m in M, of the walls among some landmarks, as far as they have been seen."""
    walls = ~is_tag(known.ids)
    return ends_of(known.p_ML[walls], known.anchor[walls], known.reach[walls])


def ends_of(wall: FloatArray, anchor: FloatArray, reach: FloatArray) -> FloatArray:
    """Return both ends (w, 2, 2) of walls (w, 2) with a reach (w, 2) from their anchors (w, 2)."""
    along = along_walls(wall)
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    return np.asarray((anchor + wall[:, 1:] * normal)[:, None] + reach[:, :, None] * along[:, None])


def least_known(known: MapEstimate | KeyframeGraph) -> tuple[float, FloatArray] | None:
    """Return the greatest standard deviation of a landmark's place, m, for a wall normal to it, and the place (2,) in
    M, m; None without landmarks."""
    tags = is_tag(known.ids)
    _, of_walls, by_walls = known_walls(known)
    by_tags = np.sqrt(np.linalg.eigvalsh(known.landmark_covariance[tags])[:, -1])
    deviation, places = np.append(by_tags, by_walls), np.vstack([known.p_ML[tags], of_walls.reshape(-1, 2)])
    if not len(deviation):
        return None
    worst = int(np.argmax(deviation))
    return float(deviation[worst]), places[worst]


def directions(pairs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors (q, 2) along and normal to the walls through pairs of points (q, 2, 2), and the points'
    distances (q,), m."""
    along = pairs[:, 1] - pairs[:, 0]
    length = np.hypot(*along.T)
    along = along / np.maximum(length, 1e-9)[:, None]
    return along, np.column_stack([along[:, 1], -along[:, 0]]), length


def grouped(node: IntArray, lines: FloatArray, twist: FloatArray, X_AB: FloatArray) -> Looks:
    """Group the lines (q, 11) of scans at some poses, see `scan_lines`, to looks at walls. twist: (q, 2) of the
    robot."""
    angle, (offset, begin, end, middle, deviation) = lines[:, 0], lines[:, [1, 2, 3, 4, 6]].T
    c, s = np.cos(angle), np.sin(angle)
    middles = c * offset - s * middle, s * offset + c * middle
    seen = np.column_stack([angle, *middles, lines[:, 7:], lines[:, 5], deviation, twist])
    ends = np.column_stack([begin - middle, end - middle])
    in_A = se2.transform(X_AB[node], seen[:, 1:3])
    wall, newest = _grouped(X_AB[node, 2] + angle, in_A, ends, lines[:, 5], deviation)
    return Looks(node, wall, seen, ends, in_A[newest], np.arange(len(newest)))


@njit(cache=True)
def _grouped(
    angle: FloatArray, p_AM: FloatArray, ends: FloatArray, sigma_angle: FloatArray, sigma: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return the wall (q,) of each look in A, and the newest look (w,) at each wall."""
    q = len(angle)
    wall, newest, reach, walls = np.empty(q, dtype=np.int64), np.empty(q, dtype=np.int64), np.empty((q, 2)), 0
    for j in range(q):
        wall[j], nearest, moved = -1, np.inf, 0.0
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
                nearest, wall[j], moved = off, w, along
        w = wall[j]
        if w < 0:
            wall[j], newest[walls], reach[walls] = walls, j, ends[j]
            walls += 1
            continue
        reach[w, 0], reach[w, 1] = min(reach[w, 0], moved + ends[j, 0]), max(reach[w, 1], moved + ends[j, 1])
        newest[w] = j
        reach[w] -= moved
    return wall, newest[:walls].copy()


def ends_seen(one: Keyframe, shared: FloatArray) -> FloatArray:
    """Return both ends (w, 2, 2), m in A, of the walls of a keyframe, given the parameters (13,)."""
    w = one.walls
    return ends_of(one.given(shared)[0][:w], one.anchor[:w], one.reach[:w])


def same_walls(one: Keyframe, other: Keyframe) -> bool:
    """Return whether two keyframes with the same walls agree on each within SAME_WALL, m and rad."""
    apart = (one.y_AL - other.y_AL)[: one.walls]
    along = along_walls(one.y_AL[: one.walls])
    moved = (one.anchor - other.anchor)[: one.walls]
    off = apart[:, 1] + along[:, 1] * moved[:, 0] - along[:, 0] * moved[:, 1]
    return bool(np.all(np.abs(apart[:, 0]) < SAME_WALL) and np.all(np.abs(off) < SAME_WALL))


class SeenWalls(NamedTuple):
    """The walls of a turn as landmarks of its keyframe. order: (w,) of them among those of its looks, ids ascending.
    anchor: (w, 2) in A, reach: (w, 2) m. shift: (w,) m, displacement of the anchor along the wall from that of its
    looks. looks: (w,) number of looks."""

    order: IntArray
    ids: IntArray
    anchor: FloatArray
    reach: FloatArray
    shift: FloatArray
    looks: IntArray


def seen_walls(looks: Looks, walls: FloatArray, X_AB: FloatArray) -> SeenWalls:
    """Return the walls (w, 2) of a solution, each with an anchor on it in the middle of what was seen."""
    w, along = len(walls), along_walls(walls)
    middle = se2.transform(X_AB[looks.node], looks.seen[:, 1:3]) - looks.anchor[looks.wall]
    s = np.einsum("qi,qi->q", middle, along[looks.wall])
    reach = np.column_stack([np.full(w, np.inf), np.full(w, -np.inf)])
    np.minimum.at(reach[:, 0], looks.wall, s + looks.ends[:, 0])
    np.maximum.at(reach[:, 1], looks.wall, s + looks.ends[:, 1])
    order, shift = np.argsort(-looks.name), reach.mean(axis=1)
    anchor = ends_of(walls, looks.anchor, shift[:, None])[:, 0]
    counts = np.bincount(looks.wall, minlength=w)
    reach, ids = reach - shift[:, None], PROVISIONAL - 1 - looks.name
    return SeenWalls(order, ids[order], anchor[order], reach[order], shift[order], counts[order])


def with_floor(W: FloatArray, g: FloatArray, walls: int, level: float) -> tuple[FloatArray, FloatArray]:
    """Return information (u, u) and gradient (u,) with the floor of the walls, which are the first unknowns."""
    if not walls:
        return W, g
    of_walls = slice(0, 2 * walls)
    of_floor = np.diag(np.tile(1.0 / np.square(level * FLOOR), walls))
    taken = np.linalg.solve(W[of_walls, of_walls] + of_floor, W[of_walls])
    anew = W - W[:, of_walls] @ taken
    return 0.5 * (anew + anew.T), g - taken.T @ g[of_walls]


@message
class Names:
    """The association of a turn's walls with the map's: provisional (v,) ids in the turn, ids (v,) in the map."""

    provisional: Annotated[IntArray, "v"]
    ids: Annotated[IntArray, "v"]


def named(one: Keyframe, names: Names) -> Keyframe:
    """Return a keyframe with the map's ids for its walls; unassociated walls are marginalised out."""
    order = np.argsort(names.ids)
    rows = np.append(np.searchsorted(one.ids, names.provisional[order]), np.arange(one.walls, len(one.ids)))
    return replace(of_landmarks(one, rows), ids=np.append(names.ids[order], one.ids[one.walls :]))


def beside_walls(one: Keyframe) -> Keyframe:
    """Return a keyframe without the points on its walls, so that no ray counts twice."""
    w, free = one.walls, np.ones(len(one.points), dtype=bool)
    for (angle, distance), anchor, reach in zip(one.y_AL[:w], one.anchor[:w], one.reach[:w], strict=True):
        n = np.array([math.cos(angle), math.sin(angle)])
        p = one.points[:, :2] - anchor
        along = p @ [-n[1], n[0]]
        on = (np.abs(p @ n - distance) < ON_WALL) & (one.points[:, 2:] @ n < -SAME_DIRECTION)
        free &= ~(on & (along > reach[0] - ON_WALL) & (along < reach[1] + ON_WALL))
    return replace(one, points=one.points[free])


def identified(
    one: Keyframe, counts: IntArray, walls: Walls, estimate: MapEstimate, floor: float = 1.0
) -> tuple[Names, Walls]:
    """Associate the walls of a keyframe that begins at the map's newest pose with the map's, or accept them as new;
    returns the names and the updated statistics.

    counts: (n,) looks at each landmark of the keyframe. floor: with which it was reduced. Ambiguous walls get no name.
    """
    y_AL, _, R = one.given(estimate.shared)
    w, known = one.walls, np.flatnonzero(~is_tag(estimate.ids) & estimate.is_local)
    entry, length = estimate.local_entry[known], one.reach[:w, 1] - one.reach[:w, 0]
    seen = WallSet(y_AL[:w], one.anchor[:w], one.reach[:w])
    mapped = WallSet(estimate.p_ML[known], estimate.anchor[known], estimate.reach[known])
    squared, off, overlap = compared(seen, R, mapped, entry, estimate.X_MD, estimate.covariance)
    provisional, ids, again = [], [], []
    taken, next_id = np.zeros(len(known), dtype=bool), int(estimate.ids.min(initial=WALLS_BELOW)) - 1
    # The longest first: of two pieces of one wall the longer one is associated.
    for k in np.argsort(-length, kind="stable"):
        agrees = squared[k] < GATE
        if agrees.any():
            best = int(np.argmax(np.where(agrees, overlap[k], -np.inf)))
            rivals = agrees & (np.abs(off[k] - off[k, best]) > ONE_WALL)
            if not rivals.any() and not taken[best]:
                taken[best] = True
                again.append((k, best))
                provisional.append(one.ids[k])
                ids.append(estimate.ids[known[best]])
        elif not np.any(off[k] < UNCLEAR) and counts[k] >= walls.least_looks and length[k] >= LEAST_LENGTH:
            provisional.append(one.ids[k])
            ids.append(next_id)
            next_id -= 1
    if again:
        k, best = np.array(again).T
        rows = (2 * k[:, None] + [0, 1]).ravel()
        of_these = y_AL[k], one.anchor[k], R[np.ix_(rows, rows)]
        walls = walls.seen_again(*_off(*of_these, known[best], entry[best], estimate), floor)
    return Names(np.array(provisional, dtype=np.int64), np.array(ids, dtype=np.int64)), walls


def renamed(
    one: Keyframe, walls: Walls, estimate: MapEstimate, X_MA: FloatArray, covariance: FloatArray
) -> tuple[Names, Walls]:
    """Return the names of a keyframe's walls, in their order, with its start at X_MA (3,) of another map, known with
    this covariance (3, 3): those of the map's walls that agree, otherwise new ones; and the updated statistics."""
    joint = estimate.covariance.copy()
    joint[-3:], joint[:, -3:] = 0.0, 0.0
    joint[-3:, -3:] = covariance
    # With no looks `identified` accepts no new wall.
    none = np.zeros(len(one.ids), dtype=np.int64)
    again, walls = identified(one, none, walls, replace(estimate, X_MD=X_MA, covariance=joint), 0.0)
    ids = one.ids[: one.walls]
    new = int(estimate.ids.min(initial=WALLS_BELOW)) - 1 - np.arange(len(ids))
    new[np.searchsorted(ids, again.provisional)] = again.ids
    return Names(ids, new), walls


@njit(cache=True)
def compared(
    from_A: WallSet, R: FloatArray, mapped: WallSet, entry: IntArray, X_MD: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return squared errors (s, k) in deviations, distances (s, k) m, both infinite if walls face another way or hardly
    overlap, and overlaps (s, k) m, of s walls seen from the newest pose and k walls of the map.

    R: covariance of those seen, which come first in it. entry: (k,) among the jointly known landmarks.
    """
    (seen, p_AC, seen_reach), (wall, p_MC, reach) = from_A, mapped
    s, k, D = len(seen), len(wall), len(covariance) - 3
    squared, far, overlap = np.full((s, k), np.inf), np.full((s, k), np.inf), np.full((s, k), -np.inf)
    at = np.empty(5, dtype=np.int64)
    at[2:] = np.arange(D, D + 3)
    J = np.zeros((2, 5))
    J[0, 0], J[0, 4], J[1, 1] = 1.0, -1.0, 1.0
    ends = np.ones((2, 2))
    c, t = math.cos(X_MD[2]), math.sin(X_MD[2])
    for j in range(k):
        at[0], at[1] = 2 * entry[j], 2 * entry[j] + 1
        P = covariance[at][:, at]
        n_x, n_y = math.cos(wall[j, 0]), math.sin(wall[j, 0])
        for i in range(s):
            turn, off, by_angle, by_x, by_y, by_theta = wall_off(wall[j], p_MC[j], seen[i], p_AC[i], X_MD)
            if math.cos(turn) < SAME_DIRECTION:
                continue
            x = X_MD[0] + c * p_AC[i, 0] - t * p_AC[i, 1] - p_MC[j, 0]
            y = X_MD[1] + t * p_AC[i, 0] + c * p_AC[i, 1] - p_MC[j, 1]
            along = n_x * y - n_y * x
            least = min(OVERLAP, 0.5 * (seen_reach[i, 1] - seen_reach[i, 0]))
            shared = min(reach[j, 1], along + seen_reach[i, 1]) - max(reach[j, 0], along + seen_reach[i, 0])
            overlap[i, j] = shared
            if shared <= least:
                continue
            ends[:, 0] = -seen_reach[i]
            of_ends = ends @ np.array([turn, off])
            far[i, j] = np.abs(of_ends).max()
            J[1, 0], J[1, 2], J[1, 3], J[1, 4] = by_angle, by_x, by_y, by_theta
            S = J @ P @ J.T + R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            if np.trace(ends @ S @ ends.T) < 2.0 * MOST_DEVIATION**2:
                squared[i, j] = (S[1, 1] * turn * turn - 2.0 * S[0, 1] * turn * off + S[0, 0] * off * off) / (
                    S[0, 0] * S[1, 1] - S[0, 1] ** 2
                )
    return squared, far, overlap


def _off(
    seen: FloatArray, p_AC: FloatArray, R: FloatArray, row: IntArray, entry: IntArray, estimate: MapEstimate
) -> tuple[FloatArray, FloatArray]:
    """Return the errors (2q,), angle and distance, of walls (q, 2), seen from the newest pose with covariance R (2q,
    2q), against walls of the map, in rows (q,), entry (q,) among those jointly known; and their covariance (2q, 2q)."""
    q = len(row)
    J, off = np.zeros((2 * q, 2 * q + 3)), np.empty(2 * q)
    for k in range(q):
        wall, anchor, angle, distance = estimate.p_ML[row[k]], estimate.anchor[row[k]], 2 * k, 2 * k + 1
        off[angle], off[distance], by_angle, *by_pose = wall_off(wall, anchor, seen[k], p_AC[k], estimate.X_MD)
        J[angle, [angle, -1]] = 1.0, -1.0
        J[distance, [angle, distance, -3, -2, -1]] = by_angle, 1.0, *by_pose
    at = np.append((2 * entry[:, None] + [0, 1]).ravel(), len(estimate.covariance) - np.arange(3, 0, -1))
    return off, J @ estimate.covariance[np.ix_(at, at)] @ J.T + R

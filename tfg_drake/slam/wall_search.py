"""Finds a robot among the walls of the map by those that it has seen lately, wherever it may be.

Any two seen walls that are not parallel give a pose for any two of the map that stand at the same angle. It is judged
by how much of all that was seen lies on walls of the map. Where another place explains nearly as much, as in a building
of equal rooms, none is known.
"""

from __future__ import annotations

import itertools

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.walls import directions

# The longest walls seen are used, so many.
MOST = 8
# Two of them are not parallel where the sine of the angle between them is more than this; a pair of the map's stands at
# the same angle within this, rad.
LEAST_SINE, SAME_ANGLE = 0.5, 0.05
# What was seen lies on a wall where it is off it by no more than this, m.
ON_WALL = 0.06
# The robot is where so large a share of what was seen lies on walls, this much of it, m, and of so many.
LEAST_SHARE, LEAST_LENGTH, LEAST_WALLS = 0.8, 5.0, 3
# And every place farther off than SAME, m and rad, leaves so much more of it unexplained, m.
SAME = (0.5, 0.2)
MARGIN = 1.5
# A place as near as this, m, is asked first: that the robot has drifted is likelier than that somebody has carried it.
# And nobody carries it farther than this: the other end of a building, not mapped yet, may be alike.
DRIFTED, CARRIED = 1.5, 10.0
# Steps of a refinement: which walls are on which changes with the pose.
STEPS = 5


def find_place(
    seen: FloatArray, walls: FloatArray, expected: FloatArray, *, anywhere: bool = False
) -> tuple[FloatArray | None, float]:
    """The pose X_MA (3,) of the frame A in which walls (s, 2, 2) m were seen, None where that is not known; and the
    share of what was seen that lies on the map's walls from the best pose that is no farther than SAME from the
    expected one (3,).

    walls: (w, 2, 2) the ends of the map's walls, m in M. anywhere: the robot may be, and no place is likelier than
    others beforehand.
    """
    if not (len(walls) and len(seen)):
        return None, 0.0
    seen = seen[np.argsort(-directions(seen)[2], kind="stable")[:MOST]]
    poses = np.vstack([expected, _candidates(seen, walls)])
    share, on = _judged(poses, seen, walls)
    here, off = float(share[~_elsewhere(poses, expected)].max()), np.hypot(*(poses - expected)[:, :2].T)
    near = ((off < DRIFTED, DRIFTED), (off < np.inf, CARRIED))
    for is_rival, farthest in ((off < np.inf, np.inf),) if anywhere else near:
        best = int(np.argmax(np.where(off < farthest, share, -1.0)))
        matched, is_rival = on[best] >= 0, is_rival & _elsewhere(poses, poses[best])
        others = share[is_rival].max(initial=0.0) + MARGIN / directions(seen)[2].sum()
        if share[best] >= max(LEAST_SHARE, others) and tells_place(seen[matched]):
            return _fitted(poses[best], seen[matched], walls[on[best, matched]]), here
    return None, here


def refined(X_MA: FloatArray, seen: FloatArray, walls: FloatArray) -> FloatArray:
    """A pose (3,) that is known roughly, by least squares of all walls seen (s, 2, 2) that lie on those of the map from
    it; walls as of `find_place`."""
    for _ in range(STEPS):
        on = matched(X_MA, seen, walls)
        X_MA = _fitted(X_MA, seen[on >= 0], walls[on[on >= 0]])
    return X_MA


def matched(X_MA: FloatArray, seen: FloatArray, walls: FloatArray) -> IntArray:
    """The row (s,) of the map's wall that each wall seen from a pose (3,) lies on, -1 for none; as of `find_place`."""
    return np.asarray(_judged(X_MA[None], seen, walls)[1][0])


def tells_place(seen: FloatArray) -> bool:
    """Whether walls seen (s, 2, 2) are enough to tell where they are."""
    return len(seen) >= LEAST_WALLS and float(directions(seen)[2].sum()) >= LEAST_LENGTH


def _elsewhere(poses: FloatArray, X: FloatArray) -> BoolArray:
    """Which poses (k, 3) are farther than SAME from another (3,)."""
    off = poses - X
    return np.asarray((np.hypot(off[:, 0], off[:, 1]) > SAME[0]) | (np.abs(se2.wrap_angle(off[:, 2])) > SAME[1]))


def _headings(along: FloatArray) -> FloatArray:
    """The headings (n,), rad, of unit vectors (n, 2)."""
    return np.asarray(np.arctan2(along[:, 1], along[:, 0]))


def _candidates(seen: FloatArray, walls: FloatArray) -> FloatArray:
    """(k, 3) the poses that two seen walls give for any two of the map."""
    along, normal, _ = directions(walls)
    heading, heading_seen = _headings(along), _headings(directions(seen)[0])
    middle, offset = seen.mean(axis=1), np.sum(walls[:, 0] * normal, axis=1)
    poses = [np.empty((0, 3))]
    for i, j in itertools.combinations(range(len(seen)), 2):
        between = heading_seen[j] - heading_seen[i]
        if abs(np.sin(between)) < LEAST_SINE:
            continue
        apart = se2.wrap_angle(heading - heading[:, None] - between)
        a, b = np.nonzero(np.abs(apart) < SAME_ANGLE)
        theta = heading[a] - heading_seen[i] + 0.5 * apart[a, b]
        c, s = np.cos(theta), np.sin(theta)
        right = np.empty((len(a), 2))
        for column, (of, k) in enumerate(((a, i), (b, j))):
            x, y = middle[k]
            turned = np.column_stack([c * x - s * y, s * x + c * y])
            right[:, column] = offset[of] - np.sum(normal[of] * turned, axis=1)
        t = np.linalg.solve(np.stack([normal[a], normal[b]], axis=1), right[:, :, None])[:, :, 0]
        poses.append(np.column_stack([t, theta]))
    return np.concatenate(poses)


def _judged(poses: FloatArray, seen: FloatArray, walls: FloatArray) -> tuple[FloatArray, IntArray]:
    """The share (k,) of what was seen that lies on walls of the map, from each of the poses (k, 3), and the wall (k, s)
    that each seen one lies on most, -1 for none."""
    (along, normal, reach), (along_seen, _, length) = directions(walls), directions(seen)
    heading, heading_seen = _headings(along), _headings(along_seen)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    total, on = np.zeros(len(poses)), np.empty((len(poses), len(seen)), dtype=np.int64)
    for k in range(len(seen)):
        ends = []
        for x, y in seen[k]:
            ends.append(np.column_stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y]))
        off = [e @ normal.T - np.sum(walls[:, 0] * normal, axis=1) for e in ends]
        at = [e @ along.T - np.sum(walls[:, 0] * along, axis=1) for e in ends]
        overlap = np.minimum(reach, at[1]) - np.maximum(at[0], 0.0)
        turned = np.cos(poses[:, 2, None] + heading_seen[k] - heading)
        fits = (np.maximum(np.abs(off[0]), np.abs(off[1])) < ON_WALL) & (turned > 0.9)
        overlap = np.where(fits, np.maximum(overlap, 0.0), 0.0)
        best = np.argmax(overlap, axis=1)
        most = overlap[np.arange(len(poses)), best]
        total += np.minimum(most, length[k])
        on[:, k] = np.where(most > 0.5 * length[k], best, -1)
    return np.asarray(total / length.sum()), on


def _fitted(pose: FloatArray, seen: FloatArray, walls: FloatArray) -> FloatArray:
    """The pose (3,) from which walls seen (n, 2, 2) lie on those of the map (n, 2, 2) by least squares."""
    _, normal, _ = directions(walls)
    for _ in range(5):
        p = se2.transform(pose, seen.reshape(-1, 2)).reshape(-1, 2, 2)
        off = np.sum((p - walls[:, :1]) * normal[:, None], axis=2).ravel()
        n, lever = np.repeat(normal, 2, axis=0), p.reshape(-1, 2) - pose[:2]
        J = np.column_stack([n, n[:, 1] * lever[:, 0] - n[:, 0] * lever[:, 1]])
        pose = pose - np.linalg.lstsq(J, off, rcond=None)[0]
    return np.asarray(pose)

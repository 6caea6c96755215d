"""The localiser: a Schmidt filter of the pose between views, which considers landmarks and shared parameters.

State: the pose in the frame of the last departure pose D, and tags met on the way, which enter at their first sighting.
Considered, never updated: the landmarks of the map and the shared parameters, with their joint covariance. They inform
the pose, with their uncertainty; the map is updated by views only. Instead of the cross covariance the filter keeps the
sensitivity W of the state, x = W c + an independent part, for the landmarks seen since D only, so its cost does not
depend on the size of the map. It is linearised in D, where everything near is known well: in M a filter would gain
false information on the heading that it shares with the whole map (the inconsistency of EKF SLAM).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TagDetections, is_tag, message, replace
from tfg_drake.slam.keyframe import along_walls, placed, rows_of
from tfg_drake.slam.localizer_kernels import (
    POSE,
    Instant,
    Motion,
    State,
    correct_by_walls,
    filtered,
    pose_in_map,
    walls_seen,
)
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.tag_error import in_place
from tfg_drake.slam.walls import FLOOR, Walls, WallSet, no_walls
from tfg_drake.table import empty, take

# Greatest number of local tags; those unseen for the longest time are dropped.
MOST_LOCAL = 30
# Tags seen in fewer frames are no goals, as a single detection may be false.
LEAST_FRAMES = 2


@message
class Localizer:
    """The filter's Gaussian in D.

    map: the considered map, D is its X_MD. mean: (2k + 3,) pose and local tags, covariance: (2k + 3, 2k + 3). seen:
    (s,) rows in map.local of the landmarks seen since D, p_DL: (s, 2) their places. considered: (2s + 13, 2s + 13)
    covariance of the parameters and of these in D, with_D: (2s + 13, 3) with X_MD. sensitivity: (2k + 3, 2s + 13), W.
    local_ids, last_seen, local_frames: (k,) ids, stamps (s) and frames of the local tags. walls: of map.local, the
    first in it, in D. floor: as of `walls.Walls`.
    """

    map: MapEstimate
    mean: Annotated[FloatArray, "2k+3"]
    covariance: Annotated[FloatArray, "2k+3", "2k+3"]
    seen: Annotated[IntArray, "s"]
    p_DL: Annotated[FloatArray, "s", 2]
    considered: Annotated[FloatArray, f"2s+{SHARED}", f"2s+{SHARED}"]
    with_D: Annotated[FloatArray, f"2s+{SHARED}", 3]
    sensitivity: Annotated[FloatArray, "2k+3", f"2s+{SHARED}"]
    local_ids: Annotated[IntArray, "k"]
    last_seen: Annotated[FloatArray, "k"]
    local_frames: Annotated[IntArray, "k"]
    walls: WallSet
    floor: float

    @property
    def state(self) -> State:
        """mean, covariance and sensitivity."""
        return self.mean, self.covariance, self.sensitivity

    @property
    def X_MB(self) -> FloatArray:
        """The pose (3,) in M."""
        return se2.compose(self.map.X_MD, self.mean[:POSE])


def start_localizer(estimate: MapEstimate, walls: Walls | None = None) -> Localizer:
    """Return the localiser at the departure pose of the newest map, and its walls."""
    walls = walls or no_walls()
    of_walls = estimate.local[~is_tag(estimate.ids[estimate.local])]
    in_D = WallSet(*_in_departure(estimate, of_walls), estimate.reach[of_walls])
    start = empty(Localizer, map=estimate, walls=in_D, floor=walls.floor)
    return _with_seen(start, start.seen)


def placed_localizer(estimate: MapEstimate, walls: Walls, X_MB: FloatArray, sigma: FloatArray) -> Localizer:
    """Return the localiser at a pose X_MB (3,) found among the walls, with deviations sigma (3,), m, m, rad."""
    mean = se2.between(estimate.X_MD, X_MB)
    return replace(start_localizer(estimate, walls), mean=mean, covariance=np.diag(sigma) ** 2)


def step_localizer(
    localizer: Localizer, motion: Motion, detections: TagDetections, instant: Instant
) -> tuple[Localizer, int, int]:
    """Return the localiser after an odometry increment and the frame at its end, the number of sightings of known tags,
    and the number of those ignored.

    Known tags correct the pose, all at once; unknown ones join the state. A sighting outside its gate is ignored.
    """
    now, ids = localizer, detections.ids
    row, known = rows_of(ids, now.map.ids[now.map.local])
    row, entry = np.where(known, row, -1), np.where(known, -1, _places(ids, now.local_ids, POSE))
    new = known & (_places(row, now.seen, SHARED) < 0)
    if new.any():
        now = _with_seen(now, np.append(now.seen, np.sort(row[new])))
    column = _places(row, now.seen, SHARED)
    considered, places = (now.map.shared, now.considered), (column, entry, now.p_DL)
    frame = detections.bearing, detections.range, detections.sigma_bearing, detections.sigma_range
    (mean, covariance, sensitivity), accepted = filtered(now.state, considered, motion, instant, places, frame)
    now = replace(now, mean=mean, covariance=covariance, sensitivity=sensitivity)
    local, fresh = entry >= 0, (column < 0) & (entry < 0)
    of, inside = (entry[local] - POSE) // 2, accepted[local]
    frames, last_seen = now.local_frames.copy(), now.last_seen.copy()
    frames[of] += np.where(inside, 1, -1)
    last_seen[of[inside]] = detections.stamp
    now = replace(
        now,
        local_ids=np.append(now.local_ids, ids[fresh]),
        last_seen=np.append(last_seen, np.full(np.count_nonzero(fresh), detections.stamp)),
        local_frames=np.append(frames, np.ones(np.count_nonzero(fresh), dtype=np.int64)),
    )
    # A tag that was seen elsewhere as often as at its place is forgotten; its next sighting gives the new place.
    keep = now.local_frames > 0
    if len(keep) > MOST_LOCAL:
        keep[np.argsort(-now.last_seen, kind="stable")[MOST_LOCAL:]] = False
    known = ~fresh
    return _keep_local(now, keep), int(np.count_nonzero(known)), int(np.count_nonzero(known & ~accepted))


def _places(these: IntArray, among: IntArray, first: int) -> IntArray:
    """Return the index (m,) of the first of the two entries of each among `among` (k,), whose entries begin at `first`;
    -1 if it is not among them."""
    places = np.full(len(these), -1)
    i, k = np.nonzero(these[:, None] == among)
    places[i] = first + 2 * k
    return places


def corrected_by_walls(
    localizer: Localizer, lines: FloatArray, twist: FloatArray, variance: FloatArray
) -> tuple[Localizer, int, int]:
    """Return the localiser corrected by the lines (k, 11) of a scan at its instant, see `scan_lines`, that are known
    walls; the number of lines that test the pose, and the number that contradict it: those behind known walls or
    outside the gate.

    twist: (2,) forward speed (m/s) and turn rate (rad/s) then, with variance (2,).
    """
    now, shared = localizer, localizer.map.shared
    wall, through = walls_seen(now.mean[:POSE], shared, twist, lines, now.walls)
    found = wall >= 0
    if not found.any():
        return now, through, through
    lines, wall = lines[found], wall[found]
    # Without np.setdiff1d, which takes as long as the correction.
    new = wall[~(now.seen == wall[:, None]).any(axis=1)]
    if len(new):
        now = _with_seen(now, np.append(now.seen, np.unique(new)))
    column = SHARED + 2 * np.argmax(now.seen == wall[:, None], axis=1)
    state = now.mean.copy(), now.covariance.copy(), now.sensitivity.copy()
    of_lines = WallSet(*(of[wall] for of in now.walls))
    fits = correct_by_walls(state, (shared, now.considered), (twist, variance), lines, column, of_lines)
    mean, covariance, sensitivity = state
    now = replace(now, mean=mean, covariance=covariance, sensitivity=sensitivity)
    return now, len(lines) + through, int(np.count_nonzero(~fits)) + through


def without_local(localizer: Localizer) -> Localizer:
    """Return the localiser without the tags met on the way."""
    return _keep_local(localizer, np.zeros(len(localizer.local_ids), dtype=bool))


def localized_pose(
    localizer: Localizer, noise: FloatArray, increment: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Return X_MB (3,) and its covariance (3, 3) after an odometry increment (3,) over dt seconds."""
    estimate, considered = localizer.map, (localizer.map.shared, localizer.considered)
    return pose_in_map(
        localizer.state, considered, (increment, dt, noise), estimate.X_MD, localizer.with_D, estimate.covariance
    )


def new_tags(localizer: Localizer, ids: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the ids (u,) of tags met on the way in LEAST_FRAMES or more that are not among `ids` (n,), ascending, and
    their p_MU (u, 2)."""
    some = (localizer.local_frames >= LEAST_FRAMES) & ~rows_of(localizer.local_ids, ids)[1]
    p_DU = localizer.mean[POSE:].reshape(-1, 2)[some]
    return localizer.local_ids[some], se2.transform(localizer.map.X_MD, p_DU)


def _considered(estimate: MapEstimate, seen: IntArray, floor: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return considered, with_D and p_DL, see Localizer, for the landmarks in rows (s,) of the map's local.

    p_DL = R_MD^T (p_ML - t_MD), so an error of X_MD moves it by -R_MD^T and turns it about D; it turns a wall, and
    moves it along its normal. The constant errors of tags, as seen from D, and those that a keyframe's looks at a wall
    share, see `walls.FLOOR`, are added.
    """
    X_MD, s, size = estimate.X_MD, len(seen), len(estimate.covariance)
    R_DM, walls = se2.rotation(float(X_MD[2])).T, np.flatnonzero(~is_tag(estimate.ids[estimate.local[seen]]))
    p_DL, p_DC = _in_departure(estimate, estimate.local[seen])
    along = along_walls(p_DL[walls])
    normal, lever = np.column_stack([along[:, 1], -along[:, 0]]) @ R_DM, np.sum(along * p_DC[walls], axis=1)
    at = np.append((2 * seen[:, None] + [0, 1]).ravel(), np.arange(size - 3, size))
    P = np.empty((2 * s + 3 + SHARED, 2 * s + 3 + SHARED))
    P[:-SHARED, :-SHARED] = estimate.covariance[np.ix_(at, at)]
    P[:-SHARED, -SHARED:] = estimate.with_shared[at]
    P[-SHARED:, :-SHARED], P[-SHARED:, -SHARED:] = estimate.with_shared[at].T, estimate.with_shared[size:]

    def seen_from_D(rows: FloatArray) -> FloatArray:
        """Return errors of parameters, landmarks in D, X_MD, from those of landmarks in M, X_MD, parameters."""
        in_M, of_D, turned = rows[: 2 * s].reshape(s, 2, rows.shape[1]), rows[2 * s : 2 * s + 2], rows[2 * s + 2]
        in_D = np.einsum("ij,sjk->sik", R_DM, in_M - of_D)
        in_D[:, 0] += p_DL[:, 1, None] * turned
        in_D[:, 1] -= p_DL[:, 0, None] * turned
        in_D[walls, 0] = in_M[walls, 0] - turned
        in_D[walls, 1] = in_M[walls, 1] - normal @ of_D + lever[:, None] * turned
        return np.vstack([rows[-SHARED:], in_D.reshape(2 * s, rows.shape[1]), rows[2 * s : 2 * s + 3]])

    joint = seen_from_D(seen_from_D(P).T)
    if estimate.tag_error.any():
        own = in_place(p_DL, estimate.tag_error)
        own[walls] = 0.0
        joint[SHARED:-3, SHARED:-3] += scipy.linalg.block_diag(*own)
    of_walls = SHARED + 2 * walls[:, None] + [0, 1]
    joint[of_walls, of_walls] += np.square(floor * FLOOR)
    return joint[:-3, :-3].copy(), joint[:-3, -3:].copy(), p_DL


def _in_departure(estimate: MapEstimate, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return landmarks of the map in rows (s,), and the anchors of walls, (s, 2) each, in D."""
    return placed(se2.inverse(estimate.X_MD), estimate.ids[rows], estimate.p_ML[rows], estimate.anchor[rows])


def _with_seen(localizer: Localizer, seen: IntArray) -> Localizer:
    """Return the localiser that considers the landmarks in rows (s,) of the map's local, the earlier ones first."""
    considered, with_D, p_DL = _considered(localizer.map, seen, localizer.floor)
    sensitivity = np.pad(localizer.sensitivity, ((0, 0), (0, len(considered) - len(localizer.considered))))
    return replace(localizer, seen=seen, considered=considered, with_D=with_D, p_DL=p_DL, sensitivity=sensitivity)


def _keep_local(localizer: Localizer, keep: BoolArray) -> Localizer:
    """Return the localiser with only some (k,) of its local tags; the others are marginalised out."""
    if keep.all():
        return localizer
    rows = np.append(np.ones(POSE, dtype=bool), np.repeat(keep, 2))
    return replace(
        take(localizer, k=keep),
        mean=localizer.mean[rows],
        covariance=localizer.covariance[np.ix_(rows, rows)],
        sensitivity=localizer.sensitivity[rows],
    )

"""Layers of a map as tables: how far a row has to move until it is told anew."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.star import inside_any
from tfg_drake.messages import GoalChoice, MapEstimate, Roadmap, TfgMap
from tfg_drake.pictures.rows import Table
from tfg_drake.pictures.scene import POSITION
from tfg_drake.slam.walls import known_walls
from tfg_drake.tfg.frontier import PUSH, SPACING

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap
    from tfg_drake.slam.keyframe_graph import KeyframeGraph

# Resolution of a variance's logarithm, a tenth of a standard deviation, and of a correlation.
VARIANCE = 0.2
# Resolution of a gain, as a share of the greatest: a fifth of a step from one shade to the next.
SHARE = 0.04
# Added to variances, m^2, so that deviations below a tenth of a millimetre look alike.
LEAST = 1e-8


def landmarks(estimate: MapEstimate | SavedMap) -> Table:
    """points: (n, 2) m. covariance: (n, 3) of xx, xy, yy, m^2. doubtful: (n,). ids: (n,)."""
    covariance, doubtful = estimate.landmark_covariance[:, [0, 0, 1], [0, 1, 1]], estimate.is_doubtful
    xx, xy, yy = covariance.T + np.array([[LEAST], [0.0], [LEAST]])
    spread = np.column_stack([np.log(xx), np.log(yy)]) / VARIANCE
    correlation = xy / np.sqrt(xx * yy) / VARIANCE
    values = np.column_stack([estimate.p_ML / POSITION, spread, correlation, 2.0 * doubtful])
    told = {"covariance": covariance.astype(np.float32), "doubtful": doubtful}
    return Table({"points": estimate.p_ML, **told, "ids": estimate.ids}, values, estimate.ids)


def wall_landmarks(known: MapEstimate | KeyframeGraph) -> Table:
    """segments: (w, 4) from one point of a wall to the other, m. deviation: (w, 2) normal to the wall at these, m."""
    ids, p_ML, deviation = known_walls(known)
    segments = p_ML.reshape(-1, 4)
    values = np.column_stack([segments / POSITION, np.log(deviation**2 + LEAST) / VARIANCE])
    return Table({"segments": segments, "deviation": deviation.astype(np.float32)}, values, ids)


def surfaces(tfg: TfgMap) -> Table:
    """segments: (m, 4) m. kind: (m,) 0 edge, 1 wall end, 2 surface without a landmark, 3 area not to be entered."""
    segments, kind = tfg.obstacles, np.append(tfg.segment_kind, np.full(len(tfg.keep_out), 3))
    values = np.column_stack([segments / POSITION, 2.0 * kind])
    return Table({"segments": segments, "kind": kind.astype(np.uint8)}, values)


def frontiers(tfg: TfgMap) -> Table:
    """segments: (f, 4) m, a bar at each of the frontier's points: on the border of what is known, or of one that lies
    in free space, in front of a surface, on that surface."""
    p, normal = np.array(tfg.frontiers), tfg.frontier_normal
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    in_free = inside_any(p, tfg.star_offsets, tfg.star_vertices)
    to_surface = clearance(np.hstack([p, p]), tfg.segments, PUSH) % PUSH  # 0 where there is none
    p = p + np.where(in_free, -to_surface, PUSH)[:, None] * normal
    # A point may stand for that of several views, which lies round about.
    half = 0.5 * np.minimum(tfg.frontier_length, SPACING)[:, None] * along
    segments = np.hstack([p - half, p + half])
    return Table({"segments": segments}, segments / POSITION)


def nodes(roadmap: Roadmap) -> Table:
    """points: (n, 2) m. ids: (n,) of the nodes."""
    ids = roadmap.node_ids(np.arange(len(roadmap.points)))
    return Table({"points": roadmap.points, "ids": ids}, roadmap.points / POSITION, ids)


def edges(roadmap: Roadmap) -> Table:
    """edges: (e, 2) ids of nodes."""
    ends = roadmap.node_ids(roadmap.edges)
    return Table({"edges": ends}, np.zeros((len(ends), 0)), (ends[:, 0] << 32) + ends[:, 1])


def gains(choice: GoalChoice, roadmap: Roadmap) -> Table:
    """points: (c, 2) m, of the candidates. share: (c,) of the most gain, of 255."""
    rows = roadmap.nodes(choice.candidates)
    known = rows >= 0
    best = max(float(np.max(choice.gain, initial=0.0)), 1e-9)
    points, share = roadmap.points[rows[known]], np.clip(choice.gain / best, 0.0, 1.0)[known]
    values = np.column_stack([points / POSITION, share / SHARE])
    arrays: dict[str, NDArray[Any]] = {"points": points, "share": np.rint(255.0 * share).astype(np.uint8)}
    return Table(arrays, values, choice.candidates[known])

"""The rules of Mu et al. (CDC 2016) as printed, for the method `paper`, where ours differ.

Each has the one repair without which it is meaningless, and states it. docs/method.md compares them with ours.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tfg_drake.messages import BoolArray, FloatArray, IntArray, TfgMap, replace
from tfg_drake.planning.candidates import Situation, places
from tfg_drake.planning.expected_view import expected_tags
from tfg_drake.planning.parameters import COMFORT

# Surfaces whose ends are within this distance, m, are connected.
TOUCH = 0.1


@dataclasses.dataclass(frozen=True)
class PaperRules:
    """The selection of the paper's rules; ours replace those that are off.

    argmax: the goal is the sample of most gain, however far (Sec. III-C, the argmax of the entropy reduction). theorem:
    the gain is that of Theorem 1. frontiers: these are gaps between landmarks (Sec. III-D). path_cost: that of
    Sec. III-E. only_at_goals: sightings on the way localise and are not mapped, and there are no glances (Sec. III-C).
    one_turn: at the start the robot turns once, as at any goal. only_landmarks: walls are not landmarks (Sec. II).
    """

    argmax: bool = True
    theorem: bool = True
    frontiers: bool = True
    path_cost: bool = True
    only_at_goals: bool = True
    one_turn: bool = True
    only_landmarks: bool = True

    def settings(self) -> list[str]:
        """The scenario's settings that implement some of the rules, as for `--set`."""
        settings = {
            "argmax": ["goal=argmax"],
            "theorem": ["gain=paper"],
            "only_at_goals": ["glance_period=0", "path_keyframe_period=0"],
            "one_turn": ["first_look=0", "first_turns=1"],
            "only_landmarks": ["landmarks=tags"],
        }
        return [f"explorer.{one}" for rule, all_of in settings.items() if getattr(self, rule) for one in all_of]


def frontiers_between_landmarks(now: Situation) -> Situation:
    """Return the situation with the frontiers of Sec. III-D: at each reachable place the landmarks expected in view are
    sorted by bearing, and two consecutive ones that both border a frontier are the ends of one. Its size is their
    distance, and new landmarks are expected in its middle.

    A landmark borders a frontier if at least one side of it is not connected to any neighbour. Repair: two connected
    landmarks are never the ends of a frontier.
    """
    estimate, tfg, roadmap = now.estimate, now.tfg, now.roadmap
    nodes = places(roadmap, tfg, estimate.X_MD[:2])
    points = roadmap.points[nodes]
    seen = expected_tags(points, estimate, tfg, now.parameters.sensor)
    # Every entry and the next by bearing, round to the first; of two landmarks one pair.
    point = np.repeat(np.arange(len(points)), seen.count)
    way = estimate.p_ML[seen.index] - points[point]
    order = np.lexsort((np.arctan2(way[:, 1], way[:, 0]), point))
    following = np.arange(len(order)) + 1
    last = seen.offsets[1:][seen.count > 0] - 1
    following[last] = seen.offsets[:-1][seen.count > 0]
    following[last[seen.count[seen.count > 0] == 2]] -= -1
    a, b = seen.index[order], seen.index[order][following]
    joined, borders = neighbours(tfg, estimate.ids, estimate.p_ML)
    ends = borders[a] & borders[b] & (a != b) & ~joined[a, b]
    p, point = 0.5 * (estimate.p_ML[a] + estimate.p_ML[b])[ends], point[ends]
    normal = points[point] - p
    count = np.zeros(len(roadmap.points), dtype=np.int64)
    count[nodes] = np.bincount(point, minlength=len(nodes))
    return dataclasses.replace(
        now,
        tfg=replace(
            tfg,
            frontiers=p,
            frontier_length=np.hypot(*(estimate.p_ML[b] - estimate.p_ML[a])[ends].T),
            frontier_normal=normal / np.maximum(np.hypot(*normal.T), 1e-9)[:, None],
        ),
        roadmap=replace(
            roadmap, frontier_offsets=np.append(0, np.cumsum(count)), frontier_index=np.arange(len(p), dtype=np.int64)
        ),
    )


def neighbours(tfg: TfgMap, ids: IntArray, p_ML: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return masks of connected landmarks, (n, n), joined by a surface with no other landmark on it (Sec. III-A), and
    of those that border a frontier (n,), with an unconnected side (Sec. III-D).

    ids: (n,) ascending. p_ML: (n, 2), m in M.
    """
    n, m, end_ids = len(ids), len(tfg.segments), tfg.segment_ids.ravel()
    is_end = np.isin(end_ids, ids)
    # Pieces that touch where no landmark is are of one surface.
    piece = np.arange(2 * m) // 2
    touch = cKDTree(tfg.segments.reshape(-1, 2)[~is_end]).query_pairs(TOUCH, output_type="ndarray")
    first, second = piece[~is_end][touch].T if len(touch) else np.zeros((2, 0), dtype=np.int64)
    _, surface = connected_components(coo_matrix((np.ones(len(first)), (first, second)), shape=(m, m)), directed=False)
    on = np.zeros((n, int(surface.max(initial=-1)) + 1), dtype=np.bool_)
    on[np.searchsorted(ids, end_ids[is_end]), surface[piece[is_end]]] = True
    joined = (on.astype(np.float64) @ on.T > 0.0) & ~np.eye(n, dtype=np.bool_)
    # To the left of its outward normal a landmark has what lies that way along its surface.
    left = np.column_stack([-tfg.facing[:, 1], tfg.facing[:, 0]])
    side = np.einsum("ijk,ik->ij", p_ML[None] - p_ML[:, None], left)
    return joined, ~((joined & (side > 0.0)).any(axis=1) & (joined & (side < 0.0)).any(axis=1))


def cost_of_edge(length: FloatArray, gap: FloatArray) -> FloatArray:
    """Return the cost (e,) of edges by Sec. III-E: the length (e,), m, plus a penalty, the squared distance to the
    closest obstacle. gap: (e,) m.

    Repair: the sign. As printed, a path that keeps away from obstacles costs more; here the penalty is COMFORT squared
    minus the squared distance, and zero beyond COMFORT.
    """
    return np.asarray(np.maximum(length, 1e-9) + COMFORT**2 - np.minimum(gap, COMFORT) ** 2)

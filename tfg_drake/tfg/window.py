"""The part of a large map round a place: what a goal changes lies there, and costs no more than on a small map.

A goal sees as far as its scan reaches, and what lies there was seen by goals within twice that. So on a map too large
to be known jointly the graph of those takes the goal up as the whole would, and nothing else is touched.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tfg_drake.config import ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.distance import segment_distance
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap, replace
from tfg_drake.tfg import graph as tfg_graph
from tfg_drake.tfg.frontier import FrontierPoints, join, no_points, place_points, select
from tfg_drake.tfg.graph import Sightings, TfgGraph
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.surfaces import Surfaces

# How far two places that were once next to each other may have been torn apart by a loop that closed, m.
TORN = 1.0


def is_small(estimate: MapEstimate) -> bool:
    """Whether all of the map is known jointly: then it is not cut to pieces."""
    return len(estimate.local) == len(estimate.ids)


def update(
    graph: TfgGraph,
    estimate: MapEstimate,
    panorama: Panorama,
    sightings: Sightings,
    tags: TagSensorConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    *,
    glance: bool = False,
) -> TfgGraph:
    """As `tfg_drake.tfg.graph.update`, of a large map the part round the newest goal only.

    Raises ValueError where the estimate is of another stage than the next.
    """
    if is_small(estimate):
        return tfg_graph.update(graph, estimate, panorama, sightings, tags, robot, explorer, glance=glance)
    seen = panorama.range_max + TORN
    place = estimate.X_MA[-1, :2]
    goals = within(estimate.X_MA[: graph.stage], place, 2.0 * seen)
    surfaces = goals[graph.surfaces.goal]
    landmarks = within(estimate.p_ML, place, 2.0 * seen) | np.isin(estimate.ids, graph.surfaces.ids[surfaces])
    near, far = split(graph, estimate, goals, landmarks, place, 2.0 * seen)
    near = tfg_graph.update(
        near,
        of_landmarks(estimate, landmarks),
        panorama,
        sightings,
        tags,
        robot,
        explorer,
        glance=glance,
        goals=np.flatnonzero(goals),
        reach=seen,
    )
    missing = ~np.isin(near.sighted.id, estimate.ids)
    near = replace(near, sighted=select(near.sighted, missing), viewpoints=select(near.viewpoints, missing))
    return joined(near, np.append(np.flatnonzero(goals), graph.stage), far, np.flatnonzero(~goals))


def of_landmarks(estimate: MapEstimate, keep: BoolArray) -> MapEstimate:
    """The map with some of its landmarks (n,) only, and with all its goals."""
    local = keep[estimate.local]
    rows = np.append(np.repeat(local, 2), np.ones(3, dtype=np.bool_))
    return replace(
        estimate,
        ids=estimate.ids[keep],
        p_ML=estimate.p_ML[keep],
        local=np.cumsum(keep)[estimate.local[local]] - 1,
        covariance=estimate.covariance[np.ix_(rows, rows)],
        landmark_covariance=estimate.landmark_covariance[keep],
    )


def map_near(tfg: TfgMap, estimate: MapEstimate, place: FloatArray, reach: float) -> tuple[TfgMap, MapEstimate]:
    """The TFG, row for row with a map, and that map, as far as they come within reach (m) of a place (2,), in M."""
    surface = segment_distance(tfg.segments, np.concatenate([place, place])[None]) <= reach
    star, frontier = within(tfg.star_centers, place, reach), within(tfg.frontiers, place, reach)
    landmarks = within(estimate.p_ML, place, reach)
    count = np.diff(tfg.star_offsets)
    near = replace(
        tfg,
        segments=tfg.segments[surface],
        segment_kind=tfg.segment_kind[surface],
        segment_ids=tfg.segment_ids[surface],
        facing=tfg.facing[landmarks],
        frontiers=tfg.frontiers[frontier],
        frontier_length=tfg.frontier_length[frontier],
        frontier_normal=tfg.frontier_normal[frontier],
        star_offsets=np.append(0, np.cumsum(count[star])),
        star_vertices=tfg.star_vertices[np.repeat(star, count)],
        star_centers=tfg.star_centers[star],
        viewpoints=tfg.viewpoints[within(tfg.viewpoints, place, reach)],
    )
    return near, of_landmarks(estimate, landmarks)


def split(
    graph: TfgGraph,
    estimate: MapEstimate,
    goals: BoolArray,
    landmarks: BoolArray,
    place: FloatArray,
    reach: float,
) -> tuple[TfgGraph, TfgGraph]:
    """The surfaces and stars that some of the goals (k,) saw, some of the map's landmarks (n,), and the frontier points
    within reach (m) of a place (2,), in M; and the rest. Tags sighted are all in the first."""
    tags = landmarks[np.searchsorted(estimate.ids, graph.tag_ids)]

    def near(points: FrontierPoints) -> BoolArray:
        return within(place_points(points, estimate.X_MA).p, place, reach)

    first = _part(graph, goals, tags, near, sighted=True)
    return first, _part(graph, ~goals, ~tags, lambda points: ~near(points), sighted=False)


def joined(a: TfgGraph, a_goals: IntArray, b: TfgGraph, b_goals: IntArray) -> TfgGraph:
    """The graph of two parts, each with the stars of its goals; the first is the newer one."""
    tag, star = np.argsort(np.concatenate([a.tag_ids, b.tag_ids])), np.argsort(np.concatenate([a_goals, b_goals]))
    surfaces = Surfaces(
        np.concatenate([a.surfaces.kind, b.surfaces.kind]),
        np.concatenate([a.surfaces.ids, b.surfaces.ids]),
        np.concatenate([a.surfaces.goal, b.surfaces.goal]),
        np.concatenate([a.surfaces.range, b.surfaces.range]),
        _chained(a.surfaces.offsets, b.surfaces.offsets),
        np.concatenate([a.surfaces.vertices, b.surfaces.vertices]),
    )
    star_offsets, star_vertices = _taken(
        star, _chained(a.star_offsets, b.star_offsets), np.concatenate([a.star_vertices, b.star_vertices])
    )
    return TfgGraph(
        stage=a.stage,
        surfaces=_surfaces(surfaces, np.argsort(surfaces.kind, kind="stable")),
        tag_ids=np.concatenate([a.tag_ids, b.tag_ids])[tag],
        tag_goal=np.concatenate([a.tag_goal, b.tag_goal])[tag],
        tag_facing=np.concatenate([a.tag_facing, b.tag_facing])[tag],
        tag_range=np.concatenate([a.tag_range, b.tag_range])[tag],
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        shadows=join(a.shadows, b.shadows),
        uninspected=join(a.uninspected, b.uninspected),
        unseen_backs=join(a.unseen_backs, b.unseen_backs),
        open_ends=join(a.open_ends, b.open_ends),
        sighted=join(a.sighted, b.sighted),
        viewpoints=join(a.viewpoints, b.viewpoints),
        tried=join(a.tried, b.tried),
        tried_count=np.concatenate([a.tried_count, b.tried_count]),
    )


def within(points: FloatArray, place: FloatArray, reach: float) -> BoolArray:
    """Which points or poses (n, 2 or 3) lie within reach (m) of a place (2,), (n,)."""
    return np.asarray(np.hypot(points[:, 0] - place[0], points[:, 1] - place[1]) <= reach)


def _part(
    graph: TfgGraph,
    goals: BoolArray,
    tags: BoolArray,
    points: Callable[[FrontierPoints], BoolArray],
    *,
    sighted: bool,
) -> TfgGraph:
    """The surfaces and stars of some goals (k,), some tags (n,), the points asked for, and all tags sighted or none."""
    star_offsets, star_vertices = _taken(np.flatnonzero(goals), graph.star_offsets, graph.star_vertices)

    def asked(of: FrontierPoints) -> FrontierPoints:
        return select(of, points(of))

    return TfgGraph(
        stage=graph.stage,
        surfaces=_surfaces(graph.surfaces, np.flatnonzero(goals[graph.surfaces.goal])),
        tag_ids=graph.tag_ids[tags],
        tag_goal=graph.tag_goal[tags],
        tag_facing=graph.tag_facing[tags],
        tag_range=graph.tag_range[tags],
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        sighted=graph.sighted if sighted else no_points(),
        viewpoints=graph.viewpoints if sighted else no_points(),
        shadows=asked(graph.shadows),
        uninspected=asked(graph.uninspected),
        unseen_backs=asked(graph.unseen_backs),
        open_ends=asked(graph.open_ends),
        tried=asked(graph.tried),
        tried_count=graph.tried_count[points(graph.tried)],
    )


def _surfaces(surfaces: Surfaces, rows: IntArray) -> Surfaces:
    """Some of the surfaces, in this order."""
    offsets, vertices = _taken(rows, surfaces.offsets, surfaces.vertices)
    return Surfaces(
        surfaces.kind[rows], surfaces.ids[rows], surfaces.goal[rows], surfaces.range[rows], offsets, vertices
    )


def _taken(rows: IntArray, offsets: IntArray, packed: FloatArray) -> tuple[IntArray, FloatArray]:
    """Offsets and contents of some rows of a packed array, in this order."""
    count = np.diff(offsets)[rows]
    taken = np.append(0, np.cumsum(count))
    return taken, packed[np.repeat(offsets[rows] - taken[:-1], count) + np.arange(taken[-1])]


def _chained(a: IntArray, b: IntArray) -> IntArray:
    """Offsets of two packed arrays, one behind the other."""
    return np.concatenate([a, a[-1] + b[1:]])

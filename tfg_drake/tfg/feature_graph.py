"""The topological feature graph as it is kept, and the part of it that is near the newest view."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, is_tag, message, replace
from tfg_drake.tfg.frontier import FrontierPoints, join, no_points, place_points, select
from tfg_drake.tfg.near import within
from tfg_drake.tfg.polyline import taken
from tfg_drake.tfg.surfaces import Surfaces, no_surfaces, place


@message
class TfgGraph:
    """The graph in the coordinates of its walls and views.

    stage: number of views in it. surfaces: obstacle surfaces. tag_ids: (n,) ascending, tag_view: (n,) and tag_facing:
    (n, 2): the side each landmark faces, a unit vector in that view's frame; tag_range: (n,) m from where it was seen.
    star_offsets: (k + 1,), star_vertices: (v, 2) in each view's frame, m. free_space_frontiers: points where free space
    ends at the unknown and no star has covered it yet. uninspected: points of surface on which a tag may have been
    missed. unseen_backs: points on the far faces of thin walls that no view has seen. open_ends: points in front of
    other faces that none has seen. sighted: tags seen on the way and not mapped, viewpoints: row for row the place of
    the robot then. tried: places where views have tried a frontier in vain, tried_count: (t,) how often. met: points
    of dynamic obstacles, until they are seen past, met_stamp: (p,) when they were met, s.
    """

    stage: int
    surfaces: Surfaces
    tag_ids: IntArray
    tag_view: IntArray
    tag_facing: FloatArray
    tag_range: FloatArray
    star_offsets: IntArray
    star_vertices: FloatArray
    free_space_frontiers: FrontierPoints
    uninspected: FrontierPoints
    unseen_backs: FrontierPoints
    open_ends: FrontierPoints
    sighted: FrontierPoints
    viewpoints: FrontierPoints
    tried: FrontierPoints
    tried_count: IntArray
    met: FrontierPoints
    met_stamp: FloatArray


_TAGS = ("tag_ids", "tag_view", "tag_facing", "tag_range")
# Points, and what there is of each besides.
_POINTS = {
    **dict.fromkeys(("free_space_frontiers", "uninspected", "unseen_backs", "open_ends"), ()),
    "tried": ("tried_count",),
    "met": ("met_stamp",),
}


def empty_graph() -> TfgGraph:
    """The graph before the first view."""
    none, pairs, points = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), no_points()
    return TfgGraph(
        stage=0,
        surfaces=no_surfaces(),
        tag_ids=none,
        tag_view=none,
        tag_facing=pairs,
        tag_range=np.zeros(0),
        star_offsets=np.zeros(1, dtype=np.int64),
        star_vertices=pairs,
        free_space_frontiers=points,
        uninspected=points,
        unseen_backs=points,
        open_ends=points,
        sighted=points,
        viewpoints=points,
        tried=points,
        tried_count=none,
        met=points,
        met_stamp=np.zeros(0),
    )


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a graph: what is near a view.

    surfaces: (s,), tags: (n,), views: (k,) and points, of each kind: which of the whole graph's are in it; all tags
    that were sighted are. graph: the part by itself, with the stars of its views only. estimate: the map with the
    landmarks that are near, or that something near is anchored to or joins.
    """

    surfaces: BoolArray
    tags: BoolArray
    views: BoolArray
    points: Mapping[str, BoolArray]
    graph: TfgGraph
    estimate: MapEstimate


def part_of(graph: TfgGraph, estimate: MapEstimate, radius: float) -> Part:
    """What of the graph lies within a radius (m) of the newest view of the estimate, or was seen by that."""
    X_MA = estimate.X_MA

    def near(points: FloatArray) -> BoolArray:
        return within(points, X_MA[-1], radius)

    views = near(X_MA[: graph.stage])
    vertices = np.append(near(place(graph.surfaces, estimate)), False)
    surfaces = np.logical_or.reduceat(vertices, graph.surfaces.offsets[:-1])
    tags = near(estimate.p_ML[np.searchsorted(estimate.ids, graph.tag_ids)])
    tags |= np.isin(graph.tag_ids, estimate.observation.ids)
    points = {name: near(place_points(getattr(graph, name), X_MA).p) for name in _POINTS}
    star_offsets, star_vertices = taken(np.flatnonzero(views), graph.star_offsets, graph.star_vertices)
    rows: dict[str, Any] = {name: getattr(graph, name)[tags] for name in _TAGS}
    for name, columns in _POINTS.items():
        rows[name] = select(getattr(graph, name), points[name])
        rows |= {column: getattr(graph, column)[points[name]] for column in columns}
    part = replace(
        graph,
        surfaces=_some(graph.surfaces, np.flatnonzero(surfaces)),
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        **rows,
    )
    anchors = np.concatenate([part.tag_ids, part.surfaces.ids.ravel(), estimate.observation.ids])
    # Of a wall both points, if one is near.
    walls = estimate.ids[near(estimate.p_ML) & ~is_tag(estimate.ids)]
    landmarks = near(estimate.p_ML) | np.isin(estimate.ids, np.concatenate([anchors, walls ^ 1]))
    return Part(surfaces, tags, views, points, part, estimate.of_landmarks(landmarks))


def with_part(graph: TfgGraph, part: Part, changed: TfgGraph) -> TfgGraph:
    """The graph with a part of it as it has become since, with the newest view, which is the last of its stars."""
    far = ~part.tags
    tag = np.argsort(np.append(graph.tag_ids[far], changed.tag_ids))
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(graph, name)[far], getattr(changed, name)])[tag] for name in _TAGS
    }
    for name, columns in _POINTS.items():
        far = ~part.points[name]
        rows[name] = join(select(getattr(graph, name), far), getattr(changed, name))
        rows |= {column: np.append(getattr(graph, column)[far], getattr(changed, column)) for column in columns}
    # Rows of the whole graph's stars and surfaces, and behind them of the part's.
    stars = np.append(np.arange(graph.stage), graph.stage + len(changed.star_offsets) - 2)
    stars[:-1][part.views] = graph.stage + np.arange(np.count_nonzero(part.views))
    star_offsets, star_vertices = taken(
        stars,
        _chained(graph.star_offsets, changed.star_offsets),
        np.concatenate([graph.star_vertices, changed.star_vertices]),
    )
    surfaces = _both(graph.surfaces, changed.surfaces)
    kept = np.append(np.flatnonzero(~part.surfaces), np.arange(len(graph.surfaces.view), len(surfaces.view)))
    # In the order in which they were found: where two overlap, the first is believed.
    kept = kept[np.lexsort([surfaces.view[kept], ~surfaces.on_wall[kept]])]
    return replace(
        changed, surfaces=_some(surfaces, kept), star_offsets=star_offsets, star_vertices=star_vertices, **rows
    )


def behind(first: TfgGraph, second: TfgGraph) -> TfgGraph:
    """Two graphs of one map as one, the second's views behind the first's. A tag of both faces as it was seen from
    nearest by."""
    rows: dict[str, Any] = {"stage": first.stage + second.stage}
    for name, new in vars(second).items():
        old = getattr(first, name)
        if isinstance(new, FrontierPoints):
            rows[name] = join(old, replace(new, view=new.view + first.stage))
        elif isinstance(new, np.ndarray):
            rows[name] = np.concatenate([old, new + first.stage if name == "tag_view" else new])
    tags = np.lexsort((rows["tag_range"], rows["tag_ids"]))
    tags = tags[np.unique(rows["tag_ids"][tags], return_index=True)[1]]
    rows |= {name: rows[name][tags] for name in _TAGS}
    rows["surfaces"] = _both(first.surfaces, replace(second.surfaces, view=second.surfaces.view + first.stage))
    return TfgGraph(**rows | {"star_offsets": _chained(first.star_offsets, second.star_offsets)})


def _both(first: Surfaces, second: Surfaces) -> Surfaces:
    """Surfaces, one behind the other."""
    both: dict[str, Any] = {
        name: np.concatenate([column, getattr(second, name)]) for name, column in vars(first).items()
    }
    return Surfaces(**both | {"offsets": _chained(first.offsets, second.offsets)})


def _some(surfaces: Surfaces, rows: IntArray) -> Surfaces:
    """Some of the surfaces, in this order."""
    offsets, vertices = taken(rows, surfaces.offsets, surfaces.vertices)
    return Surfaces(surfaces.ids[rows], surfaces.view[rows], surfaces.range[rows], offsets, vertices)


def _chained(first: IntArray, second: IntArray) -> IntArray:
    """Offsets of two packed arrays, one behind the other."""
    return np.append(first, first[-1] + second[1:])

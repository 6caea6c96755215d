"""The topological feature graph as it is kept, and how it is divided into what is near the newest view and the rest."""

from __future__ import annotations

from typing import Any

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, message, replace
from tfg_drake.tfg.frontier import FrontierPoints, join, no_points, place_points, select
from tfg_drake.tfg.near import within
from tfg_drake.tfg.polyline import taken
from tfg_drake.tfg.surfaces import Surfaces, no_surfaces, place


@message
class TfgGraph:
    """The graph in the coordinates of its landmarks and views.

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


@message
class Division:
    """A graph in two parts, each with the stars of its views only, (k,) and (l,), ascending. What is near includes all
    tags that were sighted and are not mapped."""

    near: TfgGraph
    near_views: IntArray
    rest: TfgGraph
    rest_views: IntArray


def divided(graph: TfgGraph, estimate: MapEstimate, radius: float) -> Division:
    """The graph divided into what lies within a radius (m) of the newest view of the estimate, or was seen by that, and
    the rest."""
    X_MA = estimate.X_MA

    def near(points: FloatArray) -> BoolArray:
        return within(points, X_MA[-1], radius)

    views = near(X_MA[: graph.stage])
    vertices = np.append(near(place(graph.surfaces, estimate)), False)
    surfaces = np.logical_or.reduceat(vertices, graph.surfaces.offsets[:-1])
    tags = near(estimate.p_ML[np.searchsorted(estimate.ids, graph.tag_ids)])
    tags |= np.isin(graph.tag_ids, estimate.observation.ids)
    points = {name: near(place_points(getattr(graph, name), X_MA).p) for name in _POINTS}
    rest = _some(graph, ~surfaces, ~tags, ~views, {name: ~which for name, which in points.items()})
    return Division(
        _some(graph, surfaces, tags, views, points),
        np.flatnonzero(views),
        replace(rest, sighted=no_points(), viewpoints=no_points()),
        np.flatnonzero(~views),
    )


def united(division: Division) -> TfgGraph:
    """The graph of both parts, of the near one's stage."""
    near, rest = division.near, division.rest
    tag = np.argsort(np.concatenate([rest.tag_ids, near.tag_ids]))
    star_offsets, star_vertices = taken(
        np.argsort(np.concatenate([division.rest_views, division.near_views])),
        _chained(rest.star_offsets, near.star_offsets),
        np.concatenate([rest.star_vertices, near.star_vertices]),
    )
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(rest, name), getattr(near, name)])
        for name in (*_TAGS, *(name for names in _POINTS.values() for name in names))
    }
    points: dict[str, Any] = {name: join(getattr(rest, name), getattr(near, name)) for name in _POINTS}
    first, second = rest.surfaces, near.surfaces
    surfaces = Surfaces(
        kind=np.concatenate([first.kind, second.kind]),
        ids=np.concatenate([first.ids, second.ids]),
        view=np.concatenate([first.view, second.view]),
        range=np.concatenate([first.range, second.range]),
        offsets=_chained(first.offsets, second.offsets),
        vertices=np.concatenate([first.vertices, second.vertices]),
    )
    return replace(
        near,
        # In the order in which they were found: where two overlap, the first is believed.
        surfaces=_some_surfaces(surfaces, np.lexsort([surfaces.view, surfaces.kind])),
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        **(rows | {name: rows[name][tag] for name in _TAGS}),
        **points,
    )


def _some(
    graph: TfgGraph, surfaces: BoolArray, tags: BoolArray, views: BoolArray, points: dict[str, BoolArray]
) -> TfgGraph:
    """Some of the graph's surfaces (s,), tags (n,), stars (k,) and points, and all tags that were sighted."""
    star_offsets, star_vertices = taken(np.flatnonzero(views), graph.star_offsets, graph.star_vertices)
    rows: dict[str, Any] = {name: getattr(graph, name)[tags] for name in _TAGS}
    for name, columns in _POINTS.items():
        rows[name] = select(getattr(graph, name), points[name])
        rows |= {column: getattr(graph, column)[points[name]] for column in columns}
    return replace(
        graph,
        surfaces=_some_surfaces(graph.surfaces, np.flatnonzero(surfaces)),
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        **rows,
    )


def _some_surfaces(surfaces: Surfaces, rows: IntArray) -> Surfaces:
    """Some of the surfaces, in this order."""
    offsets, vertices = taken(rows, surfaces.offsets, surfaces.vertices)
    kind, ids, view, farthest = surfaces.kind[rows], surfaces.ids[rows], surfaces.view[rows], surfaces.range[rows]
    return Surfaces(kind, ids, view, farthest, offsets, vertices)


def _chained(first: IntArray, second: IntArray) -> IntArray:
    """Offsets of two packed arrays, one behind the other."""
    return np.append(first, first[-1] + second[1:])

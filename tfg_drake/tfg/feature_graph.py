"""The stored form of the topological feature graph, and its part near the newest view."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, message, replace
from tfg_drake.slam.walls import wall_ends
from tfg_drake.table import concat, take
from tfg_drake.tfg.frontier import FrontierPoints, place_points
from tfg_drake.tfg.near import within
from tfg_drake.tfg.surfaces import Surfaces, place


@message
class TfgGraph:
    """The graph in the coordinates of its walls and views.

    stage: number of views in it. surfaces: obstacle surfaces. tag_ids: (n,) ascending, tag_view: (n,) and tag_facing:
    (n, 2): the side each tag faces, a unit vector in that view's frame; tag_range: (n,) distance of that sighting, m.
    star_offsets: (k + 1,), star_vertices: (v, 2) in each view's frame, m. frontiers: points where free space ends at
    the unknown, not yet covered by a star, and points in front of faces that no view has seen, or none well. met:
    points of dynamic obstacles, until they are seen past, met_stamp: (p,) time when they were met, s.
    """

    stage: int
    surfaces: Annotated[Surfaces, "s"]
    tag_ids: Annotated[IntArray, "n"]
    tag_view: Annotated[IntArray, "n"]
    tag_facing: Annotated[FloatArray, "n", 2]
    tag_range: Annotated[FloatArray, "n"]
    star_offsets: Annotated[IntArray, "k+1"]
    star_vertices: Annotated[FloatArray, "v", 2]
    frontiers: Annotated[FrontierPoints, "f"]
    met: Annotated[FrontierPoints, "p"]
    met_stamp: Annotated[FloatArray, "p"]


# The axes of points that change where they are near the newest view.
_NEAR = {"f": "frontiers", "p": "met"}


@dataclasses.dataclass(frozen=True)
class Part:
    """The part of a graph near a view.

    rows: for each of the graph's axes, the rows of the whole graph that are in it. graph: the part by itself, with the
    stars of its views only. estimate: the map with the landmarks nearby, and those that something nearby is anchored to
    or joins.
    """

    rows: Mapping[str, BoolArray]
    graph: TfgGraph
    estimate: MapEstimate


def part_of(graph: TfgGraph, estimate: MapEstimate, radius: float) -> Part:
    """Return the part of the graph within a radius (m) of the newest view of the estimate, or seen by that view."""
    X_MA = estimate.X_MA

    def near(points: FloatArray) -> BoolArray:
        return within(points, X_MA[-1], radius)

    vertices = np.append(near(place(graph.surfaces, estimate)), False)
    tags = near(estimate.p_ML[np.searchsorted(estimate.ids, graph.tag_ids)])
    rows = {
        "s": np.logical_or.reduceat(vertices, graph.surfaces.offsets[:-1]),
        "n": tags | np.isin(graph.tag_ids, estimate.observation.ids),
        "k": near(X_MA[: graph.stage]),
    }
    rows |= {axis: near(place_points(getattr(graph, name), X_MA).p) for axis, name in _NEAR.items()}
    part = take(graph, **rows)
    anchors = np.concatenate([part.tag_ids, part.surfaces.ids.ravel(), estimate.observation.ids])
    landmarks = near(estimate.places) | np.isin(estimate.ids, anchors)
    ends = wall_ends(estimate)
    landmarks[: len(ends)] |= near(ends[:, 0]) | near(ends[:, 1])
    return Part(rows, part, estimate.of_landmarks(landmarks))


def with_part(graph: TfgGraph, part: Part, changed: TfgGraph) -> TfgGraph:
    """Return the graph with a part replaced by its changed version, which has the newest view as its last star."""
    both = concat(take(graph, **{axis: ~near for axis, near in part.rows.items()}), changed)
    views = part.rows["k"]
    return take(
        replace(both, stage=changed.stage),
        n=np.argsort(both.tag_ids),
        k=np.argsort(np.concatenate([np.flatnonzero(~views), np.flatnonzero(views), [graph.stage]])),
        # In the order in which they were found: where two overlap, the first is believed.
        s=np.lexsort([both.surfaces.view, ~both.surfaces.on_wall]),
    )


def behind(first: TfgGraph, second: TfgGraph) -> TfgGraph:
    """Return two graphs of one map as one, with the second's views after the first's. The facing of a common tag is
    that of the nearest sighting."""
    later: dict[str, Any] = {
        name: replace(anchored, view=anchored.view + first.stage)
        for name, anchored in vars(second).items()
        if isinstance(anchored, FrontierPoints | Surfaces)
    }
    both = concat(first, replace(second, tag_view=second.tag_view + first.stage, **later))
    return seen_nearest(replace(both, stage=first.stage + second.stage))


def seen_nearest(graph: TfgGraph) -> TfgGraph:
    """Return the graph with each tag once, by its nearest sighting."""
    tags = np.lexsort((graph.tag_range, graph.tag_ids))
    return take(graph, n=tags[np.unique(graph.tag_ids[tags], return_index=True)[1]])

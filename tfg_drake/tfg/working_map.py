"""The working map: the active part of a large map, which takes up a new view as the whole map would.

A view sees as far as its scan reaches. So everything within some distance of the newest view was seen by views no
farther away than that distance and the scan's reach. On a map too large to be known jointly all others are inactive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tfg_drake.config import ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import BoolArray, IntArray, MapEstimate, WorkingMap, replace
from tfg_drake.tfg import graph as tfg_graph
from tfg_drake.tfg.frontier import join, select
from tfg_drake.tfg.graph import TfgGraph, UnmappedSightings, anchored, empty_graph, empty_map
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import taken
from tfg_drake.tfg.submaps import Submaps, extended, rearranged, to_activate, undivided, whole
from tfg_drake.tfg.surfaces import Surfaces

# How far two places that were once next to each other may have been torn apart by a loop that closed, m.
TORN = 1.0
# The working map is complete within so many times the scan's reach of the newest view: that is more than the view saw,
# and as far as the order in which the frontiers are best visited depends on the map.
COMPLETE = 2.5
# Rules that look for the next goal in the whole map at every stage: with them all submaps stay active.
FAR_SIGHTED = ("argmax", "random")
_POINTS = ("free_space_frontiers", "uninspected", "unseen_backs", "open_ends", "sighted", "viewpoints", "tried", "met")


def empty_graphs() -> Submaps[TfgGraph]:
    """The graph before the first view."""
    return undivided(empty_graph())


def may_deactivate(explorer: ExplorerConfig) -> bool:
    """Whether submaps may be inactive: not with rules that choose the next goal from the whole map, nor where the robot
    must know the length of its way home."""
    return explorer.goal not in FAR_SIGHTED and not explorer.return_home


def update(
    graphs: Submaps[TfgGraph],
    estimate: MapEstimate,
    panorama: Panorama,
    sightings: UnmappedSightings,
    tags: TagSensorConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    *,
    glance: bool = False,
) -> Submaps[TfgGraph]:
    """As `tfg_drake.tfg.graph.update`, of the active submap alone; the inactive ones do not change.

    Raises ValueError where the estimate is of another stage than the next.
    """
    seen = reach_of(panorama)
    is_large = bool(graphs.inactive) or not estimate.is_joint
    if is_large and may_deactivate(explorer):
        if not graphs.inactive:
            # While all was known jointly, the newest view looked for unseen faces everywhere.
            backs, ends = (
                anchored(of, estimate.X_MA[:-1]) for of in (graphs.active.unseen_backs, graphs.active.open_ends)
            )
            graphs = replace(graphs, active=replace(graphs.active, unseen_backs=backs, open_ends=ends))
        graphs = rearranged(graphs, to_activate(graphs.submap, estimate.X_MA, (COMPLETE + 1.0) * seen), split, merged)
    near = tfg_graph.update(
        graphs.active,
        estimate_near(graphs, estimate, seen),
        panorama,
        sightings,
        tags,
        robot,
        explorer,
        glance=glance,
        views=graphs.views,
        reach=seen if is_large else math.inf,
    )
    if graphs.inactive:
        missing = estimate.ids[np.searchsorted(estimate.ids, near.sighted.id).clip(max=len(estimate.ids) - 1)]
        missing = missing != near.sighted.id
        near = replace(near, sighted=select(near.sighted, missing), viewpoints=select(near.viewpoints, missing))
    return extended(graphs, near, estimate.stage)


def reach_of(panorama: Panorama) -> float:
    """Distance, m, within which a view may have seen the same places as the panorama, as mapped now."""
    return panorama.range_max + TORN


def working_map(
    graphs: Submaps[TfgGraph], estimate: MapEstimate, panorama: Panorama, robot: RobotConfig, explorer: ExplorerConfig
) -> WorkingMap:
    """The active submap, resolved; the estimate and the panorama are of the graph's stage."""
    seen = reach_of(panorama)
    part = estimate_near(graphs, estimate, seen)
    tfg = tfg_graph.resolve(graphs.active, part, robot, explorer, views=graphs.views)
    if not graphs.inactive:
        return WorkingMap(part, tfg, graphs.submap < 0)
    # Farther away a wall may be missing through which a frontier would be seen.
    reach = COMPLETE * seen
    whole_there = np.hypot(*(tfg.frontiers - estimate.X_MA[-1, :2]).T) <= reach
    tfg = replace(
        tfg,
        frontiers=tfg.frontiers[whole_there],
        frontier_length=tfg.frontier_length[whole_there],
        frontier_normal=tfg.frontier_normal[whole_there],
    )
    return WorkingMap(part, tfg, graphs.submap < 0, reach)


def empty_working_map(estimate: MapEstimate) -> WorkingMap:
    """The working map before the first view, with the estimate of then."""
    return WorkingMap(estimate, empty_map(), np.zeros(0, dtype=np.bool_))


def whole_graph(graphs: Submaps[TfgGraph]) -> TfgGraph:
    """The graph of all views."""
    return replace(whole(graphs, merged), stage=len(graphs.submap))


def estimate_near(graphs: Submaps[TfgGraph], estimate: MapEstimate, reach: float) -> MapEstimate:
    """The map with the landmarks that anchor the active submap and those within reach (m) of the newest view only."""
    if not graphs.inactive:
        return estimate
    ids = np.concatenate([graphs.active.tag_ids, graphs.active.surfaces.ids.ravel()])
    keep = np.hypot(*(estimate.p_ML - estimate.X_MA[-1, :2]).T) <= reach
    keep[np.searchsorted(estimate.ids, ids[ids >= 0])] = True
    return of_landmarks(estimate, keep)


def of_landmarks(estimate: MapEstimate, keep: BoolArray) -> MapEstimate:
    """The map with some of its landmarks (n,) only, and with all its views."""
    local = keep[estimate.is_local]
    rows = np.append(np.repeat(local, 2), np.ones(3, dtype=np.bool_))
    shared = np.append(rows, np.ones(len(estimate.shared), dtype=np.bool_))
    return replace(
        estimate,
        ids=estimate.ids[keep],
        p_ML=estimate.p_ML[keep],
        local=np.flatnonzero(estimate.is_local[keep]),
        covariance=estimate.covariance[np.ix_(rows, rows)],
        landmark_covariance=estimate.landmark_covariance[keep],
        with_shared=estimate.with_shared[shared] if len(estimate.shared) else estimate.with_shared,
    )


def split(graph: TfgGraph, views: IntArray, stays: BoolArray) -> tuple[TfgGraph, TfgGraph]:
    """The graph split in two: what the views (k,) saw that stay (k,), and what the others saw."""
    return _of_views(graph, views, stays), _of_views(graph, views, ~stays)


def merged(graphs: Sequence[TfgGraph], views: Sequence[IntArray]) -> TfgGraph:
    """The graph of several submaps, each with the stars of its views (k,); the first is the active one."""
    tag = np.argsort(np.concatenate([graph.tag_ids for graph in graphs]))
    star = np.argsort(np.concatenate(views))
    surfaces = _chained([graph.surfaces for graph in graphs])
    star_offsets, star_vertices = taken(
        star,
        _chained_offsets([graph.star_offsets for graph in graphs]),
        np.concatenate([graph.star_vertices for graph in graphs]),
    )
    tags = ("tag_ids", "tag_view", "tag_facing", "tag_range")
    rows: dict[str, Any] = {name: np.concatenate([getattr(graph, name) for graph in graphs])[tag] for name in tags}
    points: dict[str, Any] = {name: join(*(getattr(graph, name) for graph in graphs)) for name in _POINTS}
    return replace(
        graphs[0],
        # In the order in which they were found: where two overlap, the first is believed.
        surfaces=_surfaces(surfaces, np.lexsort([surfaces.view, surfaces.kind])),
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        tried_count=np.concatenate([graph.tried_count for graph in graphs]),
        met_stamp=np.concatenate([graph.met_stamp for graph in graphs]),
        **rows,
        **points,
    )


def _of_views(graph: TfgGraph, views: IntArray, which: BoolArray) -> TfgGraph:
    """The graph of some (k,) of the graph's views (k,) only."""
    theirs = np.zeros(int(views.max(initial=-1)) + 1, dtype=np.bool_)
    theirs[views[which]] = True
    tags = theirs[graph.tag_view]
    star_offsets, star_vertices = taken(np.flatnonzero(which), graph.star_offsets, graph.star_vertices)
    points: dict[str, Any] = {name: select(of, theirs[of.view]) for name in _POINTS for of in (getattr(graph, name),)}
    return replace(
        graph,
        surfaces=_surfaces(graph.surfaces, np.flatnonzero(theirs[graph.surfaces.view])),
        tag_ids=graph.tag_ids[tags],
        tag_view=graph.tag_view[tags],
        tag_facing=graph.tag_facing[tags],
        tag_range=graph.tag_range[tags],
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        tried_count=graph.tried_count[theirs[graph.tried.view]],
        met_stamp=graph.met_stamp[theirs[graph.met.view]],
        **points,
    )


def _chained(parts: Sequence[Surfaces]) -> Surfaces:
    """All surfaces, part by part."""
    offsets = _chained_offsets([part.offsets for part in parts])
    kind, ids, view, farthest, vertices = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("kind", "ids", "view", "range", "vertices")
    )
    return Surfaces(kind, ids, view, farthest, offsets, vertices)


def _surfaces(surfaces: Surfaces, rows: IntArray) -> Surfaces:
    """Some of the surfaces, in this order."""
    offsets, vertices = taken(rows, surfaces.offsets, surfaces.vertices)
    return Surfaces(
        surfaces.kind[rows], surfaces.ids[rows], surfaces.view[rows], surfaces.range[rows], offsets, vertices
    )


def _chained_offsets(parts: Sequence[IntArray]) -> IntArray:
    """Offsets of packed arrays, one behind the other."""
    return np.append(0, np.cumsum(np.concatenate([np.diff(offsets) for offsets in parts])))

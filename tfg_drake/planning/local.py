"""The surroundings of the newest view: of a large map planning works on that alone, wherever it is enough.

What is near `tfg_drake.tfg.near` says. A place within a radius is judged by what can be seen from there: by landmarks,
surfaces and free space within the radius and the sensor's range. Whatever lies within a circle hides nothing from
sight but what is in it, too.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import BoolArray, IntArray, MapEstimate, TfgMap, is_tag, replace
from tfg_drake.planning.roadmap import Edges, RoadmapState, place_in_map
from tfg_drake.slam.walls import wall_ends
from tfg_drake.table import concat, put, take
from tfg_drake.tfg.near import radius_of, within

# Rules that look for the next goal in the whole map at every stage.
FAR_SIGHTED = ("argmax", "random")


def planning_radius(estimate: MapEstimate, explorer: ExplorerConfig) -> float:
    """Distance, m, from the newest view within which planning looks first: as `radius_of`, but inf with rules that
    choose the next goal from the whole map, and where the robot must know the length of its way home."""
    looks_far = explorer.goal in FAR_SIGHTED or explorer.return_home
    return math.inf if looks_far else radius_of(estimate)


def local(estimate: MapEstimate, tfg: TfgMap, radius: float, sight: float) -> tuple[MapEstimate, TfgMap]:
    """The map and the TFG as far as places within a radius (m) of the newest view are judged by them: frontiers within
    the radius, and landmarks, surfaces and stars within the radius and what is seen from there, sight (m).

    Where that is all, it is what was given. All views stay in the map.
    """
    if math.isinf(radius):
        return estimate, tfg
    here = estimate.X_MA[-1, :2]
    far = radius + sight
    tags = is_tag(estimate.ids)
    walls = within(wall_ends(estimate).reshape(-1, 2), here, far).reshape(-1, 2).any(axis=1)
    landmarks = np.append(walls, within(estimate.p_ML[tags], here, far))
    near = {
        "m": clearance(tfg.segments, np.tile(here, 2)[None], np.inf) <= far,
        "n": landmarks[tags],
        "k": within(tfg.star_centers, here, far),
        "f": within(tfg.frontiers, here, radius),
        "g": within(tfg.given_up, here, radius),
        "p": within(tfg.viewpoints, here, radius),
    }
    if landmarks.all() and all(rows.all() for rows in near.values()):
        return estimate, tfg
    return estimate.of_landmarks(landmarks), take(tfg, **near)


def local_roadmap(nodes: RoadmapState, estimate: MapEstimate, radius: float) -> tuple[RoadmapState, BoolArray]:
    """The roadmap with those of its nodes (n,) only that lie within a radius (m) of the map's newest view, and the
    edges between them; and which these are (n,)."""
    if math.isinf(radius):
        return nodes, np.ones(len(nodes.ids), dtype=np.bool_)
    points = place_in_map(nodes.anchor, nodes.p_AN, estimate.X_MA)
    near = within(points, estimate.X_MA[-1], radius)
    rows = _rows_between(near, nodes.edges)
    ends = (np.cumsum(near) - 1)[nodes.edges.nodes[rows]]
    order = np.argsort(_pairs(ends, len(near)))
    part = take(replace(nodes, points=points), n=near, e=rows[order])
    return replace(part, edges=replace(part.edges, nodes=ends[order])), near


def with_part(nodes: RoadmapState, near: BoolArray, part: RoadmapState, estimate: MapEstimate) -> RoadmapState:
    """The roadmap, placed by the map, with that part of it of which the nodes near (n,) are, as it has become since.
    Its new edges are the last."""
    old, first, count = np.flatnonzero(near), np.count_nonzero(near), len(near) + len(part.ids)
    names = np.append(old, len(near) + np.arange(len(part.ids) - first))
    edges, rows = replace(part.edges, nodes=names[part.edges.nodes]), _rows_between(near, nodes.edges)
    # The part's edges are in the order of the nodes, and those that it had are among them.
    at = np.searchsorted(_pairs(edges.nodes, count), _pairs(nodes.edges.nodes[rows], count))
    added = np.setdiff1d(np.arange(len(edges)), at, assume_unique=True)
    sigma = nodes.sigma.copy()
    sigma[old] = part.sigma[:first]
    whole = replace(nodes, sigma=sigma, edges=put(nodes.edges, rows, take(edges, at)))
    part = replace(part, edges=edges)
    whole = concat(whole, take(part, n=np.arange(first, len(part.ids)), e=added))
    points = place_in_map(whole.anchor, whole.p_AN, estimate.X_MA)
    return replace(whole, stage=part.stage, next_id=part.next_id, way_end=part.way_end, points=points)


def _rows_between(near: BoolArray, edges: Edges) -> IntArray:
    """The edges (k,) between two of the nodes near (n,)."""
    return np.flatnonzero(near[edges.nodes[:, 0]] & near[edges.nodes[:, 1]])


def _pairs(nodes: IntArray, count: int) -> IntArray:
    """A number (e,) for each edge's nodes (e, 2), of count nodes: in the order of the nodes."""
    return nodes[:, 0] * count + nodes[:, 1]

"""The surroundings of the newest view, to which planning on a large map is limited if they suffice.

`tfg_drake.tfg.near` defines the radius. A place within the radius is evaluated by everything visible from there:
landmarks, surfaces and free space within radius plus sensor range. Nothing outside a circle hides one of its points
from another.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import MapEstimate, TfgMap, is_tag, replace
from tfg_drake.planning.roadmap import RoadmapState, place_in_map
from tfg_drake.slam.walls import wall_ends
from tfg_drake.table import take
from tfg_drake.tfg.near import radius_of, within

# Goal rules that consider the whole map at every stage.
FAR_SIGHTED = ("argmax", "random")


def planning_radius(estimate: MapEstimate, explorer: ExplorerConfig) -> float:
    """Return the distance, m, from the newest view that planning considers first: `radius_of`, or inf for rules that
    choose from the whole map and if the robot must know the length of its way home."""
    looks_far = explorer.goal in FAR_SIGHTED or explorer.return_home
    return math.inf if looks_far else radius_of(estimate)


def local(estimate: MapEstimate, tfg: TfgMap, radius: float, sight: float) -> tuple[MapEstimate, TfgMap]:
    """Return the part of map and TFG needed to evaluate places within a radius (m) of the newest view: frontiers within
    the radius, and landmarks, surfaces and stars within the radius plus sight (m).

    If that is everything, the arguments are returned. All views stay in the map.
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
    }
    if landmarks.all() and all(rows.all() for rows in near.values()):
        return estimate, tfg
    return estimate.of_landmarks(landmarks), take(tfg, **near)


def local_roadmap(nodes: RoadmapState, estimate: MapEstimate, radius: float) -> RoadmapState:
    """Return the roadmap with only the nodes within a radius (m) of the map's newest view, and the edges between
    them."""
    near = within(place_in_map(nodes.anchor, nodes.p_AN, estimate.X_MA), estimate.X_MA[-1], radius)
    if near.all():
        return nodes
    rows = nodes.edges.between(near)
    part = take(nodes, n=near, e=rows)
    return replace(part, edges=replace(part.edges, nodes=(np.cumsum(near) - 1)[part.edges.nodes]))

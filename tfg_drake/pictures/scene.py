"""A mission as a scene: each message becomes a record of flat shapes, whoever draws them.

A record is a mapping from names to arrays. Positions and lengths are in metres, in the frame of the message: M of what
the robot knows, W of what is true. `tfg_drake.systems.timeline_recorder` writes records for the page of
`tfg_drake.cockpit`, `tfg_drake.pictures.layers` makes the layers of all other pictures of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from tfg_drake.geometry.se2 import pose_at, transform
from tfg_drake.grid.frontier import FREE, OCCUPIED, classify, row_runs
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    IntArray,
    LaserScan,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)
from tfg_drake.pictures.drawing import polyline_segments
from tfg_drake.planning.shortest_ways import joined
from tfg_drake.world.world import World

Record = Mapping[str, NDArray[Any]]

# Positions that differ by at most this, m, are drawn alike: in most pictures a fraction of a pixel.
POSITION = 0.01
# Columns of a candidate: the parts of its gain, and the gain, nats.
GAINS = ("exploitation", "exploration", "pose_price", "gain")
# Number of candidates besides the chosen one that are explained.
NEXT_BEST = 3


def walls(world: World) -> Record:
    """segments: (m, 4) true walls. tags: (n, 2) and tag_facing: (n,) rad, ids: (n,)."""
    return {"segments": world.walls, "tags": world.p_WT, "tag_facing": world.tag_facing, "ids": world.tag_ids}


def free_space(tfg: TfgMap) -> tuple[FloatArray, ...]:
    """The star polygons (v, 2) seen from each view, its own place (v[0]) first."""
    points = np.insert(tfg.star_vertices, tfg.star_offsets[:-1], tfg.star_centers, axis=0)
    ends = (tfg.star_offsets + np.arange(len(tfg.star_offsets))).tolist()
    return tuple(points[begin:end].copy() for begin, end in itertools.pairwise(ends))


def changed_stars(before: Mapping[int, FloatArray], now: tuple[FloatArray, ...]) -> IntArray:
    """The indices of those star polygons that are new or have moved by more than POSITION."""

    def has_changed(index: int) -> bool:
        old, star = before.get(index), now[index]
        return old is None or star.shape != old.shape or bool(np.abs(star - old).max(initial=0.0) > POSITION)

    return np.array([index for index in range(len(now)) if has_changed(index)], dtype=np.int64)


def packed_stars(stars: tuple[FloatArray, ...], which: IntArray) -> Record:
    """index: (k,) which they are. count: (k,) points of each, its centre first. points: (sum of count, 2)."""
    some = [stars[i] for i in which]
    points = np.vstack(some) if some else np.zeros((0, 2))
    return {"index": which, "count": np.array([len(star) for star in some], dtype=np.int64), "points": points}


def explained(choice: GoalChoice, roadmap: Roadmap) -> list[dict[str, Any]]:
    """The chosen goal, then the best candidates that were not taken, by the value that was maximised: place, parts of
    the gain, nats, time, s, to get there, and gain per second. What a tour visits later is taken."""
    if choice.node < 0 or not len(choice.candidates):
        return []
    rows = roadmap.nodes(choice.candidates)
    # Ties are broken by the gain, as a tour gives no value to the candidates that it leaves out.
    order = np.lexsort((-choice.gain, -choice.value))
    chosen = [i for i in order if choice.candidates[i] == choice.node][:1]
    taken = np.isin(choice.candidates, choice.tour) | (choice.candidates == choice.node)
    others = [i for i in order if not taken[i] and rows[i] >= 0][:NEXT_BEST]
    told = []
    for i in chosen + others:
        row = int(rows[i])
        time = float(roadmap.travel_time[row]) if row >= 0 else math.nan
        told.append(
            {
                "at": [_finite(value) for value in roadmap.points[row]] if row >= 0 else None,
                **{name: _finite(getattr(choice, name)[i]) for name in GAINS},
                "time": _finite(time),
                "rate": _finite(choice.gain[i] / max(time, 1.0)),
                "chosen": bool(choice.candidates[i] == choice.node),
            }
        )
    return told


def goal(choice: GoalChoice) -> Record:
    """points: (1, 2) the goal, (0, 2) where there is none."""
    return {"points": choice.p_MG[None] if choice.verdict == "goal" and choice.node >= 0 else np.zeros((0, 2))}


def tour(choice: GoalChoice, roadmap: Roadmap) -> Record:
    """tour: (s, 2) the stops of the tour, the goal first. done: (s,) s from the choice until each is done with. legs:
    (k, 4) the shortest ways along the roadmap from each stop to the next, straight where there is none."""
    rows, of_tour = roadmap.nodes(choice.tour), np.isin(choice.candidates, choice.tour)
    done = np.sort(-choice.value[of_tour])
    stops = rows[rows >= 0]
    return {"tour": roadmap.points[stops], "done": done[rows >= 0].astype(np.float32), "legs": _legs(roadmap, stops)}


def _legs(roadmap: Roadmap, stops: IntArray) -> FloatArray:
    """The shortest ways along the roadmap from each of its nodes stops (s,) to the next as segments (k, 4), m."""
    if len(stops) < 2:
        return np.zeros((0, 4))
    points, edges = roadmap.points, roadmap.edges
    length = np.hypot(*(points[edges[:, 1]] - points[edges[:, 0]]).T)
    _, before = dijkstra(joined(edges, length, len(points)), indices=stops[:-1], return_predecessors=True)
    ways = []
    for (first, last), node_before in zip(itertools.pairwise(stops.tolist()), before.tolist(), strict=True):
        way = [last]
        while way[-1] != first:
            node = node_before[way[-1]]
            way.append(node if node >= 0 else first)
        ways.append(polyline_segments(points[way[::-1]]))
    return np.vstack(ways)


def path(message: Path) -> Record:
    """segments: (p - 1, 4)."""
    return {"segments": polyline_segments(message.points)}


def scan_rays(scan: LaserScan, pose: PoseEstimate) -> Record:
    """rays: (r + 1, 2) where the scanner was, then the end of each ray of which something is known, at full range where
    it met nothing. met: (r,) whether it met something. There has been a scan: its stamp is finite."""
    known = ~np.isnan(scan.ranges)
    angles, ranges = scan.angles[known], np.minimum(scan.ranges[known], scan.range_max)
    ends = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rays = transform(pose_at(pose, scan.stamp), np.vstack([np.zeros(2), ends]))
    return {"rays": rays, "met": ranges < scan.range_max}


def grid_cells(grid: GridMap) -> Record:
    """free, occupied: (r, 4) runs of cells, as wide as a cell."""
    cells = classify(grid)
    return {name: row_runs(grid, cells == kind) for name, kind in (("free", FREE), ("occupied", OCCUPIED))}


def _finite(value: float) -> float | None:
    return round(float(value), 4) if math.isfinite(value) else None

"""Where to look once more at tags that were seen but are not known to be at any one place, before a mission ends."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, Visibility, visible_targets

# From so near a place where the robot has looked again it sees nothing else, m, and so near it is there.
SAME_PLACE = 2.0
THERE = 0.5
# What was seen so near a tag that is no doubt there is that tag with a misread id, m.
MISREAD = 0.3


def best_views(now: Situation, looked: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """The doubtful tags (d,), rows of estimate.doubtful, that the robot can look at where it has not looked again yet,
    and the reachable node (d,) from which each of them seems largest: near, and not aslant. And the ids (s,) of the
    nodes from which it has looked again: before (t,), looked, and where it is now.

    A tag hangs on the surface nearest to where it was seen. Where another hangs, its id was misread.
    """
    estimate, tfg, roadmap, sensor = now.estimate, now.tfg, now.roadmap, now.parameters.sensor
    places = estimate.doubtful_places
    nodes = np.flatnonzero(roadmap.reachable)
    if not (len(places) and len(nodes) and len(tfg.segments)):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), looked
    normals, points = _normals(places, tfg.segments), roadmap.points[nodes]
    size = np.zeros((len(places), len(nodes)))
    surfaces = tfg.segments, segment_grid(tfg.segments)
    within = sensor.range, sensor.max_incidence, SURFACE_TOLERANCE
    for facing in (normals, -normals):
        sees = Visibility(*visible_targets(points, places, facing, *surfaces, *within, 0.0, 0.0))
        node, tag = np.repeat(np.arange(len(nodes)), sees.count), sees.index
        way = points[node] - places[tag]
        # Its width in the picture goes with the cosine of the incidence over the range.
        width = np.sum(way * facing[tag], axis=1) / np.sum(way**2, axis=1)
        size[tag, node] = np.where(_another_hangs(places, facing, now)[tag], 0.0, width)
    best = nodes[np.argmax(size, axis=1)]
    seen = size.max(axis=1) > 0.0
    here = seen & (np.hypot(*(roadmap.points[best] - estimate.X_MD[:2]).T) < THERE)
    looked = np.union1d(looked, roadmap.node_ids(best[here]))
    known = roadmap.nodes(looked)
    distance, _ = cKDTree(roadmap.points[known[known >= 0]]).query(roadmap.points[best])
    tags = np.flatnonzero(seen & (distance >= SAME_PLACE))
    return tags, best[tags], looked


def _another_hangs(places: FloatArray, facing: FloatArray, now: Situation) -> BoolArray:
    """At which of the places (d, 2) on surfaces that face (d, 2) the map has another tag, which is not doubtful."""
    certain = ~now.estimate.is_doubtful
    apart = np.linalg.norm(places[:, None] - now.estimate.p_ML[certain], axis=2)
    return np.asarray(np.any((apart < MISREAD) & (facing @ now.tfg.facing[certain].T > 0.0), axis=1))


def _normals(places: FloatArray, segments: FloatArray) -> FloatArray:
    """(d, 2) unit normals of the segments (m, 4) nearest to each of the places (d, 2)."""
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    length = np.hypot(*along.T)
    along = along / np.maximum(length, 1e-9)[:, None]
    way = places[:, None] - start
    share = np.clip(np.sum(way * along, axis=2), 0.0, length)
    apart = np.linalg.norm(way - share[..., None] * along, axis=2)
    # A landmark without a surface is a piece of no length, which faces nowhere.
    nearest = np.argmin(np.where(length > 0.0, apart, np.inf), axis=1)
    return np.column_stack([-along[nearest, 1], along[nearest, 0]])

"""Layers of a map as tables: how far a row has to move until it is told anew."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tfg_drake.messages import FloatArray, GoalChoice, IntArray, MapEstimate, Roadmap, TfgMap
from tfg_drake.pictures import scene
from tfg_drake.slam.walls import known_walls
from tfg_drake.storage.rows import Table

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap
    from tfg_drake.slam.keyframe_graph import KeyframeGraph

# Positions that differ by no more are alike, m: in most pictures a fraction of a pixel.
POSITION = 0.01
# The same of the nodes of the roadmap, which are thousands, m.
NODE = 0.05
# Of a variance's logarithm, that is a tenth of a standard deviation; of a correlation; of a unit vector's components.
VARIANCE, CORRELATION, DIRECTION = 0.2, 0.2, 0.05
# Of the most gain: a fifth of the way from one shade to the next.
SHARE = 0.04
# Added to variances, m^2: below a tenth of a millimetre they are all alike.
LEAST = 1e-8


def landmarks(estimate: MapEstimate | SavedMap) -> Table:
    """points, covariance, doubtful, ids: see `scene.landmarks`."""
    layer = scene.landmarks(estimate)
    xx, xy, yy = layer["covariance"].T + np.array([[LEAST], [0.0], [LEAST]])
    spread = np.column_stack([np.log(xx), np.log(yy)]) / VARIANCE
    correlation = xy / np.sqrt(xx * yy) / CORRELATION
    values = np.column_stack([estimate.p_ML / POSITION, spread, correlation, 2.0 * layer["doubtful"]])
    arrays = {**layer, "covariance": layer["covariance"].astype(np.float32)}
    return Table(arrays, estimate.p_ML, values, estimate.ids)


def wall_landmarks(known: MapEstimate | KeyframeGraph) -> Table:
    """segments: (w, 4) from one point of a wall to the other, m. deviation: (w, 2) normal to the wall at these, m."""
    ids, p_ML, deviation = known_walls(known)
    segments = p_ML.reshape(-1, 4)
    values = np.column_stack([segments / POSITION, np.log(deviation**2 + LEAST) / VARIANCE])
    return Table({"segments": segments, "deviation": deviation.astype(np.float32)}, _middles(segments), values, ids)


def surfaces(tfg: TfgMap) -> Table:
    """segments, kind: see `scene.surfaces`."""
    segments, kind = scene.surfaces(tfg).values()
    values = np.column_stack([segments / POSITION, 2.0 * kind])
    return Table({"segments": segments, "kind": kind.astype(np.uint8)}, _middles(segments), values)


def facing(tfg: TfgMap, ids: IntArray, p_ML: FloatArray) -> Table:
    """ids: (n,) of the landmarks, facing: (n, 2) their normals, see `scene.tag_normals`. p_ML: (n, 2) m."""
    normals = scene.tag_normals(tfg, ids)
    return Table({"ids": ids, "facing": normals.astype(np.float32)}, p_ML, normals / DIRECTION, ids)


def frontiers(tfg: TfgMap) -> Table:
    """segments: see `scene.frontiers`."""
    segments = scene.frontiers(tfg)["segments"]
    return Table({"segments": segments}, tfg.frontiers, segments / POSITION)


def nodes(roadmap: Roadmap) -> Table:
    """points: (n, 2) m. ids: (n,) of the nodes."""
    ids = roadmap.node_ids(np.arange(len(roadmap.points)))
    return Table({"points": roadmap.points, "ids": ids}, roadmap.points, roadmap.points / NODE, ids)


def edges(roadmap: Roadmap) -> Table:
    """edges: (e, 2) ids of nodes."""
    ends = roadmap.node_ids(roadmap.edges)
    places = np.zeros((len(ends), 2))  # All of a roadmap is told at once.
    return Table({"edges": ends}, places, np.zeros((len(ends), 0)), (ends[:, 0] << 32) + ends[:, 1])


def gains(choice: GoalChoice, roadmap: Roadmap) -> Table:
    """points: (c, 2) m, of the candidates. share: (c,) of the most gain, of 255."""
    layer, ids = scene.gains(choice, roadmap), choice.candidates[roadmap.nodes(choice.candidates) >= 0]
    values = np.column_stack([layer["points"] / NODE, layer["share"] / SHARE])
    arrays = {"points": layer["points"], "share": np.rint(255.0 * layer["share"]).astype(np.uint8)}
    return Table(arrays, layer["points"], values, ids)


def _middles(segments: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (segments[:, :2] + segments[:, 2:]))

"""A map as GTSAM's own archives: a NonlinearFactorGraph and its Values."""

from __future__ import annotations

import gtsam
from gtsam.symbol_shorthand import L, W

from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import WALLS_BELOW
from tfg_drake.slam.gtsam_solver import named_graph


def gtsam_texts(saved: SavedMap) -> tuple[str, str]:
    """What `NonlinearFactorGraph.deserialize` and `Values.deserialize` read: the graph of
    `tfg_drake.slam.gtsam_solver.map_graph`, linear at the map's values, as GTSAM has no factor for a keyframe that it
    can write.

    Its variables are those of `map_graph`, in the map frame M, but for the landmarks' names: tag i is L(i), wall w is
    W(w).
    """
    names = [L(one) if one >= WALLS_BELOW else W(WALLS_BELOW - 1 - one) for one in saved.graph.ids.tolist()]
    factors, values = named_graph(saved.graph, names)
    linear = gtsam.NonlinearFactorGraph()
    for number in range(factors.size()):
        linear.add(gtsam.LinearContainerFactor(factors.at(number).linearize(values), values))
    return linear.serialize(), values.serialize()

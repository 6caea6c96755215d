"""The map: values of the whole keyframe graph and the joint Gaussian round a place."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import IntArray, MapEstimate, Observation
from tfg_drake.slam.dissection_solver import DissectionSolver
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.map_update import estimate_of
from tfg_drake.slam.solver import Solver, solved

# Landmarks known jointly: those nearest to the robot; and so many of all others once everything is explored.
JOINT = 400
SPREAD = 600
# At the end of a mission those of the whole map are, if they are no more than this: their covariance has 200 MB then.
MOST_JOINT = 2500


def solve(
    graph: KeyframeGraph,
    stamp: float,
    observation: Observation,
    *,
    node: int = -1,
    also: IntArray | None = None,
    joint: int = JOINT,
    spread: int = 0,
) -> tuple[KeyframeGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map with the joint Gaussian round a node.

    Args:
        graph: k keyframes, at least one.
        stamp: s, observation: the newest view's, with its trajectory; both go into the MapEstimate.
        node: whose pose X_MD is, from 1 to k; the newest by default.
        also: (r,) rows of landmarks that are to be known jointly however far away.
        joint: how many landmarks next to the node are known jointly. spread: and how many of the others.
    """
    node = len(graph.keyframes) if node < 0 else node
    by_distance = np.argsort(np.hypot(*(graph.p_ML - graph.X_MN[node, :2]).T), kind="stable")
    local = np.sort(by_distance[:joint])
    if spread:
        others = np.sort(by_distance[joint:])
        local = np.union1d(local, others[np.linspace(0, len(others) - 1, min(spread, len(others))).astype(np.int64)])
    local = local if also is None else np.union1d(local, also)
    graph, local, covariance = solved(graph, solver_of(graph), local, node)
    return graph, estimate_of(graph, stamp, observation, graph.p_ML, graph.X_MN[node], local, covariance)


def solver_of(graph: KeyframeGraph) -> Solver:
    """The graph's solver, by its name."""
    if graph.solver == "dissection":
        return DissectionSolver(graph)
    # Its library is loaded only where it is asked for.
    from tfg_drake.slam.gtsam_solver import GtsamSolver

    return GtsamSolver(graph)


def known_jointly(graph: KeyframeGraph) -> int:
    """How many landmarks are known jointly at the end of a mission."""
    return len(graph.ids) if len(graph.ids) <= MOST_JOINT else JOINT

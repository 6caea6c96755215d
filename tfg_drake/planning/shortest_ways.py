"""The cheapest ways along the edges of a roadmap, by scipy's Dijkstra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tfg_drake.messages import FloatArray, IntArray


class Ways(NamedTuple):
    """The cheapest ways to n nodes from any of several sources.

    cost: (n,), inf if unreachable. predecessor: (n,) the node before each, n if the way begins at it, -1 if it is
    unreachable. order: (r,) the reachable nodes, by increasing cost.
    """

    cost: FloatArray
    predecessor: IntArray
    order: IntArray


def joined(
    edges: IntArray, weight: FloatArray, count: int, sources: IntArray | None = None, start: FloatArray | None = None
) -> csr_array:
    """Return the undirected graph of edges (e, 2) with weights (e,) between count nodes; with sources (s,), all
    different, a graph of count + 1 nodes whose last node leads to each source at the cost start (s,)."""
    a, b = edges.T
    if sources is None or start is None:
        return csr_array((np.tile(weight, 2), (np.append(a, b), np.append(b, a))), shape=(count, count))
    begin, end = np.concatenate([a, b, np.full(len(sources), count)]), np.concatenate([b, a, sources])
    return csr_array((np.concatenate([weight, weight, start]), (begin, end)), shape=(count + 1, count + 1))


def shortest_ways(edges: IntArray, weight: FloatArray, count: int, sources: IntArray, start: FloatArray) -> Ways:
    """Return the Ways to all of count nodes along undirected edges (e, 2) of positive weight (e,), inf for closed ones,
    from sources (s,), all different, with initial costs start (s,)."""
    graph = joined(edges, weight, count, sources, start)
    cost, predecessor = dijkstra(graph, indices=count, return_predecessors=True)
    cost, reached = cost[:count], np.isfinite(cost[:count])
    order = np.argsort(cost, kind="stable")[: np.count_nonzero(reached)]
    return Ways(cost, np.where(reached, predecessor[:count], -1).astype(np.int64), order)

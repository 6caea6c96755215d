"""Dijkstra's algorithm on edges as a roadmap keeps them (numba kernels)."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.messages import FloatArray, IntArray


class Ways(NamedTuple):
    """The cheapest ways to n nodes from any of several sources.

    cost: (n,), inf where unreachable. predecessor: (n,) the node before each, n where the way begins at it, -1 where
    it is unreachable. step: (n,) the edge to each from there; where the way begins at it the number of edges and that
    of the source. order: (r,) the nodes that are reached, by increasing cost.
    """

    cost: FloatArray
    predecessor: IntArray
    step: IntArray
    order: IntArray


@read_only_arguments
@njit(cache=True)
def neighbours(edges: IntArray, count: int) -> tuple[IntArray, IntArray, IntArray]:
    """What edges (e, 2) join each of count nodes to: (offsets (count + 1,), nodes (2e,), edges (2e,)), node i by the
    edges[offsets[i]:offsets[i + 1]] to the nodes row for row."""
    offsets = np.zeros(count + 1, dtype=np.int64)
    for e in range(len(edges)):
        offsets[edges[e, 0] + 1] += 1
        offsets[edges[e, 1] + 1] += 1
    offsets = np.cumsum(offsets)
    filled, nodes, by = (
        offsets[:-1].copy(),
        np.empty(offsets[-1], dtype=np.int64),
        np.empty(offsets[-1], dtype=np.int64),
    )
    for e in range(len(edges)):
        for end in range(2):
            at = filled[edges[e, end]]
            nodes[at], by[at] = edges[e, 1 - end], e
            filled[edges[e, end]] = at + 1
    return offsets, nodes, by


@read_only_arguments
@njit(cache=True)
def shortest_ways(
    offsets: IntArray, beside: IntArray, by: IntArray, weight: FloatArray, sources: IntArray, start: FloatArray
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """The Ways to all nodes along edges, either way, of positive weight (e,), inf for those that are closed, from
    sources (s,), each of which it costs start (s,) to begin at. offsets, beside, by: the `neighbours`."""
    count = len(offsets) - 1
    cost, predecessor, step = np.full(count, np.inf), np.full(count, -1), np.full(count, -1)
    order, reached = np.empty(count, dtype=np.int64), 0
    # Every node once for each time that its cost fell.
    heap = [(0.0, 0)]
    heap.pop()
    for s in range(len(sources)):
        if start[s] < cost[sources[s]]:
            cost[sources[s]], predecessor[sources[s]], step[sources[s]] = start[s], count, len(weight) + s
            heapq.heappush(heap, (start[s], sources[s]))
    while len(heap) > 0:
        here, node = heapq.heappop(heap)
        if here > cost[node]:
            continue
        order[reached] = node
        reached += 1
        for k in range(offsets[node], offsets[node + 1]):
            other, there = beside[k], here + weight[by[k]]
            if there < cost[other]:
                cost[other], predecessor[other], step[other] = there, node, by[k]
                heapq.heappush(heap, (there, other))
    return cost, predecessor, step, order[:reached]

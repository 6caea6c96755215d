"""Dijkstra's algorithm on edges as a roadmap keeps them (numba kernels)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

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


@njit(cache=True)
def shortest_ways(
    edges: IntArray, weight: FloatArray, sources: IntArray, start: FloatArray, count: int
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """The Ways to count nodes along edges (e, 2), either way, of positive weight (e,), inf for those that are closed,
    from sources (s,), each of which it costs start (s,) to begin at."""
    offsets = np.zeros(count + 1, dtype=np.int64)
    for e in range(len(edges)):
        for end in range(2):
            offsets[edges[e, end] + 1] += 1
    offsets = np.cumsum(offsets)
    filled, beside = offsets[:-1].copy(), np.empty(offsets[-1], dtype=np.int64)
    for e in range(len(edges)):
        for end in range(2):
            beside[filled[edges[e, end]]] = e
            filled[edges[e, end]] += 1

    cost, predecessor, step = np.full(count, np.inf), np.full(count, -1), np.full(count, -1)
    order, reached = np.empty(count, dtype=np.int64), 0
    done = np.zeros(count, dtype=np.bool_)
    # A heap: every node once for each time that its cost fell.
    heap, due, size = np.empty(len(beside) + len(sources), dtype=np.int64), np.empty(len(beside) + len(sources)), 0
    for s in range(len(sources)):
        if start[s] < cost[sources[s]]:
            cost[sources[s]], predecessor[sources[s]], step[sources[s]] = start[s], count, len(edges) + s
            size = _pushed(heap, due, size, sources[s], start[s])
    while size > 0:
        node = heap[0]
        size = _popped(heap, due, size)
        if done[node]:
            continue
        done[node], order[reached] = True, node
        reached += 1
        for k in range(offsets[node], offsets[node + 1]):
            e = beside[k]
            other = edges[e, 0] + edges[e, 1] - node
            if cost[node] + weight[e] < cost[other]:
                cost[other], predecessor[other], step[other] = cost[node] + weight[e], node, e
                size = _pushed(heap, due, size, other, cost[other])
    return cost, predecessor, step, order[:reached]


@njit(cache=True)
def _pushed(heap: IntArray, due: FloatArray, size: int, node: int, cost: float) -> int:
    """The size of a heap of nodes, the first of which is due first, with another one in it."""
    at = size
    while at > 0 and due[(at - 1) // 2] > cost:
        heap[at], due[at] = heap[(at - 1) // 2], due[(at - 1) // 2]
        at = (at - 1) // 2
    heap[at], due[at] = node, cost
    return size + 1


@njit(cache=True)
def _popped(heap: IntArray, due: FloatArray, size: int) -> int:
    """The size of the heap without its first node."""
    size -= 1
    node, cost = heap[size], due[size]
    at, child = 0, 1
    while child < size:
        if child + 1 < size and due[child + 1] < due[child]:
            child += 1
        if due[child] >= cost:
            break
        heap[at], due[at] = heap[child], due[child]
        at, child = child, 2 * child + 1
    heap[at], due[at] = node, cost
    return size

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


@njit(cache=True)
def shortest_ways(
    offsets: IntArray, beside: IntArray, by: IntArray, weight: FloatArray, sources: IntArray, start: FloatArray
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """The Ways to all nodes along edges, either way, of positive weight (e,), inf for those that are closed, from
    sources (s,), each of which it costs start (s,) to begin at. offsets, beside, by: the `neighbours`."""
    count = len(offsets) - 1
    cost, predecessor, step = np.full(count, np.inf), np.full(count, -1), np.full(count, -1)
    order, reached = np.empty(count, dtype=np.int64), 0
    # A heap: every node once for each time that its cost fell.
    heap, due, size = np.empty(len(beside) + len(sources), dtype=np.int64), np.empty(len(beside) + len(sources)), 0
    for s in range(len(sources)):
        if start[s] < cost[sources[s]]:
            cost[sources[s]], predecessor[sources[s]], step[sources[s]] = start[s], count, len(weight) + s
            size = _pushed(heap, due, size, sources[s], start[s])
    while size > 0:
        node, here = heap[0], due[0]
        size = _popped(heap, due, size)
        if here > cost[node]:
            continue
        order[reached] = node
        reached += 1
        for k in range(offsets[node], offsets[node + 1]):
            other, there = beside[k], here + weight[by[k]]
            if there < cost[other]:
                cost[other], predecessor[other], step[other] = there, node, by[k]
                size = _pushed(heap, due, size, other, there)
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

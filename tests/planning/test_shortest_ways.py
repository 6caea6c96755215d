"""Dijkstra's algorithm against scipy's."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from tfg_drake.planning.shortest_ways import Ways, neighbours, shortest_ways


@pytest.mark.parametrize("seed", range(5))
def test_the_cheapest_ways_are_scipys(seed):
    rng = np.random.default_rng(seed)
    n = 60
    edges = np.unique(np.sort(rng.integers(0, n, (80, 2)), axis=1), axis=0)
    edges = edges[edges[:, 0] < edges[:, 1]]
    weight = rng.uniform(0.1, 2.0, len(edges))
    weight[::7] = np.inf
    sources, start = np.array([3, 17, 3]), np.array([0.5, 0.0, 2.0])
    ways = Ways(*shortest_ways(*neighbours(edges, n), weight, sources, start))

    is_open = np.isfinite(weight)
    a, b = np.vstack([edges[is_open], [[3, n], [17, n]]]).T
    graph = csr_matrix((np.append(weight[is_open], [0.5, 1e-12]), (a, b)), shape=(n + 1, n + 1))
    cost, before = dijkstra(graph, directed=False, indices=n, return_predecessors=True)
    np.testing.assert_allclose(ways.cost, cost[:n], atol=1e-9)
    np.testing.assert_array_equal(ways.predecessor, np.where(np.isfinite(cost[:n]), before[:n], -1))
    assert 10 < len(ways.order) < n
    np.testing.assert_array_equal(np.sort(ways.order), np.flatnonzero(np.isfinite(cost[:n])))
    assert (np.diff(ways.cost[ways.order]) >= 0.0).all()
    for node in ways.order:
        step = ways.step[node]
        if ways.predecessor[node] == n:
            assert sources[step - len(edges)] == node
        else:
            assert set(edges[step]) == {node, ways.predecessor[node]}


def test_without_a_source_nothing_is_reached():
    ways = Ways(*shortest_ways(*neighbours(np.array([[0, 1]]), 2), np.ones(1), np.zeros(0, dtype=int), np.zeros(0)))
    assert np.isinf(ways.cost).all()
    assert ways.predecessor.tolist() == [-1, -1]

"""The cheapest ways against Bellman's equation."""

import numpy as np
import pytest

from tfg_drake.planning.shortest_ways import joined, shortest_ways


@pytest.mark.parametrize("seed", range(5))
def test_no_edge_and_no_source_makes_a_way_cheaper(seed):
    rng = np.random.default_rng(seed)
    n = 60
    edges = np.unique(np.sort(rng.integers(0, n, (80, 2)), axis=1), axis=0)
    edges = edges[edges[:, 0] < edges[:, 1]]
    weight = rng.uniform(0.1, 2.0, len(edges))
    weight[::7] = np.inf
    sources, start = np.array([3, 17]), np.array([0.5, 0.0])
    ways = shortest_ways(edges, weight, n, sources, start)

    expected = np.full(n, np.inf)
    expected[sources] = start
    for _ in range(n):
        for (a, b), one in zip(edges, weight, strict=True):
            expected[a], expected[b] = min(expected[a], expected[b] + one), min(expected[b], expected[a] + one)
    np.testing.assert_allclose(ways.cost, expected, rtol=1e-12)
    assert 10 < len(ways.order) < n
    np.testing.assert_array_equal(np.sort(ways.order), np.flatnonzero(np.isfinite(expected)))
    assert (np.diff(ways.cost[ways.order]) >= 0.0).all()
    length = joined(edges, weight, n, sources, start)
    for node in ways.order:
        before = ways.predecessor[node]
        cost = 0.0 if before == n else ways.cost[before]
        assert cost + length[before, node] == pytest.approx(ways.cost[node])
    assert (ways.predecessor[np.isinf(expected)] == -1).all()


def test_without_a_source_nothing_is_reached():
    ways = shortest_ways(np.array([[0, 1]]), np.ones(1), 2, np.zeros(0, dtype=int), np.zeros(0))
    assert np.isinf(ways.cost).all()
    assert ways.predecessor.tolist() == [-1, -1]

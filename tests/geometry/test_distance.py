import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.geometry.distance import clearance, crossed, enter, point_distance, segments_cross
from tfg_drake.geometry.segment_grid import segment_grid


def random_segments(rng, n):
    a = rng.uniform(-5, 5, (n, 2))
    return np.hstack([a, a + rng.normal(0, 1.5, (n, 2))])


def lines(segments):
    return shapely.linestrings(np.asarray(segments).reshape(-1, 2, 2))


def test_point_distance_agrees_with_shapely():
    rng = np.random.default_rng(0)
    segments, points = random_segments(rng, 40), rng.uniform(-6, 6, (50, 2))
    expected = shapely.distance(shapely.points(points)[:, None], lines(segments)[None]).min(axis=1)
    np.testing.assert_allclose(point_distance(points, segments), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_clearance_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    segments, edges = random_segments(rng, 12), random_segments(rng, 200)
    expected = shapely.distance(lines(edges)[:, None], lines(segments)[None]).min(axis=1)
    assert 0 < (expected == 0).sum() < 200
    np.testing.assert_allclose(clearance(edges, segments, np.inf), expected, atol=1e-12)
    np.testing.assert_allclose(clearance(edges, segments, 0.7), np.minimum(expected, 0.7), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_enter_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    segments, edges = random_segments(rng, 12), random_segments(rng, 200)
    crosses = shapely.crosses(lines(edges)[:, None], lines(segments)[None])
    # In front is on the left: the three points run counter-clockwise.
    ring = np.concatenate([np.tile(segments[None], (200, 1, 1)), np.tile(edges[:, None, :2], (1, 12, 1))], axis=2)
    in_front = shapely.is_ccw(shapely.linearrings(ring.reshape(200, 12, 3, 2)))
    expected = (crosses & in_front).any(axis=1)
    assert 0 < expected.sum() < crosses.any(axis=1).sum()
    np.testing.assert_array_equal(enter(edges, segments), expected)


coordinate = st.integers(-3, 3).map(float)


@settings(deadline=None, max_examples=200)
@given(st.lists(coordinate, min_size=4, max_size=4), st.lists(coordinate, min_size=4, max_size=4))
def test_degenerate_pairs_agree_with_shapely(edge, segment):
    def geometry(row):
        a, b = row[:2], row[2:]
        return shapely.Point(a) if a == b else shapely.LineString([a, b])

    distance = clearance(np.array([edge]), np.array([segment]), np.inf)[0]
    assert distance == pytest.approx(geometry(edge).distance(geometry(segment)), abs=1e-12)


def test_nothing_is_infinitely_far():
    none = np.zeros((0, 4))
    assert point_distance(np.zeros((2, 2)), none).tolist() == [np.inf, np.inf]
    assert clearance(np.zeros((1, 4)), none, np.inf).tolist() == [np.inf]
    assert clearance(np.zeros((1, 4)), none, 2.0).tolist() == [2.0]
    assert len(clearance(none, np.zeros((1, 4)), np.inf)) == 0


@given(seed=st.integers(0, 2**32 - 1))
def test_what_a_line_crosses_is_found_in_its_cells(seed):
    rng = np.random.default_rng(seed)
    # Some of them whole numbers, on the borders of cells; some lines hardly a column wide.
    segments = np.vstack([rng.integers(-4, 5, (15, 4)).astype(float), rng.uniform(-4.0, 4.0, (15, 4))])
    edges = np.vstack([rng.integers(-5, 6, (20, 4)).astype(float), rng.uniform(-5.0, 5.0, (20, 4))])
    edges[::5, 2] = edges[::5, 0] + rng.choice([0.0, 1e-15, 1e-9, 1e-4, 2e-3], 8)
    grid = segment_grid(segments)
    for edge in edges:
        crossing = [j for j, s in enumerate(segments) if segments_cross(*edge, *s)]
        for first in (-1, 3, *crossing[-1:]):
            found = crossed(*edge, segments, grid, first)
            assert found == first if first in crossing else (found in crossing if crossing else found == -1)

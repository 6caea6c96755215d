import numpy as np
import pytest
import shapely

from tfg_drake.geometry.polygon import fault, hatched, outline

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


@pytest.mark.parametrize(
    ("corners", "told"),
    [
        (SQUARE, ""),
        (SQUARE[::-1], ""),
        ([[0, 0], [2, 0], [2, 2], [1, 0.5], [0, 2]], ""),
        ([[0, 0], [1, 0]], "has 2 corners"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "crosses or touches itself between corners 0 and 1"),
        ([[0, 0], [2, 0], [1, 0], [1, 1]], "crosses or touches itself between corners 0 and 1"),
        ([[0, 0], [1, 0], [1, 0], [0, 1]], "crosses or touches itself between corners 0 and 1"),
        ([[0, 0], [1, 0], [2, 0]], "has no area"),
    ],
)
def test_what_is_no_polygon_is_named(corners, told):
    assert fault(np.array(corners, dtype=float)) == told


def test_nothing_inside_is_far_from_the_outline_and_the_lines_across():
    random = np.random.default_rng(1)
    for _ in range(20):
        angles = np.sort(random.uniform(0, 2 * np.pi, random.integers(3, 9)))
        corners = random.uniform(-5, 5, 2) + random.uniform(0.2, 3, len(angles))[:, None] * np.stack(
            [np.cos(angles), np.sin(angles)], axis=1
        )
        polygon = shapely.Polygon(corners)
        assert (fault(corners) == "") == polygon.is_valid
        if not polygon.is_valid:
            continue
        lines = hatched([corners], 0.2)
        drawn = shapely.linestrings(lines.reshape(-1, 2, 2))
        assert shapely.covers(polygon.buffer(1e-9), drawn).all()
        places = shapely.points(random.uniform(corners.min(axis=0), corners.max(axis=0), (500, 2)))
        inside = places[shapely.contains(polygon, places)]
        assert (shapely.distance(inside, shapely.union_all(drawn)) <= 0.1 + 1e-9).all()


def test_of_no_polygons_there_is_nothing():
    assert hatched([], 0.2).shape == (0, 4)
    np.testing.assert_array_equal(hatched([np.array(SQUARE, dtype=float)], 3.0)[:4], outline(np.array(SQUARE)))

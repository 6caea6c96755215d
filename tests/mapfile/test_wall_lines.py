import itertools

import numpy as np
import pytest
import shapely

from tfg_drake.mapfile.wall_lines import OFF, wall_lines

# A room of 8 x 5 m with a door of 0.9 m in its southern wall, and a wall that stands in it at an angle.
WALLS = [[0, 0, 3, 0], [3.9, 0, 8, 0], [8, 0, 8, 5], [8, 5, 0, 5], [0, 5, 0, 0], [2, 2, 4, 3]]


def pieces(rng, noise):
    """The walls in pieces of about a metre that share their ends, in any order and direction, each end off by noise."""
    found = []
    for wall in np.array(WALLS, dtype=float).reshape(-1, 2, 2):
        count = round(np.hypot(*(wall[1] - wall[0])))
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        ends = wall[0] + share * (wall[1] - wall[0]) + rng.normal(0.0, noise, (count + 1, 2))
        found += [[*a, *b] if rng.random() < 0.5 else [*b, *a] for a, b in itertools.pairwise(ends)]
    return rng.permutation(np.array(found))


@pytest.mark.parametrize("seed", range(5))
def test_a_wall_in_pieces_is_one_line_and_a_door_stays_open(seed):
    segments = pieces(np.random.default_rng(seed), 0.004)
    assert len(segments) == 27
    lines = wall_lines(segments)
    assert len(lines) == len(WALLS)
    drawn, walls = (shapely.MultiLineString(list(some.reshape(-1, 2, 2))) for some in (lines, np.array(WALLS, float)))
    assert shapely.hausdorff_distance(drawn, walls, densify=0.01) < 0.03
    assert drawn.distance(shapely.Point(3.45, 0.0)) > 0.4
    assert shapely.MultiLineString(list(segments.reshape(-1, 2, 2))).within(drawn.buffer(1.5 * OFF))


def test_both_faces_of_a_thin_wall_and_of_none_stay():
    faces = np.array([[0.0, 0.0, 2.0, 0.0], [2.0, 0.1, 0.0, 0.1]])
    np.testing.assert_array_equal(wall_lines(faces), faces)
    assert wall_lines(np.zeros((0, 4))).shape == (0, 4)

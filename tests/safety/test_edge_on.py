"""Whether what was met may stand there yet where rays pass: edge-on walls do, people who have gone do not."""

import numpy as np
import pytest

from tfg_drake.safety.edge_on import may_stand

ANGLES = np.linspace(-1.0, 1.0, 241)


def stands(places, ranges, age=0.5):
    """may_stand of places (n, 2) under the same ranges or those given (241,)."""
    places = np.array(places, dtype=float)
    ranges = np.broadcast_to(np.asarray(ranges, dtype=float), ANGLES.shape).copy()
    return may_stand(places, np.full(len(places), age), ANGLES, ranges).tolist()


# A wall along the line of sight, an arc of somebody's body across it, each a few cells.
EDGE_ON = [[0.4 + 0.04 * k, 0.0] for k in range(6)]
BODY = [[0.6, 0.04 * k - 0.1] for k in range(6)]


def test_a_wall_that_is_seen_edge_on_stands_though_rays_pass():
    assert stands(EDGE_ON, 3.0) == [True] * 6
    assert stands(EDGE_ON[:2], 3.0, age=9.0) == [True] * 2
    # The next ray meets its farther end.
    assert stands(EDGE_ON[:2], 0.45, age=9.0) == [True] * 2


def test_somebody_who_has_gone_frees_the_way_at_once():
    assert stands(BODY, 3.0) == [False] * 6


def test_what_is_seen_right_behind_stands_there():
    assert stands(BODY, np.where(np.abs(ANGLES) < 0.5, 0.63, 3.0))[1:5] == [False] * 4


@pytest.mark.parametrize(("age", "left"), [(0.5, True), (1.9, False)])
def test_a_lone_place_is_gone_within_two_seconds(age, left):
    assert stands([[0.5, 0.0]], 3.0, age) == [left]


def test_where_no_ray_tells_of_it_a_place_stands():
    assert stands([[0.5, 0.0]], np.nan, age=9.0) == [True]
    assert stands([[-0.5, 0.1]], 3.0, age=9.0) == [True]

"""No tour is below the bound."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.tour_bound import shortest_chain, tour_bound
from tests.comparison.two_rooms import ROBOT, cells_and_see, world
from tfg_drake.comparison.best_tour import ToSee, best_tour
from tfg_drake.config import ScanConfig, TagSensorConfig
from tfg_drake.messages import replace


@given(st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_the_shortest_chain_is_that_of_all_orders(seed, count):
    apart = np.random.default_rng(seed).uniform(0.0, 9.0, (count + 1, count + 1))

    def length(order):
        driven = 0.0
        for a, b in zip((0, *order), order, strict=False):
            driven = max(driven + apart[a, b], apart[0, b])
        return driven

    chains = map(length, itertools.permutations(range(1, count + 1)))
    assert shortest_chain(apart) == pytest.approx(min(chains))


def test_a_tag_far_down_a_corridor_has_to_be_gone_to():
    walls = np.array([[0.0, 0, 30, 0], [30, 0, 30, 2], [30, 2, 0, 2], [0, 2, 0, 0]])
    # The second one is seen wherever the first is.
    tags, normals = np.array([[30.0, 1.0], [28.0, 2.0]]), np.array([[-1.0, 0.0], [0.0, -1.0]])
    see = ToSee(tags, normals, np.array([[5.0, 1.0, 0.2], [12.0, 1.0, 0.0]]), np.ones(2, dtype=bool), 0.99)
    time, length = tour_bound(walls, np.array([1.0, 1.0]), see, ROBOT)
    # 24 m; at 0.5 m/s, reached with 0.5 m/s^2. Less what is allowed for roughness.
    assert 23.4 < length <= 24.0
    assert time == pytest.approx(length / 0.5 + 0.5)


def test_what_is_seen_at_once_needs_no_way():
    see = ToSee(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0, dtype=bool), 0.99)
    assert tour_bound(world().walls, np.array([1.0, 1.0]), see, ROBOT) == (0.0, 0.0)


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1))
def test_no_tour_of_a_world_drawn_at_random_is_below_its_bound(seed):
    rng = np.random.default_rng(seed)
    boxes = rng.uniform([3.3, 0.3], [6.0, 3.0], (2, 2))
    sides = [[x, y, x + w, y + h] for (x, y), w, h in zip(boxes, *rng.uniform(0.2, 1.0, (2, 2)), strict=True)]
    door = rng.uniform(0.3, 2.6)
    outer, rooms = world(4), np.array([[3.0, 0, 3, door], [3, door + 0.9, 3, 4]])
    one = replace(outer, walls=np.vstack([outer.walls[:4], rooms, sides]))
    scan = ScanConfig(range=float(rng.uniform(2.5, 10.0)))
    cells, see = cells_and_see(one, scan, TagSensorConfig(range=scan.range))
    tour = best_tour(one, cells, see, ROBOT, rounds=3)
    time, length = tour_bound(one.walls, one.start[:2], see, ROBOT)
    if tour.is_enough:
        assert time <= tour.time
        assert length <= tour.distance

"""Advised tags against a dense solution and by what a user relies on."""

import numpy as np
import pytest

from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.visibility import line_of_sight
from tfg_drake.messages import replace
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.world import tag_advice
from tfg_drake.world.tag_advice import advise_tags
from tfg_drake.world.world import World, WorldError

MAPPER = PlanningParameters()
# Two rooms of 4 x 3 m with a door between them.
WALLS = np.array([[0, 0, 8, 0], [8, 0, 8, 3], [8, 3, 0, 3], [0, 3, 0, 0], [4, 0, 4, 1], [4, 2, 4, 3]], dtype=float)
ROOMS = World(
    walls=WALLS,
    tag_ids=np.zeros(0, dtype=np.int64),
    p_WT=np.zeros((0, 2)),
    tag_facing=np.zeros(0),
    start=np.array([1.0, 1.5, 0.0]),
)


@pytest.fixture(scope="module")
def advice():
    return advise_tags(ROOMS, 6, MAPPER)


def test_tags_hang_on_walls_and_face_the_floor(advice):
    assert advice.p_WT.shape == (6, 2)
    normal = np.stack([np.cos(advice.facing), np.sin(advice.facing)], axis=1)
    for p, n in zip(advice.p_WT, normal, strict=True):
        assert line_of_sight(WALLS, p + 0.2 * n, advice.places).any()
    distance = np.hypot(*(advice.p_WT[:, None] - advice.p_WT).transpose(2, 0, 1))
    assert (distance[np.triu_indices(6, 1)] >= tag_advice.TAG_SPACING).all()


def test_each_tag_makes_the_position_better_known_everywhere(advice):
    assert advice.deviation.shape == (7, len(advice.places))
    assert (np.diff(advice.deviation, axis=0) <= 1e-12).all()
    assert advice.deviation[-1].mean() < 0.3 * advice.deviation[0].mean()


def test_both_rooms_get_some(advice):
    assert (advice.p_WT[:, 0] < 4.0).any()
    assert (advice.p_WT[:, 0] > 4.0).any()


def turns(world):
    places, parent = tag_advice._places(world, 0.18, None)
    return tag_advice._Turns(world, places, parent, MAPPER), places


def test_the_first_tag_is_the_best_of_all_and_each_next_too(advice):
    model, _ = turns(ROOMS)
    rows = [model.rows(p, f) for p, f in zip(*tag_advice._candidates(ROOMS, 0.18), strict=True)]
    for p, facing in zip(advice.p_WT[:3], advice.facing[:3], strict=True):
        chosen = model.rows(p, facing)
        # Older promises bound newer ones but for a little: positions alone are not quite submodular.
        assert model.promise(chosen) >= 0.98 * max(model.promise(one) for one in rows)
        model.hang(chosen)


def test_a_tag_tells_as_much_as_in_a_dense_solution_with_its_place_in_it():
    model, places = turns(ROOMS)
    prior = model._covariance.copy() + 1e-12 * np.eye(len(model._covariance))
    p, facing = np.array([4.0 - 0.01, 0.5]), np.pi
    columns, A = model.rows(p, facing)
    model.hang((columns, A))
    # The same by information, with the tag's place as two more unknowns and every sighting a pair of rows.
    n = len(prior)
    information = np.zeros((n + 2, n + 2))
    information[:n, :n] = np.linalg.inv(prior)
    sensor = TagSensorConfig()
    at = np.vstack([ROOMS.start[None, :2], places])
    for i in np.unique(columns // 3).tolist():
        d = p - at[i]
        r = np.hypot(*d)
        noise = model._first_noise if i == 0 else model._noise
        J = np.zeros((2, n + 2))
        J[0, n:], J[0, 3 * i : 3 * i + 2] = d / r, -d / r
        across = np.array([-d[1], d[0]]) / r**2
        J[1, n:], J[1, 3 * i : 3 * i + 2], J[1, 3 * i + 2] = across, -across, -1.0
        J[0] /= max(noise[0] + noise[1] * r, noise[2])
        J[1] /= noise[3]
        information += J.T @ J
        assert r <= sensor.range
    dense = np.linalg.inv(information)[:n, :n]
    assert np.abs(model._covariance - dense).max() < 1e-6 * prior.max()


def test_tags_that_hang_stay_and_are_built_upon():
    hung = replace(
        ROOMS, tag_ids=np.arange(2), p_WT=np.array([[4.01, 0.5], [7.99, 1.5]]), tag_facing=np.array([0.0, np.pi])
    )
    more = advise_tags(hung, 1, MAPPER)
    assert more.deviation[0].mean() < advise_tags(ROOMS, 0, MAPPER).deviation[0].mean()
    assert more.p_WT[0, 0] < 4.0  # where none hangs


def test_a_floor_limits_where_the_robot_will_be():
    left = advise_tags(ROOMS, 2, MAPPER, floor=lambda points: points[:, 0] < 3.5)
    assert (left.places[:, 0] < 3.5).all()


def test_walls_without_room_for_so_many_give_fewer():
    few = advise_tags(replace(ROOMS, walls=WALLS[:1]), 1000, MAPPER)
    assert 0 < len(few.p_WT) < 60
    assert len(few.deviation) == len(few.p_WT) + 1


def test_a_world_without_walls_is_refused():
    with pytest.raises(WorldError, match="no wall can be reached from the start"):
        advise_tags(replace(ROOMS, walls=WALLS[:0]), 3, MAPPER)

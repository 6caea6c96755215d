"""Doors that shut and open, furniture and tags that are moved."""

import numpy as np
import pytest

from tfg_drake.config import ChangeConfig, TagConfig
from tfg_drake.world.changing import CLEAR, is_due, successive, world_at
from tfg_drake.world.world import World, WorldError

WALLS = np.array([[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5], [3, 3.4, 3, 4]])
WORLD = World(
    WALLS, np.array([7, 3, 5]), np.array([[1.0, 0.01], [2.0, 0.01], [5.0, 0.01]]), np.full(3, 1.5), np.ones(3)
)
DOOR = [3.0, 2.5, 3.0, 3.4]


def test_a_door_shuts_and_opens_again():
    shut, opened = ChangeConfig(time=2.0, walls=[DOOR]), ChangeConfig(time=5.0, opened=[DOOR])
    worlds = successive(WORLD, [shut, opened])
    assert [len(world.walls) for world in worlds] == [6, 7, 6]
    assert worlds[1].walls[-1].tolist() == DOOR
    assert worlds[2].walls.tolist() == WALLS.tolist()
    for time, walls in ((1.9, 6), (2.0, 7), (4.9, 7), (5.0, 6)):
        assert len(world_at(WORLD, [shut, opened], time).walls) == walls


def test_a_piece_of_a_wall_is_opened():
    (_, after) = successive(WORLD, [ChangeConfig(opened=[[4.0, 4.0, 3.0, 4.0], [3.0, 2.0, 3.0, 9.0]])])
    left = after.walls.tolist()
    assert [6, 4, 4, 4] in left
    assert [3, 4, 0, 4] in left
    assert [3, 0, 3, 2] in left
    assert len(left) == 6


def test_tags_are_moved_and_fall_off():
    change = ChangeConfig(tags=[TagConfig(id=3, position=[2.5, 0.01], facing=1.0)], fallen=[7])
    (_, after) = successive(WORLD, [change])
    assert after.tag_ids.tolist() == [3, 5]
    assert after.p_WT.tolist() == [[2.5, 0.01], [5.0, 0.01]]
    assert after.tag_facing.tolist() == [1.0, 1.5]
    assert len(WORLD.tag_ids) == 3


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ([ChangeConfig(opened=[[1, 1, 2, 2]])], r"reality\.changes\[0\]: opened: there is no wall from \(1, 1\)"),
        ([ChangeConfig(fallen=[9])], r"reality\.changes\[0\]: there is no tag 9 in the world then"),
        (
            [ChangeConfig(fallen=[3]), ChangeConfig(tags=[TagConfig(id=3, position=[0.0, 0.0], facing=0.0)])],
            r"changes\[1\]: there is no tag 3",
        ),
        ([ChangeConfig(walls=[[1, 1, 1, 1]])], r"reality\.changes\[0\]: world\.walls\[6\]: zero length"),
        ([ChangeConfig(time=2.0), ChangeConfig(time=1.0)], r"reality\.changes\[1\]\.time: is before"),
    ],
)
def test_what_cannot_be_changed_is_refused(changes, complaint):
    with pytest.raises(WorldError, match=complaint):
        successive(WORLD, changes)


def test_nothing_is_put_onto_the_robot_or_right_beside_it():
    shut, moved = ChangeConfig(time=2.0, walls=[DOOR]), ChangeConfig(time=2.0, fallen=[3])
    beside, away = np.array([3.0 - 0.2 - 0.9 * CLEAR, 3.0]), np.array([3.0 - 0.2 - 1.1 * CLEAR, 3.0])
    assert not is_due(shut, 3.0, beside, 0.2)
    assert not is_due(shut, 1.9, away, 0.2)
    assert is_due(shut, 3.0, away, 0.2)
    assert is_due(moved, 2.0, beside, 0.2)

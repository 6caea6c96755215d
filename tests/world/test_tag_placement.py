import numpy as np
import pytest
from scipy.spatial import cKDTree

from tfg_drake.world.reachability import make_grid, reachable_cells, reachable_tags
from tfg_drake.world.tag_placement import TAG_OFFSET, place_tags
from tfg_drake.world.world import World, WorldError

SQUARE = np.array([[0, 0, 4, 0], [4, 0, 4, 4], [4, 4, 0, 4], [0, 4, 0, 0]], dtype=float)
START = np.array([1.0, 1.0, 0.0])


def test_one_tag_a_metre_on_the_inner_faces_of_a_square_room():
    ids, p_WT, facing = place_tags(SQUARE, START, 1.0, 0.18)
    np.testing.assert_array_equal(ids, np.arange(16))
    np.testing.assert_allclose(p_WT[:4], [[x, TAG_OFFSET] for x in (0.5, 1.5, 2.5, 3.5)])
    np.testing.assert_allclose(facing, np.repeat([np.pi / 2, np.pi, -np.pi / 2, 0.0], 4), atol=1e-12)


def test_both_faces_of_a_thin_wall_and_none_in_a_sealed_room():
    walls = np.vstack([SQUARE, [[2, 0, 2, 3]], [[3, 3, 4, 3], [3, 3, 3, 4]]])
    _, p_WT, facing = place_tags(walls, START, 1.0, 0.18)
    on_wall = np.abs(p_WT[:, 0] - 2.0) < 0.02
    np.testing.assert_allclose(sorted(np.abs(facing[on_wall])), [0, 0, 0, np.pi, np.pi, np.pi], atol=1e-12)
    assert not ((p_WT > 3.005).all(axis=1)).any()


def test_every_tag_is_reachable_and_a_circle_gets_evenly_spread_tags():
    angle = np.linspace(0, 2 * np.pi, 101)
    circle = 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    walls = np.column_stack([circle[:-1], circle[1:]])
    ids, p_WT, facing = place_tags(walls, np.zeros(3), 1.0, 0.18)
    assert 14 <= len(ids) <= 19
    distance = cKDTree(p_WT).query(p_WT, k=2)[0][:, 1]
    assert distance.min() >= 1.0
    world = World(walls=walls, tag_ids=ids, p_WT=p_WT, tag_facing=facing, start=np.zeros(3))
    grid = make_grid(world)
    assert reachable_tags(world, grid, reachable_cells(grid, world, 0.18), 10.0, np.deg2rad(75)).all()


def test_no_walls_no_tags():
    assert len(place_tags(np.zeros((0, 4)), START, 1.0, 0.18)[0]) == 0


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan])
def test_a_spacing_must_be_positive(spacing):
    with pytest.raises(WorldError, match="tag spacing: must be a positive number of metres, is"):
        place_tags(SQUARE, START, spacing, 0.18)

"""A drive thought out beforehand."""

import numpy as np
import pytest

from tfg_drake.messages import replace
from tfg_drake.planning.path import PATH_STEP
from tfg_drake.planning.scripted_drive import next_place, straight_path
from tfg_drake.tfg.graph import empty_map

DRIVE = np.array([[1.0, 2.0], [3.0, 4.0]])


def test_places_come_in_order():
    first, second = next_place(DRIVE, 1, empty_map()), next_place(DRIVE, 2, empty_map())
    assert (first.verdict, first.node, first.p_MG.tolist()) == ("goal", 0, [1.0, 2.0])
    assert (second.stage, second.node, second.p_MG.tolist()) == (2, 1, [3.0, 4.0])


@pytest.mark.parametrize(
    ("length", "verdict", "reason"),
    [
        ([], "complete", "The drive is over and no frontier is left."),
        ([1.0, 0.5], "stuck", "The drive is over and 1.5 m of frontier are open."),
    ],
)
def test_at_its_end_the_map_says_whether_all_was_seen(length, verdict, reason):
    tfg = replace(empty_map(), frontier_length=np.array(length))
    end = next_place(DRIVE, 3, tfg)
    assert (end.node, end.verdict, end.reason) == (-1, verdict, reason)


def test_the_path_is_straight_and_dense():
    path = straight_path(7, 2, np.array([0.0, 1.0, 0.3]), np.array([3.0, 5.0]))
    assert (path.id, path.stage) == (7, 2)
    assert path.points[0] == pytest.approx([0.0, 1.0])
    assert path.points[-1] == pytest.approx([3.0, 5.0])
    assert np.hypot(*np.diff(path.points, axis=0).T).max() <= PATH_STEP + 1e-9
    assert 4.0 * path.points[:, 0] - 3.0 * (path.points[:, 1] - 1.0) == pytest.approx(0.0, abs=1e-9)


def test_a_path_to_where_the_robot_stands_has_two_points():
    assert straight_path(1, 1, np.zeros(3), np.zeros(2)).points.shape == (2, 2)

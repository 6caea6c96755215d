import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.config import ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import replace
from tfg_drake.planning.candidates import (
    frontier_seen,
    thin_candidates,
    time_at_goal,
    time_to_go_on,
)
from tfg_drake.planning.expected_view import Visibility
from tfg_drake.planning.pure_pursuit import PLANNED_SHARE
from tfg_drake.tfg.graph import empty_map


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 40))
def test_candidates_are_thinned_evenly_and_frontiers_come_first(sees, count):
    nodes = 3 * np.arange(len(sees))
    flags = np.array(sees, dtype=np.int64)
    kept = thin_candidates(nodes, flags, count)
    assert len(kept) == len(np.unique(kept)) == min(count, len(nodes))
    assert (np.diff(kept) > 0).all()
    assert set(kept) <= set(nodes)
    seeing = set(nodes[flags > 0])
    assert len(seeing & set(kept)) == min(len(seeing), count)
    for of in (sorted(seeing), sorted(set(nodes) - seeing)):
        gaps = np.diff(np.flatnonzero(np.isin(of, kept)))
        assert not len(gaps) or np.ptp(gaps) <= 1


def test_a_frontier_near_the_end_of_the_view_counts_for_less():
    tfg = replace(empty_map(), frontiers=np.array([[4.0, 0.0], [7.5, 0.0]]), frontier_length=np.array([0.4, 0.4]))
    seen = frontier_seen(np.zeros((1, 2)), Visibility(np.array([0, 2]), np.arange(2)), tfg, TagSensorConfig())
    np.testing.assert_allclose(seen, [[0.4, 0.2]])


def test_a_stay_at_a_goal_is_half_of_what_a_turn_has_to_bring_into_view_on_average():
    sensor = dataclasses.replace(TagSensorConfig(), field_of_view=np.pi)
    assert time_at_goal(sensor, ExplorerConfig(turn_rate=0.5)) == pytest.approx(np.pi + 1.0)
    assert time_at_goal(dataclasses.replace(sensor, field_of_view=7.0), ExplorerConfig()) == 1.0


def test_from_a_goal_the_robot_turns_by_a_quarter_and_starts_again():
    robot = RobotConfig(max_turn_rate=0.5, max_speed=0.4, max_acceleration=0.8)
    assert time_to_go_on(robot) == pytest.approx(np.pi / PLANNED_SHARE + 0.5)

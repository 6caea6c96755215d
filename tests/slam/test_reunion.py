"""A robot that maps on though it has lost its place finds the map before again."""

import numpy as np
import pytest

from tests.slam.test_scan_lines import ANGLES, CONFIG
from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, replace
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam import estimator, reunion
from tfg_drake.slam.estimator import begin_turn, end_turn, process_odometry, process_scan
from tfg_drake.slam.estimator_state import KIDNAPPED, initial_state, opened
from tfg_drake.slam.place_search import no_places
from tfg_drake.slam.walls import known_walls

# A room that is not alike from any two sides.
ROOM = np.array(
    [[0, 0, 6, 0], [6, 0, 6, 3], [6, 3, 4, 3], [4, 3, 4, 5], [4, 5, 0, 5], [0, 5, 0, 0], [1.5, 2, 1.5, 3.2]],
    dtype=float,
)
PERIOD = 0.1


class Robot:
    """Drives exactly as its odometry says; scans have noise."""

    def __init__(self):
        self.X_WB, self.time, self.rng = np.array([2.5, 1.5, 0.0]), 0.0, np.random.default_rng(6)

    def odometry(self, speed=0.0, rate=0.0):
        return Odometry(self.time, self.X_WB.copy(), np.array([speed, rate]))

    def drive(self, state, speed, rate, steps):
        for _ in range(steps):
            self.time += PERIOD
            self.X_WB = se2.compose(self.X_WB, np.array([speed * PERIOD, 0.0, rate * PERIOD]))
            state = process_odometry(state, self.odometry(speed, rate))
            seen = scan(ROOM, self.X_WB, self.time, ANGLES, self.rng.normal(size=len(ANGLES)), CONFIG)
            state = process_scan(state, seen)
        return state

    def view(self, state):
        return end_turn(self.drive(begin_turn(state, self.time), 0.0, 0.5, 126), self.time)


@pytest.mark.parametrize("late", [False, True], ids=["at once", "a view later"])
@pytest.mark.parametrize("carried", [0.0, 0.8], ids=["where it was", "carried"])
def test_certainty_comes_back_when_the_walls_tell_where_the_robot_is(carried, late, monkeypatch):
    robot = Robot()
    state = process_odometry(initial_state(OdometryConfig(), landmarks="walls"), robot.odometry())
    state = robot.view(state)
    walls, before = known_walls(state.map)[1], known_walls(state.map)[2]
    assert len(walls) >= 6
    # From here on it is not found by its walls on the way.
    monkeypatch.setattr(estimator, "find_itself", lambda state, *_args, **_kwargs: state)
    state = robot.drive(state, 0.2, 0.0, 10)
    state = replace(state, kidnapped=True, way=(), piece=replace(opened(state), sigma=KIDNAPPED))
    offset = np.array([0.0, carried, 0.0])
    robot.X_WB = robot.X_WB + offset
    robot.odometry = lambda speed=0.0, rate=0.0: Odometry(robot.time, robot.X_WB - offset, np.array([speed, rate]))
    if late:
        with monkeypatch.context() as patch:
            patch.setattr(reunion, "find_places", lambda *_args: no_places())
            state = robot.drive(robot.view(state), 0.2, 0.0, 5)
        assert state.map.covariance[-3, -3] > 1.0
    state = robot.view(state)
    assert np.abs(state.map.covariance[-3:, -3:]).max() < 0.05**2
    deviation = known_walls(state.map)[2]
    assert np.sort(deviation.max(axis=1))[len(walls) - 1] < 2.0 * before.max()
    error = se2.compose(np.array([2.5, 1.5, 0.0]), state.map.X_MD) - robot.X_WB
    error[2] = se2.wrap_angle(error[2])
    assert np.abs(error).max() < 0.03

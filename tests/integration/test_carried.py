"""A robot that is carried elsewhere in a building without tags never states a pose that is wrong."""

import math

import numpy as np
import pytest

import tfg_drake
from tfg_drake.config import DisturbanceConfig
from tfg_drake.diagrams.scenario import PrepareScenario
from tfg_drake.geometry.se2 import compose


@pytest.mark.slow
def test_a_robot_that_was_carried_away_finds_itself_among_the_walls():
    """After 3 m and 90 degrees in the 150th second, felt by neither wheels nor gyro."""
    scenario = PrepareScenario("house", [], 0, "house", math.inf)
    scenario.disturbances = [DisturbanceConfig(150.0, 1.0, ahead=3.0, turn=0.5 * math.pi, gyro_feels=False)]
    mission = tfg_drake.explore(scenario, until=150.0)
    false, error = 0, math.inf
    while mission.time < 190.0:
        mission.advance(0.5)
        pose, truth = mission.look("pose"), mission.look("truth.pose")
        error = float(np.hypot(*(compose(mission.X_WM, pose.X_MB)[:2] - truth[:2])))
        stated = math.sqrt(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
        false += error > max(0.3, 3.0 * stated)
    # As long as it takes to see that it is elsewhere, half seconds.
    assert false <= 30
    assert error < 0.1

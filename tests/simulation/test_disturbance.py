"""Moving the base behind its wheels' back."""

import numpy as np
import pytest

from tests.arrays import frozen
from tfg_drake.config import DisturbanceConfig, OdometryConfig, RobotConfig
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation import odometry
from tfg_drake.simulation.disturbance import displacement

NO_WALLS = frozen(np.zeros((0, 4)))
NO_ERRORS = np.zeros(3)


def test_a_disturbance_moves_evenly_over_its_duration_and_never_again():
    push = [DisturbanceConfig(time=2.0, duration=0.5, ahead=0.4, left=-0.2, turn=0.3, gyro_feels=False)]
    assert displacement(push, 0.0, 2.0) == pytest.approx([0, 0, 0, 0])
    assert displacement(push, 2.1, 2.2) == pytest.approx([0.08, -0.04, 0.06, 0.0])
    assert displacement(push, 0.0, 9.0) == pytest.approx([0.4, -0.2, 0.3, 0.0])


def test_disturbances_add_up():
    both = [DisturbanceConfig(time=1.0, ahead=1.0, turn=0.5), DisturbanceConfig(time=1.0, left=2.0)]
    assert displacement(both, 0.0, 5.0) == pytest.approx([1.0, 2.0, 0.5, 0.5])


@pytest.mark.parametrize("gyro_feels", [True, False])
def test_wheels_do_not_notice_and_the_gyro_feels_what_it_may(gyro_feels):
    """A push of a robot that stands: the truth moves, odometry does not, but for the turn where the gyro feels it."""
    push = [DisturbanceConfig(time=0.25, duration=0.5, ahead=0.2, left=0.1, turn=0.4, gyro_feels=gyro_feels)]
    robot, noiseless = RobotConfig(), OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)
    base, wheels = drive.initial_state(np.zeros(3), NO_WALLS, robot), odometry.initial_state(np.zeros(3))
    period = 1.0 / 32.0
    for k in range(32):
        moved = displacement(push, k * period, (k + 1) * period)
        base = drive.step(base, np.zeros(2), NO_WALLS, robot, period, moved)
        wheels = odometry.integrate(
            wheels, (k + 1) * period, base[drive.X : drive.TURN_RATE + 1], NO_ERRORS, np.zeros(2), noiseless, moved
        )
    said = odometry.message(wheels)
    assert base[drive.THETA] == pytest.approx(0.4)
    assert np.hypot(base[drive.X], base[drive.Y]) == pytest.approx(np.hypot(0.2, 0.1), abs=0.01)
    assert pytest.approx([0.0, 0.0, 0.4 if gyro_feels else 0.0], abs=1e-9) == said.X_OB


def test_wheels_that_slip_report_way_that_was_not_made():
    slip = [DisturbanceConfig(time=0.0, duration=1.0, ahead=-0.3)]
    robot, noiseless = RobotConfig(), OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)
    base, wheels = drive.initial_state(np.zeros(3), NO_WALLS, robot), odometry.initial_state(np.zeros(3))
    period = 1.0 / 32.0
    for k in range(64):
        moved = displacement(slip, k * period, (k + 1) * period)
        base = drive.step(base, np.array([0.5, 0.2]), NO_WALLS, robot, period, moved)
        wheels = odometry.integrate(
            wheels, (k + 1) * period, base[drive.X : drive.TURN_RATE + 1], NO_ERRORS, np.zeros(2), noiseless, moved
        )
    free = drive.initial_state(np.zeros(3), NO_WALLS, robot)
    for _ in range(64):
        free = drive.step(free, np.array([0.5, 0.2]), NO_WALLS, robot, period)
    assert pytest.approx(free[drive.X : drive.THETA + 1], abs=1e-9) == odometry.message(wheels).X_OB
    missing = np.linalg.norm(free[drive.X : drive.X + 2] - base[drive.X : drive.X + 2])
    assert missing == pytest.approx(0.3, abs=0.01)

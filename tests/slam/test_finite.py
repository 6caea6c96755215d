"""Estimates that are no longer finite end at once, and what was mapped before is as it was."""

import numpy as np
import pytest

from tfg_drake.bad_input import EstimateLost
from tfg_drake.messages import Odometry, replace
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator import begin_turn, end_turn, process_detections, process_odometry
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.finite import kept_finite


@pytest.fixture
def turned(drive):
    """A robot and the estimator after its first turn."""
    points = np.random.default_rng(3).uniform(-5.0, 5.0, (20, 2))
    robot = drive(points, 3, 1.0)
    state = process_odometry(initial_state(robot.config), robot.odometry())
    state = begin_turn(state, robot.time)
    for _ in range(201):
        for message in robot.step(0.0, 1.0):
            state = (process_odometry if isinstance(message, Odometry) else process_detections)(state, message)
    return robot, end_turn(state, robot.time)


def test_odometry_that_is_no_number_is_told_when_it_comes(turned):
    robot, state = turned
    assert state.map.stage == 1

    def go_on(state):
        for _ in range(40):
            for message in robot.step(0.2, 0.0):
                if isinstance(message, Odometry):
                    state = process_odometry(state, replace(message, X_OB=message.X_OB * np.nan))
                else:
                    state = process_detections(state, message)

    with pytest.raises(
        EstimateLost, match=r"^the estimate is no longer finite at .* \(its pose is not\); .* stage 1; "
    ):
        go_on(state)
    assert np.isfinite(state.map.p_ML).all()


def test_what_cannot_be_solved_is_told_in_a_line(turned, monkeypatch):
    robot, state = turned

    def fail(*_args):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(estimator, "reduced_now", fail)
    state = begin_turn(state, robot.time)
    with pytest.raises(EstimateLost, match=r"\(Matrix is not positive definite\)"):
        end_turn(state, robot.time)


@pytest.mark.parametrize("field", ["p_ML", "X_MD", "covariance", "shared"])
def test_a_map_that_is_no_number_is_told(turned, field):
    _, state = turned
    spoilt = replace(state, map=replace(state.map, **{field: getattr(state.map, field) * np.nan}))
    with pytest.raises(EstimateLost, match=r"\(its map is not\)"):
        kept_finite(lambda _: spoilt)(state)

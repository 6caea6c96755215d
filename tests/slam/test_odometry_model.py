import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry
from tfg_drake.slam.odometry_model import (
    REST_SHARE,
    arc,
    first_reckoning,
    interpolate,
    predict_increment,
    random_walks,
    reckon,
    reckoned_at,
)

NOISE = random_walks(OdometryConfig())


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3), st.floats(-3, 3))
def test_without_calibration_error_the_increment_is_the_measured_motion(x, y, theta, heading):
    X_0 = np.array([1.0, 2.0, heading])
    X_1 = se2.compose(X_0, np.array([x, y, theta]))
    X, _, covariance = predict_increment(arc(X_0, X_1), 0.1, np.zeros(3), NOISE)
    np.testing.assert_allclose(X, [x, y, theta], atol=1e-12)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_jacobian_on_the_calibration():
    increment, calibration = np.array([0.2, 0.01, 0.3]), np.array([0.01, 0.02, -0.01])
    _, jacobian, _ = predict_increment(increment, 0.1, calibration, NOISE)
    for i, h in enumerate(1e-6 * np.eye(3)):
        plus = predict_increment(increment, 0.1, calibration + h, NOISE)[0]
        minus = predict_increment(increment, 0.1, calibration - h, NOISE)[0]
        np.testing.assert_allclose(jacobian[:, i], (plus - minus) / 2e-6, atol=1e-8)


def test_random_walk_against_many_small_steps():
    dt, steps, speed, rate = 1.0 / 256.0, 64, 0.5, 0.05
    noise = np.append(NOISE[:2], 0.0)
    rng = np.random.default_rng(1)
    X = np.zeros((4000, 3))
    for _ in range(steps):
        turn = rate * dt + NOISE[1] * np.sqrt(dt) * rng.normal(size=len(X))
        forward = speed * dt + NOISE[0] * np.sqrt(speed * dt) * rng.normal(size=len(X))
        step = np.column_stack([forward * np.cos(0.5 * turn), forward * np.sin(0.5 * turn), turn])
        X = se2.compose(X, step)
    covariance = predict_increment(arc(np.zeros(3), X.mean(axis=0)), steps * dt, np.zeros(3), noise)[2]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), X.std(axis=0), rtol=0.1)
    np.testing.assert_allclose(
        np.sqrt(np.linalg.eigvalsh(covariance)), np.sqrt(np.linalg.eigvalsh(np.cov(X.T))), rtol=0.15
    )


def test_interpolation_follows_the_arc():
    def on_circle(angle):
        return np.array([2.0 * np.sin(angle), 2.0 - 2.0 * np.cos(angle), angle])

    before, after = (Odometry(t, on_circle(0.8 * t), np.zeros(2)) for t in (1.0, 1.5))
    np.testing.assert_allclose(interpolate(before, after, 1.2), on_circle(0.8 * 1.2), atol=1e-12)
    np.testing.assert_allclose(interpolate(before, before, 1.0), before.X_OB)


def test_half_turns_wrap():
    before = Odometry(0.0, np.array([0.0, 0.0, 3.1]), np.zeros(2))
    after = Odometry(1.0, np.array([0.0, 0.0, -3.1]), np.zeros(2))
    assert abs(interpolate(before, after, 0.5)[2]) == pytest.approx(np.pi)


def test_what_the_gyro_says_while_no_wheel_turns_is_left_out():
    first = Odometry(1.0, np.array([1.0, 2.0, 0.5]), np.zeros(2))
    still = Odometry(2.0, np.array([1.0, 2.0, 0.7]), np.array([0.0, 0.2]), at_rest=True)
    on = Odometry(3.0, se2.compose(still.X_OB, np.array([0.5, 0.0, 0.1])), np.array([0.5, 0.1]))
    start = first_reckoning(first)
    rest = reckon(start, first, still)
    np.testing.assert_array_equal(rest.X_OB, first.X_OB)
    np.testing.assert_array_equal(rest.V_B, 0.0)
    assert rest.clock == pytest.approx(REST_SHARE)
    moved = reckon(rest, still, on)
    np.testing.assert_allclose(moved.X_OB, se2.compose(first.X_OB, np.array([0.5, 0.0, 0.1])), atol=1e-12)
    assert moved.clock == pytest.approx(1.0 + REST_SHARE)
    assert reckoned_at(rest, moved, 2.5).clock == pytest.approx(0.5 + REST_SHARE)

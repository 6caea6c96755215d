"""The batch smoother on drives whose truth is known."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.slam.conftest import RingDrive
from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.batch_smoother import HUBER_SIGMAS, smooth
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, TagDetections, replace
from tfg_drake.slam.odometry_model import arc, predict_increment, random_walks
from tfg_drake.slam.shared import calibration_sigma


@pytest.fixture
def drive():
    """RingDrive, the class."""
    return RingDrive


def record(drive, noise, steps=640, seed=4):
    """Odometry, frames and true poses at the odometry's stamps of a drive on a circle among tags, and the drive."""
    angle = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    robot = drive(6.0 * np.column_stack([np.cos(angle), np.sin(angle)]), seed, noise)
    odometry, frames, stamps, X_MB = [robot.last], [], [0.0], [robot.X_MB]
    for _ in range(steps):
        for one in robot.step(0.5, 0.35):
            (frames if isinstance(one, TagDetections) else odometry).append(one)
        stamps.append(robot.time)
        X_MB.append(robot.X_MB)
    return tuple(odometry), tuple(frames), np.array(stamps), np.array(X_MB), robot


def errors(run, stamps, X_MB, robot):
    """Largest errors of positions (m) and of landmarks (m); the first pose is held, so nothing is aligned."""
    rows = np.searchsorted(stamps, run.stamps - 1e-9)
    at = np.isclose(stamps[np.minimum(rows, len(stamps) - 1)], run.stamps)
    position = np.linalg.norm(run.X_MB[at, :2] - X_MB[rows[at], :2], axis=1)
    return position.max(), np.linalg.norm(run.p_ML - robot.p_ML(run.ids), axis=1).max()


def test_a_drive_without_noise_is_solved_exactly(drive):
    odometry, frames, stamps, X_MB, robot = record(drive, 0.0)
    run = smooth(odometry, frames, robot.config)
    assert max(errors(run, stamps, X_MB, robot)) < 1e-6
    np.testing.assert_allclose(run.calibration, 0.0, atol=1e-6)
    assert run.half_chi_square < 1e-6
    assert run.used == sum(len(frame.ids) for frame in frames)
    assert run.rejected == 0
    assert np.all(np.diff(run.stamps) > 0.0)


def test_noise_costs_what_the_kernel_makes_of_it(drive):
    odometry, frames, stamps, X_MB, robot = record(drive, 1.0)
    run = smooth(odometry, frames, robot.config)
    position, landmark = errors(run, stamps, X_MB, robot)
    assert position < 0.1
    assert landmark < 0.1
    # Two normal errors a sighting, of length r: the mean of Huber's function of r, not of r^2 / 2, which is 1.
    k = HUBER_SIGMAS
    mean = 1.0 - math.exp(-0.5 * k**2) + k * math.sqrt(0.5 * math.pi) * math.erfc(k / math.sqrt(2.0))
    assert run.half_chi_square / run.used == pytest.approx(mean, abs=0.04)
    assert run.rejected < 0.005 * run.used


def test_the_calibration_is_found(drive):
    odometry, frames, _, _, robot = record(drive, 1.0)
    run = smooth(odometry, frames, robot.config)
    np.testing.assert_allclose(run.calibration[:2], robot.errors[:2], atol=5e-3)


def test_gross_errors_are_rejected(drive):
    odometry, frames, stamps, X_MB, robot = record(drive, 1.0)
    random = np.random.default_rng(0)
    spoiled, count = [], 0
    for frame in frames:
        bad = random.random(len(frame.ids)) < 0.03
        count += int(bad.sum())
        distance = np.where(bad, frame.range + 3.0, frame.range)
        spoiled.append(
            TagDetections(frame.stamp, frame.ids, distance, frame.bearing, frame.sigma_range, frame.sigma_bearing)
        )
    run = smooth(odometry, tuple(spoiled), robot.config)
    assert count <= run.rejected <= count + 0.005 * run.used
    assert max(errors(run, stamps, X_MB, robot)) < 0.1


def test_a_run_that_saw_nothing_is_its_odometry(drive):
    odometry, _, _, _, robot = record(drive, 0.0)
    run = smooth(odometry, (), robot.config)
    assert run.ids.tolist() == []
    assert run.p_ML.shape == (0, 2)
    np.testing.assert_allclose(run.X_MB[-1], odometry[-1].X_OB, atol=1e-9)
    assert run.used == run.rejected == 0


def test_one_message_is_one_pose(drive):
    odometry, _, _, _, robot = record(drive, 0.0, steps=1)
    run = smooth(odometry[:1], (), robot.config)
    np.testing.assert_allclose(run.X_MB, se2.compose(np.zeros(3), np.zeros(3))[None])


def test_without_odometry_there_is_nothing_to_smooth(drive):
    with pytest.raises(ValueError, match="A run without odometry cannot be smoothed"):
        smooth((), (), drive(np.zeros((0, 2)), 0, 0.0).config)


def test_progress_runs_from_nothing_to_one(drive):
    odometry, frames, _, _, robot = record(drive, 1.0, steps=100)
    shares = []
    smooth(odometry, frames, robot.config, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_misread_ids_lead_nowhere(drive):
    odometry, frames, stamps, X_MB, robot = record(drive, 1.0)
    random = np.random.default_rng(1)
    spoiled, count = [], 0
    for frame in frames:
        ids = np.where(random.random(len(frame.ids)) < 0.1, random.integers(100, 112, len(frame.ids)), frame.ids)
        count += int(np.sum(ids != frame.ids))
        spoiled.append(replace(frame, ids=ids))
    run = smooth(odometry, tuple(spoiled), robot.config)
    assert count <= run.rejected <= count + 0.01 * run.used
    assert max(errors(run, stamps, X_MB, robot)) < 0.1


def test_the_solution_is_that_of_a_dense_solver():
    """A short way with a frame at every odometry message, so that nothing is interpolated."""
    random = np.random.default_rng(2)
    config = OdometryConfig()
    tags = random.uniform(-4.0, 4.0, (6, 2))
    X_MB, X_OB, odometry, frames, seen = np.zeros(3), np.zeros(3), [], [], []
    for i in range(25):
        odometry.append(Odometry(stamp=0.4 * i, X_OB=X_OB, V_B=np.zeros(2)))
        d = se2.transform(se2.inverse(X_MB), tags)
        noise = random.standard_normal((2, 6))
        bearing, distance = np.arctan2(d[:, 1], d[:, 0]) + 0.01 * noise[0], np.hypot(*d.T) + 0.05 * noise[1]
        frames.append(TagDetections(0.4 * i, np.arange(6), distance, bearing, np.full(6, 0.05), np.full(6, 0.01)))
        seen.append(np.column_stack([bearing, distance]))
        X_MB = se2.compose(X_MB, np.array([0.2, 0.0, 0.15]))
        X_OB = se2.compose(X_OB, np.array([0.2, 0.0, 0.15]) + 0.003 * random.standard_normal(3))
    run = smooth(tuple(odometry), tuple(frames), config)
    assert run.rejected == 0

    increments = [arc(a.X_OB, b.X_OB) for a, b in itertools.pairwise(odometry)]
    whiteners = [
        np.linalg.inv(np.linalg.cholesky(predict_increment(one, 0.4, np.zeros(3), random_walks(config))[2]))
        for one in increments
    ]

    def residual(x):
        poses, p_ML, calibration = np.vstack([np.zeros(3), x[:72].reshape(-1, 3)]), x[72:84].reshape(-1, 2), x[84:]
        rows = [calibration / calibration_sigma(config)]
        for i, (increment, whitener) in enumerate(zip(increments, whiteners, strict=True)):
            motion = predict_increment(increment, 0.4, calibration, random_walks(config))[0]
            # The logarithm of the error, as seen from the measured pose, turned back to where its noise is known.
            x, y, angle = se2.between(motion, se2.between(poses[i], poses[i + 1]))
            half = 0.5 * angle
            c = half / math.tan(half) if half else 1.0
            rows.append(whitener @ [*se2.rotation(motion[2]) @ [c * x + half * y, c * y - half * x], angle])
        for pose, z in zip(poses, seen, strict=True):
            d = se2.transform(se2.inverse(pose), p_ML)
            r = np.column_stack(
                [se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - z[:, 0]) / 0.01, (np.hypot(*d.T) - z[:, 1]) / 0.05]
            )
            length = np.linalg.norm(r, axis=1)
            huber = np.sqrt(2.0 * HUBER_SIGMAS * np.maximum(length, HUBER_SIGMAS) - HUBER_SIGMAS**2)
            rows.append((r * np.where(length > HUBER_SIGMAS, huber / length, 1.0)[:, None]).ravel())
        return np.concatenate(rows)

    found = np.concatenate([run.X_MB[1:].ravel(), run.p_ML.ravel(), run.calibration])
    dense = least_squares(residual, found + 1e-3 * random.standard_normal(87), xtol=1e-12, ftol=1e-12, gtol=1e-9)
    # GTSAM takes the Jacobian of a motion where its error is zero, and so ends a little beside the optimum.
    assert run.half_chi_square == pytest.approx(dense.cost, rel=1e-5)
    np.testing.assert_allclose(found, dense.x, atol=1e-4)

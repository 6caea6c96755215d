import dataclasses

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections
from tfg_drake.slam import localizer as localizer_module
from tfg_drake.slam import pose_filter
from tfg_drake.slam.goal_graph import empty_map
from tfg_drake.slam.localizer import start_localizer, step_localizer
from tfg_drake.slam.odometry_model import odometry_model, predict_increment

MODEL = odometry_model(OdometryConfig())


def make_map(n, seed, sigma=0.05):
    rng = np.random.default_rng(seed)
    root = sigma * rng.normal(size=(2 * n + 3, 2 * n + 3)) / np.sqrt(2 * n + 3) + 0.2 * sigma * np.eye(2 * n + 3)
    root[-1] *= 0.2
    truth = np.append(rng.uniform(-6.0, 6.0, 2 * n), [0.5, -0.3, 0.7])
    mean = truth + root @ rng.normal(size=2 * n + 3)
    estimate = dataclasses.replace(
        empty_map(), stage=1, ids=np.arange(n), p_ML=mean[:-3].reshape(-1, 2), X_MD=mean[-3:], covariance=root @ root.T
    )
    return estimate, truth[:-3].reshape(-1, 2), truth[-3:]


def sight(ids, points, X_WB, stamp, rng=None):
    p_BL = se2.transform(se2.inverse(X_WB), points)
    r, b = np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0])
    sigma_r, sigma_b = 0.02 + 0.01 * r, np.full(len(ids), 0.01)
    if rng is not None:
        r, b = r + sigma_r * rng.normal(size=len(ids)), b + sigma_b * rng.normal(size=len(ids))
    return TagDetections(stamp, np.asarray(ids), r, se2.wrap_angle(b), sigma_r, sigma_b)


def brute_force(x, P, considered, increment, dt, detections, rows):
    """Prediction and one update of the dense joint Gaussian over (pose, calibration, landmarks), the gain of the
    considered rows zero, in Joseph's form. rows: of each sighted tag."""
    X, on_calibration, Q = predict_increment(increment, dt, x[3:6], MODEL.noise)
    F = np.eye(len(x))
    R = np.eye(3)
    R[:2, :2] = se2.rotation(x[2])
    motion = R @ X
    F[:3, 2] = -motion[1], motion[0], 1.0
    F[:3, 3:6] = R @ on_calibration
    P = F @ P @ F.T
    P[:3, :3] += R @ Q @ R.T
    x = x.copy()
    x[:3] += motion
    H = np.zeros((2 * len(rows), len(x)))
    nu = np.zeros(2 * len(rows))
    for i, k in enumerate(rows):
        d = x[k : k + 2] - x[:2]
        r = np.hypot(*d)
        J = np.array([d / r, [-d[1] / r**2, d[0] / r**2]])
        H[2 * i : 2 * i + 2, :2], H[2 * i : 2 * i + 2, k : k + 2], H[2 * i + 1, 2] = -J, J, -1.0
        bearing = se2.wrap_angle(detections.bearing[i] - np.arctan2(d[1], d[0]) + x[2])
        nu[2 * i : 2 * i + 2] = detections.range[i] - r, bearing
    noise = np.diag(np.column_stack([detections.sigma_range, detections.sigma_bearing]).ravel() ** 2)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    K[considered] = 0.0
    joseph = np.eye(len(x)) - K @ H
    return x + K @ nu, joseph @ P @ joseph.T + K @ noise @ K.T


def look(localizer, frame):
    """One frame without motion."""
    return step_localizer(localizer, MODEL, np.zeros(3), 0.0, frame)


def test_equals_the_joint_gaussian_with_zero_gain_for_the_map():
    estimate, points, X_MB = make_map(6, 1)
    rng = np.random.default_rng(5)
    localizer = start_localizer(MODEL, estimate)
    extra = np.array([[2.0, 3.0], [-1.0, 4.0]])
    first = sight([40, 41], extra, X_MB, 0.0, rng)
    localizer = look(localizer, first)
    # The joint order here: pose, calibration, two local tags, map.
    core = len(localizer.mean)
    x = np.concatenate([localizer.mean, estimate.p_ML.ravel()])
    P = np.block([[localizer.covariance, localizer.cross], [localizer.cross.T, localizer.map_covariance]])
    assert np.linalg.eigvalsh(P).min() > 0.0
    increment, ids = np.array([0.05, 0.0, 0.03]), [0, 3, 40, 5, 41]
    for stamp in (0.1, 0.2, 0.3):
        X_MB = se2.compose(X_MB, predict_increment(increment, 0.1, np.zeros(3), np.zeros(3))[0])
        frame = sight(ids, np.vstack([points[[0, 3]], extra[:1], points[[5]], extra[1:]]), X_MB, stamp, rng)
        rows = [core, core + 6, 6, core + 10, 8]
        x, P = brute_force(x, P, slice(core, None), increment, 0.1, frame, rows)
        localizer = step_localizer(localizer, MODEL, increment, 0.1, frame)
        np.testing.assert_allclose(localizer.mean, x[:core], atol=1e-10)
        np.testing.assert_allclose(localizer.covariance, P[:core, :core], atol=1e-11)
        np.testing.assert_allclose(localizer.cross, P[:core, core:], atol=1e-11)
        np.testing.assert_array_equal(localizer.map_covariance, estimate.covariance[:-3, :-3])


def test_a_tag_joins_with_its_full_covariance():
    estimate, _, X_MB = make_map(3, 2)
    localizer = look(start_localizer(MODEL, estimate), sight([9], np.array([[3.0, 1.0]]), X_MB, 0.0))

    def place(pose, r, b):
        return pose[:2] + r * np.array([np.cos(pose[2] + b), np.sin(pose[2] + b)])

    p_BL = se2.transform(se2.inverse(X_MB), np.array([3.0, 1.0]))
    z = np.array([np.hypot(*p_BL), np.arctan2(p_BL[1], p_BL[0])])
    J = np.column_stack(
        [(place(estimate.X_MD + h, *z) - place(estimate.X_MD - h, *z)) / 2e-6 for h in 1e-6 * np.eye(3)]
    )
    J_z = np.column_stack(
        [(place(estimate.X_MD, *(z + h)) - place(estimate.X_MD, *(z - h))) / 2e-6 for h in 1e-6 * np.eye(2)]
    )
    noise = np.diag([0.02 + 0.01 * z[0], 0.01]) ** 2
    pose = localizer.covariance[:3, :3]
    np.testing.assert_allclose(localizer.covariance[6:, 6:], J @ pose @ J.T + J_z @ noise @ J_z.T, atol=1e-9)
    np.testing.assert_allclose(localizer.covariance[6:, :3], J @ pose, atol=1e-9)
    np.testing.assert_allclose(localizer.cross[6:], J @ localizer.cross[:3], atol=1e-9)


def test_a_gross_error_is_ignored():
    estimate, points, X_MB = make_map(5, 3)
    localizer = start_localizer(MODEL, estimate)
    frame = sight(np.arange(5), points, X_MB, 0.0)
    distance = frame.range.copy()
    distance[2] += 3.0
    others = np.array([0, 1, 3, 4])
    spoilt = look(localizer, dataclasses.replace(frame, range=distance))
    clean = look(localizer, sight(others, points[others], X_MB, 0.0))
    np.testing.assert_allclose(spoilt.mean, clean.mean, atol=1e-12)
    np.testing.assert_allclose(spoilt.covariance, clean.covariance, atol=1e-14)


def test_consistent_over_many_sightings_of_the_same_map(nees):
    values = []
    for seed in range(30):
        estimate, points, X_MB = make_map(10, seed)
        rng = np.random.default_rng(100 + seed)
        localizer = start_localizer(MODEL, estimate)
        for i in range(60):
            frame = sight(np.arange(10), points, X_MB, 0.1 * i, rng)
            localizer = step_localizer(localizer, MODEL, np.zeros(3), 0.1, frame)
        error = localizer.mean[:3] - X_MB
        error[2] = se2.wrap_angle(error[2])
        values.append(nees(error, localizer.covariance[:3, :3]))
    assert 0.6 < np.mean(values) < 1.4


def test_only_the_nearest_landmarks_and_the_latest_local_tags_are_kept(monkeypatch):
    monkeypatch.setattr(localizer_module, "WINDOW", 4)
    monkeypatch.setattr(localizer_module, "MOST_LOCAL", 2)
    estimate, _, X_MB = make_map(8, 4)
    localizer = start_localizer(MODEL, estimate)
    distance = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T)
    assert set(localizer.map_ids) == set(np.argsort(distance)[:4])
    rows = (2 * localizer.map_ids[:, None] + [0, 1]).ravel()
    np.testing.assert_array_equal(localizer.cross[:3], estimate.covariance[-3:, rows])
    for stamp, tag in ((0.0, 50), (0.1, 51), (0.2, 52)):
        frame = sight([tag], np.array([[2.0, tag - 50.0]]), X_MB, stamp)
        localizer = step_localizer(localizer, MODEL, np.zeros(3), 0.1, frame)
    np.testing.assert_array_equal(localizer.local_ids, [51, 52])


def test_before_the_first_map_it_stands_at_the_origin():
    localizer = start_localizer(MODEL, None)
    np.testing.assert_array_equal(localizer.mean[:3], np.zeros(3))
    np.testing.assert_array_equal(localizer.covariance[:3, :3], np.zeros((3, 3)))
    mean, covariance = pose_filter.predict_pose(localizer, MODEL, np.array([1.0, 0.0, 0.0]), 2.0)
    np.testing.assert_allclose(mean, [1.0, 0.0, 0.0])
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(0.015, 0.02), rel=0.02)

import dataclasses

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections
from tfg_drake.slam import pose_filter
from tfg_drake.slam.departure_frame import (
    covariance_in_departure_frame,
    covariance_with_departure,
    local_positions,
)
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.localizer import (
    MOST_LOCAL,
    localized_pose,
    new_tags,
    start_localizer,
    step_localizer,
)
from tfg_drake.slam.odometry_model import odometry_model, predict_increment

MODEL = odometry_model(OdometryConfig())


def make_map(n, seed, sigma=0.05):
    rng = np.random.default_rng(seed)
    root = sigma * rng.normal(size=(2 * n + 3, 2 * n + 3)) / np.sqrt(2 * n + 3) + 0.2 * sigma * np.eye(2 * n + 3)
    root[-1] *= 0.2
    truth = np.append(rng.uniform(-6.0, 6.0, 2 * n), [0.5, -0.3, 0.7])
    mean = truth + root @ rng.normal(size=2 * n + 3)
    estimate = dataclasses.replace(
        empty_map(), stage=1, ids=np.arange(n), p_ML=mean[:-3].reshape(-1, 2), X_MD=mean[-3:], local=np.arange(n),
        covariance=root @ root.T,
    )  # fmt: skip
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
    return step_localizer(localizer, MODEL, np.zeros(3), 0.0, frame)[0]


def in_departure_frame(estimate, rows):
    """p_DL (m, 2) of the landmarks in some rows (m,), and the covariance of (p_DL row by row, X_MD)."""
    entries, heading = estimate.local_entry[rows], float(estimate.X_MD[2])
    p_DL = local_positions(estimate)
    P = covariance_in_departure_frame(estimate.covariance, heading, p_DL, entries, entries)
    cross = covariance_with_departure(estimate.covariance, heading, p_DL, entries)
    return p_DL[entries], np.block([[P, cross], [cross.T, estimate.covariance[-3:, -3:]]])


def joint_covariance(filter_, estimate):
    """Of the state with the landmarks that the estimate knows jointly, row by row, and X_MD."""
    considered = in_departure_frame(estimate, estimate.local)[1]
    W = np.zeros((len(filter_.mean), len(considered)))
    W[:, np.repeat(2 * filter_.seen, 2) + np.tile([0, 1], len(filter_.seen))] = filter_.sensitivity
    cross = W @ considered
    return np.block([[filter_.covariance, cross], [cross.T, considered]])


def test_equals_the_joint_gaussian_with_zero_gain_for_the_map():
    estimate, points, X_MB = make_map(6, 1)
    rng = np.random.default_rng(5)
    localizer = start_localizer(MODEL, estimate)
    extra = np.array([[2.0, 3.0], [-1.0, 4.0]])
    first = sight([40, 41], extra, X_MB, 0.0, rng)
    filter_ = look(localizer, first).filter
    # The joint order here: pose, calibration, two local tags, map, X_MD.
    core = len(filter_.mean)
    x = np.concatenate([filter_.mean, filter_.p_DL.ravel(), localizer.X_MD])
    P = joint_covariance(filter_, estimate)
    increment, ids = np.array([0.05, 0.0, 0.03]), [0, 3, 40, 5, 41]
    for stamp in (0.1, 0.2, 0.3):
        X_MB = se2.compose(X_MB, predict_increment(increment, 0.1, np.zeros(3), np.zeros(3))[0])
        frame = sight(ids, np.vstack([points[[0, 3]], extra[:1], points[[5]], extra[1:]]), X_MB, stamp, rng)
        rows = [core, core + 6, 6, core + 10, 8]
        x, P = brute_force(x, P, slice(core, None), increment, 0.1, frame, rows)
        filter_, _, _ = pose_filter.step(filter_, MODEL, increment, 0.1, frame)
        np.testing.assert_allclose(filter_.mean, x[:core], atol=1e-10)
        np.testing.assert_allclose(joint_covariance(filter_, estimate), P, atol=1e-11)
    assert sorted(filter_.seen) == [0, 3, 5]


def test_a_tag_joins_with_its_full_covariance():
    estimate, _, X_MB = make_map(3, 2)
    filter_ = start_localizer(MODEL, estimate).filter
    rng = np.random.default_rng(3)
    root = 0.01 * rng.normal(size=(6, 6))
    pose = np.array([0.4, -0.2, 0.3])
    filter_ = dataclasses.replace(
        filter_,
        mean=np.concatenate([pose, np.zeros(3)]),
        covariance=root @ root.T,
        sensitivity=0.1 * rng.normal(size=(6, 4)),
        seen=np.array([2, 0]),
    )
    filter_, _, _ = pose_filter.step(filter_, MODEL, np.zeros(3), 0.0, sight([9], np.array([[3.0, 1.0]]), X_MB, 0.0))

    def place(pose, r, b):
        return pose[:2] + r * np.array([np.cos(pose[2] + b), np.sin(pose[2] + b)])

    p_BL = se2.transform(se2.inverse(X_MB), np.array([3.0, 1.0]))
    z = np.array([np.hypot(*p_BL), np.arctan2(p_BL[1], p_BL[0])])
    J = np.column_stack([(place(pose + h, *z) - place(pose - h, *z)) / 2e-6 for h in 1e-6 * np.eye(3)])
    J_z = np.column_stack([(place(pose, *(z + h)) - place(pose, *(z - h))) / 2e-6 for h in 1e-6 * np.eye(2)])
    noise = np.diag([0.02 + 0.01 * z[0], 0.01]) ** 2
    P = filter_.covariance
    np.testing.assert_allclose(P[6:, 6:], J @ P[:3, :3] @ J.T + J_z @ noise @ J_z.T, atol=1e-9)
    np.testing.assert_allclose(P[6:, :3], J @ P[:3, :3], atol=1e-9)
    np.testing.assert_allclose(filter_.sensitivity[6:], J @ filter_.sensitivity[:3], atol=1e-9)


def test_a_gross_error_is_ignored():
    estimate, points, X_MB = make_map(5, 3)
    localizer = start_localizer(MODEL, estimate)
    frame = sight(np.arange(5), points, X_MB, 0.0)
    distance = frame.range.copy()
    distance[2] += 3.0
    others = np.array([0, 1, 3, 4])
    spoilt = look(localizer, dataclasses.replace(frame, range=distance))
    clean = look(localizer, sight(others, points[others], X_MB, 0.0))
    np.testing.assert_allclose(spoilt.filter.mean, clean.filter.mean, atol=1e-12)
    np.testing.assert_allclose(spoilt.filter.covariance, clean.filter.covariance, atol=1e-14)


def test_consistent_over_many_sightings_of_the_same_map(nees):
    values = []
    for seed in range(30):
        estimate, points, X_MB = make_map(10, seed)
        rng = np.random.default_rng(100 + seed)
        localizer = start_localizer(MODEL, estimate)
        for i in range(60):
            frame = sight(np.arange(10), points, X_MB, 0.1 * i, rng)
            localizer, _, _ = step_localizer(localizer, MODEL, np.zeros(3), 0.1, frame)
        pose, covariance = localized_pose(localizer, MODEL, np.zeros(3), 0.0)
        error = pose - X_MB
        error[2] = se2.wrap_angle(error[2])
        values.append(nees(error, covariance))
    assert 0.6 < np.mean(values) < 1.4


def test_consistent_where_the_whole_map_is_uncertain_and_far_from_its_origin(nees):
    """100 m from the origin, the map turned about it by 0.05 rad, a drive past sharply known neighbours."""
    values = []
    rng = np.random.default_rng(0)
    for seed in range(20):
        estimate, points, X_MB = make_map(12, seed, sigma=0.01)
        X_WM = np.array([100.0, 0.0, 0.0])
        turned = np.array([0.0, 0.0, 0.05 * rng.normal()])
        X_MB, points = se2.compose(X_WM, X_MB), se2.transform(X_WM, points)
        X_WD = X_MB
        p_ML = se2.transform(turned, se2.transform(X_WM, estimate.p_ML))
        X_MD = se2.compose(turned, se2.compose(X_WM, estimate.X_MD))
        R = np.kron(np.eye(12), se2.rotation(turned[2]))
        R = np.block([[R, np.zeros((24, 3))], [np.zeros((3, 24)), np.eye(3)]])
        R[-3:-1, -3:-1] = se2.rotation(turned[2])
        lever = np.concatenate([np.column_stack([-p_ML[:, 1], p_ML[:, 0]]).ravel(), [-X_MD[1], X_MD[0], 1.0]])
        covariance = R @ estimate.covariance @ R.T + 0.05**2 * np.outer(lever, lever)
        localizer = start_localizer(MODEL, dataclasses.replace(estimate, p_ML=p_ML, X_MD=X_MD, covariance=covariance))
        increment = np.array([0.05, 0.0, 0.005])
        for i in range(100):
            X_MB = se2.compose(X_MB, predict_increment(increment, 0.1, np.zeros(3), np.zeros(3))[0])
            frame = sight(np.arange(12), points, X_MB, 0.1 * i, rng)
            noisy = increment + [0.0045, 0.0, 0.0016] * rng.normal(size=3)
            localizer, _, _ = step_localizer(localizer, MODEL, noisy, 0.1, frame)
        # Turned as one, far from the origin, no error in M is Gaussian; what the filter holds in D is.
        error = localizer.filter.mean[:3] - se2.between(X_WD, X_MB)
        error[2] = se2.wrap_angle(error[2])
        values.append(nees(error, localizer.filter.covariance[:3, :3]))
    assert 0.6 < np.mean(values) < 1.5


def test_the_map_seen_from_the_departure_pose():
    estimate, _, _ = make_map(5, 7, sigma=0.003)
    rng = np.random.default_rng(1)
    mean = np.concatenate([estimate.p_ML.ravel(), estimate.X_MD])
    samples = mean + rng.multivariate_normal(np.zeros(13), estimate.covariance, 20_000)
    rows = np.array([1, 4])
    seen = [
        np.concatenate([se2.transform(se2.inverse(x[-3:]), x[:-3].reshape(5, 2)[rows]).ravel(), x[-3:]])
        for x in samples
    ]
    p_DL, covariance = in_departure_frame(estimate, rows)
    np.testing.assert_allclose(p_DL.ravel(), np.mean(seen, axis=0)[:4], atol=1e-3)
    np.testing.assert_allclose(covariance, np.cov(np.transpose(seen)), atol=0.05 * np.abs(covariance).max())


def test_all_that_is_known_jointly_is_considered():
    estimate, _, _ = make_map(8, 4)
    localizer = start_localizer(MODEL, part_of(estimate, np.array([1, 2, 5, 7])))
    np.testing.assert_array_equal(localizer.filter.map_ids, [1, 2, 5, 7])
    p_ML = se2.transform(estimate.X_MD, localizer.filter.p_DL)
    np.testing.assert_allclose(p_ML, estimate.p_ML[localizer.filter.map_ids])


def test_of_many_new_tags_the_filter_keeps_the_latest():
    estimate, _, X_MB = make_map(8, 4)
    localizer = start_localizer(MODEL, estimate)
    for k, tag in enumerate(range(50, 100)):
        frame = sight([tag], np.array([[2.0, tag - 75.0]]), X_MB, 0.1 * k)
        localizer, _, _ = step_localizer(localizer, MODEL, np.zeros(3), 0.1, frame)
    np.testing.assert_array_equal(localizer.filter.local_ids, np.arange(100 - MOST_LOCAL, 100))
    p_MU = se2.transform(localizer.X_MD, localizer.filter.mean[pose_filter.CORE :].reshape(-1, 2))
    np.testing.assert_allclose(p_MU[:, 1], np.arange(100 - MOST_LOCAL, 100) - 75.0, atol=0.5)


def test_before_the_first_map_it_stands_at_the_origin():
    localizer = start_localizer(MODEL, None)
    pose, covariance = localized_pose(localizer, MODEL, np.zeros(3), 0.0)
    np.testing.assert_array_equal(pose, np.zeros(3))
    np.testing.assert_array_equal(covariance, np.zeros((3, 3)))
    mean, covariance = localized_pose(localizer, MODEL, np.array([1.0, 0.0, 0.0]), 2.0)
    np.testing.assert_allclose(mean, [1.0, 0.0, 0.0])
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(0.015, 0.02), rel=0.02)


def part_of(estimate, rows):
    """The estimate of a large map of which these rows are known jointly."""
    pose = len(estimate.covariance) - np.array([3, 2, 1])
    entries = np.concatenate([np.repeat(2 * rows, 2) + np.tile([0, 1], len(rows)), pose])
    return dataclasses.replace(estimate, local=rows, covariance=estimate.covariance[np.ix_(entries, entries)])


def test_nobody_looks_for_what_one_frame_saw():
    estimate, _, X_MB = make_map(8, 4)
    none, there = np.zeros(0, dtype=np.int64), np.array([20.0, 0.0])
    elsewhere = there + np.array([0.0, 3.0])

    def published(places):
        localizer = start_localizer(MODEL, estimate)
        for stamp, place in enumerate(places):
            seen = sight([50], place[None], X_MB, 0.1 * stamp)
            localizer, _, _ = step_localizer(localizer, MODEL, np.zeros(3), 0.1, seen)
        ids, p_MU = new_tags(localizer, none)
        return [] if not len(ids) else [there, elsewhere][int(np.hypot(*(p_MU[0] - there)) > 1.5)].tolist()

    assert published([there]) == []
    assert published([there, there]) == there.tolist()
    # What was seen elsewhere as often is forgotten.
    assert published([there, elsewhere]) == []
    assert published([there, elsewhere, elsewhere, elsewhere]) == elsewhere.tolist()

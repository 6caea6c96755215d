import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from tests.arrays import frozen
from tests.walls import no_walls
from tfg_drake.config import OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import replace
from tfg_drake.planning.chance_constraint import (
    BETWEEN_VIEWS,
    TRACKING_DEVIATION,
    collision_probability,
    deviation_along,
    localised_deviation,
    predicted_deviation,
    required_clearance,
)
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.graph import empty_map as empty_tfg

PARAMETERS = PlanningParameters(robot=RobotConfig(max_speed=0.5))


def deviation(targets, noise=(0.02, 0.01, 0.0, 0.01), covariance=None):
    """Of a robot at the origin that sees targets which face it, by their covariance, or as if they were exact."""
    targets = np.asarray(targets, dtype=float)
    n = len(targets)
    entry, errors = (np.full(n, -1), np.zeros((3, 3))) if covariance is None else (np.arange(n), covariance)
    views, facing = (np.array([0, n]), np.arange(n)), -targets / np.hypot(*targets.T)[:, None]
    given = frozen(targets), frozen(facing), 9.0, 1.2, np.array(noise) / 2.0, entry, frozen(errors)
    sigma, sees, knows = localised_deviation(np.zeros((1, 2)), *views, *given)
    assert (sees.tolist(), knows.tolist()) == ([n], [0 if covariance is None else n])
    return sigma[0]


@pytest.mark.parametrize("seed", range(5))
def test_deviation_is_the_inverse_information_with_heading_unknown(seed):
    targets = np.random.default_rng(seed).uniform(-5, 5, (4, 2))
    information = np.zeros((3, 3))
    for p in targets:
        r = np.linalg.norm(p)
        J = np.array([[-p[0] / r, -p[1] / r, 0], [p[1] / r**2, -p[0] / r**2, -1]])
        information += 4.0 * J.T @ np.diag([(0.02 + 0.01 * r) ** -2, 0.01**-2]) @ J
    worst = np.linalg.eigvalsh(np.linalg.inv(information)[:2, :2])[-1] ** 0.5
    assert deviation(targets) == pytest.approx(worst, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_an_uncertain_map_adds_what_the_robot_does_not_share_with_the_surface(seed):
    """Against samples: landmarks are drawn, the robot finds its place by linear least squares as if they were exact."""
    rng = np.random.default_rng(seed)
    targets = np.array([[1.0, 0.3], [-1.2, 2.0], [2.5, -3.0], [0.5, -2.0]])
    loose = rng.normal(0, 0.05, (8, 8))
    common = np.tile(np.eye(2), (4, 1))
    S = loose @ loose.T + 0.5 * common @ common.T
    r = np.linalg.norm(targets, axis=1)
    rows = []
    for (x, y), d in zip(targets, r, strict=True):
        rows += [np.array([-x / d, -y / d, 0]) / (0.02 + 0.01 * d), np.array([y / d**2, -x / d**2, -1]) / 0.01]
    K = 2.0 * np.array(rows)
    G = np.zeros((8, 8))
    for i in range(4):
        G[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = -K[2 * i : 2 * i + 2, :2]
    dL = rng.multivariate_normal(np.zeros(8), S, 200_000)
    seen = dL @ G.T + rng.normal(size=dL.shape)
    error = -np.linalg.lstsq(K, seen.T, rcond=None)[0][:2].T
    # The first landmark, the only one that is near enough, carries the surface.
    worst = np.linalg.eigvalsh(np.cov((error - dL[:, :2]).T))[-1] ** 0.5
    sigma = deviation(targets, covariance=S)
    assert sigma == pytest.approx(worst, rel=0.01)


@pytest.mark.parametrize(
    ("wall", "facing", "other", "counts"),
    [
        ((-5.0, 0.5, 5.0, 0.5), (0.0, -1.0), 1.0, False),
        ((-5.0, 1.0, 5.0, 1.0), (0.0, 1.0), 1.0, False),
        ((-5.0, 1.0, 5.0, 1.0), (0.0, 1.0), 3.0, True),
        ((-5.0, 1.0, 5.0, 1.0), (0.0, -1.0), 1.0, True),
        ((-5.0, 1.0, 5.0, 1.0), (0.99, -0.1), 1.0, True),
    ],
    ids=["behind a wall", "the other face", "and nothing else near", "on the wall", "seen slantwise"],
)
def test_only_surfaces_that_it_could_touch_have_to_be_known(wall, facing, other, counts):
    """The last landmark is 1 m off, and badly known, the last but one `other` metres off, and well known. The first,
    far away, is not known jointly with them, and another place sees that alone."""
    p_ML = np.array([[30.0, 0.0], [3.0, 0.0], [0.0, -3.0], [-other, 0.0], [0.0, 1.0]])
    estimate = replace(
        empty_map(),
        ids=np.arange(5),
        p_ML=p_ML,
        **no_walls(5),
        local=np.arange(1, 5),
        covariance=np.diag([1e-8] * 6 + [0.25] * 2 + [0.0] * 3),
    )
    towards = -p_ML / np.hypot(*p_ML.T)[:, None]
    tfg = replace(empty_tfg(), facing=np.vstack([towards[:4], facing]), segments=np.array([wall]))
    places = np.array([[29.0, 0.0], [0.0, 0.0]])
    # Seen too slantwise the last one is no help in finding the robot's place.
    sigma = predicted_deviation(places, estimate, tfg, PARAMETERS)
    assert (sigma[1] > 0.3) == counts
    assert sigma[1] < 0.05 or counts


def test_a_place_is_known_by_all_landmarks_in_view_where_only_a_few_are_known_jointly():
    p_ML = np.array([[3.0, 0.0], [3.1, 0.0], [0.0, 3.0], [-3.0, 0.0], [0.0, -3.0]])
    all_of_it = replace(
        empty_map(),
        ids=np.arange(5),
        p_ML=p_ML,
        **no_walls(5),
        local=np.arange(5),
        covariance=np.diag([1e-8] * 10 + [0.0] * 3),
    )
    two = replace(all_of_it, local=np.arange(2), covariance=np.diag([1e-8] * 4 + [0.0] * 3))
    tfg = replace(empty_tfg(), facing=-p_ML / np.hypot(*p_ML.T)[:, None])
    place = np.zeros((1, 2))

    def at_place(estimate, before):
        return predicted_deviation(place, estimate, tfg, PARAMETERS, np.array([before]))[0]

    sigma = at_place(all_of_it, 0.123)
    assert sigma < 0.05
    assert at_place(two, np.inf) == pytest.approx(sigma, rel=1e-3)
    # It is what it was when all were known.
    assert at_place(two, 0.123) == 0.123


def test_one_landmark_does_not_localise():
    assert deviation([[1, 0]]) == np.inf
    assert deviation([[1, 0], [0, 1]]) < 0.05


def test_required_clearance_keeps_the_collision_probability_between_two_surfaces():
    sigma = np.array([0.03, 0.1])
    need = required_clearance(0.18, sigma, 0.01)
    assert 2 * norm.cdf((0.18 - need) / sigma) == pytest.approx([0.01, 0.01])
    assert collision_probability(need, 0.18, sigma) == pytest.approx([0.01, 0.01])
    assert collision_probability(np.array([0.1]), 0.18, np.array([0.03])) == [1.0]


@pytest.mark.parametrize("noise", [0.02, 0.06, 0.2])
def test_what_odometry_adds_while_the_frames_come_counts_where_it_is_more_than_the_tracking(noise):
    p_ML = np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 0.0], [0.0, -3.0]])
    estimate = replace(empty_map(), ids=np.arange(4), p_ML=p_ML, **no_walls(4), covariance=np.zeros((3, 3)))
    tfg, place = replace(empty_tfg(), facing=-p_ML / 3.0), np.zeros((1, 2))
    sensor, odometry, speed = TagSensorConfig(), OdometryConfig(distance_noise=noise), 0.4
    parameters = dataclasses.replace(PARAMETERS, robot=RobotConfig(max_speed=speed), odometry=odometry)
    (sigma,) = predicted_deviation(place, estimate, tfg, parameters)
    frames = sensor.detection_probability * sensor.rate * sensor.field_of_view / (2 * np.pi)
    of_frame = np.array([sensor.range_noise, sensor.range_noise_per_metre, 0.0, sensor.bearing_noise])
    standing = deviation(p_ML, 2.0 * of_frame / np.sqrt(frames))
    Q = odometry_covariance(np.zeros(3), np.array([[speed, 0.0]]), np.array([speed]), np.ones(1), odometry)[0]
    assert sigma**2 - standing**2 == pytest.approx(max(TRACKING_DEVIATION**2, Q[0, 0], Q[1, 1]))
    assert (max(Q[0, 0], Q[1, 1]) > TRACKING_DEVIATION**2) == (noise > 0.02)


@pytest.mark.parametrize("turned", [0.0, np.pi])
def test_a_robot_goes_on_by_what_it_knew_where_it_has_too_little_in_view_ahead(turned):
    """Landmarks ahead of the start and beyond the end of a straight path, whichever way it runs; between them none."""
    p_ML = np.array([[3.0, 0.5], [3.0, -0.5], [5.0, 1.0], [13.0, 1.0], [13.0, -1.0]])
    R = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    estimate = replace(empty_map(), ids=np.arange(5), p_ML=p_ML @ R.T, **no_walls(5), covariance=np.zeros((3, 3)))
    tfg = replace(empty_tfg(), facing=np.tile(R @ [-1.0, 0.0], (5, 1)))
    path = np.stack([np.linspace(0.0, 11.0, 111), np.zeros(111)], axis=1) @ R.T
    sensor, odometry = TagSensorConfig(range=6.0), OdometryConfig()
    rest = estimate, tfg, dataclasses.replace(PARAMETERS, sensor=sensor)
    at_each = predicted_deviation(path, *rest)
    brute = np.empty(111)
    x = path @ R[:, 0]
    for k in range(111):
        best = np.inf
        for j in range(k + 1):
            d = p_ML - [x[j], 0.0]
            r, incidence = np.hypot(*d.T), np.arctan2(np.abs(d[:, 1]), d[:, 0])
            seen = (r < 6.0) & (incidence < sensor.max_incidence) & (incidence < 0.5 * sensor.field_of_view)
            if j == 0 or seen.sum() >= 2:
                way = np.array([x[k] - x[j]])
                Q = odometry_covariance(np.zeros(3), np.stack([way, 0 * way], axis=1), way, way / 0.5, odometry)[0]
                best = min(best, at_each[j] ** 2 + max(Q[0, 0], Q[1, 1]))
        brute[k] = np.sqrt(best)
    along = deviation_along(path, *rest)
    np.testing.assert_allclose(along, brute, rtol=1e-9)
    assert (along < at_each - 0.01).any()
    assert (along == at_each).any()


def test_a_robot_is_not_sure_of_its_place_by_what_is_behind_it():
    p_ML = np.array([[-1.0, 1.0], [-1.0, -1.0], [-2.0, 0.0]])
    estimate = replace(empty_map(), ids=np.arange(3), p_ML=p_ML, **no_walls(3), covariance=np.zeros((3, 3)))
    tfg = replace(empty_tfg(), facing=np.tile([1.0, 0.0], (3, 1)))
    path = np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1)
    rest = estimate, tfg, PARAMETERS
    at_each = predicted_deviation(path, *rest)
    drift = 0.02**2 * path[:, 0] + (0.015 * path[:, 0]) ** 2
    np.testing.assert_allclose(deviation_along(path, *rest) ** 2, at_each[0] ** 2 + drift, rtol=1e-9)
    # The way back to them it is.
    np.testing.assert_allclose(deviation_along(path[::-1].copy(), *rest)[-1], at_each[0], rtol=1e-9)


def test_out_of_sight_of_landmarks_the_deviation_grows_as_odometry_does_from_the_nearest_place_that_sees_some():
    p_ML = np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 0.0], [0.0, -3.0]])
    far = np.array([0.0, 200.0, 0.0])
    estimate = replace(empty_map(), ids=np.arange(4), p_ML=p_ML, **no_walls(4), X_MD=far, covariance=np.zeros((3, 3)))
    tfg = replace(empty_tfg(), facing=-p_ML / 3.0)
    points, odometry = np.array([[0.0, 0.0], [30.0, 0.0]]), OdometryConfig()
    sigma = predicted_deviation(points, estimate, tfg, PARAMETERS)
    Q = odometry_covariance(np.zeros(3), points[1:], np.array([30.0]), np.array([60.0]), odometry)[0]
    assert sigma[1] ** 2 - sigma[0] ** 2 == pytest.approx(max(Q[0, 0], Q[1, 1]))
    assert sigma[0] > 0.02
    # By walls it is told at the next view.
    by_walls = replace(estimate, by_walls=True)
    sigma_w = predicted_deviation(points, by_walls, tfg, PARAMETERS)
    Q = odometry_covariance(
        np.zeros(3), points[1:], np.array([BETWEEN_VIEWS]), np.array([2.0 * BETWEEN_VIEWS]), odometry
    )
    assert sigma_w[0] == sigma[0]
    assert sigma_w[1] ** 2 - sigma_w[0] ** 2 == pytest.approx(max(Q[0, 0, 0], Q[0, 1, 1]))

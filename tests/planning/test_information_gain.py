import dataclasses

import numpy as np
import pytest

from tests.arrays import frozen
from tests.walls import no_walls, walls_between
from tfg_drake.config import ExplorerConfig, OdometryConfig, TagSensorConfig
from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import WALLS_BELOW, replace
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain, share_seen
from tfg_drake.planning.expected_view import Visibility, targets
from tfg_drake.planning.information_gain import (
    PRIOR_LENGTH,
    Turns,
    density_shown,
    departure_given_landmarks,
    sightings_of_turn,
    turn_noise,
)
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.graph import empty_map as empty_tfg


def whitened(p_AL, noise):
    r = np.linalg.norm(p_AL)
    jacobian = np.array([[p_AL[0] / r, p_AL[1] / r], [-p_AL[1] / r**2, p_AL[0] / r**2]])
    return jacobian / np.array([[max(noise[0] + noise[1] * r, noise[2])], [noise[3]]])


def brute_force(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma, noise):
    """Log-determinant difference of the landmarks' marginal information, poses eliminated by Schur complements."""
    n, u = len(p_ML), int(sum(count))
    size = 2 * n + 2 * u
    information = np.zeros((size + 6, size + 6))  # landmarks, new landmarks, departure, arrival
    old = np.r_[0 : 2 * n, size : size + 3]
    information[np.ix_(old, old)] += np.linalg.inv(covariance)
    information[range(2 * n, size), range(2 * n, size)] += prior_sigma**-2
    F = np.eye(3)
    F[:2, 2] = [-(point[1] - X_MD[1]), point[0] - X_MD[0]]
    odometry = np.hstack([-F, np.eye(3)])
    information[size:, size:] += odometry.T @ np.linalg.inv(Q) @ odometry

    def marginal(matrix):
        return matrix[:size, :size] - matrix[:size, size:] @ np.linalg.solve(matrix[size:, size:], matrix[size:, :size])

    seen = [(2 * i, p_ML[i]) for i in known]
    seen += [(2 * n + 2 * k, p) for k, p in enumerate(np.repeat(p_MU, count.astype(int), axis=0))]
    after = information.copy()
    for column, p in seen:
        J = np.zeros((2, size + 6))
        J[:, column : column + 2] = whitened(p - point, noise)
        J[:, size + 3 : size + 5] = -J[:, column : column + 2]
        J[1, size + 5] = -1 / noise[3]
        after += J.T @ J
    return 0.5 * (np.linalg.slogdet(marginal(after))[1] - np.linalg.slogdet(marginal(information))[1])


def problem(seed, n=9, common=0.3):
    """Landmarks and a departure pose that move together by `common` metres, and by centimetres on their own."""
    rng = np.random.default_rng(seed)
    p_ML, X_MD = rng.uniform(-6, 6, (n, 2)), np.r_[rng.uniform(-2, 2, 2), rng.uniform(-3, 3)]
    together = np.zeros((2 * n + 3, 3))
    for i, p in enumerate([*p_ML, X_MD[:2]]):
        together[2 * i : 2 * i + 2] = [[1, 0, -p[1]], [0, 1, p[0]]]
    together[-1, 2] = 1
    loose = rng.normal(0, 0.02, (2 * n + 3, 2 * n + 3))
    loose[-1] *= 0.2
    covariance = common**2 * together @ np.diag([1, 1, 0.01]) @ together.T + loose @ loose.T + 1e-6 * np.eye(2 * n + 3)
    point = rng.uniform(-3, 3, 2)
    Q = odometry_covariance(X_MD, point[None], np.array([4.0]), np.array([9.0]), OdometryConfig())
    Q = Q + 1e-6 * np.eye(3)
    return rng, p_ML, X_MD, covariance, point, Q


def known_tags(rows, p_ML, S):
    """Known for one candidate that sees these rows of the tags p_ML (n, 2)."""
    as_they_are = np.arange(len(p_ML)), np.tile(np.eye(2), (len(p_ML), 1, 1)), np.zeros((len(p_ML), 2))
    return Known(np.array([0, len(rows)]), rows, p_ML, *as_they_are, S)


# A sensor range at which every frontier point counts in full, m.
SEE_ALL = 1e9


def problem_of(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma):
    """The kernels' arguments for one candidate that sees some of the landmarks and all new ones."""
    n = 2 * len(p_ML)
    S = covariance
    given = S[n:, n:] - S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:]) if n else S
    rows = np.asarray(known, dtype=np.int64)
    return (
        point[None],
        Arrival(frozen(X_MD), given, Q),
        known_tags(rows, p_ML, frozen(S)),
        New(np.array([0, len(p_MU)]), np.arange(len(p_MU)), frozen(p_MU), count, prior_sigma, np.array([SEE_ALL, 1.0])),
    )


def kernel(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma, noise):
    return exact_gain(*problem_of(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma), noise)[0]


NOISE = turn_noise(TagSensorConfig(), sightings_of_turn(TagSensorConfig(), 1.0))


@pytest.mark.parametrize(("distance", "share"), [(1.0, 1.0), (5.0, 1.0), (7.5, 0.5), (10.0, 0.0), (12.0, 0.0)])
def test_a_frontier_counts_by_the_depth_of_view_behind_it(distance, share):
    assert share_seen(distance, np.array([10.0, 5.0])) == pytest.approx(share)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("seen", "new"), [(5, 0), (5, 3), (0, 4), (1, 2), (0, 0)])
def test_gain_equals_brute_force(seed, seen, new):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    known = np.sort(rng.permutation(len(p_ML))[:seen])
    p_MU, count = rng.uniform(-8, 8, (new, 2)), rng.integers(1, 4, new).astype(float)
    exploitation, exploration, _ = kernel(point, Q, known, p_ML, X_MD, covariance, p_MU, count, 10.0, NOISE)
    arguments = (point, Q[0], known, p_ML, X_MD, covariance)
    assert exploitation == pytest.approx(brute_force(*arguments, p_MU[:0], count[:0], 10.0, NOISE), abs=1e-9)
    assert exploitation + exploration == pytest.approx(brute_force(*arguments, p_MU, count, 10.0, NOISE), abs=1e-9)


def test_pose_price_vanishes_with_a_known_pose_and_grows_with_its_uncertainty():
    rng, p_ML, X_MD, covariance, point, Q = problem(3)
    covariance = covariance.copy()
    covariance[-3:, :] = covariance[:, -3:] = 0.0
    p_MU, count = rng.uniform(-8, 8, (3, 2)), np.ones(3)
    prices = [
        kernel(point, scale * Q, range(9), p_ML, X_MD, covariance, p_MU, count, 10.0, NOISE)[2]
        for scale in (0.0, 0.01, 1.0, 100.0)
    ]
    assert prices[0] == pytest.approx(0.0, abs=1e-9)
    assert prices == sorted(prices)


def test_fractions_of_a_landmark_interpolate():
    rng, p_ML, X_MD, covariance, point, Q = problem(5)
    p_MU = rng.uniform(-8, 8, (1, 2))
    gains = [
        kernel(point, Q, [0, 1, 2], p_ML, X_MD, covariance, p_MU, np.array([count]), 10.0, NOISE)[1]
        for count in (0.0, 0.5, 1.0, 1.5, 2.0)
    ]
    assert gains[0] == pytest.approx(0.0, abs=1e-9)
    assert gains == sorted(gains)


def test_a_departure_given_the_landmarks_is_as_certain_as_what_it_does_not_share_with_them():
    shared = np.zeros((9, 2))
    shared[[0, 2, 4, 6], 0] = shared[[1, 3, 5, 7], 1] = 1.0
    S = shared @ shared.T + 1e-4 * np.eye(9)
    known, rows = no_walls(3), np.arange(3)
    estimate = replace(empty_map(), ids=rows, p_ML=np.zeros((3, 2)), **known, local=rows, covariance=S)
    np.testing.assert_allclose(departure_given_landmarks(estimate), np.linalg.inv(np.linalg.inv(S)[6:, 6:]), atol=1e-9)


def test_a_turn_sees_a_tag_as_often_as_it_is_detected_while_in_view():
    sensor = dataclasses.replace(TagSensorConfig(), detection_probability=0.5, rate=10.0, field_of_view=1.2)
    assert sightings_of_turn(sensor, 0.6) == pytest.approx(10.0)
    few, many = turn_noise(sensor, 4.0), turn_noise(sensor, 1e9)
    np.testing.assert_allclose(few, [0.01, 0.005, 0.01, 0.005])
    np.testing.assert_allclose(many[2:], [0.01, 0.002])


def room(seed, walls=True, tags=True):
    """A room of 8 x 6 m round the origin with a tag and a wall on every side but the west, as seen from inside, and a
    covariance by which all moves together, too."""
    rng, corners = np.random.default_rng(seed), np.array([[-4.0, -3], [4, -3], [4, 3], [-4, 3]])
    sides = np.stack([corners[:-1], corners[1:]], axis=1)  # seen from their left
    inwards = np.array([[0.0, 1], [-1, 0], [0, -1]])
    lines, anchor, reach = walls_between(sides[::-1])
    keep = np.append(np.full(3, walls), np.full(3, tags))
    ids, p_ML = np.append(WALLS_BELOW - 3 + np.arange(3), np.arange(3)), np.vstack([lines, sides.mean(axis=1)])
    anchor, reach = np.vstack([anchor, np.zeros((3, 2))]), np.vstack([reach, np.zeros((3, 2))])
    ids, p_ML, anchor, reach = ids[keep], p_ML[keep], anchor[keep], reach[keep]
    root = rng.normal(0, 0.02, (2 * len(ids) + 3, 2 * len(ids) + 3))
    root[-1] *= 0.2
    X_MD = np.append(rng.uniform(-1, 1, 2), 0.3)
    together = np.zeros((2 * len(ids) + 3, 3))
    for i, (p, a) in enumerate(zip([*p_ML, X_MD[:2]], [*anchor, np.zeros(2)], strict=True)):
        c, s = np.cos(p[0]), np.sin(p[0])
        of_wall = [[0, 0, 1], [c, s, s * a[0] - c * a[1]]]
        together[2 * i : 2 * i + 2] = of_wall if a.any() else [[1, 0, -p[1]], [0, 1, p[0]]]
    together[-1, 2] = 1
    covariance = root @ root.T + 0.09 * together @ np.diag([1, 1, 0.01]) @ together.T + 1e-6 * np.eye(len(root))
    landmarks = replace(
        empty_map(),
        stage=1,
        ids=ids,
        p_ML=p_ML,
        anchor=anchor,
        reach=reach,
        local=np.arange(len(ids)),
        covariance=covariance,
        X_MD=X_MD,
    )
    segments = np.hstack([corners, np.roll(corners, -1, axis=0)])[:3]
    facing = inwards if tags else np.zeros((0, 2))
    return landmarks, replace(empty_tfg(), stage=1, segments=segments, facing=facing)


def nothing_new(points):
    return Visibility(np.zeros(len(points) + 1, dtype=np.int64), np.zeros(0, dtype=np.int64))


def judge_of(landmarks, tfg, scan_range=10.0, **sensor):
    return Turns(landmarks, tfg, PlanningParameters(sensor=TagSensorConfig(**sensor), scan_range=scan_range))


def test_a_walls_normal_points_away_from_where_it_was_seen_and_corners_hide_none_of_its_points():
    landmarks, tfg = room(0)
    of = targets(landmarks, tfg)
    # Towards the middle of the room, and so long that the angle is most of what the looks share.
    assert (np.einsum("ij,ij->i", of.facing, of.p_MT) < 0.0).all()
    deviation = np.repeat(np.hypot(2e-3, 1e-3 * (np.array([4, 3, 4]) - 0.2)), 2)
    np.testing.assert_allclose(-of.normal[:6], of.facing[:6] / deviation[:, None])
    seen = judge_of(landmarks, tfg).seen(np.zeros((1, 2)))
    assert seen.index.tolist() == list(range(9))
    # The south wall is seen too aslant from near by; three ends of the others are out of range.
    seen = judge_of(landmarks, tfg, 6.0).seen(np.array([[0.0, -2.9]]))
    assert seen.index.tolist() == [2, 6, 7, 8]
    # A tag sensor that sees half as far leaves the walls alone.
    seen = judge_of(landmarks, tfg, range=3.5).seen(np.zeros((1, 2)))
    assert seen.index.tolist() == [0, 1, 2, 3, 4, 5, 6, 8]
    # What stands before the east wall hides it.
    before = replace(tfg, segments=np.vstack([tfg.segments, [[3.0, -2.2, 3.0, 2.2]]]))
    seen = judge_of(landmarks, before).seen(np.zeros((1, 2)))
    assert seen.index.tolist() == [0, 1, 4, 5, 6, 8]
    seen = judge_of(landmarks, replace(tfg, segments=np.zeros((0, 4)))).seen(np.array([[4.5, 0.0]]))
    assert seen.index.tolist() == [0, 1, 4, 5, 6, 8]


def test_each_of_many_points_sees_what_it_sees_alone():
    judge = judge_of(*room(0), 6.0, range=5.0)
    points = np.random.default_rng(0).uniform([-3.5, -2.7], [5.0, 2.7], (20, 2))
    seen = judge.seen(points)
    for i, point in enumerate(points):
        assert seen.of(np.array([i])).index.tolist() == judge.seen(point[None]).index.tolist()
    assert set(seen.index) == set(range(9))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("tags", [True, False])
def test_walls_and_tags_bring_the_mutual_information_of_their_joint_gaussian(seed, tags):
    landmarks, tfg = room(seed, tags=tags)
    judge, point = judge_of(landmarks, tfg), np.array([[1.0, -0.5]])
    arrival = judge.arrival(point, np.array([4.0]), np.array([9.0]))
    seen = judge.seen(point)
    of = judge.targets
    assert len(seen.index) == len(of.entry) == 6 + 3 * tags
    n, noise = 2 * len(landmarks.ids), judge.noise

    # The Gaussian of landmarks and arrival pose, and the measurements' Jacobian by differences.
    F = np.eye(n + 3)
    F[n : n + 2, -1] = [landmarks.X_MD[1] - point[0, 1], point[0, 0] - landmarks.X_MD[0]]
    S = F @ landmarks.covariance @ F.T
    S[n:, n:] += arrival.odometry[0]

    def measured(state):
        p, x, R = state[:n].reshape(-1, 2), state[n : n + 2], rotation(state[-1])
        z = []
        for t in seen.index:
            i = of.entry[t]
            if landmarks.ids[i] < WALLS_BELOW:
                n_M, along = np.array([np.cos(p[i, 0]), np.sin(p[i, 0])]), np.array([-np.sin(p[i, 0]), np.cos(p[i, 0])])
                at = (of.p_MT[t] - landmarks.anchor[i]) @ [-of.normal[t, 1], of.normal[t, 0]] / np.hypot(*of.normal[t])
                z.append(of.normal[t] @ R.T @ (landmarks.anchor[i] + p[i, 1] * n_M + at * along - x))
            else:
                p_B = R.T @ (p[i] - x)
                r = np.hypot(*p_B)
                z += [r / max(noise[0] + noise[1] * r, noise[2]), np.arctan2(p_B[1], p_B[0]) / noise[3]]
        return np.array(z)

    at = np.concatenate([landmarks.p_ML.ravel(), point[0], [0.0]])
    J = np.column_stack([(measured(at + d) - measured(at - d)) / 2e-6 for d in 1e-6 * np.eye(n + 3)])
    # The noise of a range is that at its mean: only the numerator varies.
    for k, i in enumerate(np.flatnonzero(landmarks.ids >= 0)):
        d = landmarks.p_ML[i] - point[0]
        row = of.of_walls + 2 * k
        J[row] = 0.0
        J[row, 2 * i : 2 * i + 2] = whitened(d, noise)[0]
        J[row, n : n + 2] = -whitened(d, noise)[0]
    S_x_given_L = S[n:, n:] - S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:])
    of_both, of_pose = J @ S @ J.T, J[:, n:] @ S_x_given_L @ J[:, n:].T
    expected = 0.5 * (np.linalg.slogdet(np.eye(len(J)) + of_both)[1] - np.linalg.slogdet(np.eye(len(J)) + of_pose)[1])

    gains = judge.gains(point, arrival, seen, nothing_new(point))
    assert gains.exploitation[0] == pytest.approx(expected, rel=1e-5)
    price_free = 0.5 * np.linalg.slogdet(np.eye(len(J)) + J[:, :n] @ S[:n, :n] @ J[:, :n].T)[1]
    assert gains.pose_price[0] == pytest.approx(price_free - expected, rel=1e-4)


def test_walls_are_worth_something_beside_tags():
    (both, tfg), (tags, _) = room(1), room(1, walls=False)
    point = np.array([[1.0, -0.5]])
    found = []
    for landmarks in (tags, both):
        judge = judge_of(landmarks, tfg)
        seen = judge.seen(point)
        arrival = judge.arrival(point, np.array([4.0]), np.array([9.0]))
        found.append(judge.gains(point, arrival, seen, nothing_new(point)).exploitation[0])
    assert found[1] > found[0] + 1.0


def test_new_landmarks_are_as_dense_as_the_building_has_shown():
    explorer, (tags, tfg) = ExplorerConfig(density=0.7), room(0, walls=False)
    tfg = replace(tfg, inspected=12.0)
    assert density_shown(tags, tfg, explorer) == 0.7
    both, walls = room(0)[0], room(0, tags=False)[0]
    # 22 m of surface, of which 12 m were inspected.
    of_walls, prior = 3 / (22.0 + PRIOR_LENGTH), 0.7 * PRIOR_LENGTH
    assert density_shown(both, tfg, explorer) == pytest.approx((3 + prior) / (12.0 + PRIOR_LENGTH) + of_walls)
    assert density_shown(walls, tfg, explorer) == pytest.approx(prior / (12.0 + PRIOR_LENGTH) + of_walls)
    # What nobody has inspected tells nothing of tags.
    assert density_shown(walls, replace(tfg, inspected=0.0), explorer) == pytest.approx(0.7 + of_walls)
    # In a large building without tags walls alone are left.
    assert density_shown(walls, replace(tfg, inspected=1e6), explorer) == pytest.approx(of_walls, abs=1e-4)

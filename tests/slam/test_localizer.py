"""The filter between views against a filter that carries everything jointly."""

import numpy as np
import pytest

from tests.slam.oracle import NOISE, PRIOR, SIGMA, WALKS, Drive, measured
from tests.slam.rings import NOTHING
from tests.slam.test_scan_lines import ANGLES, CONFIG, WALLS
from tests.walls import no_walls, walls_between
from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, TagDetections, replace
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map
from tfg_drake.slam.localizer import (
    MOST_LOCAL,
    corrected_by_walls,
    localized_pose,
    new_tags,
    placed_localizer,
    start_localizer,
    step_localizer,
    without_local,
)
from tfg_drake.slam.map_update import finished, updated
from tfg_drake.slam.odometry_model import arc, predict_increment
from tfg_drake.slam.scan_lines import scan_lines
from tfg_drake.slam.shared import LEAST_SIGMA, SHARED, exactly_known
from tfg_drake.slam.turn import reduced
from tfg_drake.slam.walls import FLOOR
from tfg_drake.slam.walls import no_walls as no_walls_yet

STANDING = np.zeros(2)


def make_map(n, seed, sigma=0.05, of_shared=None):
    """A map of n tags whose errors are correlated with each other, D's and the parameters', of deviations of_shared
    (8,), its tags and D in truth, and the parameters in truth."""
    rng = np.random.default_rng(seed)
    size = 2 * n + 3
    root = sigma * rng.normal(size=(size, size)) / np.sqrt(size) + 0.2 * sigma * np.eye(size)
    root[-1] *= 0.2
    shared_root = np.diag(np.full(SHARED, LEAST_SIGMA) if of_shared is None else of_shared)
    whole = np.zeros((size + SHARED, size + SHARED))
    whole[:size, :size], whole[size:, size:] = root, shared_root
    if of_shared is not None:
        whole[:size, size:] = 0.3 * sigma * rng.normal(size=(size, SHARED)) / np.sqrt(SHARED)
        whole[size - 1, size:] *= 0.2
    truth = np.concatenate([rng.uniform(-6.0, 6.0, 2 * n), [0.5, -0.3, 0.7], np.zeros(SHARED)])
    mean = truth + whole @ rng.normal(size=size + SHARED)
    P = whole @ whole.T
    estimate = replace(
        empty_map(), stage=1, ids=np.arange(n), p_ML=mean[: 2 * n].reshape(-1, 2), X_MD=mean[2 * n : size],
        local=np.arange(n), covariance=P[:size, :size], shared=mean[size:], with_shared=P[:, size:], **no_walls(n),
    )  # fmt: skip
    return estimate, truth[: 2 * n].reshape(-1, 2), truth[2 * n : size]


def sight(ids, points, X_WB, stamp, rng=None, shared=None, twist=STANDING):
    n = len(ids)
    shared = np.zeros(SHARED) if shared is None else shared
    r, b = measured(np.tile(X_WB, (n, 1)), points, shared, np.tile(twist, (n, 1))).T
    sigma_r, sigma_b = 0.02 + 0.01 * r, np.full(n, 0.01)
    if rng is not None:
        r, b = r + sigma_r * rng.normal(size=n), b + sigma_b * rng.normal(size=n)
    return TagDetections(stamp, np.asarray(ids), r, se2.wrap_angle(b), sigma_r, sigma_b)


class Joint:
    """The dense Gaussian of (pose in D, local tags in D, parameters, landmarks in D, X_MD), whose considered part has
    no gain; Jacobians are differences.

    It carries all of it as one covariance, in Joseph's form.
    """

    def __init__(self, estimate):
        n = len(estimate.ids)
        x = np.concatenate([estimate.p_ML.ravel(), estimate.X_MD, estimate.shared])

        def in_D(x):
            X_MD = x[2 * n : 2 * n + 3]
            p_DL = se2.transform(se2.inverse(X_MD), x[: 2 * n].reshape(-1, 2))
            return np.concatenate([np.zeros(3), x[2 * n + 3 :], p_DL.ravel(), X_MD])

        J = differences(in_D, x)
        self.x, self.P, self.local = in_D(x), J @ estimate.joint_covariance @ J.T, {}

    @property
    def shared(self):
        """First column of the parameters."""
        return 3 + 2 * len(self.local)

    def predict(self, increment, dt):
        shared = self.shared

        def moved(x):
            motion = predict_increment(increment, dt, x[shared : shared + 3], WALKS)[0]
            return np.concatenate([se2.compose(x[:3], motion), x[3:]])

        F = differences(moved, self.x)
        Q = predict_increment(increment, dt, self.x[shared : shared + 3], WALKS)[2]
        R = np.eye(3)
        R[:2, :2] = se2.rotation(self.x[2])
        self.x, self.P = moved(self.x), F @ self.P @ F.T
        self.P[:3, :3] += R @ Q @ R.T

    def look(self, frame, twist, offset):
        """Correct by the tags that are known, add the others."""
        known = [k for k, tag in enumerate(frame.ids) if tag < 40 or tag in self.local]
        self._correct(frame, known, twist, offset)
        for k in np.setdiff1d(np.arange(len(frame.ids)), known):
            self._add(frame, k, twist, offset)

    def _place(self, tag):
        return 3 + 2 * self.local[tag] if tag in self.local else self.shared + SHARED + 2 * tag

    def _correct(self, frame, known, twist, offset):
        rows = np.array([self._place(int(tag)) for tag in frame.ids[known]])
        twists = np.tile(twist, (len(rows), 1))
        late = np.zeros(SHARED)
        late[6] = offset

        def seen(x):
            points = np.column_stack([x[rows], x[rows + 1]])
            shared = x[self.shared : self.shared + SHARED] - late
            return measured(np.tile(x[:3], (len(rows), 1)), points, shared, twists).ravel()

        nu = np.column_stack([frame.range[known], frame.bearing[known]]).ravel() - seen(self.x)
        nu[1::2] = se2.wrap_angle(nu[1::2])
        H = differences(seen, self.x)
        noise = np.diag(np.column_stack([frame.sigma_range[known], frame.sigma_bearing[known]]).ravel() ** 2)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + noise)
        K[self.shared :] = 0.0
        joseph = np.eye(len(self.x)) - K @ H
        self.x, self.P = self.x + K @ nu, joseph @ self.P @ joseph.T + K @ noise @ K.T

    def _add(self, frame, k, twist, offset):
        shared, z = self.shared, np.array([frame.range[k], frame.bearing[k]])

        def with_tag(x, z):
            yaw, ahead, aside, clock, scale = x[shared + np.array([3, 4, 5, 6, 7])]
            clock = clock - offset
            angle = x[2] + z[1] + yaw - clock * twist[1]
            lever = se2.rotation(x[2]) @ [ahead - clock * twist[0], aside]
            p = x[:2] + lever + z[0] / (1.0 + scale) * np.array([np.cos(angle), np.sin(angle)])
            return np.concatenate([x[:shared], p, x[shared:]])

        G, G_z = differences(lambda x: with_tag(x, z), self.x), differences(lambda z: with_tag(self.x, z), z)
        self.x = with_tag(self.x, z)
        noise = np.diag([frame.sigma_range[k], frame.sigma_bearing[k]]) ** 2
        self.P = G @ self.P @ G.T + G_z @ noise @ G_z.T
        self.local[int(frame.ids[k])] = len(self.local)

    def pose(self):
        """X_MB and its covariance."""

        def in_M(x):
            return se2.compose(x[-3:], x[:3])

        J = differences(in_M, self.x)
        return in_M(self.x), J @ self.P @ J.T


def differences(function, x):
    """The Jacobian of a function at x (n,), by differences."""
    return np.column_stack([(function(x + h) - function(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))])


def look(localizer, frame):
    """One frame without motion."""
    return step_localizer(localizer, (np.zeros(3), 0.0, WALKS), frame, (STANDING, 0.0))[0]


def test_it_is_the_joint_gaussian_with_zero_gain_for_map_and_parameters():
    estimate, points, X_MB = make_map(6, 1, of_shared=SIGMA)
    rng, truth = np.random.default_rng(5), 0.5 * SIGMA
    localizer, joint = start_localizer(estimate), Joint(estimate)
    extra = np.array([[2.0, 3.0], [-1.0, 4.0]])
    increment, ids, twist, offset = np.array([0.05, 0.0, 0.03]), [0, 3, 40, 5, 41], np.array([0.5, 0.3]), 0.01
    for stamp in (0.0, 0.1, 0.2, 0.3):
        X_MB = se2.compose(X_MB, predict_increment(increment, 0.1, np.zeros(3), np.zeros(3))[0])
        there = np.vstack([points[[0, 3]], extra[:1], points[[5]], extra[1:]])
        frame = sight(ids, there, X_MB, stamp, rng, truth, twist)
        joint.predict(increment, 0.1)
        joint.look(frame, twist, offset)
        localizer, known, ignored = step_localizer(localizer, (increment, 0.1, WALKS), frame, (twist, offset))
        assert (known, ignored) == (5 if stamp else 3, 0)
        size = 3 + 2 * len(joint.local)
        np.testing.assert_allclose(localizer.mean, joint.x[:size], atol=1e-8)
        deviation = np.sqrt(np.diag(joint.P))[:size]
        np.testing.assert_allclose(
            localizer.covariance / np.outer(deviation, deviation),
            joint.P[:size, :size] / np.outer(deviation, deviation),
            atol=1e-6,
        )
        (X, P), (expected, of_joint) = localized_pose(localizer, WALKS, np.zeros(3), 0.0), joint.pose()
        np.testing.assert_allclose(X, expected, atol=1e-8)
        np.testing.assert_allclose(P, of_joint, atol=1e-6 * np.abs(of_joint).max())
        # Landmarks and parameters are as they were.
        assert localizer.map is estimate
    assert sorted(localizer.seen) == [0, 3, 5]
    # And a step of odometry beyond.
    joint.predict(increment, 0.1)
    X, P = localized_pose(localizer, WALKS, increment, 0.1)
    np.testing.assert_allclose(X, joint.pose()[0], atol=1e-8)
    np.testing.assert_allclose(P, joint.pose()[1], atol=1e-6 * np.abs(joint.pose()[1]).max())


def test_what_it_considers_it_never_learns():
    """However often it sees tags, the pose remains as uncertain as these and the parameters make it."""
    estimate, points, X_MB = make_map(4, 8, of_shared=SIGMA)
    frame = sight(np.arange(4), points, X_MB, 0.0)
    localizer = placed_localizer(estimate, no_walls_yet(), X_MB, np.array([1.0, 1.0, 0.5]))
    for k in range(300):
        localizer, _, _ = step_localizer(localizer, (np.zeros(3), 0.0, WALKS), frame, (STANDING, 0.0))
        if k == 100:
            after = localized_pose(localizer, WALKS, np.zeros(3), 0.0)[1]
    covariance = localized_pose(localizer, WALKS, np.zeros(3), 0.0)[1]
    np.testing.assert_allclose(np.diag(covariance), np.diag(after), rtol=0.02)
    assert covariance[2, 2] > 0.5 * SIGMA[3] ** 2
    np.testing.assert_array_equal(localizer.considered[:SHARED, :SHARED], estimate.with_shared[-SHARED:])


def test_a_gross_error_is_ignored():
    estimate, points, X_MB = make_map(5, 3)
    localizer = start_localizer(estimate)
    frame = sight(np.arange(5), points, X_MB, 0.0)
    distance = frame.range.copy()
    distance[2] += 3.0
    others = np.array([0, 1, 3, 4])
    spoilt = look(localizer, replace(frame, range=distance))
    clean = look(localizer, sight(others, points[others], X_MB, 0.0))
    np.testing.assert_allclose(spoilt.mean, clean.mean, atol=1e-12)
    np.testing.assert_allclose(spoilt.covariance, clean.covariance, atol=1e-14)


def test_consistent_over_many_sightings_of_the_same_map(nees):
    values = []
    for seed in range(30):
        estimate, points, X_MB = make_map(10, seed)
        rng = np.random.default_rng(100 + seed)
        localizer = start_localizer(estimate)
        for i in range(60):
            frame = sight(np.arange(10), points, X_MB, 0.1 * i, rng)
            localizer, _, _ = step_localizer(localizer, (np.zeros(3), 0.1, WALKS), frame, (STANDING, 0.0))
        pose, covariance = localized_pose(localizer, WALKS, np.zeros(3), 0.0)
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
        with_shared = np.vstack([np.zeros((27, SHARED)), estimate.with_shared[-SHARED:]])
        there = replace(estimate, p_ML=p_ML, X_MD=X_MD, covariance=covariance, with_shared=with_shared)
        localizer = start_localizer(there)
        increment = np.array([0.05, 0.0, 0.005])
        for i in range(100):
            X_MB = se2.compose(X_MB, predict_increment(increment, 0.1, np.zeros(3), np.zeros(3))[0])
            frame = sight(np.arange(12), points, X_MB, 0.1 * i, rng)
            noisy = increment + [0.0045, 0.0, 0.0016] * rng.normal(size=3)
            localizer, _, _ = step_localizer(localizer, (noisy, 0.1, WALKS), frame, (STANDING, 0.0))
        # Turned as one, far from the origin, no error in M is Gaussian; what the filter holds in D is.
        error = localizer.mean[:3] - se2.between(X_WD, X_MB)
        error[2] = se2.wrap_angle(error[2])
        values.append(nees(error, localizer.covariance[:3, :3]))
    assert 0.6 < np.mean(values) < 1.5


def test_all_that_is_known_jointly_is_considered():
    estimate, points, X_MB = make_map(8, 4)
    localizer = start_localizer(part_of(estimate, np.array([1, 2, 5, 7])))
    rows = np.array([1, 2, 5, 7])
    localizer = look(localizer, sight(rows, points[rows], X_MB, 0.0))
    np.testing.assert_array_equal(localizer.map.local[localizer.seen], rows)
    np.testing.assert_allclose(se2.transform(estimate.X_MD, localizer.p_DL), estimate.p_ML[rows])
    # Another is a tag met on the way.
    localizer = look(localizer, sight([3], points[[3]], X_MB, 0.1))
    np.testing.assert_array_equal(localizer.local_ids, [3])
    assert len(without_local(localizer).mean) == 3


def test_of_many_new_tags_the_filter_keeps_the_latest():
    estimate, _, X_MB = make_map(8, 4)
    localizer = start_localizer(estimate)
    for k, tag in enumerate(range(50, 100)):
        frame = sight([tag], np.array([[2.0, tag - 75.0]]), X_MB, 0.1 * k)
        localizer, _, _ = step_localizer(localizer, (np.zeros(3), 0.1, WALKS), frame, (STANDING, 0.0))
    np.testing.assert_array_equal(localizer.local_ids, np.arange(100 - MOST_LOCAL, 100))
    p_MU = se2.transform(localizer.map.X_MD, localizer.mean[3:].reshape(-1, 2))
    np.testing.assert_allclose(p_MU[:, 1], np.arange(100 - MOST_LOCAL, 100) - 75.0, atol=0.5)


def test_before_the_first_map_it_stands_at_the_origin():
    sheet = SIGMA * (np.arange(SHARED) < 3)
    localizer = start_localizer(empty_map(exactly_known(sheet)))
    pose, covariance = localized_pose(localizer, WALKS, np.zeros(3), 0.0)
    np.testing.assert_array_equal(pose, np.zeros(3))
    np.testing.assert_array_equal(covariance, np.zeros((3, 3)))
    mean, covariance = localized_pose(localizer, WALKS, np.array([1.0, 0.0, 0.0]), 2.0)
    np.testing.assert_allclose(mean, [1.0, 0.0, 0.0])
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(0.015, 0.02), rel=0.02)


def part_of(estimate, rows):
    """The estimate of a large map of which these rows are known jointly."""
    pose = len(estimate.covariance) - np.array([3, 2, 1])
    entries = np.concatenate([np.repeat(2 * rows, 2) + np.tile([0, 1], len(rows)), pose])
    with_shared = np.vstack([estimate.with_shared[entries], estimate.with_shared[-SHARED:]])
    covariance = estimate.covariance[np.ix_(entries, entries)]
    return replace(estimate, local=rows, covariance=covariance, with_shared=with_shared)


def test_nobody_looks_for_what_one_frame_saw():
    estimate, _, X_MB = make_map(8, 4)
    none, there = np.zeros(0, dtype=np.int64), np.array([20.0, 0.0])
    elsewhere = there + np.array([0.0, 3.0])

    def published(places):
        localizer = start_localizer(estimate)
        for stamp, place in enumerate(places):
            seen = sight([50], place[None], X_MB, 0.1 * stamp)
            localizer, _, _ = step_localizer(localizer, (np.zeros(3), 0.1, WALKS), seen, (STANDING, 0.0))
        ids, p_MU = new_tags(localizer, none)
        return [] if not len(ids) else [there, elsewhere][int(np.hypot(*(p_MU[0] - there)) > 1.5)].tolist()

    assert published([there]) == []
    assert published([there, there]) == there.tolist()
    # What was seen elsewhere as often is forgotten.
    assert published([there, elsewhere]) == []
    assert published([there, elsewhere, elsewhere, elsewhere]) == elsewhere.tolist()


def test_consistent_on_drives_with_all_parameters_off(nees):
    """Poses after legs of a drive, by the map that turns before have made."""
    values, outside = [], 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        robot = Drive(rng.uniform(-8.0, 8.0, (30, 2)), SIGMA * rng.normal(size=SHARED), seed)
        graph, estimate = empty_graph(PRIOR), empty_map(PRIOR)
        for leg in (None, (0.4, 0.1, 4.0), (0.4, -0.3, 5.0)):
            twist = np.array(leg[:2]) if leg else np.zeros(2)
            pieces = robot.piece(*leg) if leg else robot.piece(0.0, 0.6, 10.5)
            if leg:
                localizer, last = start_localizer(estimate), pieces[0]
                for frame in pieces[1]:
                    increment, dt = arc(last.X_OB, frame.X_OB), frame.clock - last.clock
                    localizer, _, ignored = step_localizer(
                        localizer, (increment, dt, WALKS), frame.detections, (twist, 0.0)
                    )
                    outside += ignored
                    last = frame
                X, P = localized_pose(localizer, WALKS, np.zeros(3), 0.0)
                error = X - robot.X_MB
                error[2] = se2.wrap_angle(error[2])
                values.append(nees(error, P))
            graph, estimate, _ = updated(graph, estimate, reduced(NOISE, pieces, graph.shared).keyframe)
            graph, estimate = finished(graph, estimate, 0.0, NOTHING)
    # The mean of 32 times three squares, correlated in pairs.
    assert 0.6 < np.mean(values) < 1.5
    # One sighting in 270 000 is outside its gate, of some 15 000.
    assert outside <= 1


def among_walls(sigma):
    """A map of the walls of a room, which are where they are, and D, known jointly to some sigma; the lines that a
    scan sees, and from where in M, X_MB (3,)."""
    rng, X_MD = np.random.default_rng(9), np.array([-1.0, -1.0, 0.3])
    walls, anchor, reach = walls_between(WALLS[:5].reshape(-1, 2, 2))
    size = 2 * len(walls) + 3 + SHARED
    root = sigma * rng.normal(size=(size, size))
    P = root @ root.T / size
    estimate = replace(
        empty_map(), stage=1, ids=WALLS_BELOW - len(walls) + np.arange(len(walls)), p_ML=walls, anchor=anchor,
        reach=reach, X_MD=X_MD, local=np.arange(len(walls)), covariance=P[:-SHARED, :-SHARED],
        shared=np.zeros(SHARED), with_shared=P[:, -SHARED:],
    )  # fmt: skip
    X_MB = se2.compose(X_MD, np.array([0.4, 0.1, 0.5]))
    return estimate, scan_lines(scan(WALLS, X_MB, 0.0, ANGLES, np.zeros(len(ANGLES)), CONFIG)), X_MB


def test_walls_put_the_robot_where_it_is():
    estimate, lines, X_MB = among_walls(0.0)
    off = np.array([0.06, -0.04, 0.02])
    localizer = placed_localizer(estimate, no_walls_yet(), se2.compose(X_MB, off), np.array([0.1, 0.1, 0.05]))
    for _ in range(2):
        localizer, told, contradicted = corrected_by_walls(localizer, lines, STANDING, np.zeros(2))
        assert (told, contradicted) == (len(lines), 0)
    assert len(localizer.seen) >= 2
    X, P = localized_pose(localizer, WALKS, np.zeros(3), 0.0)
    np.testing.assert_allclose(se2.between(X_MB, X), 0.0, atol=1e-3)
    # No better than the floor, which all looks at a wall share.
    assert (np.sqrt(np.diag(P)) > 0.5 * FLOOR.min()).all()
    assert (np.sqrt(np.diag(P)) < [0.01, 0.01, 0.004]).all()


def test_what_it_considers_of_walls_is_what_the_map_knows_of_them_seen_from_the_departure():
    estimate, lines, X_MB = among_walls(0.02)
    floor, s = 2.0, len(estimate.ids)
    walls = replace(no_walls_yet(), floor=floor)
    localizer = placed_localizer(estimate, walls, X_MB, np.array([0.1, 0.1, 0.05]))
    localizer, _, _ = corrected_by_walls(localizer, lines, STANDING, np.zeros(2))
    seen = localizer.seen
    assert len(seen) >= 2
    p_DC = se2.transform(se2.inverse(estimate.X_MD), estimate.anchor)

    def in_D(x):
        """Parameters and the walls seen, as they are in D by anchors that are fixed there."""
        X_MD, found = x[2 * s : 2 * s + 3], [x[2 * s + 3 :]]
        for row in seen:
            angle, distance = x[2 * row : 2 * row + 2]
            normal = np.array([np.cos(angle), np.sin(angle)])
            (on_it,) = se2.transform(se2.inverse(X_MD), (estimate.anchor[row] + distance * normal)[None])
            turned = angle - X_MD[2]
            found.append([turned, np.array([np.cos(turned), np.sin(turned)]) @ (on_it - p_DC[row])])
        return np.concatenate(found)

    x = np.concatenate([estimate.p_ML.ravel(), estimate.X_MD, np.zeros(SHARED)])
    J, P = differences(in_D, x), estimate.joint_covariance
    expected = J @ P @ J.T
    expected[SHARED:, SHARED:] += np.diag(np.tile(np.square(floor * FLOOR), len(seen)))
    np.testing.assert_allclose(localizer.considered, expected, atol=1e-7 * np.abs(expected).max())
    with_D = J @ P[:, 2 * s : 2 * s + 3]
    np.testing.assert_allclose(localizer.with_D, with_D, atol=1e-7 * np.abs(with_D).max())
    np.testing.assert_allclose(localizer.p_DL.ravel(), in_D(x)[SHARED:], atol=1e-12)

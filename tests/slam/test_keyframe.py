"""A keyframe as a function of tags, poses and parameters."""

import numpy as np
import pytest
import scipy.linalg

from tests.slam.oracle import NOISE, PRIOR, SIGMA, Drive, dense
from tests.slam.rings import NOTHING, dense_solution, observed, reckoned
from tests.walls import walls_between
from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, replace
from tfg_drake.slam.keyframe import fusion, keyframe, linearised, of_places, residual, rows_of, way, without_tags
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.shared import DISTANCE_SCALE, GYRO_SCALE, RANGE_SCALE, SHARED, Shared
from tfg_drake.slam.turn import reduced
from tfg_drake.slam.walls import ends_seen, known_walls

P_ML = np.array([[3.0, 1.0], [2.0, -1.0], [5.0, 0.0], [4.0, 2.0]])
X_MA, X_AD = np.array([0.3, -0.2, 0.4]), np.array([0.1, 0.0, 0.2])
TRUTH = SIGMA * np.array([1.0, -0.5, 0.7, -1.2, 0.3, 0.8, -0.4, 0.6, -0.9, 0.2, 1.1, -0.7, 1.5])


def seen(seed=0, tags=4, shared=TRUTH):
    """A keyframe at X_MA that depends on all parameters."""
    return observed(np.random.default_rng(seed), P_ML, X_MA, X_AD, np.arange(tags), shared=shared)


def cost(one, p_ML, A, D, shared):
    """Twice the cost, written out."""
    scale = 1.0 + shared[one.unit]
    places = se2.transform(se2.inverse(A), np.vstack([p_ML, D[:2]]))
    y = np.append(scale * places.ravel(), se2.wrap_angle(D[2] - A[2]))
    error = np.append(y - np.append(one.y_AL.ravel(), one.y_AD), shared)
    return error @ one.information @ error + 2.0 * one.vector @ shared


def test_the_linearisation_is_that_of_its_cost():
    """Gradient and, where the error vanishes, Hessian by differences; in the order of tags, D, A and parameters."""
    one = seen()
    one = replace(one, vector=np.arange(float(SHARED)))
    x = np.concatenate([P_ML.ravel(), se2.compose(X_MA, X_AD), X_MA, TRUTH])
    x += 0.01 * np.random.default_rng(1).normal(size=len(x))

    def parts(x):
        return x[:8].reshape(-1, 2), x[11:14], x[8:11], x[14:]

    def at(x):
        p_ML, A, D, shared = parts(x)
        return linearised(one, (p_ML, np.zeros((4, 2))), (A, D), shared)

    def errors(x):
        p_ML, A, D, shared = parts(x)
        return residual(p_ML, np.zeros((4, 2)), one.measured, A, D, shared)[0]

    H, g, twice = at(x)
    assert twice == pytest.approx(cost(one, *parts(x)), rel=1e-12)
    steps = 1e-6 * np.eye(len(x))
    slope = [(cost(one, *parts(x + h)) - cost(one, *parts(x - h))) / 4e-6 for h in steps]
    np.testing.assert_allclose(g, slope, rtol=1e-5, atol=1e-2)
    J = np.column_stack([(errors(x + h) - errors(x - h)) / 2e-6 for h in steps])
    p_ML, A, D, shared = parts(x)
    on = residual(p_ML, np.zeros((4, 2)), one.measured, A, D, shared)[1]
    np.testing.assert_allclose(on, J[:, 11:], atol=1e-8)
    np.testing.assert_allclose(H, J.T @ one.information @ J, rtol=1e-6, atol=1e-7 * np.abs(H).max())


@pytest.mark.parametrize("fused", [False, True])
def test_with_the_tags_errors_the_linearisation_is_that_of_its_cost(fused):
    """An error moves where a tag is seen by on_error, or is a parameter of a keyframe that was fused."""
    rng, errors = np.random.default_rng(4), 0.02 * np.random.default_rng(5).normal(size=(4, 2))
    one = observed(rng, P_ML, X_MA, X_AD, np.arange(4), 1.0, errors, TRUTH)
    if fused:
        one = fusion(one, observed(rng, P_ML, X_AD, X_AD, np.arange(4), 1.0, errors, TRUTH), TRUTH)[0]
        assert one.pull.any()
    else:
        one = replace(one, vector=np.arange(float(SHARED)))
    x = np.concatenate([P_ML.ravel(), se2.compose(X_MA, X_AD), X_MA, TRUTH, errors.ravel()])
    x += 0.01 * rng.normal(size=len(x))

    def twice(x):
        p_ML, D, A, shared, errors = x[:8].reshape(-1, 2), x[8:11], x[11:14], x[14:27], x[27:]
        error = residual(p_ML, np.zeros((4, 2)), one.measured, A, D, shared)[0]
        if fused:
            error = np.append(error, errors)
            return error @ one.information @ error + 2.0 * one.vector @ shared + 2.0 * one.pull.ravel() @ errors
        error[:8] += np.einsum("nij,nj->ni", one.on_error, errors.reshape(-1, 2)).ravel()
        return error @ one.information @ error + 2.0 * one.vector @ shared

    H, g, cost = linearised(one, (x[:8].reshape(-1, 2), np.zeros((4, 2))), (x[11:14], x[8:11]), x[14:27], x[27:])
    assert cost == pytest.approx(twice(x), rel=1e-9)
    steps = 1e-6 * np.eye(len(x))
    np.testing.assert_allclose(g, [(twice(x + h) - twice(x - h)) / 4e-6 for h in steps], rtol=1e-4, atol=1e-2)
    np.testing.assert_array_equal(H[27:, 27:], one.with_errors()[24:, 24:])
    few, few_g, few_cost = linearised(one, (x[:8].reshape(-1, 2), np.zeros((4, 2))), (x[11:14], x[8:11]), x[14:27])
    np.testing.assert_allclose(H[:27, :27], few, rtol=1e-12, atol=1e-9 * np.abs(few).max())
    assert (few_cost != cost, len(few_g)) == (True, 27)


def test_what_it_says_given_the_parameters_is_where_its_cost_is_least():
    one = seen()
    p_AL, there, covariance = one.given(TRUTH)
    least = cost(one, p_AL, np.zeros(3), there, TRUTH)
    rng = np.random.default_rng(2)
    root = np.linalg.cholesky(covariance)
    for _ in range(5):
        normal = rng.normal(size=11)
        moved = np.append(p_AL.ravel(), there) + root @ normal
        more = cost(one, moved[:-3].reshape(-1, 2), np.zeros(3), moved[-3:], TRUTH) - least
        assert more == pytest.approx(normal @ normal, rel=1e-6)
    np.testing.assert_allclose(p_AL, se2.transform(se2.inverse(X_MA), P_ML), atol=0.1)


def test_a_cost_known_where_parameters_are_off_is_kept_where_they_are_zero():
    """`keyframe` of a gradient and a Hessian at some point is the same parabola."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(24, 24))
    W, g, y, shared = root @ root.T, rng.normal(size=24), rng.normal(size=11), TRUTH
    none = np.zeros((4, 2))
    one = keyframe((np.arange(4), none, none, np.zeros((4, 2, 2))), y, shared, RANGE_SCALE, W, g)

    def by_keyframe(x):
        error = x - np.concatenate([one.y_AL.ravel(), one.y_AD, np.zeros(SHARED)])
        return 0.5 * error @ one.information @ error + one.vector @ x[11:]

    def by_parabola(x):
        step = x - np.append(y, shared)
        return 0.5 * step @ W @ step + g @ step

    base = np.append(y, shared)
    for _ in range(5):
        x = base + rng.normal(size=24)
        assert by_keyframe(x) - by_keyframe(base) == pytest.approx(by_parabola(x), rel=1e-9)
    # With the best y for each, it is a parabola in the parameters.
    information, gradient = one.alone()
    s = rng.normal(size=SHARED)
    best = np.linalg.solve(W[:11, :11], -W[:11, 11:] @ s)
    x = np.concatenate([one.y_AL.ravel(), one.y_AD, np.zeros(SHARED)])
    value = by_keyframe(x + np.append(best, s)) - by_keyframe(x)
    assert value == pytest.approx(0.5 * s @ information @ s + gradient @ s, rel=1e-9)


def test_it_costs_what_its_frames_cost():
    """At several parameters, all frames solved anew with these held."""
    robot = Drive(np.random.default_rng(4).uniform(-8.0, 8.0, (12, 2)), TRUTH, 4)
    pieces = robot.piece(0.2, 0.5, 8.0)
    one = reduced(NOISE, pieces, PRIOR).keyframe
    information, gradient = one.alone()
    rng, found = np.random.default_rng(1), dense([pieces]).shared
    costs, own = [], []
    for _ in range(5):
        shared = found + 0.15 * SIGMA * rng.normal(size=SHARED)
        held = dense([pieces], Shared(shared, np.diag(np.full(SHARED, 1e-14))))
        p_AL, there, covariance = one.given(shared)
        deviation = np.sqrt(np.diag(covariance))
        off, expected = held.off(p_AL, there, shared)
        assert np.abs(off[:-SHARED] / deviation).max() < 0.03
        np.testing.assert_allclose(np.sqrt(np.diag(expected))[:-SHARED], deviation, rtol=0.01)
        costs.append(held.cost)
        own.append(0.5 * shared @ information @ shared + gradient @ shared)
    np.testing.assert_allclose(np.diff(own), np.diff(costs), atol=0.02 * np.ptp(costs))


def test_without_tags_is_their_marginal():
    one = replace(seen(), vector=np.arange(float(SHARED)))
    fewer = without_tags(one, np.array([101, 103, 999]))
    np.testing.assert_array_equal(fewer.ids, [100, 102])
    keep = np.append([0, 1, 4, 5], np.arange(8, 11 + SHARED))
    # By brute force: what prior makes proper, inverted, and the prior taken away again.
    prior = np.diag(np.append(np.zeros(11), np.full(SHARED, 1e3)))
    marginal = np.linalg.inv(np.linalg.inv(one.information + prior)[np.ix_(keep, keep)])
    marginal -= prior[np.ix_(keep, keep)]
    np.testing.assert_allclose(fewer.information, marginal, rtol=1e-6, atol=1e-6 * np.abs(marginal).max())
    np.testing.assert_array_equal(fewer.y_AL, one.y_AL[[0, 2]])
    np.testing.assert_array_equal(fewer.on_error, one.on_error[[0, 2]])
    np.testing.assert_array_equal(fewer.vector, one.vector)
    assert without_tags(one, np.array([7])) is one
    none = without_tags(one, one.ids)
    assert none.unit == RANGE_SCALE
    rows = np.ix_(*[np.arange(8, 11)] * 2)
    np.testing.assert_allclose(none.given(TRUTH)[2], one.given(TRUTH)[2][rows], rtol=1e-6, atol=1e-12)


def test_two_keyframes_fused_say_what_both_say():
    """The fused keyframe's joint Gaussian of tags, end and parameters is that of a dense solution of both, linearised
    at the pose between."""
    rng = np.random.default_rng(5)
    p_ML = rng.uniform(-4.0, 4.0, (12, 2))
    X_AB = np.array([0.9, 0.05, 0.4])
    first = observed(rng, p_ML, np.zeros(3), X_AB, np.arange(9), shared=TRUTH)
    second = observed(rng, p_ML, X_AB, X_AD, np.arange(3, 12), shared=TRUTH)
    first, second = replace(first, vector=np.arange(float(SHARED))), replace(second, vector=np.full(SHARED, -2.0))
    graph = reckoned([first, second], PRIOR)
    X_MN, p, shared, covariance = dense_solution(graph)
    both, between, deviation = fusion(first, second, shared)
    X_few, p_few, shared_few, covariance_few = dense_solution(reckoned([both], PRIOR))
    at = np.concatenate([np.arange(24), 27 + np.arange(3 + SHARED)])
    expected = covariance[np.ix_(at, at)]
    sigma = np.sqrt(np.diag(expected))
    off = np.concatenate([(p_few - p).ravel(), X_few[-1] - X_MN[-1], shared_few - shared]) / sigma
    assert np.abs(off).max() < 0.02
    assert np.abs((covariance_few - expected) / np.outer(sigma, sigma)).max() < 0.02
    np.testing.assert_allclose(between, X_MN[1], atol=0.02)
    assert deviation < 0.1


def test_two_keyframes_fused_say_of_the_errors_of_tags_what_both_say():
    """Seen from two sides: it is where they look from that tells an error from a place."""
    rng, deviation = np.random.default_rng(6), np.array([0.03, 0.01])
    p_ML, X_AB = rng.uniform(-4.0, 4.0, (12, 2)), np.array([2.0, 0.5, 0.4])
    errors = deviation * rng.normal(size=(12, 2))
    first = observed(rng, p_ML, np.zeros(3), X_AB, np.arange(9), 1.0, errors, TRUTH)
    second = observed(rng, p_ML, X_AB, X_AD, np.arange(3, 12), 1.0, errors, TRUTH)
    graph = replace(reckoned([first, second], PRIOR), tag_error=deviation)
    X_MN, p, shared, covariance = dense_solution(graph)
    both, _, _ = fusion(first, second, shared)
    few = replace(reckoned([both], PRIOR), tag_error=deviation)
    at = np.concatenate([np.arange(24), 27 + np.arange(3 + 24 + SHARED)])
    expected = covariance[np.ix_(at, at)]
    sigma = np.sqrt(np.diag(expected))
    X_few, p_few, shared_few, covariance_few = dense_solution(few)
    assert np.abs((covariance_few - expected) / np.outer(sigma, sigma)).max() < 0.05
    assert np.abs((p_few - p).ravel() / sigma[:24]).max() < 0.1
    assert np.abs((shared_few - shared) / sigma[-SHARED:]).max() < 0.1
    assert np.abs((X_few[-1] - X_MN[-1]) / sigma[24:27]).max() < 0.1
    # Without one of its tags: as if that had never been seen.
    fewer = without_tags(both, both.ids[:1])
    size = 4 * 11 + 3 + SHARED
    assert fewer.information.shape == (size, size)
    expected = fusion(without_tags(first, first.ids[:1]), second, shared)[0]
    np.testing.assert_allclose(fewer.information, expected.information, rtol=1e-3, atol=1.0)
    np.testing.assert_allclose(fewer.pull, expected.pull, rtol=1e-3, atol=1.0)


def test_a_way_known_from_elsewhere_is_in_metres():
    one = way(np.array([2.0, 0.0, 0.5]), np.diag([0.1, 0.2, 0.3]) ** 2)
    shared = np.zeros(SHARED)
    shared[[DISTANCE_SCALE, RANGE_SCALE]] = 0.25, 0.5
    p_AL, X_AD, covariance = one.given(shared)
    assert p_AL.shape == (0, 2)
    np.testing.assert_allclose(X_AD, [2.0, 0.0, 0.5])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.1, 0.2, 0.3])
    assert not one.alone()[0].any()


def test_many_keyframes_tell_nothing_of_the_scale_of_ranges_that_there_is_not():
    """Nothing but the odometry measures a length: a scale would be found where keyframes that see each other's tags
    pull at it with one sign."""
    scales = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        truth = SIGMA * rng.normal(size=SHARED)
        truth[[DISTANCE_SCALE, RANGE_SCALE, GYRO_SCALE]] = 0.0, 0.0, 0.01
        robot = Drive(rng.uniform(-8.0, 8.0, (20, 2)), truth, seed)
        pieces = [robot.piece(*one) for _ in range(10) for one in ((0.0, 0.6, 5.0), (0.4, 0.2, 3.0), (0.4, -0.3, 2.0))]
        graph = reckoned([reduced(NOISE, one, PRIOR).keyframe for one in pieces], PRIOR)
        graph, _ = solve(graph, 0.0, NOTHING)
        scales.append(graph.shared.mean[RANGE_SCALE] / graph.shared.sigma[RANGE_SCALE])
    assert np.abs(scales).max() < 3.0
    assert abs(np.mean(scales)) < 1.5


def test_rows_of_known_ids():
    row, known = rows_of(np.array([3, 7, 4]), np.array([3, 4, 6]))
    assert known.tolist() == [True, False, True]
    assert row[known].tolist() == [0, 1]
    row, known = rows_of(np.array([3]), np.empty(0, dtype=np.int64))
    assert not known.any()


def test_lines_that_are_not_quite_parallel_do_not_cross():
    """Two looks at a wall, 5 mrad and 3 mm apart: fused, how far the robot drove along the wall is no better known."""
    ids, axis, none = np.array([WALLS_BELOW - 1]), np.array([1.0, 0.0, 0.0]), np.zeros((1, 2))
    covariance = np.diag([0.001, 0.001, 0.05, 0.05, 0.002]) ** 2
    reach = np.array([[-1.5, 0.0]])
    first = of_places(ids, np.array([[0.5 * np.pi, 2.0]]), none, reach, axis, covariance)
    second = of_places(ids, np.array([[0.5 * np.pi + 0.005, 2.003]]), none, reach, axis, covariance)
    both, X_AB, _ = fusion(first, second, np.zeros(SHARED))
    _, X_AD, after = both.given(np.zeros(SHARED))
    np.testing.assert_allclose([X_AB[0], X_AD[0]], [1.0, 2.0], atol=0.01)
    np.testing.assert_allclose(both.reach, [[-2.5, 0.0]], atol=0.02)
    assert np.sqrt(after[-3, -3]) == pytest.approx(np.hypot(0.05, 0.05), rel=0.01)


def looks_at_walls():
    """Three keyframes that follow each other, of two walls each anchored elsewhere, and two tags."""
    rng, keyframes, X_MA, X_AD = np.random.default_rng(8), [], np.zeros(3), np.array([1.0, 0.2, 0.3])
    angle, distance = np.array([1.2, -0.4]), np.array([2.0, 3.0])
    ids, tags = np.array([WALLS_BELOW - 2, WALLS_BELOW - 1, 100, 101]), np.array([[2.0, 1.0], [3.0, -1.0]])
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    for _ in range(3):
        p_AC = rng.uniform(-2.0, 2.0, (2, 2))
        off = distance - np.sum(normal * se2.transform(X_MA, p_AC), axis=1)
        y = np.vstack([np.column_stack([angle - X_MA[2], off]), se2.transform(se2.inverse(X_MA), tags)])
        root = 0.002 * rng.normal(size=(11, 11)) + 0.01 * np.eye(11)
        error, anchor = root @ rng.normal(size=11), np.vstack([p_AC, np.zeros((2, 2))])
        y_AD = X_AD + error[8:]
        y = y + error[:8].reshape(-1, 2)
        keyframes.append(of_places(ids, y, anchor, np.zeros((4, 2)), y_AD, root @ root.T))
        X_MA = se2.compose(X_MA, X_AD)
    return keyframes


def test_the_jacobians_of_walls_are_their_differences():
    """On the wall, on the pose that sees it and on the pose where the keyframe ends."""
    one, rng = looks_at_walls()[1], np.random.default_rng(9)
    p_MC = np.vstack([rng.normal(size=(2, 2)), np.zeros((2, 2))])
    x = np.concatenate([rng.normal(size=8), X_MA, se2.compose(X_MA, X_AD), TRUTH])

    def of(x):
        return residual(x[:8].reshape(-1, 2), p_MC, one.measured, x[8:11], x[11:14], x[14:])

    J = np.column_stack([(of(x + h)[0] - of(x - h)[0]) / 2e-6 for h in 1e-6 * np.eye(len(x))])
    _, on, by_landmark = of(x)
    np.testing.assert_allclose(on, np.hstack([J[:, 8:11], J[:, 14:]]), atol=1e-8)
    np.testing.assert_allclose(scipy.linalg.block_diag(*by_landmark[:4]), J[:8, :8], atol=1e-8)
    np.testing.assert_allclose(by_landmark[4], J[8:10, 11:13], atol=1e-8)


def test_a_map_of_walls_is_a_dense_solution():
    graph = reckoned(looks_at_walls(), PRIOR)
    X_MN, p_ML, _, covariance = dense_solution(graph)
    solved, estimate = solve(graph, 0.0, NOTHING)
    np.testing.assert_allclose(solved.p_ML, p_ML, atol=1e-6)
    np.testing.assert_allclose(solved.X_MN, X_MN, atol=1e-6)
    found, expected = estimate.joint_covariance[:8, :8], covariance[:8, :8]
    assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)


def test_two_keyframes_of_walls_fused_say_what_both_say():
    """Each has its own anchors; the fused one is linearised at the pose between."""
    first, second, _ = looks_at_walls()
    X_MN, p, _, covariance = dense_solution(reckoned([first, second], PRIOR))
    both, between, _ = fusion(first, second, np.zeros(SHARED))
    np.testing.assert_array_equal(both.anchor, first.anchor)
    X_few, p_few, _, covariance_few = dense_solution(reckoned([both], PRIOR))
    at = np.append(np.arange(8), 11 + np.arange(3))
    expected = covariance[np.ix_(at, at)]
    sigma = np.sqrt(np.diag(expected))
    off = np.concatenate([(p_few - p).ravel(), X_few[-1] - X_MN[-1]]) / sigma
    assert np.abs(off).max() < 0.02
    assert np.abs((covariance_few[:11, :11] - expected) / np.outer(sigma, sigma)).max() < 0.02
    np.testing.assert_allclose(between, X_MN[1], atol=0.02)


def test_a_wall_reaches_as_far_as_any_keyframe_has_seen_it():
    """In a fused keyframe and in the graph, whatever anchors they have: by the ends in the world."""
    truth, X_AB = np.array([[1.0, 2.0], [4.0, 3.0]]), np.array([1.0, 0.2, 0.3])
    keyframes, X_MA = [], np.zeros(3)
    for begin, end, at in ((0.3, 0.6, 0.1), (0.0, 0.5, 0.9), (0.4, 1.0, -2.0)):
        part = truth[0] + np.outer([begin, end], truth[1] - truth[0])
        seen = walls_between(se2.transform(se2.inverse(X_MA), part)[::-1], at)
        keyframes.append(of_places(np.array([WALLS_BELOW - 1]), *seen, X_AB, 1e-6 * np.eye(5)))
        X_MA = se2.compose(X_MA, X_AB)
    graph = reckoned(keyframes)
    both, _, _ = fusion(*keyframes[:2], np.zeros(SHARED))
    three, _, _ = fusion(both, keyframes[2], np.zeros(SHARED))
    for found, share in ((known_walls(graph)[1][0], 1.0), (ends_seen(three, np.zeros(SHARED))[0], 1.0),
                         (ends_seen(both, np.zeros(SHARED))[0], 0.6)):  # fmt: skip
        expected = np.vstack([truth[0] + share * (truth[1] - truth[0]), truth[0]])
        np.testing.assert_allclose(found, expected, atol=1e-9)

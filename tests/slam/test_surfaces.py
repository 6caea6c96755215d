"""Pieces of surface and ties against brute force and against least squares whose unknowns are all explicit."""

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.arrays import frozen
from tests.slam.rings import NOTHING, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import dissection
from tfg_drake.slam.dissection import DissectionSolver
from tfg_drake.slam.keyframe import moved_points, way
from tfg_drake.slam.keyframe_graph import empty_graph, extended
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.shared import SHARED, exactly_known
from tfg_drake.slam.solver import NONE, Unknowns, Values, assemble
from tfg_drake.slam.surfaces import (
    CELL,
    COMMON,
    EDGE,
    FLOOR,
    POINT,
    ROBUST,
    ROUNDS,
    SAME_WAY,
    SLOPE,
    Pieces,
    Points,
    Ties,
    add_pieces,
    add_ties,
    no_ties,
    pieces_of,
    put_together,
)

NO_BLOCK = np.zeros((0, 0))
# Two keyframes that look at the same place.
PAIR = np.array([[0.2, 0.1, 0.4], [0.6, -0.3, -2.9]])


def board(begin, end, normal, spacing=0.05):
    """Points with normals (p, 4) on a straight surface between two points, towards one side."""
    begin, end = np.array(begin), np.array(end)
    count = round(math.hypot(*(end - begin)) / spacing)
    p = begin + (np.arange(count)[:, None] + 0.5) / count * (end - begin)
    return np.hstack([p, np.broadcast_to(normal, (count, 2))])


def facing(angle):
    return np.array([math.cos(angle), math.sin(angle)])


def points_of(seen, X_MN):
    """The Points of keyframes, each of which sees some (p, 4) in M."""
    keyframe = np.repeat(np.arange(len(seen)), [len(p) for p in seen])
    p_AP = np.vstack([moved_points(se2.inverse(X), p) for p, X in zip(seen, X_MN, strict=True)])
    return Points(keyframe, p_AP, np.zeros(len(X_MN), dtype=np.int64), np.zeros((len(X_MN), 3, 3)))


def found(seen, X_MN, seed):
    return pieces_of(points_of(seen, X_MN), frozen(X_MN), seed)


def points_in(pieces):
    """How many points each look has, where all of them lie on the piece: a point weighs less, the more there are."""
    weight = pieces.moments[:, 0]
    return weight * POINT**2 / (1.0 - weight * FLOOR**2)


def test_no_points_make_no_pieces():
    for X_MN in (np.zeros((1, 3)), PAIR):
        pieces = found([np.zeros((0, 4))] * len(X_MN), X_MN, 1)
        assert [part.shape for part in pieces] == [(0, 4), (1,), (0,), (0, 6)]
        assert len(pieces.piece) == 0
        gradient = np.zeros(6)
        every = np.arange(len(pieces.frame))
        assert add_pieces(every, pieces, np.zeros((3, 3)), np.array([-1, 0, 3]), NO_BLOCK, gradient) == 0.0
        assert not gradient.any()


def test_points_are_moved_into_the_map():
    rng = np.random.default_rng(0)
    X_MN, p_AP, keyframe = rng.uniform(-3.0, 3.0, (4, 3)), rng.normal(size=(20, 4)), np.arange(20) // 5
    expected = np.vstack([moved_points(X, p_AP[keyframe == k]) for k, X in enumerate(X_MN)])
    np.testing.assert_allclose(moved_points(X_MN[keyframe], p_AP), expected, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_looks_at_a_wall_share_its_pieces(angle):
    """Each of two keyframes sees each piece, and all points are in one."""
    along, normal = facing(angle), facing(angle + 0.5 * np.pi)
    wall = board(-1.5 * along, 1.5 * along, normal)
    for seed in range(10):
        pieces = found([wall, np.vstack([wall, wall])], PAIR, seed)
        number = len(pieces.frame)
        # A line goes through so many cells at most.
        assert 10 <= number <= 3.0 * np.abs(along).sum() / CELL + 2
        np.testing.assert_array_equal(pieces.looks, 2 * np.arange(number + 1))
        np.testing.assert_array_equal(pieces.keyframe, np.tile([0, 1], number))
        np.testing.assert_array_equal(pieces.piece, np.arange(number).repeat(2))
        np.testing.assert_allclose(pieces.frame[:, 2:], np.tile(normal, (number, 1)), atol=1e-12)
        np.testing.assert_allclose(pieces.frame[:, :2] @ normal, 0.0, atol=1e-12)
        count = points_in(pieces).reshape(-1, 2)
        np.testing.assert_allclose(count, np.round(count), atol=1e-6)
        np.testing.assert_allclose(count[:, 1], 2.0 * count[:, 0])
        assert count[:, 0].sum() == pytest.approx(len(wall))


def test_what_one_keyframe_sees_alone_is_no_piece():
    wall = board([-1.5, 1.0], [1.5, 1.0], [0.0, -1.0])
    alone = board([-1.5, 2.0], [1.5, 2.0], [0.0, -1.0])
    for seed in range(10):
        pieces = found([np.vstack([wall, alone]), wall[wall[:, 0] > 0.0]], PAIR, seed)
        assert 5 <= len(pieces.frame) <= 7
        assert pieces.frame[:, 0].min() > -0.5 * CELL
        np.testing.assert_allclose(pieces.frame[:, 1], 1.0)
        assert len(found([wall, wall[:0]], PAIR, seed).frame) == 0
        # Twice by the same keyframe is by one alone.
        assert len(found([np.vstack([wall, wall]), wall[:0]], PAIR, seed).frame) == 0


@pytest.mark.parametrize(
    ("apart", "together"), [(SAME_WAY - 0.05, True), (SAME_WAY + 0.05, False), (0.5 * np.pi, False), (np.pi, False)]
)
def test_points_that_look_another_way_are_another_piece(apart, together):
    both = np.array([[0.0, 1.0, *facing(angle)] for angle in (0.3, 0.3 + apart)])
    of_one = sum(len(found([both, both], PAIR, seed).frame) == 1 for seed in range(50))
    of_two = sum(len(found([both, both], PAIR, seed).frame) == 2 for seed in range(50))
    assert of_one + of_two == 50
    # The first direction, a random one, is seldom between theirs.
    assert of_one > 40 if together else of_two == 50
    # Looks of one each have nothing in common where they are apart.
    assert sum(len(found([both[:1], both[1:]], PAIR, seed).frame) for seed in range(50)) == of_one


def test_directions_follow_each_other():
    """A bend is one piece though its first and last direction are far apart; a column all round is no surface."""
    bend = np.array([[0.0, 1.0, *facing(angle)] for angle in (0.0, 0.4, 0.8)])
    number = [len(found([bend, bend], PAIR, seed).frame) for seed in range(50)]
    assert number.count(1) > 30
    column = np.array([[0.0, 1.0, *facing(angle)] for angle in np.arange(0.0, 2.0 * np.pi, 0.3)])
    for seed in range(10):
        assert len(found([column, column], PAIR, seed).frame) == 0


def test_an_edge_counts_both_ways():
    edge, surface = np.array([[0.0, 1.0, 0.0, 0.0]]), np.array([[2.0, 1.0, 0.0, -1.0]])
    for seed in range(5):
        both = np.vstack([surface, edge])
        pieces = found([both, np.vstack([edge, both])], PAIR, seed)
        assert len(pieces.frame) == 3
        order = np.argsort(pieces.frame @ [-1.0, 0.0, 1.0, 0.0])
        expected = [[2.0, 1.0, 0.0, -1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]]
        np.testing.assert_allclose(pieces.frame[order], expected, atol=1e-12)
        weight = pieces.moments[:, 0].reshape(-1, 2)[order]
        one, two = 1.0 / (POINT**2 + FLOOR**2), 2.0 / (POINT**2 + 2.0 * FLOOR**2)
        np.testing.assert_allclose(weight, [[one, one], [EDGE * one, EDGE * two], [EDGE * one, EDGE * two]])
        # A normal along an axis is no edge.
        assert len(found([surface, surface], np.zeros((2, 3)), seed).frame) == 1
        # A surface beside the edge is another piece.
        beside = np.array([[0.0, 1.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
        assert len(found([np.vstack([edge, beside])] * 2, PAIR, seed).frame) == 4


def clutter(seed, keyframes=4):
    """Bent surfaces, edges and stray points, a part of which each keyframe sees, 3 cm off, and points each alone."""
    rng = np.random.default_rng(seed)
    angle, across = rng.uniform(-np.pi, np.pi, 150), rng.normal(0.0, 0.03, (150, 1))
    place = np.repeat(rng.uniform(-1.0, 1.0, (15, 2)), 10, axis=0)
    direction = np.repeat(rng.uniform(-np.pi, np.pi, 15), 10) + rng.normal(0.0, 0.2, 150)
    n = np.column_stack([np.cos(direction), np.sin(direction)])
    p = place + rng.uniform(-0.2, 0.2, (150, 1)) * n[:, ::-1] * [-1.0, 1.0] + across * n
    every = np.vstack([np.hstack([p, n]), np.column_stack([p[::3], np.cos(angle[::3]), np.sin(angle[::3])])])
    every = np.vstack([every, np.hstack([p[::8], np.zeros_like(p[::8])])])
    return [every[rng.random(len(every)) < 0.5] for _ in range(keyframes)], rng.uniform(-2.0, 2.0, (keyframes, 3))


def fitted_weights(frame, p_M, plain, rounds=ROUNDS):
    """Weights (p,) of points (p, 2) after some rounds of weighted least squares by offset and slope."""
    m, n = frame[:2], frame[2:]
    across, along = (p_M - m) @ n, (p_M - m) @ [-n[1], n[0]]
    line = np.zeros(2)
    for _ in range(rounds):
        A = np.column_stack([np.ones(len(along)), along])
        weight = plain / (1.0 + ((across - A @ line) / ROBUST) ** 2)
        root = np.sqrt(weight)[:, None]
        rows = np.vstack([root * A, [0.0, 1.0 / SLOPE]])
        line = np.linalg.lstsq(rows, np.append(root[:, 0] * across, 0.0), rcond=None)[0]
    return weight


def brute_force(points, X_MN, seed):
    """{frame: {keyframe: moments (6,)}} by one cell, direction, piece and point after the other."""
    rng = np.random.default_rng(seed)
    origin, first = rng.uniform(0.0, CELL, 2), rng.uniform(0.0, 2.0 * np.pi)
    cells = {}
    for k, p_A in zip(points.keyframe, points.p_AP, strict=True):
        p_M = moved_points(X_MN[k], p_A[None])[0]
        for kind, n in [(0, p_M[2:])] if p_A[2:].any() else [(1, (1.0, 0.0)), (2, (0.0, 1.0))]:
            cell = (*np.floor((p_M[:2] + origin) / CELL), kind)
            cells.setdefault(cell, []).append(((math.atan2(n[1], n[0]) - first) % (2.0 * np.pi), k, p_A, p_M[:2], n))
    expected = {}
    for (*_, kind), members in cells.items():
        members.sort(key=lambda one: one[0])
        parts = [[members[0]]]
        for before, one in pairwise(members):
            if one[0] - before[0] > SAME_WAY:
                parts.append([])
            parts[-1].append(one)
        for part in parts:
            _, k, p_A, p_M, n = (np.array(column) for column in zip(*part, strict=True))
            normal = n.mean(axis=0)
            if len(set(k)) < 2 or math.hypot(*normal) <= COMMON:
                continue
            frame = np.append(p_M.mean(axis=0), normal / math.hypot(*normal))
            of_look = np.array([np.count_nonzero(k == each) for each in k])
            plain = (EDGE if kind else 1.0) / (POINT**2 + of_look * FLOOR**2)
            x, y = p_A[:, :2].T
            terms = np.array([np.ones(len(x)), x, y, x * x, x * y, y * y]) * fitted_weights(frame, p_M, plain)
            expected[tuple(frame)] = {each: terms[:, k == each].sum(axis=1) for each in sorted(set(k))}
    return expected


@pytest.mark.parametrize("seed", range(4))
def test_pieces_are_those_of_brute_force(seed):
    """Points that are off weigh less: by a line that all of a piece have in common."""
    seen, X_MN = clutter(seed)
    points = points_of(seen, X_MN)
    pieces, expected = pieces_of(points, frozen(X_MN), seed), brute_force(points, X_MN, seed)
    assert len(pieces.frame) == len(expected) > 30
    assert pieces.looks[0] == 0
    assert pieces.looks[-1] == len(pieces.keyframe) == len(pieces.moments)
    places = np.array(list(expected))
    for i, frame in enumerate(pieces.frame):
        match = np.abs(places - frame).max(axis=1).argmin()
        np.testing.assert_allclose(frame, places[match], atol=1e-9)
        looks, of_each = slice(*pieces.looks[i : i + 2]), expected.pop(tuple(places[match]))
        places = np.delete(places, match, axis=0)
        assert pieces.keyframe[looks].tolist() == list(of_each)
        size = max(np.abs(moments).max() for moments in of_each.values())
        np.testing.assert_allclose(pieces.moments[looks], list(of_each.values()), atol=1e-9 * size)


def test_weights_settle_and_leave_out_what_is_far_off():
    rng = np.random.default_rng(5)
    X_MN, n = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0]]), facing(0.3)
    wall = board(-0.1 * n[::-1] * [-1.0, 1.0], 0.1 * n[::-1] * [-1.0, 1.0], n, 0.01)
    wall[:, :2] += rng.normal(0.0, 0.005, (len(wall), 1)) * n
    stray = np.append(0.2 * n, n)
    tried = (found([wall, np.vstack([wall, stray])], X_MN, seed) for seed in range(200))
    pieces = next(one for one in tried if points_of_all(one, np.vstack([wall, wall, stray])))
    p_M = np.vstack([wall, wall, stray])[:, :2]
    plain = 1.0 / (POINT**2 + np.repeat([len(wall), len(wall) + 1], [len(wall), len(wall) + 1]) * FLOOR**2)
    settled = fitted_weights(pieces.frame[0], p_M, plain, 100)
    expected = [settled[: len(wall)].sum(), settled[len(wall) :].sum()]
    np.testing.assert_allclose(pieces.moments[:, 0], expected, rtol=1e-3)
    assert settled[-1] < 0.1 * settled[:-1].min()


def points_of_all(pieces, every):
    """There is one piece, and all points are in it: it is where they are in the mean."""
    return len(pieces.frame) == 1 and np.allclose(pieces.frame[0, :2], every[:, :2].mean(axis=0), atol=1e-9)


def twice_cost(pieces, X_MN):
    return add_pieces(
        np.arange(len(pieces.frame)), pieces, X_MN, np.full(len(X_MN), -1), NO_BLOCK, np.zeros(3 * len(X_MN))
    )


def test_other_seeds_move_the_borders_but_not_the_cost_much():
    rng = np.random.default_rng(2)
    X_MN = np.column_stack([rng.uniform(1.0, 5.0, 8), rng.uniform(1.5, 2.5, 8), rng.uniform(-3.0, 3.0, 8)])
    seen = [ROOM + rng.normal(0.0, [0.02, 0.02, 0.0, 0.0], ROOM.shape) for _ in X_MN]
    points = points_of(seen, X_MN)
    off = X_MN + rng.normal(0.0, [0.03, 0.03, 0.01], X_MN.shape)
    found_by = [pieces_of(points, frozen(off), seed) for seed in range(12)]
    first, again = found_by[0], pieces_of(points, frozen(off), 0)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    for other in found_by[1:]:
        apart = np.abs(first.frame[:, None, :2] - other.frame[None, :, :2]).max(axis=2).min(axis=1)
        assert np.median(apart) > 0.01
    cost = np.array([twice_cost(one, off) for one in found_by])
    assert np.ptp(cost) < 0.2 * cost.mean()
    at_truth = [twice_cost(one, X_MN) for one in found_by]
    assert (at_truth < 0.75 * cost).all()


def explicit(seed, keyframes=5, number=6):
    """Some pieces and poses, and of each piece what tells of it: frame, keyframe (p,), points (p, 2) in A and weight
    (p,)."""
    rng = np.random.default_rng(seed)
    X_MN = rng.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi], (keyframes, 3))
    X_seen = X_MN + rng.normal(0.0, 0.03, X_MN.shape)
    told, looks, by, moments = [], [0], [], []
    for i in range(number):
        n = facing(rng.uniform(-np.pi, np.pi))
        frame = np.append(rng.uniform(-3.0, 3.0, 2), n)
        own = np.sort(rng.permutation(keyframes)[: rng.integers(2, keyframes + 1)]) if i else np.arange(keyframes)
        keyframe = np.repeat(own, rng.integers(1, 7, len(own)))
        size = (len(keyframe), 1)
        p_M = frame[:2] + rng.uniform(-0.15, 0.15, size) * [-n[1], n[0]] + rng.normal(0.0, 0.02, size) * n
        p = np.vstack([se2.transform(se2.inverse(X_seen[k]), p_M[keyframe == k]) for k in own])
        w = rng.uniform(500.0, 2500.0, len(p))
        told.append((frame, keyframe, p, w))
        looks.append(looks[-1] + len(own))
        by += own.tolist()
        x, y = p.T
        terms = w * np.array([np.ones(len(x)), x, y, x * x, x * y, y * y])
        moments += [terms[:, keyframe == k].sum(axis=1) for k in own]
    frames = np.array([frame for frame, *_ in told])
    return Pieces(frames, np.array(looks), np.array(by), np.array(moments)), X_MN, told


def off_line(told, x):
    """Distances of all points from a piece, and its slope, in standard deviations: x holds poses, offset and slope."""
    (m_x, m_y, n_x, n_y), keyframe, p, w = told
    X, (offset, slope) = x[:-2].reshape(-1, 3)[keyframe], x[-2:]
    c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
    d_x, d_y = X[:, 0] + c * p[:, 0] - s * p[:, 1] - m_x, X[:, 1] + s * p[:, 0] + c * p[:, 1] - m_y
    off = n_x * d_x + n_y * d_y - offset - slope * (n_x * d_y - n_y * d_x)
    return np.append(np.sqrt(w) * off, slope / SLOPE)


def jacobian(residual, x):
    """By complex steps."""
    return np.array([residual(x + 1e-30j * row).imag / 1e-30 for row in np.eye(len(x))]).T


def best_line(told, X_MN):
    """The poses, and the offset and slope that are best there."""
    x = np.append(X_MN.ravel(), [0.0, 0.0])
    J = jacobian(lambda at: off_line(told, at), x.astype(complex))[:, -2:]
    return np.append(X_MN.ravel(), np.linalg.lstsq(J, -off_line(told, x), rcond=None)[0])


def expected_of(every, X_MN):
    """Twice the cost of pieces, gradient and Hessian of the poses: offsets and slopes eliminated from the whole."""
    size = X_MN.size
    total, gradient, H = 0.0, np.zeros(size), np.zeros((size, size))
    for told in every:
        x = best_line(told, X_MN)
        e, J = off_line(told, x), jacobian(lambda at, told=told: off_line(told, at), x.astype(complex))
        whole = J.T @ J
        total += e @ e
        gradient += (J.T @ e)[:size]
        H += whole[:size, :size] - whole[:size, size:] @ np.linalg.solve(whole[size:, size:], whole[size:, :size])
    return total, gradient, H


def added(pieces, X_MN, node_at, size, which=None):
    """Twice the cost, gradient and block."""
    block, gradient = np.zeros((size, size)), np.zeros(size)
    which = np.arange(len(pieces.frame)) if which is None else np.array(which, dtype=np.int64)
    return add_pieces(which, pieces, X_MN, node_at, block, gradient), gradient, block


@pytest.mark.parametrize("seed", range(5))
def test_pieces_are_least_squares_with_offset_and_slope(seed):
    pieces, X_MN, told = explicit(seed)
    node_at = 3 * np.arange(5)
    total, gradient, H = expected_of(told, X_MN)
    found_total, found_gradient, block = added(pieces, X_MN, node_at, 15)
    assert found_total == pytest.approx(total, rel=1e-9)
    np.testing.assert_allclose(found_gradient, gradient, atol=1e-9 * np.abs(gradient).max())
    np.testing.assert_allclose(block, H, atol=1e-9 * np.abs(H).max())
    np.testing.assert_allclose(block, block.T, atol=1e-12 * np.abs(H).max())
    assert np.linalg.eigvalsh(0.5 * (block + block.T)).min() > -1e-9 * np.abs(H).max()

    def least(at):
        return 0.5 * sum(np.sum(off_line(one, best_line(one, at.reshape(-1, 3))) ** 2) for one in told)

    x, step = X_MN.ravel(), 1e-5
    by_differences = [(least(x + step * row) - least(x - step * row)) / (2.0 * step) for row in np.eye(15)]
    np.testing.assert_allclose(found_gradient, by_differences, atol=1e-6 * np.abs(gradient).max())


def test_pieces_are_added_each_where_their_unknowns_are():
    """Before and after are summed; a piece that is not asked for adds nothing; poses may have any unknowns."""
    pieces, X_MN, told = explicit(3)
    node_at, rng = np.array([12, 3, 20, 7, 0]), np.random.default_rng(0)
    at = (node_at[:, None] + [0, 1, 2]).ravel()
    block, gradient = rng.normal(size=(24, 24)), rng.normal(size=24)
    more, further = block.copy(), gradient.copy()
    total = add_pieces(np.array([1, 4]), pieces, X_MN, node_at, more, further)
    expected, expected_gradient, H = expected_of([told[1], told[4]], X_MN)
    assert total == pytest.approx(expected, rel=1e-9)
    gradient[at] += expected_gradient
    block[np.ix_(at, at)] += H
    np.testing.assert_allclose(further, gradient, atol=1e-9 * np.abs(expected_gradient).max())
    np.testing.assert_allclose(more, block, atol=1e-9 * np.abs(H).max())


@pytest.mark.parametrize("fixed", [[0], [2], [1, 4]])
def test_a_pose_that_is_no_unknown_has_no_rows(fixed):
    pieces, X_MN, told = explicit(4)
    free = np.setdiff1d(np.arange(5), fixed)
    node_at = np.full(5, -19)
    node_at[free] = 3 * np.arange(len(free))
    total, gradient, H = expected_of(told, X_MN)
    rows = (3 * free[:, None] + [0, 1, 2]).ravel()
    # Three unknowns more that are of no pose.
    found_total, found_gradient, block = added(pieces, X_MN, node_at, len(rows) + 3)
    assert found_total == pytest.approx(total, rel=1e-9)
    np.testing.assert_allclose(found_gradient[:-3], gradient[rows], atol=1e-9 * np.abs(gradient).max())
    np.testing.assert_allclose(block[:-3, :-3], H[np.ix_(rows, rows)], atol=1e-9 * np.abs(H).max())
    assert not found_gradient[-3:].any()
    assert not block[-3:].any()
    assert not block[:, -3:].any()


def test_without_a_block_only_the_gradient_is_added():
    pieces, X_MN, _ = explicit(5)
    node_at, without = np.array([-1, 0, 3, 6, 9]), np.ones(12)
    expected, gradient, _ = added(pieces, X_MN, node_at, 12)
    assert add_pieces(np.arange(6), pieces, X_MN, node_at, NO_BLOCK, without) == expected
    np.testing.assert_allclose(without, 1.0 + gradient, rtol=1e-12)


@pytest.mark.parametrize("move", [[3.0, -1.0, 0.0], [0.0, 0.0, 2.5], [-7.0, 4.0, -1.2]])
def test_pieces_tell_nothing_of_where_all_poses_are(move):
    """Cost and Hessian move with poses and frames; where only the poses are shifted, the offsets take all."""
    pieces, X_MN, _ = explicit(6)
    node_at = 3 * np.arange(5)
    moved = pieces._replace(frame=moved_points(np.array(move), pieces.frame))
    total, gradient, block = added(pieces, X_MN, node_at, 15)
    there = added(moved, se2.compose(np.array(move), X_MN), node_at, 15)
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(move[2])
    turn = np.kron(np.eye(5), turn)
    assert there[0] == pytest.approx(total, rel=1e-9)
    np.testing.assert_allclose(there[1], turn @ gradient, atol=1e-9 * np.abs(gradient).max())
    np.testing.assert_allclose(there[2], turn @ block @ turn.T, atol=1e-9 * np.abs(block).max())
    shift = np.tile([0.2, -0.1, 0.0], 5)
    assert added(pieces, X_MN + shift.reshape(5, 3), node_at, 15)[0] == pytest.approx(total, rel=1e-9)
    assert abs(shift @ gradient) < 1e-9 * np.abs(gradient).max()
    assert np.abs(block @ shift).max() < 1e-9 * np.abs(block).max()


INFORMATION = np.array([[400.0, 90.0, -30.0], [90.0, 250.0, 60.0], [-30.0, 60.0, 900.0]])


def some_ties(seed):
    """Ties between four poses, that are off by little; headings and turns go over +-pi, and round more than once."""
    rng = np.random.default_rng(seed)
    X_MN = rng.uniform(-3.0, 3.0, (4, 3))
    X_MN[:, 2] = [3.1, -3.1, -0.2, 3.0]
    first, second = np.array([0, 1, 3, 2, 0]), np.array([1, 0, 2, 1, 3])
    X_AB = se2.between(X_MN[first], X_MN[second]) + rng.normal(0.0, 0.1, (5, 3))
    X_AB[:, 2] += 2.0 * np.pi * np.array([0, 0, 1, -2, 0])
    return Ties(first, second, X_AB, INFORMATION * np.arange(1.0, 6.0)[:, None, None]), X_MN


def off_tie(ties, t, x):
    """By how much a tie is off where the poses are x, which may be complex."""
    A, B = x.reshape(-1, 3)[[ties.first[t], ties.second[t]]]
    c, s = np.cos(A[2]), np.sin(A[2])
    apart = np.array([[c, s], [-s, c]]) @ (B - A)[:2] - ties.X_AB[t, :2]
    turn = B[2] - A[2] - ties.X_AB[t, 2]
    return np.append(apart, turn - 2.0 * np.pi * np.round(turn.real / (2.0 * np.pi)))


def ties_by_hand(ties, X_MN, which):
    total, gradient, H = 0.0, np.zeros(X_MN.size), np.zeros((X_MN.size, X_MN.size))
    for t in which:
        e = off_tie(ties, t, X_MN.ravel())
        J = jacobian(lambda x, t=t: off_tie(ties, t, x), X_MN.ravel().astype(complex))
        total += e @ ties.information[t] @ e
        gradient += J.T @ ties.information[t] @ e
        H += J.T @ ties.information[t] @ J
    return total, gradient, H


@pytest.mark.parametrize("seed", range(3))
def test_ties_are_least_squares_of_relative_poses(seed):
    ties, X_MN = some_ties(seed)
    every, node_at, block, gradient = np.arange(5), 3 * np.arange(4), np.zeros((12, 12)), np.zeros(12)
    total = add_ties(every, ties, X_MN, node_at, block, gradient)
    # All are nearly where they are to be, whichever way round.
    assert 0.0 < total < 15 * 900.0 * 0.3**2
    expected = ties_by_hand(ties, X_MN, every)
    assert total == pytest.approx(expected[0], rel=1e-12)
    np.testing.assert_allclose(gradient, expected[1], atol=1e-10 * np.abs(gradient).max())
    np.testing.assert_allclose(block, expected[2], atol=1e-12 * np.abs(block).max())

    def cost(x):
        return 0.5 * add_ties(every, ties, x.reshape(4, 3), node_at, NO_BLOCK, np.zeros(12))

    x, step = X_MN.ravel(), 1e-6
    by_differences = [(cost(x + step * row) - cost(x - step * row)) / (2.0 * step) for row in np.eye(12)]
    np.testing.assert_allclose(gradient, by_differences, atol=1e-6 * np.abs(gradient).max())


def test_a_tie_that_is_kept_costs_nothing_and_half_a_turn_off_most():
    for heading in (0.0, 3.1, -np.pi):
        X_MN = np.array([[1.0, 2.0, heading], [0.0, 0.0, 0.0]])
        X_MN[1] = se2.compose(X_MN[0], np.array([0.5, -0.2, 0.2]))
        for turn, off in ((0.2, 0.0), (0.2 + 4.0 * np.pi, 0.0), (3.2, 3.0), (-2.8, 3.0), (3.7, 2.0 * np.pi - 3.5)):
            ties = Ties(np.array([0]), np.array([1]), np.array([[0.5, -0.2, turn]]), np.eye(3)[None])
            total = add_ties(np.array([0]), ties, X_MN, np.array([-1, -1]), NO_BLOCK, np.zeros(3))
            assert total == pytest.approx(off**2, abs=1e-9)


def test_ties_are_added_each_where_their_unknowns_are():
    ties, X_MN = some_ties(7)
    node_at = np.array([4, -19, 0, 9])
    block, gradient, without = np.ones((13, 13)), np.ones(13), np.ones(13)
    which = np.array([0, 2, 4])
    total = add_ties(which, ties, X_MN, node_at, block, gradient)
    expected = ties_by_hand(ties, X_MN, which)
    free = np.array([0, 2, 3])
    at, rows = (node_at[free][:, None] + [0, 1, 2]).ravel(), (3 * free[:, None] + [0, 1, 2]).ravel()
    whole, of_each = np.ones((13, 13)), np.ones(13)
    whole[np.ix_(at, at)] += expected[2][np.ix_(rows, rows)]
    of_each[at] += expected[1][rows]
    assert total == pytest.approx(expected[0], rel=1e-12)
    np.testing.assert_allclose(block, whole, atol=1e-10 * np.abs(whole).max())
    np.testing.assert_allclose(gradient, of_each, atol=1e-10 * np.abs(of_each).max())
    assert add_ties(which, ties, X_MN, node_at, NO_BLOCK, without) == total
    np.testing.assert_array_equal(without, gradient)
    assert add_ties(np.arange(0), no_ties(), X_MN, node_at, NO_BLOCK, without) == 0.0


def ring_of_surfaces(tag_error):
    """A ring of tags, passed twice, with surfaces beside the way, and ties between the laps; values near the truth."""
    keyframes, p_ML, X_MN = ring(2, views=48, laps=2.0, tags=60, tag_error=tag_error if tag_error.any() else None)
    graph, rng = reckoned(keyframes), np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, 24)
    middle = X_MN[:48:2, :2] + rng.uniform(-2.0, 2.0, (24, 2))
    ends = [
        (p - 0.5 * facing(a), p + 0.5 * facing(a), facing(a + 0.5 * np.pi)) for p, a in zip(middle, angle, strict=True)
    ]
    every, seen = np.vstack([board(*one) for one in ends]), []
    for one, X_MA in zip(keyframes, X_MN, strict=False):
        near = every[np.hypot(*(every[:, :2] - X_MA[:2]).T) < 3.0]
        near = near + rng.normal(0.0, [0.01, 0.01, 0.0, 0.0], near.shape)
        seen.append(replace(one, points=moved_points(se2.inverse(X_MA), near)))
    first = np.array([0, 10, 40, 2, len(seen) - 1])
    second = np.array([48, 58, 60, 1, 0])
    X_AB = se2.between(X_MN[first], X_MN[second]) + rng.normal(0.0, 0.02, (5, 3))
    return replace(
        graph,
        keyframes=tuple(seen),
        X_MN=np.vstack([np.zeros(3), X_MN[1:] + rng.normal(0.0, 0.01, X_MN[1:].shape)]),
        p_ML=p_ML[graph.ids - 100] + rng.normal(0.0, 0.01, (len(graph.ids), 2)),
        tag_error=tag_error,
        ties=Ties(first, second, X_AB, np.tile(INFORMATION, (len(first), 1, 1))),
    )


def whole_system(factors, values):
    """Twice the cost, gradient and information, dense: by landmarks, poses, tags' errors and parameters."""
    n, k = len(values.p_ML), len(values.X_MN) - 1
    of_errors = 2 * n if factors.has_errors else 0
    size = 2 * n + 3 * k + of_errors + SHARED
    error_at = 2 * n + 3 * k + 2 * np.arange(n) if of_errors else np.full(n, NONE)
    u = Unknowns(2 * np.arange(n), np.append(NONE, 2 * n + 3 * np.arange(k)), size - SHARED, error_at)
    H, gradient, places = np.zeros((size, size)), np.zeros(size), np.empty((len(factors.keyframes.rows), 2, 3))
    error = assemble(np.arange(k), factors.keyframes, values, u, H, gradient, places)
    error += add_pieces(np.arange(len(factors.pieces.frame)), factors.pieces, values.X_MN, u.node_at, H, gradient)
    error += add_ties(np.arange(len(factors.ties.first)), factors.ties, values.X_MN, u.node_at, H, gradient)
    H[-SHARED:, -SHARED:] += factors.information
    if of_errors:
        i = error_at[:, None] + [0, 1]
        H[i, i] += factors.of_errors
    return error + factors.priors(values, u, gradient), gradient, H, u


@pytest.mark.parametrize("tag_error", [np.zeros(2), np.array([0.03, 0.01])], ids=["exact tags", "tags with errors"])
def test_the_solver_has_pieces_and_ties_as_a_dense_system_has(tag_error):
    graph = ring_of_surfaces(tag_error)
    solver = DissectionSolver(graph)
    factors, k, n = solver.factors, len(graph.keyframes), len(graph.ids)
    fronts, pieces = solver._dissection.fronts, factors.pieces
    assert k > 2 * dissection.LEAF
    # Each piece and tie is in one front, some in leaves, some above; and what is between is eliminated there or above.
    assert sorted(np.concatenate([one.pieces for one in fronts])) == list(range(len(pieces.frame) + 5))
    assert sum(len(one.pieces) for one in fronts if one.halves) > 10
    assert sum(len(one.pieces) for one in fronts if not one.halves) > 10
    assert len(fronts[-1].pieces) > 0
    rng = np.random.default_rng(1)
    values = Values(
        graph.X_MN.copy(),
        graph.p_ML.copy(),
        1e-7 * rng.normal(size=SHARED),
        np.asarray(rng.normal(size=(n, 2)) * tag_error),
    )
    error, gradient, H, u = whole_system(factors, values)
    pairs, triples = np.array([0, 1]), np.arange(3)

    def in_order(of):
        """Unknowns in the order of the dense system."""
        parts = [of.landmark_at[:, None] + pairs, of.node_at[1:, None] + triples]
        parts += [of.error_at[:, None] + pairs] if factors.has_errors else []
        return np.concatenate([*(part.ravel() for part in parts), of.shared_at + np.arange(SHARED)])

    np.testing.assert_array_equal(in_order(u), np.arange(len(H)))
    at, system = in_order(solver.unknowns), solver.linearised(values, 0.0)
    assert sorted(at) == list(range(len(H)))
    only, again = solver.gradient(values)
    assert system.error == pytest.approx(error, rel=1e-10)
    assert again == pytest.approx(error, rel=1e-10)
    np.testing.assert_allclose(system.gradient[at], gradient, atol=1e-10 * np.abs(gradient).max())
    np.testing.assert_allclose(only[at], gradient, atol=1e-10 * np.abs(gradient).max())
    # In units of what is known of each.
    unit = 1.0 / np.sqrt(np.diag(H))
    expected = unit * np.linalg.solve(unit[:, None] * H * unit, -unit * gradient)
    deviation = np.sqrt(unit**2 * np.diag(np.linalg.inv(unit[:, None] * H * unit)))
    np.testing.assert_allclose(system.solution(-system.gradient)[at] / deviation, expected / deviation, atol=1e-6)
    log_determinant = np.linalg.slogdet(unit[:, None] * H * unit)[1] - 2.0 * np.log(unit).sum()
    assert system.log_determinant == pytest.approx(log_determinant, abs=1e-6)
    # And without them it is another.
    bare = replace(graph, keyframes=tuple(replace(one, points=np.empty((0, 4))) for one in graph.keyframes))
    for other, least in ((bare, 100.0), (replace(graph, ties=no_ties()), 1.0)):
        assert DissectionSolver(other).linearised(values, 0.0).error < error - least


# A room of 6 m by 4 m with a box in its middle, by points with normals towards the free space.
ROOM = np.vstack(
    [
        board([0.0, 0.0], [6.0, 0.0], [0.0, 1.0]),
        board([6.0, 0.0], [6.0, 4.0], [-1.0, 0.0]),
        board([6.0, 4.0], [0.0, 4.0], [0.0, -1.0]),
        board([0.0, 4.0], [0.0, 0.0], [1.0, 0.0]),
        board([2.5, 1.7], [3.7, 1.7], [0.0, -1.0]),
        board([3.7, 1.7], [3.7, 2.3], [1.0, 0.0]),
        board([3.7, 2.3], [2.5, 2.3], [0.0, 1.0]),
        board([2.5, 2.3], [2.5, 1.7], [-1.0, 0.0]),
    ]
)


def walk(seed, keyframes, laps, deviation):
    """A graph of ways round the room, each off by so much, m and rad, with what is seen from where each begins; and
    the true poses."""
    rng, angle = np.random.default_rng(seed), 2.0 * np.pi * laps * np.arange(keyframes + 1) / keyframes
    X_WN = np.column_stack([3.1 + 2.0 * np.cos(angle), 2.0 + 1.2 * np.sin(angle), se2.wrap_angle(angle + 1.5)])
    graph = empty_graph(exactly_known())
    for X_WA, X_WD in pairwise(X_WN):
        X_AD = se2.between(X_WA, X_WD) + deviation * rng.normal(size=3)
        off = X_WA[:2] - ROOM[:, :2]
        seen = ROOM[(np.hypot(*off.T) < 4.0) & (np.sum(off * ROOM[:, 2:], axis=1) > 0.0)]
        one = replace(way(X_AD, np.diag(deviation**2)), points=moved_points(se2.inverse(X_WA), seen))
        graph = extended(graph, one, se2.compose(graph.X_MN[-1], X_AD), is_view=False)
    return graph, se2.between(X_WN[0], X_WN)


def off_by(graph, X_MN):
    """By how much the poses from which something is seen are off, m and rad."""
    apart = se2.between(X_MN[:-1], graph.X_MN[:-1])
    return np.hypot(*apart[:, :2].T).max(), np.abs(apart[:, 2]).max()


@pytest.mark.parametrize("seed", range(3))
def test_rough_odometry_comes_back_to_the_room(seed):
    graph, X_MN = walk(seed, 50, 1.5, np.array([0.02, 0.02, 0.01]))
    rough = off_by(graph, X_MN)
    assert rough[0] > 0.2
    for _ in range(4):
        graph, estimate = solve(graph, 0.0, NOTHING)
    there = off_by(graph, X_MN)
    assert there[0] < 0.004
    assert there[1] < 0.002
    # Of the newest pose nothing tells but odometry: from one that is known well.
    assert 0.019 < math.sqrt(estimate.covariance[0, 0]) < 0.022


def test_what_looks_have_in_common_is_as_uneven_as_the_walls():
    """A keyframe that sees a piece of surface by ever so many points tells no more than by how uneven it is."""
    along = np.arange(-0.1, 0.1, 0.001)
    seen = np.column_stack([along, np.zeros((len(along), 2)), np.ones(len(along))])
    points = Points(
        np.repeat([0, 1], len(seen)), np.vstack([seen, seen]), np.zeros(2, dtype=np.int64), np.zeros((2, 3, 3))
    )
    for uneven in (0.0, 0.03):
        pieces = pieces_of(points, np.zeros((2, 3)), 0, uneven)
        most = len(pieces.moments) / (FLOOR**2 + uneven**2)
        assert 0.5 * most < pieces.moments[:, 0].sum() < most


def test_parts_of_the_map_between_which_the_way_is_unknown_have_no_surface_in_common():
    """Keyframes that seem to lie in one place tie each other within a part only."""
    along = np.arange(-0.5, 0.5, 0.01)
    seen = np.column_stack([along, np.zeros((len(along), 2)), np.ones(len(along))])
    points = Points(
        np.repeat(np.arange(4), len(seen)), np.tile(seen, (4, 1)), np.array([0, 0, 1, 1]), np.zeros((4, 3, 3))
    )
    pieces = pieces_of(points, np.zeros((4, 3)), 0)
    together = {tuple(pieces.keyframe[a:b].tolist()) for a, b in zip(pieces.looks, pieces.looks[1:], strict=False)}
    assert together == {(0, 1), (2, 3)}


@pytest.mark.parametrize("seed", range(3))
def test_looks_of_scans_that_lie_off_each_other_are_worth_less(seed):
    """As if each of a keyframe's n looks had n times the variance that its points get along their normal."""
    seen, X_MN = clutter(seed)
    points, rng = points_of(seen, X_MN), np.random.default_rng(seed)
    roots = rng.normal(0.0, [[0.004], [0.004], [0.002]], (len(X_MN), 3, 3))
    scatter = roots @ roots.transpose(0, 2, 1)
    sure, worse = (pieces_of(points._replace(scatter=of), frozen(X_MN), seed) for of in (points.scatter, scatter))
    looks = np.bincount(sure.keyframe)
    for look, (piece, k) in enumerate(zip(sure.piece, sure.keyframe, strict=True)):
        S = sure.moments[look]
        c, s = np.cos(X_MN[k, 2]), np.sin(X_MN[k, 2])
        a_x, a_y = np.array([[c, s], [-s, c]]) @ sure.frame[piece, 2:]
        # The points' distances change by a . (x, y) with a move of A, and by a_y x - a_x y with its turn.
        J = np.array([[a_x, 0.0, 0.0], [a_y, 0.0, 0.0], [0.0, a_y, -a_x]])
        total = np.array([[S[0], S[1], S[2]], [S[1], S[3], S[4]], [S[2], S[4], S[5]]])
        over = np.trace(scatter[k] @ J @ total @ J.T)
        np.testing.assert_allclose(worse.moments[look], S / (1.0 + looks[k] * over), rtol=1e-9)


def scans_of_a_turn(rng, error):
    """Six scans of a turn in place, a room's walls as each sees them in a quarter of a turn; where they were taken from
    and where they are thought to have been, with ties."""
    corners = np.array([[-2.0, -1.5], [2.5, -1.5], [2.5, 2.0], [-2.0, 2.0]])
    walls = [
        np.column_stack([a + np.arange(0.0, 1.0, 0.02)[:, None] * (b - a), np.tile([-(b - a)[1], (b - a)[0]], (50, 1))])
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    room = np.vstack(walls)
    room[:, 2:] /= np.hypot(room[:, 2], room[:, 3])[:, None]
    X_AB = np.column_stack([np.zeros((6, 2)), np.arange(6) * 0.8])
    seen = []
    for X in X_AB:
        p = moved_points(se2.inverse(X), room)
        p = p[np.abs(np.arctan2(p[:, 1], p[:, 0])) < 1.0]
        seen.append(p + rng.normal(0.0, [0.005, 0.005, 0.0, 0.0], p.shape))
    thought = X_AB.copy()
    thought[:, 2] *= 1.0 + error
    way = np.diag([0.002, 0.002, max(0.8 * error, 0.001)]) ** 2
    first = np.arange(5)
    ties = Ties(first, first + 1, se2.between(thought[:-1], thought[1:]), np.tile(np.linalg.inv(way), (5, 1, 1)))
    return seen, X_AB, thought, ties


@pytest.mark.parametrize("seed", range(3))
def test_scans_of_a_turn_that_was_measured_wrongly_are_put_together(seed):
    seen, X_AB, thought, ties = scans_of_a_turn(np.random.default_rng(seed), 0.02)
    points, scatter = put_together(seen, thought, ties, 0.0)
    true = np.vstack([moved_points(X, p) for X, p in zip(X_AB, seen, strict=True)])
    wrong = np.vstack([moved_points(X, p) for X, p in zip(thought, seen, strict=True)])
    off, before = (np.hypot(*(p - true)[:, :2].T).max() for p in (points, wrong))
    assert before > 0.15
    assert off < 0.03
    assert np.all(np.linalg.eigvalsh(scatter) > 0.0)
    assert 0.0005 < math.sqrt(scatter[2, 2]) < 0.01
    # Of what is seen by one scan alone nothing tells but the ties.
    alone, _ = put_together([p[:0] if k % 5 else p for k, p in enumerate(seen)], thought, ties, 0.0)
    np.testing.assert_allclose(alone[-len(seen[5]) :], moved_points(thought[5], seen[5]), atol=1e-9)


def test_one_scan_lies_where_it_was_taken_and_is_off_none():
    seen, X_AB, *_ = scans_of_a_turn(np.random.default_rng(0), 0.0)
    none = Ties(np.arange(0), np.arange(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    points, scatter = put_together(seen[3:4], X_AB[3:4], none, 0.0)
    np.testing.assert_allclose(points, moved_points(X_AB[3], seen[3]), atol=1e-12)
    assert not scatter.any()
    points, scatter = put_together([], X_AB[:0], none, 0.0)
    assert points.shape == (0, 4)
    assert not scatter.any()


@pytest.mark.parametrize("seed", range(2))
def test_the_scatter_is_that_of_brute_force(seed):
    """The mean over scans of the covariance of a scan's move of A less that of all."""
    rng = np.random.default_rng(seed)
    seen, _, thought, ties = scans_of_a_turn(rng, 0.01)
    seen = [p[:0] for p in seen]  # By the ties alone: a chain of six.
    _, scatter = put_together(seen, thought, ties, 0.0)
    draws = rng.multivariate_normal(np.zeros(3), np.linalg.inv(ties.information[0]), (20000, 5))
    moves = np.zeros((20000, 6, 3))
    X = np.zeros((20000, 3))
    for k in range(5):
        c, s = np.cos(thought[k, 2]), np.sin(thought[k, 2])
        step, there = draws[:, k], ties.X_AB[k]
        turned = step[:, :2] @ np.array([[c, s], [-s, c]])
        lever = np.array([[c, -s], [s, c]]) @ there[:2]
        X = X + np.column_stack([turned + X[:, 2:] * [-lever[1], lever[0]], step[:, 2]])
        moves[:, k + 1] = X
        moves[:, k + 1, 0] += thought[k + 1, 1] * X[:, 2]
        moves[:, k + 1, 1] -= thought[k + 1, 0] * X[:, 2]
    off = moves - moves.mean(axis=1, keepdims=True)
    expected = np.einsum("nki,nkj->ij", off, off) / (20000 * 6)
    np.testing.assert_allclose(scatter, expected, atol=0.06 * np.sqrt(np.outer(*[np.diag(expected)] * 2)).max())

"""Loops that are found by what a robot sees, and closed where the surfaces agree."""

import math

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import loop_search
from tfg_drake.slam.keyframe import moved_points, way
from tfg_drake.slam.keyframe_graph import empty_graph, no_observation
from tfg_drake.slam.loop_search import LoopSearch, bent, searched, with_loops_closed
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.shared import exactly_known

SIGMA = np.array([0.05, 0.01])


def surfaces(seed=0):
    """(p, 4) points with normals of a ring of corridor with furniture, 24 x 14 m, about the origin."""
    rng = np.random.default_rng(seed)
    parts = []
    for half_x, half_y, sign in ((12.0, 7.0, -1.0), (9.0, 4.0, 1.0)):
        x, y = np.arange(-half_x, half_x, 0.05), np.arange(-half_y, half_y, 0.05)
        for side in (-1.0, 1.0):
            parts.append(np.column_stack([x, np.full(len(x), side * half_y), 0.0 * x, np.full(len(x), sign * side)]))
            parts.append(np.column_stack([np.full(len(y), side * half_x), y, np.full(len(y), sign * side), 0.0 * y]))
    for _ in range(60):
        middle, angle = rng.uniform([-12.0, -7.0], [12.0, 7.0]), rng.uniform(0.0, 2.0 * math.pi)
        n, along = np.array([math.cos(angle), math.sin(angle)]), np.arange(-0.4, 0.4, 0.05)[:, None]
        parts.append(np.hstack([middle + along * [-n[1], n[0]], np.tile(n, (len(along), 1))]))
    return np.vstack(parts)


def true_way(steps):
    """(n, 3) poses half a metre apart along the middle of the corridor, counterclockwise."""
    corners = np.array([[-10.5, -5.5], [10.5, -5.5], [10.5, 5.5], [-10.5, 5.5]])
    poses, at, theta = [], corners[0].copy(), 0.0
    side = 1
    for _ in range(steps):
        poses.append([*at, theta])
        to = corners[side % 4] - at
        if np.hypot(*to) < 0.5:
            side, theta = side + 1, theta + 0.5 * math.pi
            to = corners[side % 4] - at
        at += 0.5 * to / np.hypot(*to)
    return np.array(poses)


def driven(steps, drift=0.004, seed=1):
    """A graph of views with scan points whose way turns by a drift, rad, each step; the true poses (n + 1, 3)."""
    seen, truth, rng = surfaces(), true_way(steps + 1), np.random.default_rng(seed)
    keyframes, X = [], [np.zeros(3)]
    for k in range(steps):
        near = seen[np.hypot(*(seen[:, :2] - truth[k, :2]).T) < 4.0]
        near = near[rng.permutation(len(near))[:120]]
        points = moved_points(se2.inverse(truth[k]), near) + rng.normal(0.0, [0.01, 0.01, 0.0, 0.0], (len(near), 4))
        step = se2.between(truth[k], truth[k + 1]) + np.array([0.0, 0.0, drift])
        keyframes.append(replace(way(step, np.diag([0.02, 0.02, 0.01]) ** 2), points=points))
        X.append(se2.compose(X[-1], step))
    graph = replace(
        empty_graph(exactly_known()),
        keyframes=tuple(keyframes),
        X_MN=np.array(X),
        view_keyframe=np.arange(steps),
        X_AV=np.zeros((steps, 3)),
    )
    return graph, se2.between(truth[0], truth)


ROUND = 2 * (42 + 22) + 8


@pytest.fixture(scope="module")
def back():
    """A robot that has come round, its way bent by drift."""
    return driven(ROUND)


def test_a_loop_is_found_after_coming_back_and_believed_once_another_agrees():
    graph, truth = driven(ROUND, drift=0.001)
    search, first, believed = LoopSearch(), None, ()
    for views in range(60, ROUND + 1):
        here = replace(graph, view_keyframe=graph.view_keyframe[:views], X_AV=graph.X_AV[:views])
        search, believed = searched(search, here, SIGMA)
        if search.candidates and first is None:
            first = views
            assert believed == ()
        if believed:
            break
    assert first > ROUND - 16
    assert len(believed) >= 2
    for loop in believed:
        off = se2.between(loop.X_AB, se2.between(truth[loop.old], truth[loop.newest]))
        assert (np.abs(off) < [0.1, 0.1, 0.03]).all()
    again, none = searched(search, here, SIGMA)
    assert again is search
    assert none == ()


def loops(truth, pairs, off=(0.0, 0.0, 0.0)):
    return tuple(
        loop_search.Loop(old, newest, se2.between(truth[old], truth[newest]) + np.array(off)) for old, newest in pairs
    )


def test_a_way_is_bent_to_its_loops_evenly(back):
    graph, truth = back
    (one,) = loops(truth, [(1, ROUND - 3)])
    after = bent(graph, (), (one,))
    closed = se2.between(after.X_MN[1], after.X_MN[ROUND - 3])
    np.testing.assert_allclose(closed, one.X_AB, atol=0.03)
    np.testing.assert_array_equal(after.X_MN[0], graph.X_MN[0])
    before = se2.between(graph.X_MN[:-1], graph.X_MN[1:])
    change = se2.between(before, se2.between(after.X_MN[:-1], after.X_MN[1:]))
    assert np.abs(change).max() < 0.06
    # One that was closed before stays.
    (old,) = loops(after.X_MN, [(4, ROUND - 6)])
    again = bent(after, (old,), loops(truth, [(2, ROUND - 1)]))
    kept = se2.between(again.X_MN[4], again.X_MN[ROUND - 6])
    np.testing.assert_allclose(kept, old.X_AB, atol=0.1)


def test_a_loop_within_one_keyframe_bends_nothing():
    """Its views are in a keyframe that others were fused with."""
    graph, truth = driven(6)
    graph = replace(graph, view_keyframe=np.array([0, 0, 2, 3, 4, 5]))
    within, other = loops(truth, [(0, 1), (2, 5)])
    np.testing.assert_array_equal(bent(graph, (within,), (other,)).X_MN, bent(graph, (), (other,)).X_MN)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (1.0, 0.6, 0.0)], ids=["true", "false"])
def test_a_loop_stays_only_where_the_surfaces_agree(back, monkeypatch, off):
    graph, truth = back
    graph, estimate = solve(graph, 0.0, no_observation())
    last = ROUND - 1
    assert np.hypot(*(graph.X_MN[last] - truth[last])[:2]) > 1.0
    new = loops(truth, [(0, last - 2), (2, last)], off)
    monkeypatch.setattr(loop_search, "searched", lambda search, *_: (search, new))
    search, after, told = with_loops_closed(LoopSearch(), graph, estimate, no_observation())
    if any(off):
        assert (after, told) == (graph, estimate)
        assert (search.closed, search.tied) == ((), 0)
    else:
        assert np.hypot(*(after.X_MN[last] - truth[last])[:2]) < 0.1
        assert (search.closed, search.tied) == (new, last)
        again, same, _ = with_loops_closed(search, after, told, no_observation())
        assert same is after
        assert again.closed == new

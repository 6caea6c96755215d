import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, S, X

from tests.slam.rings import reckoned, ring
from tfg_drake.config import SOLVERS
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam.gtsam_solver import map_graph
from tfg_drake.slam.keyframe import moved_points, way
from tfg_drake.slam.map_solver import solved
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import factors_of


@pytest.fixture(scope="module")
def graph():
    """A ring of tags, and short surfaces beside it that scan points tell."""
    keyframes, _, X_MN = ring(2, laps=1.05)
    bare, rng = reckoned(keyframes), np.random.default_rng(0)
    bare = solved(bare, np.arange(3), 1)[0]
    middle = X_MN[::2, :2] + rng.uniform(-2.0, 2.0, (len(X_MN[::2]), 2))
    angle, along = rng.uniform(0.0, 2.0 * np.pi, len(middle)), np.arange(-0.5, 0.5, 0.05)
    n = np.column_stack([np.cos(angle), np.sin(angle)])
    p = middle[:, None] + along[:, None] * n[:, None, ::-1] * [-1.0, 1.0]
    surfaces = np.concatenate([p, np.broadcast_to(n[:, None], p.shape)], axis=2).reshape(-1, 4)
    seen = []
    for one, X_MA in zip(keyframes, X_MN, strict=False):
        near = surfaces[np.hypot(*(surfaces[:, :2] - X_MA[:2]).T) < 4.0]
        near = near + rng.normal(0.0, [0.01, 0.01, 0.0, 0.0], near.shape)
        seen.append(replace(one, points=moved_points(se2.inverse(X_MA), near)))
    return replace(bare, keyframes=tuple(seen))


@pytest.mark.parametrize("local", [slice(None), slice(10, 70, 3)], ids=["all", "some"])
def test_both_solvers_come_to_the_same(graph, local):
    rows, last = np.arange(len(graph.ids))[local], len(graph.keyframes)
    (expected, by_dissection), (found, by_gtsam) = (
        solved(replace(graph, solver=solver), rows, last) for solver in SOLVERS
    )
    np.testing.assert_allclose(found.p_ML, expected.p_ML, atol=1e-6)
    np.testing.assert_allclose(found.X_MN, expected.X_MN, atol=1e-6)
    deviation = np.sqrt(np.diag(by_dissection))
    assert np.abs((by_gtsam - by_dissection) / np.outer(deviation, deviation)).max() < 1e-5
    assert abs(found.entropy - expected.entropy) < 1e-4


def test_a_pose_that_hangs_on_nothing_is_held_likewise(graph):
    unknown = way(np.array([1.0, 0.0, 0.3]), np.eye(3))
    unknown = replace(unknown, information=np.zeros_like(unknown.information))
    last = len(graph.keyframes) + 1
    adrift = replace(graph, keyframes=(*graph.keyframes, unknown), X_MN=np.vstack([graph.X_MN, [5.0, 1.0, 0.2]]))
    rows = np.arange(len(graph.ids))
    expected, found = (solved(replace(adrift, solver=solver), rows, last)[0] for solver in SOLVERS)
    np.testing.assert_allclose(found.X_MN, expected.X_MN, atol=1e-6)
    np.testing.assert_allclose(found.p_ML, expected.p_ML, atol=1e-6)


def test_the_map_is_the_optimum_of_the_graph_that_a_user_gets(graph):
    best = graph
    for _ in range(3):  # Pieces of surface are grouped by the values that a solve begins with.
        best = solved(best, np.arange(len(graph.ids)), 1)[0]
    factors, values = map_graph(best)
    assert factors.size() == 1 + len(best.keyframes) + len(factors_of(best).pieces.frame) > 1 + len(best.keyframes)
    np.testing.assert_array_equal(values.atVector(X(len(best.keyframes))), best.X_MN[-1])
    np.testing.assert_array_equal(values.atVector(S(0)), best.shared.mean)
    at_best = factors.error(values)
    for key, size in ((L(3), 2), (X(5), 3), (S(0), SHARED)):
        moved = gtsam.Values(values)
        moved.update(key, values.atVector(key) + 1e-3 * np.ones(size))
        assert factors.error(moved) > at_best
    again = gtsam.LevenbergMarquardtOptimizer(*map_graph(replace(best, p_ML=graph.p_ML))).optimize()
    np.testing.assert_allclose(again.atVector(L(3)), best.p_ML[3], atol=1e-4)


def test_errors_of_tags_are_refused(graph):
    with pytest.raises(ValueError, match="take the default solver"):
        solved(replace(graph, solver="gtsam", tag_error=np.array([0.01, 0.003])), np.arange(3), 1)

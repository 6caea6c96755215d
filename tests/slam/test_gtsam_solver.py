import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, S, X

from tests.slam.rings import reckoned, ring
from tfg_drake.messages import replace
from tfg_drake.slam.dissection import DissectionSolver
from tfg_drake.slam.gtsam_solver import GtsamSolver, map_graph
from tfg_drake.slam.keyframe import way
from tfg_drake.slam.map_solver import solved
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import Values


@pytest.fixture(scope="module")
def graph():
    keyframes, _, _ = ring(2, laps=1.05)
    return reckoned(keyframes)


@pytest.mark.parametrize("local", [slice(None), slice(10, 70, 3)], ids=["all", "some"])
def test_both_solvers_come_to_the_same(graph, local):
    rows, last = np.arange(len(graph.ids))[local], len(graph.keyframes)
    (expected, by_dissection), (found, by_gtsam) = (
        solved(graph, kind(graph), rows, last) for kind in (DissectionSolver, GtsamSolver)
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
    with pytest.raises(np.linalg.LinAlgError):
        GtsamSolver(adrift).linearised(
            Values(adrift.X_MN, adrift.p_ML, adrift.shared.mean, np.zeros_like(adrift.p_ML)), 0.0
        )
    rows = np.arange(len(graph.ids))
    expected, found = (solved(adrift, kind(adrift), rows, last)[0] for kind in (DissectionSolver, GtsamSolver))
    np.testing.assert_allclose(found.X_MN, expected.X_MN, atol=1e-6)
    np.testing.assert_allclose(found.p_ML, expected.p_ML, atol=1e-6)


def test_the_map_is_the_optimum_of_the_graph_that_a_user_gets(graph):
    best = solved(graph, DissectionSolver(graph), np.arange(len(graph.ids)), 1)[0]
    factors, values = map_graph(best)
    assert factors.size() == 1 + len(best.keyframes)
    np.testing.assert_array_equal(values.atVector(X(len(best.keyframes))), best.X_MN[-1])
    np.testing.assert_array_equal(values.atVector(S(0)), best.shared.mean)
    at_best = factors.error(values)
    for key, size in ((L(3), 2), (X(5), 3), (S(0), SHARED)):
        moved = gtsam.Values(values)
        moved.update(key, values.atVector(key) + 1e-3 * np.ones(size))
        assert factors.error(moved) > at_best
    again = gtsam.LevenbergMarquardtOptimizer(*map_graph(replace(graph, X_MN=best.X_MN))).optimize()
    np.testing.assert_allclose(again.atVector(L(3)), best.p_ML[3], atol=1e-4)


def test_errors_of_tags_are_refused(graph):
    with pytest.raises(ValueError, match="take DissectionSolver"):
        GtsamSolver(replace(graph, tag_error=np.array([0.01, 0.003])))

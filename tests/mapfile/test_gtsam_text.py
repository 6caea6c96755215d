import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, S, W, X

from tfg_drake.mapfile.gtsam_text import gtsam_texts
from tfg_drake.mapfile.saved_map import restored_estimate
from tfg_drake.messages import WALLS_BELOW, replace


def read(saved):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for archive, text in zip((graph, values), gtsam_texts(saved), strict=True):
        archive.deserialize(text)
    return graph, values


def test_gtsam_reads_back_the_maps_values_and_joint_covariance(small_map):
    graph, values = read(small_map)
    assert sorted(values.keys()) == sorted([L(10), L(11), L(12), L(13), X(1), X(2), X(3), S(0)])
    for row, tag in enumerate(small_map.ids.tolist()):
        np.testing.assert_array_equal(values.atVector(L(tag)), small_map.p_ML[row])
    estimate = restored_estimate(small_map)
    keys = [L(10), L(11), L(12), L(13), X(3)]
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys).fullMatrix()
    np.testing.assert_allclose(joint, estimate.covariance[:11, :11], rtol=1e-4, atol=1e-9)


def test_its_optimum_is_the_map(small_map):
    graph, values = read(small_map)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    for key in list(values.keys()):
        np.testing.assert_allclose(best.atVector(key), values.atVector(key), atol=1e-6)


def test_walls_have_names_of_their_own(small_map):
    ids = np.append(WALLS_BELOW + np.array([-2, -1]), small_map.ids[2:])
    keyframes = []
    for one in small_map.graph.keyframes:
        renamed = ids[np.searchsorted(small_map.ids, one.ids)]
        keyframes.append(replace(one, ids=renamed))
    walled = replace(small_map, graph=replace(small_map.graph, ids=ids, keyframes=tuple(keyframes)))
    graph, values = read(walled)
    assert set(values.keys()) == {W(1), W(0), L(12), L(13), X(1), X(2), X(3), S(0)}
    np.testing.assert_array_equal(values.atVector(W(1)), small_map.p_ML[0])
    assert {W(1), W(0), L(12), X(1), S(0)} == set(graph.at(1).keys())

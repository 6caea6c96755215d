import numpy as np
import pytest
import scipy.linalg

from tfg_drake.slam.dissection import dissected, eliminated, leaves

NOTHING = np.empty(0, dtype=np.int64)


def system(seed, keyframes=40, landmarks=60, omitted=(), most=6):
    """A graph on a strip, each keyframe with those of its 2-vectors that are near and a 3-vector of its own; what each
    says of its unknowns; and the whole information, dense."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([np.arange(keyframes), rng.uniform(size=keyframes)])
    places = np.column_stack([rng.uniform(0.0, keyframes - 1.0, landmarks), rng.uniform(size=landmarks)])
    near = np.abs(points[:, None, 0] - places[None, :, 0]) < 2.5
    keyframe, variable = np.nonzero(near)
    own, after = landmarks + np.arange(keyframes), landmarks + np.arange(1, keyframes)
    keyframe = np.concatenate([keyframe, np.arange(keyframes), np.arange(keyframes - 1)])
    variable = np.concatenate([variable, own, after])
    width = np.repeat([2, 3], [landmarks, keyframes])
    width[list(omitted)] = 0
    dissection = dissected(leaves(points, variable, keyframe, most), variable, keyframe, width, NOTHING, NOTHING)
    of_each, whole = [], np.zeros((dissection.size, dissection.size))
    for k in range(keyframes):
        mine = [v for v in variable[keyframe == k] if width[v]]
        at = np.concatenate([dissection.at[v] + np.arange(width[v]) for v in mine])
        root = rng.normal(size=(len(at), len(at)))
        of_each.append((at, root @ root.T + np.eye(len(at))))
        whole[np.ix_(at, at)] += of_each[-1][1]

    def block(front):
        information = np.zeros((len(front.unknowns), len(front.unknowns)))
        for k in front.keyframes:
            at = np.searchsorted(front.unknowns, of_each[k][0])
            information[np.ix_(at, at)] += of_each[k][1]
        return information

    return dissection, block, whole


@pytest.mark.parametrize(("omitted", "most"), [((), 6), ((7, 8, 9), 6), ((), 40), ((), 1)])
def test_is_a_dense_solution(omitted, most):
    dissection, block, whole = system(1, omitted=omitted, most=most)
    assert max(len(front.unknowns) for front in dissection.fronts) < 0.8 * len(whole) or most == 40
    elimination = eliminated(dissection, block)
    assert elimination.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-12)
    rng = np.random.default_rng(2)
    vector = rng.normal(size=len(whole))
    x = elimination.solution(vector)
    np.testing.assert_allclose(x, np.linalg.solve(whole, vector), atol=1e-9 * np.abs(x).max())
    for count in (0, 1, 30, len(whole)):
        at = rng.permutation(len(whole))[:count]
        expected = np.linalg.inv(whole)[np.ix_(at, at)]
        np.testing.assert_allclose(elimination.covariance(at), expected, atol=1e-9 * np.abs(x).max())


def test_what_no_keyframe_has_needs_damping():
    leaf = np.array([0, 1])
    dissection = dissected(leaf, leaf, leaf, np.array([2, 2, 2]), NOTHING, NOTHING)

    def block(front):
        return np.diag(np.where(front.unknowns < dissection.at[2], 4.0, 0.0)[: len(front.unknowns)])

    with pytest.raises(scipy.linalg.LinAlgError, match="singular"):
        eliminated(dissection, block)
    assert np.isfinite(eliminated(dissection, block, damping=1.0).log_determinant)


def test_leaves_are_halves_of_halves():
    rng = np.random.default_rng(3)
    points = rng.uniform(size=(100, 2)) * [10.0, 1.0]
    keyframe, variable = np.nonzero(np.abs(points[:, None, 0] - rng.uniform(0.0, 10.0, 150)) < 0.5)
    leaf = leaves(points, variable, keyframe, 20)
    np.testing.assert_array_equal(np.unique(leaf), np.arange(8))
    assert np.bincount(leaf).max() <= 20
    assert np.bincount(leaf // 4).min() >= 40
    np.testing.assert_array_equal(leaves(points[:5], np.array([0]), np.array([2]), 13), 0)


def test_a_part_is_cut_where_its_halves_share_least():
    points = np.column_stack([np.arange(20.0), np.arange(20.0)])
    # Each shares a variable with the next, and the ninth does not with the tenth.
    keyframe, variable = np.repeat(np.arange(20), 2), np.repeat(np.arange(21), 2)[1:-1]
    keyframe, variable = keyframe[variable != 9], variable[variable != 9]
    leaf = leaves(points, variable, keyframe, 12)
    assert set(leaf[:9]) != set(leaf[9:])
    assert len(set(leaf[:9])) == len(set(leaf[9:])) == 1

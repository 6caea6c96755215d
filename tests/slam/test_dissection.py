import numpy as np
import pytest
import scipy.linalg

from tfg_drake.slam.dissection import dissected, eliminated, leaves, solution


def system(seed, keyframes=40, landmarks=60, kept=5, omitted=()):
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
    dissection = dissected(leaves(points, 6), variable, keyframe, width, rng.permutation(landmarks)[:kept])
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


@pytest.mark.parametrize(("kept", "omitted"), [(5, ()), (0, ()), (60, ()), (3, (7, 8, 9))])
def test_is_a_dense_solution(kept, omitted):
    dissection, block, whole = system(1, kept=kept, omitted=omitted)
    assert max(len(front.unknowns) for front in dissection.fronts) < 0.8 * len(whole)
    elimination, size = eliminated(dissection, block), dissection.size - dissection.kept
    information = np.linalg.inv(np.linalg.inv(whole)[size:, size:])
    np.testing.assert_allclose(elimination.information, information, rtol=1e-9, atol=1e-9 * np.abs(whole).max())
    expected = np.linalg.slogdet(whole[:size, :size])[1]
    assert elimination.log_determinant == pytest.approx(expected, rel=1e-12)
    vector = np.random.default_rng(2).normal(size=len(whole))
    root = scipy.linalg.cholesky(elimination.information, lower=True) if kept else elimination.information
    x = solution(dissection, elimination, root, vector)
    np.testing.assert_allclose(x, np.linalg.solve(whole, vector), atol=1e-9 * np.abs(x).max())


def test_what_no_keyframe_has_needs_damping():
    dissection = dissected(np.array([0, 1]), np.array([0, 1]), np.array([0, 1]), np.array([2, 2, 2]), np.array([1]))

    def block(front):
        return np.diag(np.where(front.unknowns < dissection.at[2], 4.0, 0.0)[: len(front.unknowns)])

    with pytest.raises(scipy.linalg.LinAlgError, match="singular"):
        eliminated(dissection, block)
    assert np.isfinite(eliminated(dissection, block, damping=1.0).information).all()


def test_leaves_are_halves_of_halves():
    points = np.random.default_rng(3).uniform(size=(100, 2)) * [10.0, 1.0]
    leaf = leaves(points, 13)
    np.testing.assert_array_equal(np.unique(leaf), np.arange(8))
    assert np.bincount(leaf).max() <= 13
    assert points[leaf < 4, 0].max() <= points[leaf >= 4, 0].min()
    np.testing.assert_array_equal(leaves(points[:5], 13), 0)

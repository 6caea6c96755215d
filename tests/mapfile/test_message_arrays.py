from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.mapfile.array_names import array_names
from tfg_drake.mapfile.message_arrays import ArraysError, from_arrays, to_arrays
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message


@message
class Leaf:
    ids: Annotated[IntArray, "n"]
    p: Annotated[FloatArray, "n", 2]
    covariance: Annotated[FloatArray, "2n+3", "2n+3"]
    weight: float


@message
class Tree:
    X: Annotated[FloatArray, 3]
    flags: Annotated[BoolArray, "b"]
    count: int
    ready: bool
    leaf: Leaf
    leaves: tuple[Leaf, ...]
    prior_covariance: Annotated[FloatArray, "j", 3, 3]


def leaf(n, seed=0, symmetric=True):
    random = np.random.default_rng(seed)
    covariance = random.normal(size=(2 * n + 3, 2 * n + 3))
    covariance = covariance + covariance.T if symmetric else covariance
    return Leaf(np.arange(n), random.normal(size=(n, 2)), covariance, float(random.normal()))


def tree(leaves=(), j=2):
    return Tree(
        X=np.array([-0.0, np.inf, 1e-310]),
        flags=np.array([True, False]),
        count=-7,
        ready=True,
        leaf=leaf(2),
        leaves=tuple(leaves),
        prior_covariance=np.array([np.eye(3)] * j).reshape(j, 3, 3),
    )


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    elif hasattr(one, "__dataclass_fields__"):
        for name in one.__dataclass_fields__:
            assert_same(getattr(one, name), getattr(other, name))
    else:
        assert one == other


@given(st.lists(st.integers(0, 4), max_size=4), st.booleans())
def test_a_tree_comes_back_to_the_bit(sizes, symmetric):
    leaves = [leaf(n, seed, symmetric) for seed, n in enumerate(sizes)]
    before = tree(leaves, j=len(sizes))
    arrays = to_arrays(before)
    assert not any(array.dtype.hasobject for array in arrays.values())
    assert_same(from_arrays(Tree, arrays), before)


def test_the_names_say_what_is_where():
    arrays = to_arrays(tree([leaf(1), leaf(2)]))
    np.testing.assert_array_equal(arrays["X"], [0.0, np.inf, 1e-310])
    assert arrays["leaves@count"] == 2
    np.testing.assert_array_equal(arrays["leaves.p@shape"], [[1, 2], [2, 2]])
    np.testing.assert_array_equal(arrays["leaves.p"], np.concatenate([leaf(1).p.ravel(), leaf(2).p.ravel()]))
    assert arrays["leaf.covariance@lower"].shape == (7 * 8 // 2,)
    assert arrays["prior_covariance@lower"].shape == (2, 6)
    assert {name.split("@")[0] for name in array_names(Tree)} == {name.split("@")[0] for name in arrays}
    assert array_names(Tree)["leaf.covariance"] == "float64 (2n+3, 2n+3)"


def test_a_matrix_that_is_not_quite_symmetric_is_stored_whole():
    one = leaf(0)
    skewed = one.covariance.copy()
    skewed[0, 1] = np.nextafter(skewed[0, 1], 9.0)
    arrays = to_arrays(Leaf(one.ids, one.p, skewed, 0.0))
    np.testing.assert_array_equal(arrays["covariance"], skewed)
    zero = np.zeros((3, 3))
    zero[0, 1] = -0.0
    assert "covariance" in to_arrays(Leaf(one.ids, one.p, zero, 0.0))


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        ("X", None, "X is missing"),
        ("X", np.zeros(2), "X has the wrong shape"),
        ("X", np.zeros(3, dtype=np.float32), "X must be float64, not float32"),
        ("X", np.zeros(3, dtype=np.int64), "X holds no numbers"),
        ("X", np.full(3, np.nan), "X holds NaN"),
        ("flags", np.zeros(2), "flags holds no truth values"),
        ("count", np.zeros(1, dtype=np.int64), "count has the wrong shape"),
        ("count", np.float64(1.0), "count holds no integers"),
        ("leaf.ids", np.arange(5), "leaf.p has the wrong shape"),
        ("leaf.covariance@lower", np.zeros(27), "leaf.covariance@lower has the wrong shape"),
        ("leaf.covariance@lower", np.zeros(36), "leaf.covariance has the wrong shape"),
        ("leaf.covariance@lower", None, "leaf.covariance is missing"),
        ("leaves@count", np.int64(1), "leaves.ids@shape has the wrong shape"),
        ("leaves@count", np.int64(-1), "leaves@count is negative"),
        ("leaves.p", np.zeros(5), "leaves.p@shape does not fit leaves.p"),
        ("leaves.p@shape", np.array([[2, 2], [1, 2]]), "leaves.p has the wrong shape"),
        ("leaves.p@shape", np.array([[-1, 2], [-1, 2]]), "leaves.p@shape has the wrong shape"),
        ("leaves.covariance@shape", np.array([[5, 4], [7, 8]]), "leaves.covariance@shape does not fit "
         "leaves.covariance"),
        ("leaves.weight", np.zeros(3), "leaves.weight has the wrong shape"),
        ("more", np.zeros(1), "more is unknown"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(name, change, complaint):
    arrays = to_arrays(tree([leaf(1), leaf(2)]))
    assert change is None or name == "more" or name in arrays
    arrays[name] = change
    if change is None:
        del arrays[name]
    with pytest.raises(ArraysError) as caught:
        from_arrays(Tree, arrays)
    assert str(caught.value) == complaint


def test_what_cannot_be_stored_is_a_mistake_of_ours():
    @message
    class Loose:
        x: float | str | None

    with pytest.raises(TypeError, match=r"float \| str \| None cannot be stored"):
        to_arrays(Loose(1.0))
    with pytest.raises(TypeError, match="X must be float64, not int64"):
        to_arrays(Tree(**{**vars(tree()), "X": np.arange(3)}))
    with pytest.raises(TypeError, match="count must be int64, not float64"):
        to_arrays(Tree(**{**vars(tree()), "count": 1.0}))
    with pytest.raises(TypeError, match="leaf must be a Leaf, not Tree"):
        to_arrays(Tree(**{**vars(tree()), "leaf": tree()}))
    with pytest.raises(TypeError, match="leaves must be a tuple, not list"):
        to_arrays(Tree(**{**vars(tree()), "leaves": [leaf(1)]}))

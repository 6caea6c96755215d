"""Trees of messages as plain values and arrays."""

import dataclasses
import json
import math
import struct
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.mutations import mutations
from tfg_drake.messages import FloatArray, IntArray, MissionStatus, Path, message
from tfg_drake.notes import Note
from tfg_drake.storage.serialization import Packed, codec_of, pack


class Pair(NamedTuple):
    at: IntArray
    name: str


@message
class Leaf:
    points: FloatArray
    count: int


@message
class Tree:
    leaf: Leaf
    leaves: tuple[Leaf, ...]
    named: dict[int, Pair]
    either: Leaf | MissionStatus
    newest: Leaf | None
    any_message: Any
    drive: tuple[float, float]
    notes: list[Note]
    below: "Tree | None" = None


def tree(below=None):
    leaf = Leaf(np.array([[0.1, -0.0], [math.nan, math.inf]]), 2**40)
    status = MissionStatus(phase="observe", stage=3, since=1.5)
    pair = Pair(np.array([], dtype=np.int64), 'a "name"\n')
    notes = [Note("jump", 2.5, "the odometry jumped")]
    return Tree(leaf, (leaf, Leaf(leaf.points, 0)), {4: pair}, status, None, status, (1.0, -math.inf), notes, below)


def same(error):
    return error


def packed(hint, value):
    return b"".join(pack({"it": (hint, value)}))


def block(roots, rows=(), shapes=(), arrays=b""):
    """A block that somebody has made."""
    text = json.dumps([roots, rows, shapes]).encode()
    return struct.pack("<QQ", len(text), len(arrays)) + text + arrays


def test_a_tree_is_read_as_it_was_written():
    wanted = tree(tree())
    found = Packed(packed(Tree, wanted), 0, same).take("it", Tree)
    for one, other in ((found, wanted), (found.below, wanted.below)):
        assert one.leaf.points.tobytes() == other.leaf.points.tobytes()
        assert (one.leaf.count, one.drive, one.newest) == (2**40, (1.0, -math.inf), None)
        assert (one.named[4].name, one.named[4].at.dtype) == ('a "name"\n', np.int64)
        assert dataclasses.asdict(one.either) == dataclasses.asdict(other.either)
        assert vars(one.notes[0]) == vars(other.notes[0])
    assert (type(found.leaves), type(found.notes), type(found.named[4])) == (tuple, list, Pair)
    assert found.named[4].at.flags.writeable


def test_what_was_one_object_is_one_still():
    found = Packed(packed(Tree, tree()), 0, same).take("it", Tree)
    assert found.leaves[0] is found.leaf
    assert found.leaves[1].points is found.leaf.points
    assert found.any_message is found.either


@pytest.mark.parametrize("dtype", ["f8", "i8", "?", "f4", "i4", "i1", "u1"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 0, 4), (2, 3)])
def test_arrays_of_any_shape_and_order(dtype, shape):
    kind = np.ndarray[tuple[Any, ...], np.dtype[np.dtype(dtype).type]]
    array = np.arange(math.prod(shape)).reshape(shape).astype(dtype)
    for one in (array, np.asarray(array, order="F")):
        found = Packed(packed(kind, one), 0, same).take("it", kind)
        np.testing.assert_array_equal(found, array, strict=True)
        assert not found.flags.writeable


@pytest.mark.parametrize(
    ("hint", "value", "problem"),
    [
        (Leaf, tree(), "it: must be Leaf, not Tree"),
        (Leaf, Leaf(np.array([1]), 1), "it: must be an array of float64, not of int64"),
        (Leaf, Leaf(np.zeros(2), "one"), "it: must be int, not str"),
        (dict, {}, "it: dict cannot be kept: make it a dataclass with annotated fields"),
        (object, object(), "it: object cannot be kept: make it a dataclass with annotated fields"),
        (tuple[float, float], (1.0,), "it: zip() argument 2 is shorter than argument 1"),
        (Leaf | Path, tree(), "it: must not be Tree"),
    ],
)
def test_what_cannot_be_read_again_is_not_written(hint, value, problem):
    with pytest.raises(TypeError) as caught:
        pack({"it": (hint, value)})
    assert str(caught.value) == problem


@pytest.mark.parametrize(
    ("data", "hint"),
    [
        (block({"it": 0}, [[0, 1]], [["<f8", 1]], bytes(8)), Path),  # another class has other fields
        (block({"it": [0, 1]}, [[0, 1], 5], [["<f8", 1]], bytes(8)), list[Leaf]),
        (block({"it": 0}, [[0, 1, 2]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": 1}, [[0, 1]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": -1}, [[0, 1]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": True}, [[0, 1], [0, 1]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": 0}, [[0, 2**63]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": 0}, [[0, True]], [["<f8", 1]], bytes(8)), Leaf),
        (block({"it": 0}, [[0, 1]], [["<i8", 1]], bytes(8)), Leaf),  # other numbers
        (block({"it": [0, 1]}, [[0], [0, 1]], [["<f8", 1]], bytes(8)), tuple[Note, Leaf]),
        (block({"it": [0, [0]]}), Leaf | Path),
        (block({"it": [2, 0]}, [[0, 1]], [["<f8", 1]], bytes(8)), Leaf | Path),
        (block({"it": [[1.0, 2.0]]}), dict[int, float]),
        (block({}), float),
        (block([1]), float),
        # A message that is a part of itself.
        (block({"it": 0}, [[0, [], [], [0, 0], None, [0, 0], [1.0, 1.0], [], 0]]), Tree),
    ],
)
def test_what_does_not_fit_its_annotation_is_refused(data, hint):
    with pytest.raises(ValueError, match=r"^it"):
        Packed(data, 0, same).take("it", hint)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(15),
        struct.pack("<QQ", 2**60, 0),
        struct.pack("<QQ", 2, 2**40) + b"[]",
        block({}, shapes=[["|O", 1]], arrays=bytes(8)),
        block({}, shapes=[["<U1000", 1]], arrays=bytes(8)),
        block({}, shapes=[["<f8", 2**40]], arrays=bytes(8)),
        block({}, shapes=[["<f8", 0, 2**40]]),
        block({}, shapes=[["<f8", -1]], arrays=bytes(8)),
        block({}, shapes=[["<f8", 1], ["<f8", 1]], arrays=bytes(8)),
        block({}, shapes=[["<f8"]], arrays=bytes(16)),
        struct.pack("<QQ", 100_000, 0) + 100_000 * b"[",
    ],
)
def test_sizes_are_looked_at_before_anything_is_made(data):
    with pytest.raises((ValueError, TypeError, struct.error, RecursionError)):
        Packed(data, 0, same)


def test_any_bytes_are_read_or_refused():
    good, refused = packed(Tree, tree(tree())), 0
    for data in mutations(good, 2000, 3):
        try:
            Packed(data, 0, same).take("it", Tree)
        except (ValueError, TypeError, struct.error):  # what who opens a file expects
            refused += 1
    assert 500 < refused < 2000


def test_a_class_is_known_by_its_annotations_once():
    assert codec_of(Leaf) is codec_of(Leaf)

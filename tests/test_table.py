"""Messages as tables, against rows in lists."""

import ast
import importlib
import re
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.messages import FloatArray, IntArray, message
from tfg_drake.table import concat, empty, misfit, put, shapes_of, take

CORE = Path(__file__).parents[1] / "tfg_drake"


@message
class Points:
    p: Annotated[FloatArray, "n", 2]
    id: Annotated[IntArray, "n"]


@message
class Ways:
    """Ways and, on another axis, points with weights."""

    name: str
    id: Annotated[IntArray, "w"]
    offsets: Annotated[IntArray, "w+1"]
    places: Annotated[FloatArray, "v", 2]
    points: Annotated[Points, "k"]
    weight: Annotated[FloatArray, "k"]
    joint: Annotated[FloatArray, "2k+3", "2k+3"]
    scale: Annotated[FloatArray, 2]
    count: int = 7


def points(ids):
    return Points(np.array(ids, dtype=float).reshape(-1, 1) * [1.0, 10.0], np.array(ids, dtype=np.int64))


def ways(lengths, ids, name="ways"):
    """Ways of these lengths, the places of way j being (j, 0), (j, 1) ... and points of these ids."""
    places = [(j, i) for j, length in enumerate(lengths) for i in range(length)]
    k = len(ids)
    return Ways(
        name,
        np.arange(len(lengths)),
        np.append(0, np.cumsum(lengths)).astype(np.int64),
        np.array(places, dtype=float).reshape(-1, 2),
        points(ids),
        np.array(ids, dtype=float),
        np.eye(2 * k + 3),
        np.ones(2),
    )


def rows_of(table):
    """The ways as lists of their places."""
    return [table.places[a:b].tolist() for a, b in zip(table.offsets[:-1], table.offsets[1:], strict=True)]


LENGTHS = st.lists(st.integers(0, 3), min_size=1, max_size=5)


@given(LENGTHS, st.data())
def test_rows_are_taken_by_numbers_and_by_masks(lengths, data):
    table = ways(lengths, [5, 6])
    rows = data.draw(st.lists(st.integers(0, len(lengths) - 1)))
    some = take(table, np.array(rows, dtype=np.int64))
    assert rows_of(some) == [rows_of(table)[row] for row in rows]
    assert some.id.tolist() == rows
    keep = np.isin(np.arange(len(lengths)), rows)
    assert rows_of(take(table, keep)) == [row for row, kept in zip(rows_of(table), keep, strict=True) if kept]
    assert some.points is table.points
    assert some.offsets.dtype == np.int64


def test_each_axis_is_taken_by_its_letter():
    some = take(ways([1, 2], [5, 6, 7]), w=np.array([1]), k=np.array([True, False, True]))
    assert (rows_of(some), some.points.id.tolist()) == ([[[1, 0], [1, 1]]], [5, 7])
    assert (some.weight.tolist(), some.points.p.tolist()) == ([5, 7], [[5, 50], [7, 70]])
    with pytest.raises(KeyError):
        take(points([1]), k=np.array([0]))


@given(st.lists(LENGTHS, min_size=1, max_size=3))
def test_tables_are_joined_on_all_axes(several):
    tables = [ways(lengths, range(len(lengths)), name=str(lengths)) for lengths in several]
    joined = concat(*tables)
    assert rows_of(joined) == [row for table in tables for row in rows_of(table)]
    assert joined.points.id.tolist() == [i for lengths in several for i in range(len(lengths))]
    assert joined.name == tables[0].name


def test_rows_are_put_in():
    changed = put(points([1, 2, 3]), np.array([2, 0]), points([8, 9]))
    assert (changed.id.tolist(), changed.p.tolist()) == ([9, 2, 8], points([9, 2, 8]).p.tolist())


def test_an_empty_message_has_the_shapes_of_its_annotations():
    nothing = empty(Ways, scale=np.array([3.0, 4.0]))
    assert {name: getattr(nothing, name).shape for name in ("id", "offsets", "places", "weight", "joint")} == {
        "id": (0,), "offsets": (1,), "places": (0, 2), "weight": (0,), "joint": (3, 3),
    }  # fmt: skip
    assert (nothing.name, nothing.count, nothing.scale.tolist(), nothing.id.dtype) == ("", 7, [3.0, 4.0], np.int64)
    assert (nothing.points.p.shape, misfit(nothing)) == ((0, 2), "")
    full = ways([2], [4])
    assert rows_of(concat(nothing, full)) == rows_of(full)


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("places", np.zeros((3, 3)), "places has the wrong shape"),
        ("places", np.zeros((4, 2)), "offsets does not fit places"),
        ("offsets", np.array([0, 2]), "offsets has the wrong shape"),
        ("offsets", np.array([1, 2, 3]), "offsets does not fit places"),
        ("offsets", np.array([0, 4, 3]), "offsets does not fit places"),
        ("points", points([1]), "weight has the wrong shape"),
        ("weight", np.zeros((2, 1)), "weight has the wrong shape"),
        ("joint", np.eye(6), "joint has the wrong shape"),
        ("joint", np.zeros((7, 5)), "joint has the wrong shape"),
        ("scale", np.zeros(3), "scale has the wrong shape"),
    ],
)
def test_what_is_not_as_annotated_is_named(name, value, complaint):
    table = ways([1, 2], [5, 6])
    assert misfit(table) == ""
    assert misfit(Ways(**vars(table) | {name: value})) == complaint


def annotated():
    """The core's classes with shapes in their annotations."""
    for path in sorted(CORE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "Annotated[" not in text or any(part in ("systems", "diagrams", "hardware") for part in path.parts):
            continue
        module = importlib.import_module(".".join(path.relative_to(CORE.parent).with_suffix("").parts))
        classes = [node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
        yield from (kind for name in classes if shapes_of(kind := getattr(module, name)))


def test_docstrings_state_the_shapes_of_the_annotations():
    wrong, stated = [], 0
    for kind in annotated():
        for name, shape in shapes_of(kind).items():
            found = re.search(rf"\b{name}\b(?:, \w+)*(?: and \w+)?:? \(([^()]*)\)", kind.__doc__)
            if found and re.sub(r"\s", "", found[1]).strip(",") == ",".join(map(str, shape)):
                stated += 1
            elif found:
                wrong.append(f"{kind.__name__}.{name}: ({found[1]}) for {shape}")
    assert not wrong
    assert stated > 80

"""Messages as tables: a field whose annotation gives its shape is a column.

`p_ML: Annotated[FloatArray, "n", 2]` has n rows of two numbers. A letter is a length that is one throughout a message,
so all fields of n rows are columns of one table, its axis "n"; a message may have several. Of a message or a tuple in a
message the annotation gives the number of rows: `met: Annotated[FrontierPoints, "p"]`. Other lengths are numbers, or
follow from letters: "2n+3". Integers of the one length "k+1" are offsets: those of row j are offsets[j]:offsets[j + 1]
of the next field.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
import typing
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, replace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")
Array = TypeVar("Array", FloatArray, IntArray)

# Rows of a table: a truth value for each, or their numbers.
Rows = BoolArray | IntArray
Shape = tuple[int | str, ...]


def take(table: T, rows: Rows | None = None, **axes: Rows) -> T:
    """Some of the rows, in the order of their numbers or as a mask has them. rows: of the table's first axis. axes: of
    those with these letters."""
    of, changes = _columns(type(table)), dict[str, Any]()
    for axis, asked in (axes if rows is None else {of.first: rows}).items():
        some = np.flatnonzero(asked) if asked.dtype == np.bool_ else np.asarray(asked, np.int64)
        for name in of.columns[axis]:
            column = getattr(table, name)
            changes[name] = column.take(some, axis=0) if isinstance(column, np.ndarray) else take(column, some)
        for name, packed in of.ragged.get(axis, {}).items():
            changes[name], changes[packed] = taken(some, getattr(table, name), getattr(table, packed))
    return replace(table, **changes)


def concat(first: T, *others: T) -> T:
    """Tables one behind the other, on all their axes. What is no column is the first one's."""
    of, changes = _columns(type(first)), dict[str, Any]()
    for name in itertools.chain(*of.columns.values(), *(ragged.values() for ragged in of.ragged.values())):
        columns = [getattr(table, name) for table in (first, *others)]
        changes[name] = np.concatenate(columns) if isinstance(columns[0], np.ndarray) else concat(*columns)
    for name in itertools.chain(*of.ragged.values()):
        changes[name] = getattr(first, name)
        for other in others:
            changes[name] = np.append(changes[name], changes[name][-1] + getattr(other, name)[1:])
    return replace(first, **changes)


def put(table: T, rows: Rows, other: T) -> T:
    """The table with some rows of its first axis as another has them, row for row."""
    of, changes = _columns(type(table)), dict[str, Any]()
    for name in of.columns[of.first]:
        changes[name] = getattr(table, name).copy()
        changes[name][rows] = getattr(other, name)
    return replace(table, **changes)


def empty(kind: type[T], **given: Any) -> T:
    """The message of a kind without rows, with the fields given, the others' defaults, and else zeros."""
    return kind(**_nothings(kind) | given)


def misfit(table: DataclassInstance) -> str:
    """The first field that is not of the shape it is annotated with, in words; "" where all are."""
    lengths: dict[str, int] = {}
    for name, shape in shapes_of(type(table)).items():
        if not _fits(_shape(getattr(table, name)), shape, lengths):
            return f"{name} has the wrong shape"
    for name, packed in itertools.chain(*(ragged.items() for ragged in _columns(type(table)).ragged.values())):
        offsets = getattr(table, name)
        if offsets[0] != 0 or offsets[-1] != len(getattr(table, packed)) or np.any(np.diff(offsets) < 0):
            return f"{name} does not fit {packed}"
    return ""


def taken(rows: IntArray, offsets: IntArray, packed: Array) -> tuple[IntArray, Array]:
    """Offsets and contents of some rows of a packed array, in this order."""
    count = offsets[1:][rows] - offsets[:-1][rows]
    starts = np.zeros(len(rows) + 1, dtype=np.int64)
    np.cumsum(count, out=starts[1:])
    return starts, packed.take(np.repeat(offsets[:-1][rows] - starts[:-1], count) + np.arange(starts[-1]), axis=0)


@functools.cache
def shapes_of(kind: Any) -> dict[str, Shape]:
    """The shapes of a message's fields that are annotated with one."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__ for name, hint in hints.items() if typing.get_origin(hint) is typing.Annotated}


def dtype_of(hint: Any) -> np.dtype[Any] | None:
    """The type of an array's entries, None for an annotation of anything else."""
    hint = spelled_out(hint)
    if typing.get_origin(hint) is not np.ndarray:
        return None
    entry: type[np.generic] = typing.get_args(typing.get_args(hint)[1])[0]
    return np.dtype(entry)


def spelled_out(hint: Any) -> Any:
    """An annotation with what an alias of it stands for: NDArray is one of ndarray from numpy 2.5 on."""
    value = getattr(typing.get_origin(hint), "__value__", None)
    return hint if value is None else value[typing.get_args(hint)]


class _Columns(NamedTuple):
    """The columns of a kind of table by their axes, and of each axis the packed columns by their offsets'. first: the
    axis of the first column."""

    first: str
    columns: dict[str, list[str]]
    ragged: dict[str, dict[str, str]]


@functools.cache
def _columns(kind: type) -> _Columns:
    shapes, hints = shapes_of(kind), typing.get_type_hints(kind)
    columns: dict[str, list[str]] = {}
    ragged: dict[str, dict[str, str]] = {}
    packed = ""
    for (name, shape), following in itertools.zip_longest(shapes.items(), list(shapes)[1:]):
        length = shape[0] if name != packed else 0
        if isinstance(length, str) and len(length) == 1:
            columns.setdefault(length, []).append(name)
        elif isinstance(length, str) and shape == (f"{length[0]}+1",) and dtype_of(hints[name]) == np.int64:
            packed = ragged.setdefault(length[0], {})[name] = following
            columns.setdefault(length[0], [])
    return _Columns(next(iter(columns), ""), columns, ragged)


@functools.cache
def _terms(length: str) -> tuple[int, str, int]:
    """Factor, letter and what is added of a length such as "2n+3"."""
    match = re.fullmatch(r"(\d*)([a-z])(?:\+(\d+))?", length)
    if match is None:
        raise TypeError(f"{length} is no length")
    return int(match[1] or 1), match[2], int(match[3] or 0)


def _shape(value: Any) -> tuple[int, ...]:
    """The shape of an array; of a tuple or a table its number of rows."""
    if isinstance(value, np.ndarray):
        return tuple(value.shape)
    if isinstance(value, tuple):
        return (len(value),)
    name, (length, *_) = next(iter(shapes_of(value.__class__).items()))
    factor, _, more = _terms(str(length))
    return ((len(getattr(value, name)) - more) // factor,)


def _fits(found: tuple[int, ...], wanted: Shape, lengths: dict[str, int]) -> bool:
    """Whether a shape is as wanted; letters met for the first time get their lengths."""
    if len(found) != len(wanted):
        return False
    for size, length in zip(found, wanted, strict=True):
        factor, letter, more = (0, "", length) if isinstance(length, int) else _terms(length)
        known = lengths.setdefault(letter, (size - more) // factor) if letter else 0
        if known < 0 or size != factor * known + more:
            return False
    return True


@functools.cache
def _nothings(kind: type[DataclassInstance]) -> dict[str, Any]:
    """The values of the fields without a default in a message without rows."""
    hints, default = typing.get_type_hints(kind, include_extras=True), dataclasses.MISSING
    needed = [of.name for of in dataclasses.fields(kind) if of.default is default and of.default_factory is default]
    return {name: _nothing(hints[name]) for name in needed}


def _nothing(hint: Any) -> Any:
    """The value of a field without rows, by its annotation: zeros where a length does not follow from a letter."""
    shape: Shape = ()
    if typing.get_origin(hint) is typing.Annotated:
        hint, shape = hint.__origin__, hint.__metadata__
    if (dtype := dtype_of(hint)) is not None:
        zeros = np.zeros([length if isinstance(length, int) else _terms(length)[2] for length in shape], dtype)
        zeros.setflags(write=False)
        return zeros
    hint = typing.get_origin(hint) or hint
    return empty(hint) if hasattr(hint, "__dataclass_fields__") else hint()

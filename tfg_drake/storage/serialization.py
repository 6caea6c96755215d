"""Trees of messages as plain values and arrays, and back, to the bit: what a checkpoint is made of.

Data name no class. Which one stands where follows from the annotations on both sides, and nothing that is read is run.

| annotation | how it is written |
|---|---|
| `float`, `int`, `bool`, `str`, `None` | as in JSON, nan and infinities too |
| an array of one of DTYPES | its number in the table of arrays |
| a message or other dataclass | its number in the table of messages, there a list of its fields' values |
| `tuple[X, ...]`, `tuple[X, Y]`, `list[X]`, a NamedTuple | a list |
| `dict[K, V]` | a list of pairs |
| a union | [which of them, value] |
| `Any` | one of the messages of `tfg_drake.messages`, as of a union |

A block is two lengths (uint64), so many bytes of JSON, [roots, messages, arrays], and so many of the arrays, one behind
the other. Messages and arrays that were one object are one again.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import math
import struct
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tfg_drake import messages
from tfg_drake.slam import noise, turn
from tfg_drake.table import dtype_of, spelled_out

# Permitted types of an array's entries.
DTYPES = ("<f8", "<i8", "|b1", "<f4", "<i4", "|i1", "|u1")
# Greatest size of a block's JSON, bytes; its lists take twenty times as much memory.
MOST_TEXT = 16 * 2**20
# Greatest side of an array without entries, which is otherwise bounded by its number of entries.
WIDEST = 2**12
# Upper bound of an integer, as in an array.
_MOST = 2**63
# The class that implements each protocol.
_IMPLEMENTED: Mapping[Any, type] = {noise.Sample: turn.Sample}
_MESSAGES = tuple(
    kind for kind in vars(messages).values() if isinstance(kind, type) and kind.__module__ == messages.__name__
)
_LENGTHS = struct.Struct("<QQ")


class _Codec(NamedTuple):
    """write: a value's plain form, TypeError where it is not what its annotation says. read: back, ValueError or
    TypeError where that is no such form."""

    write: Callable[[Any, Packer], Any]
    read: Callable[[Any, Packed], Any]


class Packer:
    """Collects the messages, as lists of their fields, and the arrays of some trees."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self.arrays: list[NDArray[Any]] = []
        self._numbers: dict[int, int] = {}  # by where an object is in memory

    def number(self, value: Any, table: list[Any], entry: Callable[[Any], Any]) -> int:
        """The number of an object in its table, where it stands once."""
        number = self._numbers.get(id(value))
        if number is None:
            number = self._numbers[id(value)] = len(table)
            table.append(None)
            table[number] = entry(value)
        return number


def pack(trees: Mapping[str, tuple[Any, Any]]) -> list[bytes | memoryview]:
    """A block of trees, piece by piece; each has a name, an annotation and a value.

    Raises:
        TypeError: a value is not what its annotation says, or that cannot be written.
    """
    packer, roots = Packer(), {}
    for name, (hint, value) in trees.items():
        try:
            roots[name] = codec_of(hint).write(value, packer)
        except (TypeError, ValueError) as error:
            raise TypeError(f"{name}: {error}") from None
    shapes = [[array.dtype.str, *array.shape] for array in packer.arrays]
    text = json.dumps([roots, packer.rows, shapes], separators=(",", ":")).encode()
    arrays = [np.ascontiguousarray(array).data for array in packer.arrays]
    return [_LENGTHS.pack(len(text), sum(array.nbytes for array in arrays)), text, *arrays]


class Packed:
    """A block of trees that was read; `take` makes one of it. end: where it ends in the data. complaint: makes the
    error that a user is told of any other."""

    def __init__(self, data: bytes, start: int, complaint: Callable[[BaseException], Exception]) -> None:
        """Raises anything where the data are no block, before anything large is made of them."""
        self.complaint = complaint
        text, size = _LENGTHS.unpack_from(data, start)
        start += _LENGTHS.size
        self.end = start + text + size
        if text > MOST_TEXT or self.end > len(data):
            raise ValueError("it is not whole")
        self._roots, self._rows, shapes = json.loads(data[start : start + text])
        start += text
        self.names = set(self._roots)
        self._data, self._arrays, self._made = data, list[Any](), dict[int, Any]()
        for code, *shape in shapes:
            if code not in DTYPES or any(type(side) is not int or not 0 <= side <= size + WIDEST for side in shape):
                raise ValueError("an array has no such shape")
            end = start + math.prod(shape) * np.dtype(code).itemsize
            self._arrays.append((code, shape, start, end))
            start = end
        if start != self.end:
            raise ValueError("its arrays do not fit")

    def take(self, name: str, hint: Any) -> Any:
        """The tree of a name. Raises the complaint where it is missing or not what its annotation says."""
        try:
            return codec_of(hint).read(self._roots.get(name), self)
        except Exception as error:  # Anything may come of values that are not what they should be.
            raise self.complaint(ValueError(f"{name}: {error or type(error).__name__}")) from error

    def message(self, number: Any, kind: type, read: Callable[[Any], Any]) -> Any:
        """The message of a number. read: makes it of its fields' values."""
        number = _whole(number, len(self._rows))
        if number not in self._made:
            row, self._rows[number] = self._rows[number], None  # so one that is part of itself is none
            self._made[number] = read(_of(list, row))
        return _of(kind, self._made[number])

    def array(self, number: Any, dtype: np.dtype[Any]) -> Any:
        """The array of a number, read-only and over bytes of its own."""
        number = _whole(number, len(self._arrays))
        found = self._arrays[number]
        if isinstance(found, tuple):
            code, shape, start, end = found
            found = self._arrays[number] = np.ndarray(shape, code, self._data[start:end])
        return _of_dtype(dtype, found)


@functools.cache
def codec_of(hint: Any) -> _Codec:
    """How values with an annotation are written and read. Raises TypeError of an annotation that has no place in it."""
    hint = _IMPLEMENTED.get(hint, hint)
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint in (float, int, bool, str, type(None)):
        return _scalar(hint)
    if (dtype := dtype_of(hint)) is not None and dtype.str in DTYPES:
        return _Codec(
            lambda value, out: out.number(_of_dtype(dtype, value), out.arrays, lambda one: one),
            lambda plain, data: data.array(plain, dtype),
        )
    if dataclasses.is_dataclass(hint):
        return _dataclass(hint)
    if hint is Any or origin in (types.UnionType, typing.Union):
        return _union(_MESSAGES if hint is Any else parts)
    if origin is list or (origin is tuple and parts[1:] == (Ellipsis,)):
        return _parts(origin, origin, itertools.repeat(codec_of(parts[0])), strict=False)
    if origin is tuple:
        return _parts(tuple, tuple, [codec_of(part) for part in parts], strict=True)
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_make"):
        codecs = [codec_of(part) for part in typing.get_type_hints(hint).values()]
        return _parts(hint, lambda parts: hint._make(map(_own, parts)), codecs, strict=True)
    if origin is dict:
        pairs = codec_of(list[tuple[parts]])  # type: ignore[valid-type]
        return _Codec(
            lambda value, out: pairs.write([*_of(dict, value).items()], out),
            lambda plain, data: dict(pairs.read(plain, data)),
        )
    raise TypeError(f"{getattr(hint, '__name__', hint)} cannot be kept: make it a dataclass with annotated fields")


def _own(value: Any) -> Any:
    """A tuple's value; an array is writeable, as in the mission that kernels are compiled for: messages lock theirs."""
    return value.copy() if isinstance(value, np.ndarray) else value


def _of(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"must be {getattr(kind, '__name__', 'float')}, not {type(value).__name__}")
    return value


def _of_dtype(dtype: np.dtype[Any], value: Any) -> Any:
    if _of(np.ndarray, value).dtype != dtype:
        raise TypeError(f"must be an array of {dtype}, not of {value.dtype}")
    return value


def _whole(plain: Any, end: int) -> int:
    if type(plain) is not int or not 0 <= plain < end:
        raise ValueError("there is none of that number")
    return plain


def _scalar(kind: type) -> _Codec:
    allowed = _allowed(kind)

    def read(plain: Any, _data: Packed) -> Any:
        if isinstance(plain, bool) != (kind is bool) or (isinstance(plain, int) and not -_MOST <= plain < _MOST):
            raise ValueError(f"{plain!s:.20} is no {kind.__name__}")
        return _of(allowed, plain)

    return _Codec(lambda value, _: _of(allowed, value.item() if isinstance(value, np.generic) else value), read)


def _allowed(hint: Any) -> Any:
    """The class or classes of the values with an annotation."""
    return (int, float) if hint is float else typing.get_origin(spelled_out(hint)) or hint


def _dataclass(kind: Any) -> _Codec:
    @functools.cache  # when the first one comes: a class may have a field of its own kind
    def fields() -> list[tuple[str, _Codec]]:
        hints = typing.get_type_hints(kind)
        return [(field.name, codec_of(hints[field.name])) for field in dataclasses.fields(kind)]

    def write(value: Any, out: Packer) -> int:
        if type(value) is not kind:  # of a derived class the rest would be lost
            raise TypeError(f"must be {kind.__name__}, not {type(value).__name__}")
        row = lambda one: [field.write(getattr(one, name), out) for name, field in fields()]  # noqa: E731
        return out.number(value, out.rows, row)

    def made(row: list[Any], data: Packed) -> Any:
        values = zip(fields(), row, strict=True)
        return kind(**{name: field.read(plain, data) for (name, field), plain in values})

    return _Codec(write, lambda plain, data: data.message(plain, kind, lambda row: made(row, data)))


def _union(kinds: Sequence[Any]) -> _Codec:
    codecs = [(_allowed(kind), codec_of(kind)) for kind in kinds]

    def write(value: Any, out: Packer) -> list[Any]:
        for number, (kind, codec) in enumerate(codecs):
            if isinstance(value, kind):
                return [number, codec.write(value, out)]
        raise TypeError(f"must not be {type(value).__name__}")

    def read(plain: Any, data: Packed) -> Any:
        number, value = _of(list, plain)
        return codecs[_whole(number, len(codecs))][1].read(value, data)

    return _Codec(write, read)


def _parts(kind: Any, make: Callable[[Iterable[Any]], Any], codecs: Iterable[_Codec], *, strict: bool) -> _Codec:
    return _Codec(
        lambda value, out: [one.write(part, out) for one, part in zip(codecs, _of(kind, value), strict=strict)],
        lambda plain, data: make([one.read(part, data) for one, part in zip(codecs, _of(list, plain), strict=strict)]),
    )

"""Trees of messages as plain named arrays, and back, to the bit.

A message's fields become arrays named by their path, `graph.X_MA`. What a field may hold is what its annotation says:
an array of one of the aliases in `tfg_drake.messages`, float, int, bool, str, another message, a tuple of messages, or
one of these or None. Marks behind the name tell what a plain array cannot:

| array | meaning |
|---|---|
| `name@count` | elements of a tuple; their fields are columns, one array a field for all elements |
| `name@shape` | (k, dimensions): shapes of the k arrays that stand one after the other, flattened, in a column |
| `name@present` | false where an optional field is None |
| `name@lower` | a symmetric matrix or stack of them by its lower triangle, row by row |

A field with the metadata `kept: False` has no array and is read as its default. Only fields named `covariance` or
`..._covariance` are stored by the lower triangle, and only where every one of them is symmetric to the bit. Classes are
never named in the file: which class stands where follows from the annotations, and so do the shapes of all arrays.
Nothing that is read is ever run.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import BoolArray
from tfg_drake.table import dtype_of, misfit

Array = NDArray[Any]
T = TypeVar("T")

# Numbers in a row of an array without rows, at most.
_WIDEST = 16

SCALARS: dict[Any, Any] = {float: np.float64, int: np.int64, bool: np.bool_}
_NAMES = {"f": "numbers", "i": "integers", "b": "truth values", "U": "text"}


class ArraysError(ValueError):
    """The arrays do not hold the tree they should; the message names the array."""


def to_arrays(message: object) -> dict[str, Array]:
    """The arrays of a message and of everything in it.

    Raises:
        TypeError: something in the tree is not what its annotation says.
    """
    writer = _Writer()
    writer.fields(type(message), [message], "", single=True)
    return writer.arrays


def from_arrays(kind: type[T], arrays: Mapping[str, Array]) -> T:
    """The message of a class that arrays hold.

    Raises:
        ArraysError: an array is missing, unknown, of the wrong type or shape, or holds NaN.
    """
    reader = _Reader(arrays)
    (message,) = reader.fields(kind, 1, "", single=True)
    unknown = sorted(set(arrays) - reader.used)
    if unknown:
        raise ArraysError(f"{unknown[0]} is unknown")
    return typing.cast(T, message)


@functools.cache
def hints_of(kind: type) -> dict[str, Any]:
    """The annotations of a dataclass's fields by their names, without those that are not kept."""
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.metadata.get("kept", True)}


def optional_of(hint: Any) -> Any | None:
    """X of X | None, None for any other annotation."""
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return None
    inner = [part for part in typing.get_args(hint) if part is not type(None)]
    if len(inner) != 1 or len(typing.get_args(hint)) != 2:
        raise TypeError(f"{hint} cannot be stored")
    return inner[0]


def element_of(hint: Any) -> Any | None:
    """X of tuple[X, ...], None for any other annotation."""
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return arguments[0]
    return None


def _may_be_symmetric(name: str) -> bool:
    field = name.rsplit(".", 1)[-1]
    return field == "covariance" or field.endswith("_covariance")


def _is_symmetric(array: Array) -> bool:
    """Whether a stack of matrices is symmetric to the bit."""
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        return False
    bits = np.ascontiguousarray(array).view(np.int64)
    return bool(np.array_equal(bits, np.swapaxes(bits, -1, -2)))


def _lower(array: Array) -> Array:
    rows, columns = np.tril_indices(array.shape[-1])
    return np.asarray(array[..., rows, columns])


def _whole(lower: Array) -> Array:
    size = _triangle_size(lower.shape[-1])
    rows, columns = np.tril_indices(size)
    array = np.empty((*lower.shape[:-1], size, size), lower.dtype)
    array[..., rows, columns] = lower
    array[..., columns, rows] = lower
    return array


def _stored_shape(shape: Sequence[int], lower: bool) -> Sequence[int]:
    return (*shape[:-2], _triangle_length(shape[-1])) if lower else shape


class _Writer:
    """Collects the arrays of a tree."""

    def __init__(self) -> None:
        self.arrays: dict[str, Array] = {}

    def fields(self, kind: type, messages: Sequence[Any], path: str, single: bool) -> None:
        for message in messages:
            if type(message) is not kind:
                raise TypeError(f"{path or 'the tree'} must be a {kind.__name__}, not {type(message).__name__}")
        for name, hint in hints_of(kind).items():
            self._values(hint, [getattr(one, name) for one in messages], f"{path}.{name}" if path else name, single)

    def _values(self, hint: Any, values: Sequence[Any], path: str, single: bool) -> None:
        inner, element = optional_of(hint), element_of(hint)
        if inner is not None:
            present = np.array([value is not None for value in values], dtype=np.bool_)
            self._put(f"{path}@present", present, single)
            if present.any() or not single:
                self._values(inner, [value for value in values if value is not None], path, single)
        elif element is not None:
            for value in values:
                if not isinstance(value, tuple):
                    raise TypeError(f"{path} must be a tuple, not {type(value).__name__}")
            self._put(f"{path}@count", np.array([len(value) for value in values], dtype=np.int64), single)
            self.fields(element, [one for value in values for one in value], path, single=False)
        elif (dtype := dtype_of(hint)) is not None:
            self._arrays(dtype, values, path, single)
        elif hint in SCALARS or hint is str:
            allowed: Any = {float: (float, int), int: int, bool: bool, str: str}[hint]
            for value in values:
                if not isinstance(value.item() if isinstance(value, np.generic) else value, allowed):
                    raise TypeError(f"{path} must be a {hint.__name__}, not {type(value).__name__}")
            self._put(path, np.array(values, dtype=SCALARS.get(hint, np.str_)), single)
        else:
            self.fields(hint, values, path, single)

    def _put(self, name: str, column: Array, single: bool) -> None:
        self.arrays[name] = column[0] if single else column
        self.arrays[name] = np.asarray(self.arrays[name])

    def _arrays(self, dtype: np.dtype[Any], values: Sequence[Any], path: str, single: bool) -> None:
        for value in values:
            if not isinstance(value, np.ndarray) or value.dtype != dtype:
                found = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
                raise TypeError(f"{path} must be an array of {dtype}, not {found}")
        lower = _may_be_symmetric(path) and len(values) > 0 and all(_is_symmetric(value) for value in values)
        name = f"{path}@lower" if lower else path
        stored = [_lower(value) if lower else value for value in values]
        if single:
            self.arrays[name] = stored[0]
            return
        if len({value.ndim for value in values}) > 1:
            raise TypeError(f"{path} must have as many dimensions everywhere")
        dimensions = values[0].ndim if values else 1
        shapes = np.array([value.shape for value in values], dtype=np.int64).reshape(len(values), dimensions)
        self.arrays[f"{path}@shape"] = shapes
        self.arrays[name] = np.concatenate([np.zeros(0, dtype), *(value.ravel() for value in stored)])


class _Reader:
    """Takes a tree out of its arrays; used: the names of those that were."""

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self.used: set[str] = set()
        self._arrays_by_name = arrays

    def fields(self, kind: type, count: int, path: str, single: bool) -> list[Any]:
        columns: dict[str, list[Any]] = {}
        for name, hint in hints_of(kind).items():
            columns[name] = self._values(hint, count, f"{path}.{name}" if path else name, single)
        messages = [kind(**{name: column[row] for name, column in columns.items()}) for row in range(count)]
        for wrong in filter(None, map(misfit, messages)):
            raise ArraysError(f"{path}.{wrong}" if path else wrong)
        return messages

    def _values(self, hint: Any, count: int, path: str, single: bool) -> list[Any]:
        inner, element = optional_of(hint), element_of(hint)
        if inner is not None:
            present: BoolArray = self._column(f"{path}@present", np.dtype(np.bool_), count, single)
            if single and not present[0]:
                return [None]
            values = iter(self._values(inner, int(np.count_nonzero(present)), path, single))
            return [next(values) if here else None for here in present]
        if element is not None:
            counts = self._column(f"{path}@count", np.dtype(np.int64), count, single)
            if np.any(counts < 0):
                raise ArraysError(f"{path}@count is negative")
            elements = self.fields(element, int(counts.sum()), path, single=False)
            ends = np.cumsum(counts)
            return [tuple(elements[end - size : end]) for size, end in zip(counts, ends, strict=True)]
        if (dtype := dtype_of(hint)) is not None:
            return self._arrays(dtype, count, path, single)
        if hint in SCALARS or hint is str:
            column = self._column(path, np.dtype(SCALARS.get(hint, np.str_)), count, single)
            return list(column.tolist())
        return self.fields(hint, count, path, single)

    def _take(self, name: str, dtype: np.dtype[Any]) -> Array:
        self.used.add(name)
        if name not in self._arrays_by_name:
            raise ArraysError(f"{name} is missing")
        array = self._arrays_by_name[name]
        if array.dtype.kind != dtype.kind:
            raise ArraysError(f"{name} holds no {_NAMES[dtype.kind]}")
        if dtype.kind != "U" and array.dtype.itemsize != dtype.itemsize:
            raise ArraysError(f"{name} must be {dtype}, not {array.dtype}")
        if dtype.kind == "f" and np.isnan(array).any():
            raise ArraysError(f"{name} holds NaN")
        return array if dtype.kind == "U" else array.astype(dtype, copy=False)

    def _column(self, name: str, dtype: np.dtype[Any], count: int, single: bool) -> Array:
        array = self._take(name, dtype)
        if array.shape != (() if single else (count,)):
            raise ArraysError(f"{name} has the wrong shape")
        return array.reshape(count)

    def _arrays(self, dtype: np.dtype[Any], count: int, path: str, single: bool) -> list[Array]:
        lower = path not in self._arrays_by_name and _may_be_symmetric(path) and f"{path}@lower" in self._arrays_by_name
        name = f"{path}@lower" if lower else path
        stored = self._take(name, dtype)
        if single:
            if lower and (not stored.ndim or stored.shape[-1] != _triangle_length(_triangle_size(stored.shape[-1]))):
                raise ArraysError(f"{name} has the wrong shape")
            return [_whole(stored) if lower else stored]
        shapes = self._take(f"{path}@shape", np.dtype(np.int64))
        if shapes.ndim != 2 or len(shapes) != count or np.any(shapes < 0):
            raise ArraysError(f"{path}@shape has the wrong shape")
        if lower and (shapes.shape[1] < 2 or np.any(shapes[:, -1] != shapes[:, -2])):
            raise ArraysError(f"{path}@shape does not fit {name}")
        # Where one dimension is 0 the others may say what they like: an array of no numbers has no long side either.
        long = np.any(shapes > len(stored) + _WIDEST)
        parts = [_stored_shape(shape, lower) for shape in shapes.tolist()]
        if long or stored.ndim != 1 or sum(map(math.prod, parts)) != len(stored):
            raise ArraysError(f"{path}@shape does not fit {name}")
        ends = itertools.accumulate(map(math.prod, parts))
        values = [stored[end - math.prod(part) : end].reshape(part) for part, end in zip(parts, ends, strict=True)]
        return [_whole(value) for value in values] if lower else values


def _triangle_length(size: int) -> int:
    return size * (size + 1) // 2


def _triangle_size(length: int) -> int:
    """The size of the largest matrix whose lower triangle has no more than a length."""
    return (math.isqrt(8 * length + 1) - 1) // 2

"""A message as plain named arrays, and back, to the bit.

Its fields become arrays named by their path, `graph.X_MA`. What a field may hold is what its annotation says: an array
of one of the aliases in `tfg_drake.messages`, float, int, bool, another message, or a tuple of messages whose fields
are arrays and numbers. Marks behind the name tell what a plain array cannot:

| array | meaning |
|---|---|
| `name@count` | elements of a tuple; their fields are columns, one array a field for all elements |
| `name@shape` | (k, dimensions): shapes of the k arrays that stand one after the other, flattened, in a column |
| `name@lower` | a symmetric matrix or stack of them by its lower triangle, row by row |

A field with the metadata `kept: False` has no array and is read as its default. Only fields named `covariance` or
`..._covariance` are stored by the lower triangle, and only where they are symmetric to the bit. Classes are never named
in the file: which class stands where follows from the annotations, and so do the shapes of all arrays. Nothing that is
read is ever run.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tfg_drake.table import dtype_of, misfit, shapes_of

Array = NDArray[Any]
T = TypeVar("T")

# Greatest number of columns of an array without rows.
_WIDEST = 16

SCALARS: dict[Any, Any] = {float: np.float64, int: np.int64, bool: np.bool_}
_NAMES = {"f": "numbers", "i": "integers", "b": "truth values"}


class ArraysError(ValueError):
    """The arrays do not hold the message they should; the text names the array."""


def to_arrays(message: Any, path: str = "") -> dict[str, Array]:
    """The arrays of a message and of everything in it. path: before their names.

    Raises:
        TypeError: a field is not what its annotation says.
    """
    arrays: dict[str, Array] = {}
    kind: type = type(message)
    for name, hint in hints_of(kind).items():
        value, at = getattr(message, name), f"{path}{name}"
        if (element := element_of(hint)) is not None:
            arrays |= _columns(element, value, at)
        elif dataclasses.is_dataclass(hint):
            arrays |= to_arrays(_of(hint, value, at), f"{at}.")
        elif _is_symmetric(name, array := _array(hint, value, at)):
            arrays[f"{at}@lower"] = array[(..., *np.tril_indices(array.shape[-1]))]
        else:
            arrays[at] = array
    return arrays


def from_arrays(kind: type[T], arrays: Mapping[str, Array]) -> T:
    """The message of a class that arrays hold.

    Raises:
        ArraysError: an array is missing, unknown, of the wrong type or shape, or holds NaN.
    """
    left = dict(arrays)
    message: T = _message(kind, left, "")
    if left:
        raise ArraysError(f"{min(left)} is unknown")
    return message


@functools.cache
def hints_of(kind: type) -> dict[str, Any]:
    """The annotations of a dataclass's fields by their names, without those that are not kept."""
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.metadata.get("kept", True)}


def element_of(hint: Any) -> Any | None:
    """X of tuple[X, ...], None for any other annotation."""
    return typing.get_args(hint)[0] if typing.get_origin(hint) is tuple else None


def entry_type(hint: Any) -> np.dtype[Any]:
    """The type of an array's entries or of a number. Raises TypeError of an annotation of anything else."""
    dtype = np.dtype(SCALARS[hint]) if hint in SCALARS else dtype_of(hint)
    if dtype is None:
        raise TypeError(f"{hint} cannot be stored")
    return dtype


def _of(kind: Any, value: Any, path: str) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{path} must be a {kind.__name__}, not {type(value).__name__}")
    return value


def _array(hint: Any, value: Any, path: str) -> Array:
    """The value of a field as an array."""
    array, dtype = np.asarray(value), entry_type(hint)
    if array.dtype != dtype and (dtype != np.float64 or type(value) is not int):
        raise TypeError(f"{path} must be {dtype}, not {array.dtype}")
    return array.astype(dtype, copy=False)


def _columns(element: type, messages: Any, path: str) -> dict[str, Array]:
    """The arrays of a tuple of messages of a class."""
    arrays = {f"{path}@count": np.asarray(len(_of(tuple, messages, path)))}
    for name, hint in hints_of(element).items():
        at = f"{path}.{name}"
        column = [_array(hint, getattr(_of(element, one, path), name), at) for one in messages]
        if (shape := shapes_of(element).get(name)) is not None:
            shapes = [array.shape for array in column]
            arrays[f"{at}@shape"] = np.array(shapes, dtype=np.int64).reshape(len(column), len(shape))
        arrays[at] = np.concatenate([np.zeros(0, entry_type(hint)), *(array.ravel() for array in column)])
    return arrays


def _message(kind: Any, left: dict[str, Array], path: str) -> Any:
    """The message of a class whose arrays' names begin with a path; they are taken out of those that are left."""
    values: dict[str, Any] = {}
    for name, hint in hints_of(kind).items():
        at = f"{path}{name}"
        if (element := element_of(hint)) is not None:
            values[name] = _tuple(element, left, at)
        elif dataclasses.is_dataclass(hint):
            values[name] = _message(hint, left, f"{at}.")
        elif hint in SCALARS:
            values[name] = _numbers(left, at, hint, ()).item()
        elif at not in left and f"{at}@lower" in left:
            values[name] = _whole(left, f"{at}@lower", hint)
        else:
            values[name] = _taken(left, at, hint)
    return _fitting(kind, values, path)


def _tuple(element: Any, left: dict[str, Array], path: str) -> tuple[Any, ...]:
    """The messages of a class whose fields are columns."""
    count = _numbers(left, f"{path}@count", int, ()).item()
    if count < 0:
        raise ArraysError(f"{path}@count is negative")
    columns: dict[str, list[Any]] = {}
    for name, hint in hints_of(element).items():
        at = f"{path}.{name}"
        if hint in SCALARS:
            columns[name] = _numbers(left, at, hint, (count,)).tolist()
        else:
            columns[name] = _arrays(left, at, hint, count)
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    return tuple(_fitting(element, row, f"{path}.") for row in rows)


def _fitting(kind: Any, values: dict[str, Any], path: str) -> Any:
    message = kind(**values)
    if wrong := misfit(message):
        raise ArraysError(f"{path}{wrong}")
    return message


def _taken(left: dict[str, Array], name: str, hint: Any) -> Array:
    """An array of what an annotation says."""
    dtype = entry_type(hint)
    if name not in left:
        raise ArraysError(f"{name} is missing")
    array = left.pop(name)
    if array.dtype.kind != dtype.kind:
        raise ArraysError(f"{name} holds no {_NAMES[dtype.kind]}")
    if array.dtype.itemsize != dtype.itemsize:
        raise ArraysError(f"{name} must be {dtype}, not {array.dtype}")
    if dtype.kind == "f" and np.isnan(array).any():
        raise ArraysError(f"{name} holds NaN")
    return array.astype(dtype, copy=False)


def _numbers(left: dict[str, Array], name: str, hint: Any, shape: tuple[int, ...]) -> Array:
    array = _taken(left, name, hint)
    if array.shape != shape:
        raise ArraysError(f"{name} has the wrong shape")
    return array


def _arrays(left: dict[str, Array], name: str, hint: Any, count: int) -> list[Array]:
    """The arrays that stand one after the other in a column."""
    stored, shapes = _taken(left, name, hint), _taken(left, f"{name}@shape", int)
    if shapes.ndim != 2 or len(shapes) != count or np.any(shapes < 0):
        raise ArraysError(f"{name}@shape has the wrong shape")
    sizes = [math.prod(shape) for shape in shapes.tolist()]
    # Where one dimension is 0 the others may say what they like: an array of no numbers has no long side either.
    if np.any(shapes > len(stored) + _WIDEST) or stored.ndim != 1 or sum(sizes) != len(stored):
        raise ArraysError(f"{name}@shape does not fit {name}")
    rows = zip(shapes.tolist(), sizes, itertools.accumulate(sizes), strict=True)
    return [stored[end - size : end].reshape(shape) for shape, size, end in rows]


def _is_symmetric(name: str, array: Array) -> bool:
    """Whether a field's name and array are those of a stack of covariances, symmetric to the bit."""
    if not f"_{name}".endswith("_covariance"):
        return False
    bits = np.ascontiguousarray(array).view(np.int64)
    return array.shape[-1] == array.shape[-2] and np.array_equal(bits, np.swapaxes(bits, -1, -2))


def _whole(left: dict[str, Array], name: str, hint: Any) -> Array:
    """Symmetric matrices by their lower triangles."""
    lower = _taken(left, name, hint)
    length = lower.shape[-1] if lower.ndim else 0
    size = (math.isqrt(8 * length + 1) - 1) // 2
    if not lower.ndim or length != size * (size + 1) // 2:
        raise ArraysError(f"{name} has the wrong shape")
    rows, columns = np.tril_indices(size)
    array = np.empty((*lower.shape[:-1], size, size), lower.dtype)
    array[..., rows, columns] = lower
    array[..., columns, rows] = lower
    return array

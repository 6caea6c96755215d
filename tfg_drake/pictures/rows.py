"""Tables of a timeline: which of their rows stand in the file, and so what has to be written of one as it is now."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tfg_drake.messages import FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of a layer.

    arrays: each has n rows. values: (n, k), two rows are alike where no value differs by more than 1. keys: (n,)
    integers: rows with the same key are the same thing, earlier and later. Without keys a row is told by its values
    alone.
    """

    arrays: Mapping[str, NDArray[Any]]
    values: FloatArray
    keys: IntArray | None = None


@dataclasses.dataclass(eq=False)
class StandingRows:
    """The rows of a layer that stand in a file. A row's number counts the rows that were written before it."""

    _count: int = 0
    _numbers: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _values: FloatArray | None = None
    _keys: IntArray | None = None

    def change(self, table: Table) -> tuple[IntArray, IntArray]:
        """Makes what stands like a table; returns the rows of the table that have to be written, and the numbers of
        those that no longer stand."""
        before = table.values[:0] if self._values is None else self._values
        same = _alike(before, table.values, self._keys, table.keys)
        stays = np.zeros(len(before), dtype=np.bool_)
        stays[same[same >= 0]] = True
        gone, added = self._numbers[~stays], np.flatnonzero(same < 0)
        self._numbers = np.append(self._numbers[stays], self._count + np.arange(len(added)))
        self._count += len(added)
        self._values = np.vstack([before.compress(stays, axis=0), table.values.take(added, axis=0)])
        if table.keys is not None:
            keys = table.keys[added]
            self._keys = keys if self._keys is None else np.append(self._keys[stays], keys)
        return added, gone


def _alike(before: FloatArray, values: FloatArray, old_keys: IntArray | None, keys: IntArray | None) -> IntArray:
    """Index of a row of before (m, k) that is like each of values (n, k), -1 for none."""
    if not len(before) or not len(values):
        return np.full(len(values), -1)
    if keys is None or old_keys is None:
        tree = cKDTree(before, compact_nodes=False, balanced_tree=False)
        _, rows = tree.query(values, p=np.inf, distance_upper_bound=1.0)
        return np.where(rows < len(before), rows, -1)
    order = np.argsort(old_keys)
    rows = order[np.searchsorted(old_keys, keys, sorter=order).clip(max=len(order) - 1)]
    known = (old_keys[rows] == keys) & (np.abs(before.take(rows, axis=0) - values) <= 1.0).all(axis=1)
    return np.where(known, rows, -1)

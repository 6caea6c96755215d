"""Tables of a timeline: which of their rows stand in the file, and so what has to be written of one as it is now."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tfg_drake.messages import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class Near:
    """Area of a table: within reach, m, of center, (2,) m."""

    center: FloatArray
    reach: float

    def holds(self, places: FloatArray) -> BoolArray:
        """Mask (n,) of the places (n, 2), m, in it."""
        return np.asarray(np.hypot(*(places - self.center).T) <= self.reach)


EVERYWHERE = Near(np.zeros(2), math.inf)


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of a layer.

    arrays: each has n rows. places: (n, 2) m, where each row is. values: (n, k), two rows are alike where no value
    differs by more than 1. keys: (n,) integers: rows with the same key are the same thing, earlier and later. Without
    keys a row is told by its values alone.
    """

    arrays: Mapping[str, NDArray[Any]]
    places: FloatArray
    values: FloatArray
    keys: IntArray | None = None


@dataclasses.dataclass(eq=False)
class StandingRows:
    """The rows of a layer that stand in a file.

    numbers: (n,) of each row, how many were written before it. places: (n, 2) m, where each is.
    """

    _count: int = 0
    numbers: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    places: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    _values: FloatArray | None = None
    _keys: IntArray | None = None

    def change(self, table: Table, near: Near = EVERYWHERE) -> tuple[IntArray, IntArray]:
        """Makes what stands like a table, as far as the table tells.

        Args:
            table: what is there now.
            near: where the table is told; rows elsewhere stand as they did.

        Returns:
            The rows of the table that have to be written, and the numbers of those that no longer stand.
        """
        there = np.flatnonzero(near.holds(table.places))
        values = table.values.take(there, axis=0)
        keys = None if table.keys is None else table.keys[there]
        before = np.zeros((0, values.shape[1])) if self._values is None else self._values
        told = near.holds(self.places)
        if keys is not None and self._keys is not None and not told.all():
            told |= np.isin(self._keys, keys)
        old = np.flatnonzero(told)
        old_keys = None if keys is None or self._keys is None else self._keys[old]
        same = _alike(before.take(old, axis=0), values, old_keys, keys)
        stays = ~told
        stays[old[same[same >= 0]]] = True
        new = same < 0
        gone, added = self.numbers[~stays], there[new]
        self.numbers = np.append(self.numbers[stays], self._count + np.arange(len(added)))
        self._count += len(added)
        self.places = np.vstack([self.places.compress(stays, axis=0), table.places.take(added, axis=0)])
        self._values = np.vstack([before.compress(stays, axis=0), values.compress(new, axis=0)])
        if keys is not None:
            self._keys = keys[new] if self._keys is None else np.append(self._keys[stays], keys[new])
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

"""Tables of a timeline: whatever changes, what stands is what there is, and little is written of it."""

import numpy as np
import pytest

from tfg_drake.pictures.rows import StandingRows, Table


class Reader:
    """Who is told of the changes."""

    def __init__(self):
        self.standing, self.rows, self.written = StandingRows(), {}, 0

    def tell(self, values, keys=None):
        """Returns how many rows are written, and how many gone."""
        values = np.asarray(values, dtype=float)
        added, gone = self.standing.change(Table({}, values, keys))
        for number in gone:
            del self.rows[number]
        for row in added:
            self.rows[self.written] = values[row]
            self.written += 1
        return len(added), len(gone)


@pytest.mark.parametrize("keyed", [True, False])
def test_what_stands_is_what_there_is_but_for_what_is_alike(keyed):
    rng = np.random.default_rng(0)
    reader = Reader()
    values, keys = np.zeros((0, 3)), np.zeros(0, dtype=int)
    for _ in range(30):
        stays = rng.random(len(keys)) < 0.8
        values, keys = values[stays] + rng.normal(0.0, 0.7, (stays.sum(), 3)), keys[stays]
        fresh = np.setdiff1d(rng.integers(0, 1000, 10), keys)
        values, keys = np.vstack([values, rng.uniform(-1e3, 1e3, (len(fresh), 3))]), np.append(keys, fresh)
        order = rng.permutation(len(keys))
        values, keys = values[order], keys[order]
        reader.tell(values, keys if keyed else None)
        apart = np.abs(np.array(list(reader.rows.values()))[:, None] - values).max(axis=2)
        assert len(reader.rows) == len(values)
        assert apart.min(axis=0).max() <= 1.0
        assert apart.min(axis=1).max() <= 1.0


def test_only_what_has_changed_is_written():
    reader = Reader()
    values, keys = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]), np.array([7, 5, 9])
    assert reader.tell(values, keys) == (3, 0)
    assert reader.tell(values + 0.9, keys) == (0, 0)
    assert reader.tell(values + 1.1, keys) == (3, 3)  # since it was written
    assert reader.tell(values[1:] + 1.1, keys[1:]) == (0, 1)
    assert reader.tell(np.zeros((0, 2)), keys[:0]) == (0, 2)
    assert reader.tell(values, keys) == (3, 0)

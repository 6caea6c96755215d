"""A grid on disk."""

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.grid.saved_grid import load_grid, save_grid
from tfg_drake.io.files import FileError
from tfg_drake.messages import GridMap


@pytest.fixture
def path(tmp_path):
    probability = np.linspace(0.0, 1.0, 12, dtype=np.float32).reshape(3, 4)
    save_grid(tmp_path / "grid.npz", GridMap(7, 12.5, 0.1, np.array([-1.0, 2.0]), probability))
    return tmp_path / "grid.npz"


def test_a_grid_comes_back(path):
    grid = load_grid(path)
    assert (grid.stage, grid.stamp, grid.resolution, grid.origin.tolist()) == (7, 12.5, 0.1, [-1.0, 2.0])
    assert (grid.probability.shape, grid.probability[2, 3]) == ((3, 4), 1.0)


def test_a_mutated_grid_is_refused_or_read(path):
    assert_refused_or_read(path, lambda: load_grid(path), FileError)


def test_what_is_no_grid_is_one_line(path):
    np.savez(path, stage=7, stamp=0.0, resolution=0.1, origin=np.zeros(2), probability=np.zeros(3))
    with pytest.raises(FileError) as caught:
        load_grid(path)
    assert str(caught.value) == f"{path}: is damaged; copy it again from where it was recorded"
    with pytest.raises(FileError, match=r"none\.npz: no such file"):
        load_grid(path.with_name("none.npz"))

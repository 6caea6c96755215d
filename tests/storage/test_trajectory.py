import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.io.files import FileError
from tfg_drake.storage.trajectory import read_tum, write_tum


def test_round_trip(tmp_path):
    stamps = np.array([0.0, 0.03125, 1234.5])
    X_WB = np.array([[0.0, 0.0, 0.0], [1.5, -2.25, np.pi], [1e3, 3.0, -3.1]])
    write_tum(tmp_path / "t.tum", stamps, X_WB)
    read_stamps, read_poses = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(read_stamps, stamps, atol=1e-6)
    np.testing.assert_allclose(read_poses, X_WB, atol=1e-8)


def test_the_format(tmp_path):
    write_tum(tmp_path / "t.tum", np.array([1.5]), np.array([[1.0, 2.0, np.pi / 2]]))
    words = (tmp_path / "t.tum").read_text().split()
    expected = [1.5, 1.0, 2.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    np.testing.assert_allclose([float(word) for word in words], expected, atol=1e-9)


def test_an_empty_trajectory(tmp_path):
    write_tum(tmp_path / "t.tum", np.zeros(0), np.zeros((0, 3)))
    assert read_tum(tmp_path / "t.tum")[1].shape == (0, 3)


def test_a_short_line_is_refused(tmp_path):
    (tmp_path / "t.tum").write_text("# stamps\n1 2 3\n")
    with pytest.raises(ValueError, match="every line of a TUM trajectory has eight numbers"):
        read_tum(tmp_path / "t.tum")


def test_a_mutated_trajectory_is_refused_or_read(tmp_path):
    path = tmp_path / "t.tum"
    write_tum(path, np.arange(5.0), np.ones((5, 3)))
    assert_refused_or_read(path, lambda: read_tum(path), FileError)
    path.write_text("1 2 3 4 5 6 7 eight\n")
    with pytest.raises(FileError) as caught:
        read_tum(path)
    assert str(caught.value) == f"{path}: every line of a TUM trajectory has eight numbers"
    with pytest.raises(FileError, match=r"none\.tum: no such file"):
        read_tum(tmp_path / "none.tum")

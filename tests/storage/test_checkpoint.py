"""Checkpoints of missions under way."""

import os
import pickle
import zlib

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.messages import FloatArray, MissionStatus
from tfg_drake.storage import checkpoint
from tfg_drake.storage.checkpoint import MAGIC, CheckpointError, read_checkpoint, read_told, write_checkpoint

TOLD = {
    "scenario": "room",
    "world": "room",
    "seed": 3,
    "robot": "sim",
    "method": "tfg",
    "own": False,
    "scenario_digest": "",
    "sim_time_s": 1.5,
    "stamps": np.zeros(2),
    "X_WB": np.ones((2, 3)),
    "contacts": None,
}
STATE = {"time": (float, 1.5), "status": (MissionStatus, MissionStatus("observe", 3, 1.5))}


@pytest.fixture
def file(tmp_path):
    write_checkpoint(tmp_path / "checkpoint.bin", TOLD, STATE)
    return tmp_path / "checkpoint.bin"


def with_checksum(data):
    return MAGIC + zlib.crc32(data).to_bytes(4, "little") + data


def test_a_checkpoint_is_read_as_it_was_written(file):
    told, state = read_checkpoint(file.parent)
    assert (told["method"], told["contacts"]) == ("tfg", None)
    np.testing.assert_array_equal(told["X_WB"], np.ones((2, 3)))
    assert state.take("time", float) == 1.5
    assert vars(state.take("status", MissionStatus)) == vars(STATE["status"][1])
    assert read_told(file)["seed"] == 3


@pytest.mark.parametrize(
    ("name", "hint", "problem"),
    [
        ("status", FloatArray, "status: there is none of that number"),
        ("time", MissionStatus, "time: there is none of that number"),
        ("time", str, "time: must be str, not float"),
        ("x", float, "x: must be float, not NoneType"),
    ],
)
def test_a_part_that_does_not_fit_is_told(file, name, hint, problem):
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(file)[1].take(name, hint)
    assert str(caught.value).startswith(f"{file}: is damaged ({problem})")
    assert "--map" in str(caught.value)


def test_a_pickle_is_not_even_looked_at(tmp_path):
    class Runs:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "made"),)

    data = pickle.dumps(Runs())
    for made in (MAGIC + data, with_checksum(data), b"tfg_drake checkpoint 1\n" + data):
        (tmp_path / "checkpoint.bin").write_bytes(made)
        with pytest.raises(CheckpointError):
            read_told(tmp_path)
    assert not (tmp_path / "made").exists()


def test_another_version_is_told_to_begin_with_the_map(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "__version__", "0.0.1")
    write_checkpoint(tmp_path / "checkpoint.bin", TOLD, STATE)
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match=r"written by version 0\.0\.1.*--map"):
        read_checkpoint(tmp_path)
    assert read_told(tmp_path)["version"] == "0.0.1"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "is no checkpoint"),
        (b"tfg_drake checkpoint 0\n", "is no checkpoint"),
        (MAGIC, "is damaged"),
        (with_checksum(b""), "is damaged"),
        (with_checksum(bytes(30)), "is damaged"),
        (MAGIC + bytes(1000), "is damaged"),
    ],
)
def test_anything_else_is_refused_in_one_line(tmp_path, data, problem):
    (tmp_path / "checkpoint.bin").write_bytes(data)
    with pytest.raises(CheckpointError, match=problem) as caught:
        read_told(tmp_path)
    assert "\n" not in str(caught.value)


def test_every_damaged_byte_is_noticed(file):
    assert_refused_or_read(file, lambda: read_checkpoint(file), CheckpointError, 500)


@pytest.mark.parametrize(
    "change",
    [
        {"scenario": "room\nsudo something"},
        {"robot": "\x1b[2Jsim"},
        {"method": "tfg\r"},
        {"stamps": np.zeros(3)},
    ],
)
def test_what_is_told_is_lines_of_text_and_fits(file, change):
    write_checkpoint(file, TOLD | change, STATE)
    with pytest.raises(CheckpointError, match="is damaged"):
        read_told(file)


def test_a_huge_file_without_contents_is_refused(file):
    with file.open("r+b") as sparse:
        sparse.truncate(2**40)
    with pytest.raises(CheckpointError, match="more than 256 MiB"):
        read_told(file)


def test_a_folder_without_one_is_told(tmp_path):
    with pytest.raises(CheckpointError, match="holds no mission to go on with"):
        read_checkpoint(tmp_path)

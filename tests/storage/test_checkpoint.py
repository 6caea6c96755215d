"""Checkpoints of missions under way."""

import dataclasses
import os
import pickle

import numpy as np
import pytest

from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import MissionStatus
from tfg_drake.storage import checkpoint
from tfg_drake.storage.checkpoint import CheckpointError, read_checkpoint, read_told, write_checkpoint


def test_a_checkpoint_is_read_as_it_was_written(tmp_path):
    told = {"method": "tfg", "X_WB": np.eye(3)}
    status = MissionStatus(phase="observe", stage=3, since=1.5)
    state = {"systems": {"/explorer": [np.arange(3.0), status, {1: (status, None)}, np.float64(2.0), {4, 5}]}}
    write_checkpoint(tmp_path / "checkpoint.bin", told, state)
    found, after = read_checkpoint(tmp_path)
    assert found["method"] == "tfg"
    np.testing.assert_array_equal(found["X_WB"], np.eye(3))
    vector, one, nested, number, numbers = after["systems"]["/explorer"]
    np.testing.assert_array_equal(vector, np.arange(3.0))
    assert dataclasses.asdict(one) == dataclasses.asdict(status)
    # What was one object is one object still.
    assert nested[1][0] is one
    assert (number, numbers) == (2.0, {4, 5})
    assert read_told(tmp_path)["method"] == "tfg"


class Runs:
    """Runs something when it is read."""

    def __reduce__(self):
        return os.system, ("true",)


class Writes:
    def __reduce__(self):
        from tfg_drake.io.files import write_atomic

        return write_atomic, ("somewhere", "something")


class Calls:
    def __reduce__(self):
        return np.load, ("somewhere",)


@pytest.mark.parametrize("bad", [Runs(), Writes(), Calls()])
def test_nothing_that_is_read_is_run(tmp_path, bad):
    write_checkpoint(tmp_path / "checkpoint.bin", {}, {"bad": bad})
    with pytest.raises(CheckpointError, match="has no place in it"):
        read_checkpoint(tmp_path)


def test_dotted_names_do_not_reach_beyond(tmp_path):
    # GLOBAL of protocol 4 with a dotted name: `tfg_drake.io.files` has imported os.
    data = checkpoint.MAGIC + b"\x80\x04\x8c\x12tfg_drake.io.files\x8c\tos.system\x93."
    (tmp_path / "checkpoint.bin").write_bytes(data)
    with pytest.raises(CheckpointError, match="has no place in it"):
        read_told(tmp_path)


def test_another_version_is_told_to_begin_with_the_map(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "__version__", "0.0.1")
    write_checkpoint(tmp_path / "checkpoint.bin", {}, {})
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match=r"written by version 0\.0\.1.*--map"):
        read_checkpoint(tmp_path)
    assert read_told(tmp_path)["version"] == "0.0.1"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "is no checkpoint"),
        (b"tfg_drake checkpoint 0\n", "is no checkpoint"),
        (checkpoint.MAGIC, "is damaged"),
        (checkpoint.MAGIC + pickle.dumps({"version": 1})[:-3], "is damaged"),
        (checkpoint.MAGIC + pickle.dumps([SavedMap]), "is damaged"),
    ],
)
def test_anything_else_is_refused_in_one_line(tmp_path, data, problem):
    (tmp_path / "checkpoint.bin").write_bytes(data)
    with pytest.raises(CheckpointError, match=problem) as caught:
        read_told(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_folder_without_one_is_told(tmp_path):
    with pytest.raises(CheckpointError, match="holds no mission to go on with"):
        read_checkpoint(tmp_path)

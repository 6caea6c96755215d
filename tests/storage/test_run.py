"""A run's folder is read as plain arrays."""

import importlib.util
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import tfg_drake
from tests.mutations import assert_refused_or_read
from tfg_drake.io.extras import pip_install
from tfg_drake.io.files import FileError
from tfg_drake.mapfile.saved_map import save_map
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections
from tfg_drake.storage.port_recording import FILE_NAME, PortWriter
from tfg_drake.storage.run import RunError
from tfg_drake.storage.trajectory import write_tum


@pytest.fixture
def folder(tmp_path):
    """Three frames with 2, 0 and 1 tags."""
    (tmp_path / "summary.json").write_text(json.dumps({"outcome": "complete"}))
    (tmp_path / "stages.jsonl").write_text('{"stage": 1, "landmarks": 3}\n{"stage": 2, "landmarks": 4}\n')
    write_tum(tmp_path / "trajectory.tum", np.array([0.0, 0.5]), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]]))
    with PortWriter(tmp_path / FILE_NAME, "sim") as writer:
        for k, ids in enumerate(([3, 5], [], [5])):
            stamp, n = 0.1 * k, len(ids)
            numbers = np.arange(n) + 0.5 + k
            writer.write("base.odometry", stamp, Odometry(stamp, np.array([k, 0.0, 0.0]), np.zeros(2)))
            writer.write("base.hazards", stamp, Hazards(stamp, 0, 0, 0))
            tags = TagDetections(stamp, np.array(ids, dtype=np.int64), numbers, numbers, numbers, numbers)
            writer.write("tags.detections", stamp, tags)
            writer.write("scan.ranges", stamp, LaserScan(stamp, np.array([0.0, 0.1]), np.array([1.0, k]), 8.0, 0.01))
    return tmp_path


def test_everything_is_an_array(folder):
    run = tfg_drake.load_run(folder)
    assert run.summary["outcome"] == "complete"
    assert [row["landmarks"] for row in run.stages] == [3, 4]
    np.testing.assert_allclose(run.X_WB, [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]], atol=1e-8)
    assert run.X_WB_true.shape == (0, 3)
    assert run.map is None
    odometry = run.port("base.odometry")
    np.testing.assert_array_equal(odometry["X_OB"][:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(odometry["time"], [0.0, 0.1, 0.2])
    assert run.port("scan.ranges")["ranges"].shape == (3, 2)


def test_lists_of_differing_length_name_their_messages(folder):
    tags = tfg_drake.load_run(folder).port("tags.detections")
    np.testing.assert_array_equal(tags["ids"], [3, 5, 5])
    np.testing.assert_array_equal(tags["message"], [0, 0, 2])
    np.testing.assert_allclose(tags["range"], [0.5, 1.5, 2.5])
    assert tags["stamp"].shape == (3,)


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_frame_has_a_row_an_entry(folder, library, monkeypatch):
    pytest.importorskip(library, reason=f"{library} is not installed: pip install {library}")
    if library == "polars":
        find = importlib.util.find_spec
        monkeypatch.setattr("importlib.util.find_spec", lambda name: (name != "pandas" and find(name)) or None)
    run = tfg_drake.load_run(folder)
    assert len(run.frame("scan.ranges")) == 3
    frame = run.frame("tags.detections")
    assert type(frame).__module__.startswith(library)
    assert list(frame["ids"]) == [3, 5, 5]
    np.testing.assert_allclose(frame["stamp"], [0.0, 0.0, 0.2])


def test_without_pandas_and_polars_it_is_said_what_to_install(folder, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    told = re.escape(f"neither pandas nor polars is installed; get pandas with {pip_install('frames')}")
    with pytest.raises(ImportError, match=told):
        tfg_drake.load_run(folder).frame("base.odometry")
    extras = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert extras["optional-dependencies"]["frames"][0].startswith("pandas")


def test_a_run_says_in_a_line_what_it_is(folder):
    assert repr(tfg_drake.load_run(folder)) == f"<run {folder}: complete after 0 s, 2 stages>"
    # Whatever somebody has made of it, and what a mission says that failed at once.
    for time, shown in ((None, "None"), ("soon", "soon"), (12.5, "12.5")):
        (folder / "summary.json").write_text(json.dumps({"outcome": "complete", "sim_time_s": time}))
        assert f"after {shown} s" in repr(tfg_drake.load_run(folder))


def test_a_folder_without_a_run_is_told_in_a_line(folder):
    with pytest.raises(RunError, match="holds no run"):
        tfg_drake.load_run(folder / "nothing")
    with pytest.raises(KeyError, match=r"no port base; the run has base\.odometry"):
        tfg_drake.load_run(folder).port("base")


@pytest.mark.parametrize("name", ["summary.json", "stages.jsonl", "trajectory.tum", "truth.tum", "map.npz", FILE_NAME])
def test_a_mutated_file_is_refused_in_a_line_or_read(folder, small_map, name):
    write_tum(folder / "truth.tum", np.arange(3.0), np.ones((3, 3)))
    save_map(folder / "map.npz", small_map)
    assert_refused_or_read(folder / name, lambda: tfg_drake.load_run(folder).recording, FileError, count=50)


@pytest.mark.parametrize(("name", "text"), [("stages.jsonl", '{"stage": 1}\n[2]\n'), ("summary.json", "[]")])
def test_the_file_that_is_damaged_is_named(folder, name, text):
    (folder / name).write_text(text)
    with pytest.raises(FileError) as caught:
        tfg_drake.load_run(folder)
    assert str(caught.value) == f"{folder / name}: is damaged; copy it again from where it was recorded"

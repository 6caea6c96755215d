"""A run's folder: for one run at a time, without another one's results, and no mission's end where it cannot be
written."""

import errno
import json
import logging
import os
import resource
import subprocess
import sys

import numpy as np
import pytest

from tests.diagrams.rooms import DIVIDED, QUICK_LOOK, room
from tfg_drake.diagrams.methods import FindMethod
from tfg_drake.diagrams.missions import report, run, run_folder
from tfg_drake.diagrams.missions.run_folder import RESULTS, RunFolder, open_run_folder
from tfg_drake.grid.saved_grid import load_grid
from tfg_drake.mapfile.saved_map import load_map

FULL = os.strerror(errno.ENOSPC)
# A process that is killed while it holds a folder.
HOLDER = """
import sys
from pathlib import Path
from tfg_drake.diagrams.missions.run_folder import claimed
with claimed(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def held(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    yield holder
    holder.kill()
    holder.communicate()


@pytest.mark.parametrize("command", ["explore --headless", "slam nowhere.g2o", "compare", "figures"])
def test_a_second_run_into_a_folder_is_refused_in_one_line(call, held, tmp_path, monkeypatch, command):
    # On a busy machine it would say meanwhile that it loads.
    monkeypatch.setattr("tfg_drake.diagrams.screen.INTERVAL", 1e6)
    problem = "another run is at work in it; wait for its end, or name another folder"
    assert call(*command.split(), "--out", tmp_path) == (2, "", f"tfg-drake: --out {tmp_path}: {problem}\n")


def test_a_run_that_was_killed_refuses_nobody(held, tmp_path):
    with pytest.raises(BlockingIOError), open_run_folder(tmp_path, ""):
        pass
    held.kill()
    held.wait()
    with open_run_folder(tmp_path, ""):
        pass


def test_a_refused_run_touches_nothing(held, tmp_path):
    (tmp_path / "map.npz").write_text("of the run at work")
    with pytest.raises(BlockingIOError):
        run.run_mission(room(), out_dir=tmp_path)
    assert (tmp_path / "map.npz").read_text() == "of the run at work"


def test_results_of_an_earlier_run_do_not_stay(tmp_path):
    for name in (*RESULTS, "scenario.yaml", "notes.txt"):
        (tmp_path / name).write_text("earlier")
    with open_run_folder(tmp_path, ""):
        assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_scenario_that_no_run_left_stays(tmp_path):
    (tmp_path / "scenario.yaml").write_text("mine")
    with open_run_folder(tmp_path, ""):
        assert (tmp_path / "scenario.yaml").read_text() == "mine"


def test_the_reserve_is_there_for_the_end_and_leaves_no_file(tmp_path):
    with open_run_folder(tmp_path, "") as folder:
        before = os.statvfs(tmp_path)
        folder.keep_reserve()
        assert list(tmp_path.iterdir()) == []
        kept = os.fstat(folder._reserve).st_blocks * 512
        assert kept >= run_folder.RESERVE
        folder.give_up_reserve()
        folder.give_up_reserve()
        assert folder._reserve is None
        assert before.f_bsize == os.statvfs(tmp_path).f_bsize


def test_no_room_for_a_reserve_is_told(tmp_path, monkeypatch, caplog):
    def fail(*_arguments):
        raise OSError(errno.ENOSPC, FULL)

    monkeypatch.setattr(run_folder.os, "posix_fallocate", fail)
    with open_run_folder(tmp_path, "") as folder:
        folder.keep_reserve()
    assert caplog.messages == [f"{tmp_path}: no room for a reserve: {FULL}; the map may not fit at the end"]


def test_lines_wait_until_they_can_be_written(tmp_path, monkeypatch, caplog):
    folder = RunFolder(tmp_path)
    folder.append("lines", "one\n")
    monkeypatch.setattr(run_folder, "_append", _fail)
    folder.append("lines", "two\n")
    folder.append("lines", "three\n")
    assert folder.unwritten == {"lines": FULL}
    assert caplog.messages == [f"{tmp_path / 'lines'}: cannot be written: {FULL}; the mission goes on"]
    monkeypatch.undo()
    folder.append("lines", "four\n")
    assert folder.unwritten == {}
    assert (tmp_path / "lines").read_text() == "one\ntwo\nthree\nfour\n"


def _fail(*_arguments, **_options):
    raise OSError(errno.ENOSPC, FULL)


def test_a_full_disk_ends_neither_the_log_nor_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        run_folder, "open_inside", lambda _path, *how, **more: (tmp_path / "/dev/full").open(*how, **more)
    )
    folder = RunFolder(tmp_path)
    with folder.logging(), run_folder.remarks_on_screen():
        logging.getLogger("tfg_drake.run").info("stage 1")
        logging.getLogger("tfg_drake.run").info("stage 2")
    assert folder.unwritten == {"log.txt": FULL}
    remarks = f"{tmp_path / 'log.txt'}: cannot be written: {FULL}; the mission goes on\n"
    assert capsys.readouterr() == (remarks, "")


class Ends(Exception):
    """Stands for the program's sudden end."""


@pytest.mark.parametrize(
    ("method", "file", "load"), [("tfg", "map.npz", load_map), ("grid-nearest", "grid.npz", load_grid)]
)
def test_the_map_is_on_the_disk_while_it_grows(tmp_path, monkeypatch, method, file, load):
    kept = {}

    def look(progress):
        if (tmp_path / file).exists():
            kept[progress.stage] = load(tmp_path / file).stage

    def end(*_arguments):
        raise Ends

    monkeypatch.setattr(run, "write_report", end)
    monkeypatch.setattr(run, "KEPT_SHARE", np.inf)
    with pytest.raises(Ends):
        run.run_mission(room(), method=FindMethod(method), max_time=14.0, out_dir=tmp_path, on_progress=look)
    assert len(kept) >= 2
    assert all(stage - 1 <= of_map for stage, of_map in kept.items())
    assert len(list(tmp_path.glob("*.npz"))) == 1


def test_a_comparison_keeps_no_map_meanwhile(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "_keeper", _fail)
    result = run.run_mission(room(), max_time=8.5, out_dir=tmp_path, record=False)
    assert load_map(tmp_path / "map.npz").stage == result.summary["stages"]


@pytest.mark.slow
def test_a_map_is_kept_as_often_as_that_takes_little_time(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "KEPT_SHARE", 1e-9)
    saved = []
    monkeypatch.setattr(report, "save_map", lambda path, found, final: saved.append((found.stage, final)))
    run.run_mission(room(), max_time=14.0, out_dir=tmp_path)
    assert saved == [(3, False), (3, True)]


@pytest.mark.slow
@pytest.mark.parametrize("lost", [["map.npz"], ["summary.json"], ["figure.png"], ["trajectory.tum", "truth.tum"]])
def test_what_cannot_be_written_at_the_end_is_one_file_only(call, tmp_path, monkeypatch, lost):
    writers, keep = {"map.npz": "save_map", "summary.json": "write_atomic", "figure.png": "_draw"}, report.save_map
    monkeypatch.setattr(report, writers.get(lost[0], "write_tum"), _fail)
    if lost == ["map.npz"]:
        fails_at_end = lambda path, found, final: _fail() if final else keep(path, found, final=final)  # noqa: E731
        monkeypatch.setattr(report, "save_map", fails_at_end)
    monkeypatch.setattr(run, "KEPT_SHARE", np.inf)
    (tmp_path / "room.yaml").write_text(DIVIDED + QUICK_LOOK)
    arguments = ["explore", tmp_path / "room.yaml", "--tag-spacing", 1, "--headless", "--max-time", 11.5, "--json"]
    code, out, _ = call(*arguments, "--out", tmp_path / "run")
    assert code == (4 if lost[0] in ("map.npz", "summary.json") else 0)
    rows = [line for line in out.splitlines() if line.startswith("not whole")]
    assert rows == [f"not whole   {name}: {FULL}" for name in lost]
    summary = json.loads(out.splitlines()[-1])
    assert summary["outcome"] == "time_limit"
    # Of the map there is that of the last stage or the one before, as it was kept then.
    assert load_map(tmp_path / "run" / "map.npz").stage >= summary["stages"] - 1 >= 1
    written = {"map.npz", "summary.json", "figure.png", "trajectory.tum", "truth.tum", "stages.jsonl", "log.txt"}
    assert written - {path.name for path in (tmp_path / "run").iterdir()} == set(lost) - {"map.npz"}


def test_a_disk_that_fills_up_ends_neither_the_mission_nor_the_map(tmp_path):
    """This process's files may not grow beyond a size from the first view on, which stands for the disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def look(progress):
        if progress.time == 8.0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
        if progress.outcome:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    try:
        result = run.run_mission(room(), name="room", max_time=11.5, out_dir=tmp_path, on_progress=look)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert result.summary["outcome"] == "time_limit"
    assert sorted(result.unwritten) == ["checkpoint.bin", "ports.mcap", "timeline.tfg"]
    stages = result.summary["stages"]
    assert load_map(tmp_path / "map.npz").stage == stages > 1
    lines = (tmp_path / "stages.jsonl").read_text().splitlines()
    assert [json.loads(line)["stage"] for line in lines] == list(np.arange(1, stages + 1))

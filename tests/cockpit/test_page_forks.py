"""The forks that a run's page asks for."""

import json
import sys
import time

import pytest

from tfg_drake.cockpit.page_forks import PageForks
from tfg_drake.diagrams.commands.view import can_fork

SUMMARY = {
    "version": "0",
    "scenario": "house",
    "world": "house",
    "method": "tfg",
    "contacts": 0,
    "outcome": "complete",
    "sim_time_s": 100.0,
    "distance_m": 20.0,
    "stages": 9,
    "position_error_moving_m": {"mean": 0.01},
    "heading_error_rad": {"mean": 0.001},
    "landmark_rmse_m": 0.02,
    "landmarks_mapped": 30,
    "surface_coverage_5cm": 0.99999,
    "area_coverage": 1.0,
    "landmark_entropy_nats": -300.0,
}
# In the place of Python's: its last argument is the fork's folder.
PROGRAM = """#!/bin/sh
for folder; do :; done
echo "$@" > "{log}"
mkdir "$folder"
echo "  10 s  stage 1"
{rest}
"""


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "house"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    (folder / "scenario.yaml").write_text("base: house\n")
    (folder / "stages.jsonl").write_text('{"stage": 1}\n')
    return folder


def forked(run, monkeypatch, rest):
    """The state of a fork when it has ended, and how it was called."""
    program = run.parent / "program"
    program.write_text(PROGRAM.format(log=run.parent / "called", rest=rest))
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    forks = PageForks(run)
    assert forks.state()["number"] == 0
    assert forks.start(4, (1.5, -2.0))
    limit = time.monotonic() + 60.0
    while forks.is_running:
        assert time.monotonic() < limit
        time.sleep(0.01)
    return forks.state(), (run.parent / "called").read_text().split()


def test_a_fork_that_no_process_can_be_started_for_is_told_and_the_next_one_goes_on(run, monkeypatch):
    forks = PageForks(run)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", "/nowhere/python")
        assert forks.start(4, (1.5, -2.0))
    failure = "the fork cannot be started: No such file or directory; end other programs, and ask again"
    assert (forks.state()["failure"], forks.is_running) == (failure, False)
    state, _ = forked(run, monkeypatch, "exit 1")
    assert state["failure"] == "10 s  stage 1"


def test_a_fork_is_a_process_and_is_compared_with_its_run(run, monkeypatch):
    other = run.parent / "other.json"
    other.write_text(json.dumps(SUMMARY | {"sim_time_s": 90.0}))
    state, called = forked(run, monkeypatch, f"cp {other} $folder/summary.json")
    folder = str(run.with_name("house-fork-1"))
    assert called[2:] == ["fork", str(run), "--stage", "4", "--goal=1.5000,-2.0000", "--out", folder]
    assert (state["number"], state["stage"], state["folder"], state["failure"]) == (1, 4, folder, "")
    assert ("time", "100.0 s", "90.0 s", "-10.0 s") in state["rows"]


def test_why_there_is_no_fork_is_told_and_nothing_of_it_stays(run, monkeypatch):
    state, _ = forked(run, monkeypatch, "echo 'tfg-drake: goal 9,9: no place known' >&2; exit 2")
    assert (state["rows"], state["failure"]) == ([], "goal 9,9: no place known")
    assert not run.with_name("house-fork-1").exists()


def test_which_runs_can_be_forked(run):
    assert can_fork(run)
    for change in ({"contacts": None}, {"method": "manual"}, {"method": "mine"}):
        (run / "summary.json").write_text(json.dumps(SUMMARY | change))
        assert not can_fork(run)
    assert not can_fork(run.parent)

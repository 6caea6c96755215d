"""Benchmarks that watch a mission from within still see what they are to measure."""

import json
import runpy
import sys
from pathlib import Path

import pytest

from tfg_drake.datasets.recording import DatasetError

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
# What comes first of all, shortly.
QUICK = ("--set", "explorer.first_look=2", "--set", "explorer.first_turns=1")


@pytest.fixture
def run(monkeypatch, capsys):
    """What a benchmark prints with these arguments."""

    def make(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        monkeypatch.syspath_prepend(str(BENCHMARKS))
        runpy.run_path(str(BENCHMARKS / name), run_name="__main__")
        return capsys.readouterr().out

    return make


@pytest.mark.slow
def test_planning_time_sees_all_parts_of_a_stage(run) -> None:
    lines = run("planning_time.py", "paper", "--seeds", "1", "--max-time", "20", *QUICK).splitlines()
    assert int(lines[0].split()[0]) >= 2
    parts = ["tfg", "roadmap", "goal", "path", "planning", "all"]
    assert [line.split()[0] for line in lines[1:7]] == parts
    assert all(float(line.split()[1]) > 0.0 for line in lines[1:7])


@pytest.mark.slow
def test_chance_constraint_rolls_out_along_paths_of_every_stage(run) -> None:
    arguments = ("paper", "--max-time", "20", "--rollouts", "100", "--paths", "1", *QUICK)
    rows = [line.split() for line in run("chance_constraint.py", *arguments).splitlines()[1:]]
    assert [(row[0], float(row[1])) for row in rows] == [("point", 0.1), ("point", 0.01), ("path", 0.1), ("path", 0.01)]
    assert all(int(row[2]) >= 2 and int(row[3]) > 50 for row in rows)


@pytest.mark.slow
def test_gains_compares_every_formula_with_the_exact_one(run) -> None:
    lines = run("gains.py", "paper", "--seeds", "1", "--set", "explorer.budget_time=60", *QUICK).splitlines()
    assert int(lines[0].split()[0]) >= 2
    limit, paper, authors = (line.split() for line in lines[2:])
    assert [limit[0], paper[0], authors[0]] == ["limit", "paper", "authors"]
    assert abs(float(limit[1])) < abs(float(paper[1]))


def test_consistency_goes_on_where_it_stopped(run, monkeypatch, tmp_path) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    missions, results = (__import__(name) for name in ("missions", "results"))
    asked: list[tuple[list[str], int]] = []

    def summary(arguments: list[str], seed: int, _out: Path) -> dict:
        asked.append((arguments, seed))
        if len(asked) == 3:
            return {"seed": seed, "outcome": "exit 1", "reason": "killed"}
        nees = {"online_pose_anees": 1.0 + seed, "pose_anees": 0.9, "landmark_nees": 0.8}
        rest = {"landmark_rmse_m": 0.01, "contacts": 0, "cpu_time_s": 5.0, "sim_time_s": 300.0}
        return {"seed": seed, "outcome": "complete", "position_error_m": {"mean": 0.02}} | nees | rest

    monkeypatch.setattr(missions, "run_seed", summary)
    monkeypatch.setattr(results, "version", lambda: "abc")
    arguments = ("--out", str(tmp_path / "rows.jsonl"), "--seeds", "2", "--rows", "house", "house, poor odometry")
    run("consistency.py", *arguments)
    last = run("consistency.py", *arguments).splitlines()
    assert [seed for _, seed in asked] == [0, 1, 0, 1, 0]
    assert "reality.odometry.gyro_noise=0.015" in asked[-1][0]
    assert "--set" not in asked[0][0]
    rows = [line.split() for line in last if line.startswith("house")]
    assert [row[-21:-16] for row in rows] == [["2", "2", "1.50", "1.50", "2.00"]] * 2
    monkeypatch.setattr(results, "version", lambda: "def")
    run("consistency.py", *arguments)
    assert len(asked) == 9
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == 8


def test_relations_goes_on_where_it_stopped(run, tmp_path) -> None:
    figures = {"count": 3, "translation_m": {"mean": 0.05, "std": 0.01}, "rotation_deg": {"mean": 0.6, "std": 0.2}}
    kept = tmp_path / "relations.jsonl"
    kept.write_text(
        "".join(json.dumps({"log": log, "method": "karto", **figures, "cpu_time_s": 7.0}) + "\n" for log in ("a", "b"))
    )
    lines = run("relations.py", str(tmp_path), "--out", str(kept), "--logs", "a,b", "--methods", "karto").splitlines()
    assert [line.split() for line in lines[2:]] == [
        [log, "karto", "3", "0.0500", "+-", "0.0100", "0.6000", "+-", "0.2000", "7"] for log in ("a", "b")
    ]
    # Of a log that is not there nothing is kept.
    with pytest.raises(DatasetError, match=r"c.clf.bz2: no such file"):
        run("relations.py", str(tmp_path), "--out", str(kept), "--logs", "a,c", "--methods", "karto")
    assert len(kept.read_text().splitlines()) == 2

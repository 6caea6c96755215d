"""Benchmarks that watch a mission from within still see what they are to measure."""

import runpy
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def run(monkeypatch, capsys):
    """What a benchmark prints with these arguments."""

    def make(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        monkeypatch.syspath_prepend(str(BENCHMARKS))
        runpy.run_path(str(BENCHMARKS / name), run_name="__main__")
        return capsys.readouterr().out

    return make


def test_planning_time_sees_all_parts_of_a_stage(run) -> None:
    lines = run("planning_time.py", "paper", "--seeds", "1", "--max-time", "46").splitlines()
    assert int(lines[0].split()[0]) >= 2
    parts = ["tfg", "roadmap", "goal", "path", "planning", "all"]
    assert [line.split()[0] for line in lines[1:7]] == parts
    assert all(float(line.split()[1]) > 0.0 for line in lines[1:7])


def test_chance_constraint_rolls_out_along_paths_of_every_stage(run) -> None:
    arguments = ("paper", "--max-time", "46", "--rollouts", "100", "--paths", "1")
    rows = [line.split() for line in run("chance_constraint.py", *arguments).splitlines()[1:]]
    assert [(row[0], float(row[1])) for row in rows] == [("point", 0.1), ("point", 0.01), ("path", 0.1), ("path", 0.01)]
    assert all(int(row[2]) >= 2 and int(row[3]) > 50 for row in rows)


def test_gains_compares_every_formula_with_the_exact_one(run) -> None:
    lines = run("gains.py", "paper", "--seeds", "1", "--set", "explorer.budget_time=100").splitlines()
    assert int(lines[0].split()[0]) >= 2
    limit, paper, authors = (line.split() for line in lines[2:])
    assert [limit[0], paper[0], authors[0]] == ["limit", "paper", "authors"]
    assert abs(float(limit[1])) < abs(float(paper[1]))

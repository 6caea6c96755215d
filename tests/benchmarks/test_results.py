"""Tables of docs/results.md that benchmarks print."""

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def results(monkeypatch):
    """The module."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return __import__("results")


def test_tables_of_the_document_are_those_that_were_made(results) -> None:
    text = results.DOCUMENT.read_text()
    for path in results.TABLES.glob("*.md"):
        assert results.replaced(text, path.stem, path.read_text()) == text, path.stem


def test_a_table_is_what_follows_the_last_empty_line(results, monkeypatch, tmp_path) -> None:
    asked = []

    def run(command, **options):
        asked.append((command, options["cwd"]))
        return subprocess.CompletedProcess(command, 0, "seed 0\nseed 1\n\n\nworld  n\nflat   2\n\n")

    monkeypatch.setattr(results, "version", lambda: "abc")
    monkeypatch.setattr(results.subprocess, "run", run)
    monkeypatch.setitem(results.PRINTED, "logs", "located_pieces.py DATA/radish regions")
    table = results.printed("logs", tmp_path, tmp_path / "runs")
    first, told, *rest = table.splitlines()
    assert (first, rest) == ("```", ["world  n", "flat   2", "```"])
    assert told.startswith("$ python benchmarks/located_pieces.py DATA/radish ")
    assert told.endswith("  # abc")
    assert asked[0][0][:2] == [sys.executable, str(BENCHMARKS / "located_pieces.py")]
    assert str(tmp_path / "radish") in asked[0][0]
    assert asked[0][1] == tmp_path / "runs"


def test_tables_of_one_line_are_a_list(results, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(results, "version", lambda: "abc")
    monkeypatch.setitem(results.PRINTED, "faults", "kills.py + kills.py --scenario paper")
    done = subprocess.CompletedProcess([], 0, "a row\n\n20 of 20\n")
    monkeypatch.setattr(results.subprocess, "run", lambda *_, **__: done)
    lines = ["- `kills.py`, `abc`: 20 of 20.", "- `kills.py --scenario paper`, `abc`: 20 of 20."]
    assert results.printed("faults", None, tmp_path).splitlines() == lines


def test_a_table_without_its_data_or_of_a_benchmark_that_fails_is_left_alone(results, monkeypatch, tmp_path) -> None:
    assert results.printed("logs", None, tmp_path) is None
    monkeypatch.setattr(results.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "x"))
    assert results.printed("sessions", None, tmp_path) is None


def test_every_command_is_of_a_benchmark(results) -> None:
    commands = [one for arguments in results.PRINTED.values() for one in arguments.split(" + ")]
    assert all((BENCHMARKS / command.split()[0]).exists() for command in commands)


def test_every_table_has_its_place_in_the_document(results) -> None:
    text = results.DOCUMENT.read_text()
    for name in (*results.PRINTED, *results.MISSIONS):
        assert results.replaced(text, name, "new\n").count(" -->\nnew\n\n") == 1


def test_a_document_without_a_table_s_marks_is_refused(results) -> None:
    with pytest.raises(SystemExit, match="has no mark"):
        results.replaced("text\n", "kills", "")


def summary(seed: int, explored: float | None, **fields) -> dict:
    """The fields of a mission's summary that a table reads."""
    return {
        "seed": seed,
        "outcome": "complete" if explored else "stuck",
        "explored_s": explored,
        "area_seen_s": 80.0,
        "position_error_m": {"mean": 0.01, "max": 0.02},
        "online_pose_anees": 0.5,
        "surface_coverage_5cm": 0.9,
        "cpu_time_s": 10.0,
    } | fields


def test_methods_are_compared_over_the_seeds_that_both_explore(results, monkeypatch, tmp_path) -> None:
    seconds = {"tfg": {1: 100.0, 2: 300.0, 3: 900.0}, "grid-nearest": {1: 300.0, 2: 500.0, 3: None}}

    def run(arguments, folder):
        method = arguments[arguments.index("--method") + 1]
        assert arguments[arguments.index("--seed") + 1] == folder.name
        seed = int(folder.name)
        return None if (method, seed) == ("grid-nearest", 1) else summary(seed, seconds[method][seed])

    monkeypatch.setattr(results, "run", run)
    monkeypatch.setattr(results, "version", lambda: "abc")
    monkeypatch.setitem(results.MISSIONS, "explored", [results.Row("`house`", "house", range(1, 4))])
    options = argparse.Namespace(rows=None, seeds=None, data=None, out=tmp_path, jobs=1)
    table = results.of_missions("explored", options)
    assert table.splitlines()[-1] == (
        "| `house` | 1 to 3 | 3 of 3 | 433 | 80 | 0.010 | 90.0 | 10 | 0.50 (0.50)"
        " | 1 of 2 | 500 | 80 | 0.010 | 90.0 | 10 | 0.60 |"
    )


def test_a_row_that_needs_data_is_left_out_where_there_is_none(results, tmp_path) -> None:
    options = argparse.Namespace(rows=None, seeds=None, data=None, out=tmp_path, jobs=1)
    assert results.of_missions("floors", options) is None


def test_cpu_time_of_a_table_adds_up_over_calls(results, tmp_path, capsys) -> None:
    results.add_hours(tmp_path / "runs", "kills", 1800.0)
    results.add_hours(tmp_path / "runs", "kills", 1800.0)
    assert capsys.readouterr().out.endswith("kills: 1.00 CPU hours; 1.00 in all so far\n")


def test_each_deviation_is_drawn_in_turn(results, monkeypatch, tmp_path) -> None:
    asked = []
    monkeypatch.setattr(results, "run", lambda line, folder: asked.append(line))
    (row,) = results.MISSIONS["deviations"]
    results.runs_of(row, argparse.Namespace(out=tmp_path, data=None, seeds=None, jobs=1))
    settings = [tuple(line[line.index("paper") + 1 : line.index("--max-time")]) for line in asked]
    assert len(asked) == 33
    assert results.DEVIATION not in {word for line in asked for word in line}
    assert len({tuple(word.split("=")[0] for word in one) for one in settings}) == 10
    assert all(one[0] == "--set" for one in settings)

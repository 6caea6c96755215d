"""Tables of docs/results.md that benchmarks print."""

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
        return subprocess.CompletedProcess(command, 0, "seed 0\nseed 1\n\nworld  n\nflat   2\n\n")

    monkeypatch.setattr(results, "version", lambda: "abc")
    monkeypatch.setattr(results.subprocess, "run", run)
    table = results.printed("flat", tmp_path, tmp_path / "runs")
    assert table.splitlines()[1:] == ["", "```", "world  n", "flat   2", "```"]
    assert table.startswith("`python benchmarks/relocation.py --world DATA/maps/flat.yaml ")
    assert asked[0][0][:2] == [sys.executable, str(BENCHMARKS / "relocation.py")]
    assert str(tmp_path / "maps" / "flat.yaml") in asked[0][0]
    assert asked[0][1] == tmp_path / "runs"


def test_a_table_without_its_data_or_of_a_benchmark_that_fails_is_left_alone(results, monkeypatch, tmp_path) -> None:
    assert results.printed("flat", None, tmp_path) is None
    monkeypatch.setattr(results.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "x"))
    assert results.printed("sessions", None, tmp_path) is None


def test_every_command_is_of_a_benchmark(results) -> None:
    assert all((BENCHMARKS / arguments.split()[0]).exists() for arguments, _ in results.PRINTED.values())

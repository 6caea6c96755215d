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
    table = results.printed("pieces", tmp_path, tmp_path / "runs")
    first, told, *rest = table.splitlines()
    assert (first, rest) == ("```", ["world  n", "flat   2", "```"])
    assert told.startswith("$ python benchmarks/located_pieces.py DATA/radish ")
    assert told.endswith("  # abc")
    assert asked[0][0][:2] == [sys.executable, str(BENCHMARKS / "located_pieces.py")]
    assert str(tmp_path / "radish") in asked[0][0]
    assert asked[0][1] == tmp_path / "runs"


def test_a_table_without_its_data_or_of_a_benchmark_that_fails_is_left_alone(results, monkeypatch, tmp_path) -> None:
    assert results.printed("pieces", None, tmp_path) is None
    monkeypatch.setattr(results.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "x"))
    assert results.printed("sessions", None, tmp_path) is None


def test_every_command_is_of_a_benchmark(results) -> None:
    commands = [one for arguments, _ in results.PRINTED.values() for one in arguments.split(" + ")]
    assert all((BENCHMARKS / command.split()[0]).exists() for command in commands)
    assert all(f"<!-- {name}: made by" in results.DOCUMENT.read_text() for name in results.PRINTED)

"""A short run of benchmarks/intake_fuzz.py: nonsense into all that reads a robot."""

import runpy
from pathlib import Path

import pytest

FUZZ = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "intake_fuzz.py"))


@pytest.mark.parametrize("source", FUZZ["SOURCES"])
def test_nonsense_neither_raises_nor_comes_out(source, capsys):
    make, name = FUZZ["SOURCES"][source]
    row = FUZZ["fuzz"](make, name, 300, 1)
    assert row["raised"] == 0, capsys.readouterr().out
    assert row["implausible"] == 0
    # It saw both: what is refused, and what is left of it.
    assert row["out"] > 0
    assert row["refused"] > 0 or source == "Kobuki's frames"

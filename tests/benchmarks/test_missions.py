"""Command lines of benchmarks that draw worlds: what cannot be read is refused in a line."""

import importlib
from pathlib import Path

import pytest


@pytest.fixture
def missions(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("missions")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("--help", 0, "usage: offices.py draw"),
        ("few plan.yaml", 2, "argument seed: invalid seed value: 'few'"),
        ("-- -1 plan.yaml", 2, "argument seed: -1: must be 0 or more"),
        ("7", 2, "the following arguments are required: file"),
    ],
)
def test_draw_refuses_in_a_line_what_it_cannot_read(missions, monkeypatch, capsys, words, code, said):
    monkeypatch.setattr("sys.argv", ["benchmarks/offices.py", "draw", *words.split()])
    with pytest.raises(SystemExit) as ended:
        missions.draw(lambda *_: pytest.fail("drawn"))
    assert ended.value.code == code
    assert said in "".join(capsys.readouterr())


def test_draw_writes_what_is_named(missions, monkeypatch):
    drawn = []
    monkeypatch.setattr("sys.argv", ["look_alikes.py", "draw", "ring", "ring.yaml"])
    with pytest.raises(SystemExit):
        missions.draw(lambda *what: drawn.append(what), str, ("ring", "gap"))
    assert drawn == [("ring", Path("ring.yaml"))]
    monkeypatch.setattr("sys.argv", ["look_alikes.py"])
    missions.draw(lambda *_: pytest.fail("drawn"))

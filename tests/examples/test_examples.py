"""The examples run as they are written, for a shorter time and with a shorter first look."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator

import tfg_drake
from tests.diagrams.rooms import QUICK_LOOK
from tfg_drake.diagrams.methods import FindMethod
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENARIOS = EXAMPLES.parent / "diagrams" / "scenarios"


@pytest.fixture(autouse=True)
def _compiled(compiled):
    """No example says that kernels are compiled."""


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """In an empty folder with scenarios of a quick look: gives an example's text with these for the shipped ones, and
    other changes."""
    monkeypatch.chdir(tmp_path)
    for name in ("house", "corridor"):
        (tmp_path / f"{name}.yaml").write_text((SCENARIOS / f"{name}.yaml").read_text() + QUICK_LOOK)

    def changed(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        return re.sub('"(house|corridor)"', r'"\1.yaml"', text)

    return changed


@pytest.fixture
def run_example(quick, tmp_path, monkeypatch, capsys):
    """Runs an example in an empty folder, its times and numbers of seeds replaced, and gives what it prints."""

    def run_it(name, *arguments, **shorter):
        (tmp_path / name).write_text(quick((EXAMPLES / name).read_text(), *shorter.values()))
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(tmp_path / name), run_name="__main__")
        return capsys.readouterr().out

    return run_it


def test_a_mission(run_example, tmp_path, caplog):
    said = run_example("mission.py", begin=("until=60.0", "until=12.0"), more=("advance(540.0)", "advance(2.0)"))
    assert re.search(
        r"<house, seed 3: \w+ after 14 s, \d+ stages, \d+ tags, \d+ walls> while the clone stands at 12.0 s", said
    )
    assert (tmp_path / "mission.png").stat().st_size > 10_000
    assert not [line for line in caplog.messages if "see whether" in line]


def test_the_notebook(quick):
    """Its cells, one after the other, for a shorter time."""
    cells = json.loads((EXAMPLES / "mission.ipynb").read_text())["cells"]
    cells = [cell for cell in cells if cell["cell_type"] == "code"]
    # It is kept as it was run, so that a reader sees its pictures.
    assert sum("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"]) == 2
    text = "\n".join("".join(cell["source"]) for cell in cells)
    names = {}
    exec(quick(text, ("until=60.0", "until=12.0"), ("advance(540.0)", "advance(2.0)")), names)
    assert names["house"].time == 14.0
    assert "animation" in names["meshcat"].StaticHtml()


def test_a_diagram_as_in_hardware_sim(run_example, tmp_path):
    said = run_example("robot_sim.py", "house.yaml", "--max-time", 12, "--graphviz", "house.dot")
    assert re.search(r"\n\d\d tags, \d+ walls after 12 s\n\d+ m driven, 0 contacts\n$", said)
    assert (tmp_path / "house.dot").read_text().startswith("digraph")


def test_a_monitor_ends_it_when_so_many_landmarks_are_mapped(run_example):
    said = run_example("robot_sim.py", "house.yaml", "--max-time", 30, "--landmarks", 5)
    mapped, time = map(int, re.search(r"5 landmarks are mapped.\n(\d+) tags.* after (\d+) s", said).groups())
    assert mapped >= 5
    assert time < 30


def test_a_multibody_plant(run_example):
    said = run_example("multibody_plant.py", time=("until=600.0", "until=12.0"))
    assert re.search(r"<house, seed 0: \w+ after 12 s, \d+ stages, \d\d tags, \d+ walls>, 0 contacts\n$", said)


def test_another_estimator(run_example):
    said = run_example("estimator.py", time=("until=600.0", "until=12.0"))
    assert re.findall(r"^(.*): <house, seed 0: \w+ after 12 s", said, re.M) == ["as it is", "the truth"]


def test_another_goal_selector(run_example):
    said = run_example("goal_selector.py", time=("until=300.0", "until=12.0"))
    assert re.findall(r"^(.*): <house, seed 0: \w+ after 12 s", said, re.M) == ["as it is", "the farthest first"]


def test_another_follower(run_example):
    """It arrives at its first goal."""
    said = run_example("follower.py", time=("until=300.0", "until=20.0"))
    assert re.findall(r"^(.*): <house, seed 0: \w+ after 20 s", said, re.M) == ["as it is", "point by point"]
    names = runpy.run_path(str(EXAMPLES / "follower.py"))
    mission = tfg_drake.explore("house.yaml", follower=names["MakePointFollower"], until=0.0)
    while not mission.look("follower_status").arrived:
        mission.advance(1.0)
        assert mission.time < 60.0
    mission.advance(0.25)
    assert (mission.status.phase, mission.status.failures) == ("observe", 0)


def test_another_plant(run_example):
    said = run_example("plant.py", time=("until=120.0", "until=15.0"))
    one, other = (line.partition(": ")[2] for line in said.splitlines())
    assert "15 s" in one
    assert one != other


def test_the_page_on_estimators(quick):
    """Its gains of candidates, one diagram with another Context, and its NEES over time."""
    page = (EXAMPLES.parent / "docs" / "estimator.md").read_text()
    gains, loop, nees = (
        next(code for code in page.split("```python\n") if code.startswith(begin)).partition("```")[0]
        for begin in ("import dataclasses", "context = diagram", "import numpy")
    )
    house = tfg_drake.explore("house.yaml", until=12.0)
    names = {"house": house}
    exec(gains, names)
    assert names["candidates"].node_ids.tolist() == house.look("goal").candidates.tolist()
    np.testing.assert_array_equal(names["candidates"].gains.gain, house.look("goal").gain)
    assert 0 < names["seen"].count.max() <= len(names["entry"])
    stamps, X_WB = house.X_WB_true
    names |= {"Simulator": Simulator, "RandomGenerator": RandomGenerator, "seed": house.scenario.seed}
    exec(loop, names | {"diagram": house.diagram, "t": float(stamps[40])}, again := {})
    truth = house.station.GetOutputPort("truth.pose").Eval(house.station.GetMyContextFromRoot(again["context"]))
    np.testing.assert_array_equal(truth[:3], X_WB[40])
    exec(quick(nees, ("not house.outcome", "house.time < 8.0")), names)
    assert len(names["nees"]) == 8
    assert 0.0 < max(names["nees"]) < 10.0


def test_a_run_analysed(run_example, tmp_path):
    short = ApplySettings(LoadScenario("corridor"), ["explorer.first_look=1", "explorer.first_turns=1"])
    run.run_mission(short, out_dir=tmp_path / "run", max_time=15.0)
    said = run_example("analyse.py", tmp_path / "run")
    assert said.startswith("time_limit after 15.0 s")
    assert said.count("position error") == 4
    assert "    0 s: 0." in said
    assert "of the area seen" in said


@pytest.mark.parametrize("method", ["tfg", "grid-nearest"])
def test_a_run_of_a_comparison_analysed(run_example, tmp_path, method):
    """It has no ports.mcap, and a grid no landmarks."""
    short = ApplySettings(LoadScenario("corridor"), ["explorer.first_look=1", "explorer.first_turns=1"])
    run.run_mission(short, method=FindMethod(method), out_dir=tmp_path / "run", max_time=9.0, record=False)
    said = run_example("analyse.py", tmp_path / "run")
    assert re.search(r"\n(\d+ walls|a grid), 0\.\d{3} of the surface within 5 cm\n", said)
    assert ("a grid" in said) == (method == "grid-nearest") != ("tags: RMSE" in said)
    assert "was seen" not in said


def test_a_run_without_truth_is_not_analysed(run_example, tmp_path):
    (tmp_path / "summary.json").write_text('{"outcome": "complete", "sim_time_s": 5.0}')
    with pytest.raises(SystemExit, match=r"no truth\.tum, as of a real robot or a replay"):
        run_example("analyse.py", tmp_path)


def test_logs_are_mapped_with_tags_and_walls(run_example, tmp_path):
    short = ApplySettings(LoadScenario("corridor"), ["explorer.first_look=1", "explorer.first_turns=1"])
    folder = run.run_mission(short, out_dir=tmp_path / "run", max_time=15.0).folder
    tags, walls = map(
        int, re.fullmatch(r"(\d+) tags and (\d+) walls are mapped\n", run_example("logs.py", folder)).groups()
    )
    assert tags >= 0.8 * len(tfg_drake.load_run(folder).map.ids) > 0
    assert walls > 0


@pytest.mark.slow
def test_a_run_without_tags_analysed(run_example, tmp_path):
    short = ApplySettings(LoadScenario("corridor"), ["explorer.first_look=1", "explorer.first_turns=1"])
    short.world.tags = []
    run.run_mission(short, out_dir=tmp_path / "run", max_time=15.0)
    said = run_example("analyse.py", tmp_path / "run")
    assert re.search(r"\n[1-9]\d* walls, 0\.\d{3} of the surface within 5 cm\n", said)
    assert "tag" not in said


def test_a_monte_carlo(run_example):
    said = run_example("monte_carlo.py", seeds=("range(5)", "range(2)"), time=("until=90.0", "until=12.0"))
    assert said.count("seed") == 4
    assert "standard deviation" in said


def test_the_goal_selector_is_a_method_and_a_system():
    """tests/diagrams/test_methods.py explores with it."""
    assert "MakeExplorer" in runpy.run_path(str(EXAMPLES / "goal_selector.py"))

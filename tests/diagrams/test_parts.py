"""Parts of one's own that a scenario names."""

import pytest

import tfg_drake
from tests.diagrams.rooms import QUICK_LOOK, ROOM
from tfg_drake.diagrams.methods import METHODS, MethodError
from tfg_drake.diagrams.parts import PartsOf
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario, Scenario, ScenarioError

MODULE = """
from tfg_drake.diagrams.explorer import MakeFollower
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower

made = []
NUMBER = 3

def MakeMine(scenario):
    made.append(scenario)
    return MakeFollower(scenario)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module in the working folder."""
    (tmp_path / "parts_of_mine.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))


def room(**parts):
    return ApplySettings(
        LoadScenario(data=ROOM + QUICK_LOOK), [f"explorer.parts.{role}={parts[role]}" for role in parts]
    )


def test_a_scenario_names_a_part(module):
    mission = tfg_drake.explore(room(follower="parts_of_mine.MakeMine"), until=1.0)
    from parts_of_mine import made

    assert made[-1].explorer.parts.follower == "parts_of_mine.MakeMine"
    assert mission.time == 1.0


def test_the_usual_parts_have_no_name():
    assert PartsOf(Scenario()) == {}


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("parts_of_mine.MakeYours", "module 'parts_of_mine' has no attribute 'MakeYours'"),
        ("nobodys.Make", "No module named 'nobodys'"),
        ("Make", "Empty module name"),
    ],
)
def test_a_part_that_is_not_there_is_told(module, name, complaint):
    line = f"explorer.parts.planner: {name}: {complaint}; name a function of a scenario or a class: module.Name"
    with pytest.raises(ScenarioError) as caught:
        tfg_drake.explore(room(planner=name), until=0.0)
    assert str(caught.value) == line


def test_what_makes_nothing_is_told(module):
    with pytest.raises(ScenarioError) as caught:
        PartsOf(room(estimator="parts_of_mine.NUMBER"))
    assert str(caught.value) == (
        "explorer.parts.estimator: parts_of_mine.NUMBER is no function of a scenario, and no class"
    )


def test_a_method_with_parts_of_its_own_takes_none(module):
    with pytest.raises(MethodError) as caught:
        METHODS["grid-nearest"].Check(room(follower="parts_of_mine.MakeMine"))
    assert str(caught.value) == "grid-nearest: takes no explorer.parts.follower; take another method: tfg"

"""The methods by name, and one of one's own."""

from pathlib import Path

import numpy as np
import pytest

from tfg_drake.diagrams.explorer import SENSED
from tfg_drake.diagrams.methods import METHODS, FindMethod, MethodError
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario, PrepareScenario, ScenarioError

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", METHODS)
def test_every_method_has_the_ports_that_a_mission_needs(name):
    explorer = FindMethod(name).MakeExplorer(LoadScenario(FindScenario("house")))
    inputs = {explorer.get_input_port(i).get_name() for i in range(explorer.num_input_ports())}
    outputs = {explorer.get_output_port(i).get_name() for i in range(explorer.num_output_ports())}
    assert inputs <= {*SENSED, "pause", "stop", "recall", "requested_goal", "said_pose"}
    # Somebody may send the robot to a node of a roadmap.
    assert ("requested_goal" in inputs) == (METHODS[name].has_candidates or METHODS[name].needs_keys)
    # Who keeps no budget cannot be called back.
    assert ("recall" in inputs) == METHODS[name].keeps_budget
    assert {"base.odometry", "scan.ranges", "base.hazards", "base.enabled", "pause", "stop"} <= inputs
    assert {"base.velocity_commanded", "pose", "mission"} <= outputs
    assert ("grid" in outputs) != ("map" in outputs)


def test_a_file_is_a_method_named_as_the_file():
    method = FindMethod(str(ROOT / "examples" / "goal_selector.py"))
    assert method.name == "goal_selector"


def test_a_method_of_ones_own_takes_less_than_60_lines():
    assert len((ROOT / "examples" / "goal_selector.py").read_text().splitlines()) < 60


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("tgf", None, f"tgf: no such method; name a .py file or one of {', '.join(METHODS)}"),
        ("none.py", None, f"none.py: no such file; name a .py file or one of {', '.join(METHODS)}"),
        ("empty.py", "", "empty.py: has no MakeExplorer(scenario) that returns the explorer's diagram; define it"),
        ("broken.py", "1 / 0", "broken.py: cannot be imported: ZeroDivisionError: division by zero"),
        ("leaves.py", "raise SystemExit(4)", "leaves.py: cannot be imported: SystemExit: 4"),
        (
            "sensor.py",
            "MakeExplorer = print\nSETTINGS = ['tags.range=20']",
            'sensor.py: SETTINGS must be a list such as ["explorer.goal=random"], of explorer., planner., grid.',
        ),
        (
            "far.py",
            "MakeExplorer = print\nSETTINGS = ['explorer.solver=far']",
            "far.py: SETTINGS: explorer.solver=far: explorer.solver: must be one of dissection, gtsam, is far",
        ),
    ],
)
def test_what_is_no_method_is_refused_in_one_line(name, text, complaint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path(name).write_text(text)
    with pytest.raises(MethodError) as caught:
        FindMethod(name)
    assert str(caught.value) == complaint


def test_the_papers_method_needs_a_tag():
    FindMethod("paper").Check(PrepareScenario("house", [], 0))
    with pytest.raises(MethodError, match="paper: maps tags alone, and the world has none"):
        FindMethod("paper").Check(PrepareScenario("house", [], 0, None, np.inf))


@pytest.mark.parametrize("setting", ["budget_time=60", "budget_distance=9", "return_home=true"])
def test_what_a_method_does_not_mind_is_refused(setting):
    scenario = ApplySettings(LoadScenario(FindScenario("house")), [f"explorer.{setting}"])
    FindMethod("tfg-nearest").Check(scenario)
    for name in ("grid-nearest", "weighted"):
        with pytest.raises(MethodError) as caught:
            FindMethod(name).Check(scenario)
        key = setting.split("=")[0]
        assert str(caught.value) == (f"{name}: does not mind explorer.{key}; leave it out, or take another method: tfg")


def test_a_method_has_the_settings_that_it_fixes_whatever_the_scenario_says():
    scenario = ApplySettings(LoadScenario("house"), ["explorer.goal=random", "explorer.stop_gain=3"])
    fixed = {name: METHODS[name].Fixed(scenario).explorer for name in METHODS}
    goals = {"tfg-argmax": "argmax", "paper": "argmax", "tfg-nearest": "nearest_frontier"}
    assert {name: one.goal for name, one in fixed.items()} == dict.fromkeys(METHODS, "random") | goals
    assert {one.stop_gain for one in fixed.values()} == {3.0}
    assert [(fixed[name].first_look, fixed[name].first_turns) for name in ("paper", "weighted")] == [(0.0, 1)] * 2
    assert (fixed["paper"].gain, fixed["paper"].landmarks, fixed["paper"].path_keyframe_period) == ("paper", "tags", 0)


@pytest.mark.parametrize(
    ("name", "settings", "complaint"),
    [
        ("paper", ["explorer.glance_period=1"], "fixes explorer.glance_period=0; leave explorer.glance_period=1 out"),
        (
            "tfg-nearest",
            ["explorer.goal=nearest_frontier", "explorer.goal=tour"],
            "fixes explorer.goal=nearest_frontier; leave explorer.goal=tour out",
        ),
        ("grid-nearest", "explorer.first_look=2", "fixes explorer.first_look=0; leave explorer.first_look=2 out"),
    ],
)
def test_another_value_of_what_a_method_fixes_is_refused(name, settings, complaint):
    with pytest.raises(MethodError) as caught:
        FindMethod(name).Check(LoadScenario("house"), settings)
    assert str(caught.value) == f"{name}: {complaint}, or take another method: tfg"


def test_the_value_that_a_method_fixes_may_be_set_as_may_all_else():
    settings = ["explorer.goal=tour", "explorer.goal=argmax", "explorer.glance_period=0.0", "explorer.stop_gain=3"]
    FindMethod("paper").Check(LoadScenario("house"), settings)


def test_a_file_says_what_it_fixes(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("MakeExplorer = print\nSETTINGS = ['explorer.goal=random']\n")
    method = FindMethod(str(file))
    assert method.Fixed(LoadScenario("house")).explorer.goal == "random"
    with pytest.raises(MethodError, match=r"mine: fixes explorer.goal=random; leave explorer.goal=tour out"):
        method.Check(LoadScenario("house"), ["explorer.goal=tour"])


@pytest.mark.parametrize("gain", ["paper", "authors", "limit"])
def test_a_gain_of_tags_alone_is_refused_where_none_are_mapped(gain):
    settings, mend = [f"explorer.gain={gain}"], ", or take exact"
    FindMethod("tfg").Check(PrepareScenario("house", settings))
    told = f"explorer.gain={gain}: counts tags alone, and "
    with pytest.raises(ScenarioError) as caught:
        FindMethod("tfg").Check(PrepareScenario("house", settings, tag_spacing=np.inf))
    assert str(caught.value) == f"{told}the world has none; --tag-spacing 1 places some{mend}"
    with pytest.raises(ScenarioError) as caught:
        FindMethod("tfg").Check(PrepareScenario("house", [*settings, "explorer.landmarks=walls"]))
    assert str(caught.value) == f"{told}explorer.landmarks=walls maps none{mend}"

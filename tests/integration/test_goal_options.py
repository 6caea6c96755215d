"""Every named way of choosing goals drives, and a budget is kept."""

import numpy as np
import pytest

from tfg_drake.config import GAINS, GOAL_RULES
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario

# What comes first of all, shortly.
QUICK = ("explorer.first_look=2", "explorer.first_turns=1")


def mission(tmp_path, max_time, *settings):
    scenario = ApplySettings(LoadScenario(FindScenario("paper")), [*QUICK, *settings])
    return run_mission(scenario, max_time=max_time, out_dir=tmp_path / "run", record=False)


# Each rule with a gain, and with options of other parts.
DRIVEN = {
    ("tour", "limit"): ("planner.risk=path",),
    ("argmax", "paper"): ("explorer.pose_price=false", "explorer.least_tags=8"),
    ("gain_per_time", "authors"): (),
    ("nearest_frontier", "exact"): (),
    ("random", "exact"): (),
}


def test_every_rule_and_every_gain_is_driven():
    assert {rule for rule, _ in DRIVEN} == set(GOAL_RULES)
    assert {gain for _, gain in DRIVEN} == set(GAINS)


SLOW = ("nearest_frontier", "random")


@pytest.mark.parametrize(
    ("rule", "gain"), [pytest.param(*one, marks=[pytest.mark.slow] if one[0] in SLOW else []) for one in DRIVEN]
)
def test_the_robot_explores(tmp_path, rule, gain):
    result = mission(tmp_path, 20.0, f"explorer.goal={rule}", f"explorer.gain={gain}", *DRIVEN[rule, gain])
    assert result.summary["outcome"] == "time_limit"
    assert result.summary["stages"] >= 2
    assert result.summary["landmarks_mapped"] > 25
    assert result.summary["contacts"] == 0


@pytest.mark.parametrize(("key", "limit"), [("budget_time", 40.0), ("budget_distance", 8.0)])
def test_the_robot_is_home_before_its_budget_ends(tmp_path, key, limit):
    result = mission(tmp_path, 300.0, f"explorer.{key}={limit}", "explorer.return_home=true")
    summary = result.summary
    assert summary["outcome"] == "budget"
    assert summary["reason"].endswith("of the budget were too little for another goal. The robot is where it began.")
    assert summary["stages"] >= 2
    assert (summary["sim_time_s"] if key == "budget_time" else summary["distance_m"]) <= limit
    truth = np.loadtxt(result.folder / "truth.tum")
    assert np.hypot(*(truth[-1, 1:3] - truth[0, 1:3])) < 0.5


@pytest.mark.slow
def test_without_the_way_home_more_of_a_budget_is_spent_on_goals(tmp_path):
    summary = mission(tmp_path, 300.0, "explorer.budget_time=40").summary
    assert (summary["outcome"], summary["sim_time_s"] <= 40.0) == ("budget", True)
    assert summary["stages"] >= 3

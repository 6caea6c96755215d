"""Every shipped scenario runs for half a minute, the house to its end; paper in test_goal_options.py."""

import pytest

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import LoadScenario


@pytest.mark.slow
def test_the_house_is_explored_to_its_end(tmp_path):
    summary = run_mission(LoadScenario("house"), name="house", out_dir=tmp_path, record=False).summary
    assert summary["outcome"] == "complete"
    assert summary["landmarks_mapped"] >= 0.95 * summary["landmarks_reachable"]
    assert summary["contacts"] == 0
    assert summary["position_error_m"]["mean"] < 0.05
    assert summary["landmark_rmse_m"] < 0.06


@pytest.mark.parametrize(
    "name", [*(pytest.param(one, marks=pytest.mark.slow) for one in ("paper_white", "corridor", "office")), "house"]
)
def test_half_a_minute_of_a_world(tmp_path, name):
    summary = run_mission(LoadScenario(name), name=name, out_dir=tmp_path, max_time=30.0, record=False).summary
    assert (summary["outcome"], summary["sim_time_s"]) == ("time_limit", 30.0)
    assert summary["stages"] > 1
    assert summary["landmarks_mapped"] > 15
    assert summary["contacts"] == 0
    assert summary["position_error_m"]["max"] < 0.2

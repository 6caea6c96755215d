"""Missions among people: all is mapped but them, and nobody is run into."""

import pytest

from tests.diagrams.rooms import room
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_room_with_somebody_who_walks_about_and_stands_is_mapped_without_him(tmp_path, seed):
    summary = run_mission(
        ApplySettings(room(), [f"seed={seed}", "reality.people=1"]), name="room", out_dir=tmp_path, record=False
    ).summary
    assert summary["outcome"] == "complete"
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"]
    assert summary["contacts"] == 0
    assert summary["surface_phantom_m"] < 0.3
    assert summary["surface_coverage"] > 0.97

"""Missions among people: all is mapped but them, and nobody is run into."""

import pytest

from tfg_drake.diagrams.missions.run import explore
from tfg_drake.diagrams.scenario import ApplySettings, ApplyWorldFile, LoadScenario

ROOM = """
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 2.2, 3, 4]]
explorer: {first_look: 8}
"""


@pytest.mark.parametrize("seed", [3, 4])
def test_a_room_with_somebody_who_walks_about_and_stands_is_mapped_without_him(tmp_path, seed):
    room = ApplyWorldFile(LoadScenario(data=ROOM), tag_spacing=1.0)
    summary = explore(ApplySettings(room, [f"seed={seed}", "reality.people=1"]), name="room", out_dir=tmp_path).summary
    assert summary["outcome"] == "complete"
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"]
    assert summary["contacts"] == 0
    assert summary["surface_phantom_m"] < 0.3
    assert summary["surface_coverage"] > 0.97

"""Missions in a world that changes: what came is mapped, what went is not, and a tag is where it was carried."""

import numpy as np
import pytest

from tfg_drake.config import ChangeConfig, TagConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario
from tfg_drake.mapfile.saved_map import load_map

# Two rooms, each with a chair's place in it, and a door between them.
ROOMS = """
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 9, 0], [9, 0, 9, 4], [9, 4, 0, 4], [0, 4, 0, 0], [5, 0, 5, 1.4], [5, 2.4, 5, 4]]
explorer: {first_look: 8, first_turns: 3}
"""


def chair(x, y, side=0.45):
    corners = np.array([x, y]) + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return np.hstack([corners, np.roll(corners, -1, axis=0)]).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_chair_and_a_tag_are_moved_and_another_falls_off(tmp_path, seed):
    scenario = ApplyWorldFile(LoadScenario(data=ROOMS), tag_spacing=1.0)
    scenario.seed = seed
    scenario.explorer.return_home = True
    # By walls, too, it knows where it is and what it has seen, and need not look at a tag twice.
    scenario.explorer.landmarks = "tags"
    tags = {round(tag.position[0], 2): tag for tag in scenario.world.tags if tag.position[1] < 0.1}
    # The other one hangs where the robot comes by again, on its way home.
    first, other = list(tags.values())[:4:3]
    moved = TagConfig(id=first.id, position=[first.position[0] + 0.3, first.position[1]], facing=first.facing)
    scenario.reality.changes = [
        ChangeConfig(walls=chair(3.2, 2.6)),
        ChangeConfig(time=40.0, opened=chair(3.2, 2.6), walls=chair(1.0, 2.6), tags=[moved], fallen=[other.id]),
    ]
    summary = run_mission(scenario, name="rooms", out_dir=tmp_path, record=False).summary
    assert summary["outcome"] == "complete"
    assert summary["contacts"] == 0
    assert summary["landmarks_present"] == len(scenario.world.tags) - 1
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"]
    assert summary["surface_phantom_m"] < 0.1
    saved = load_map(tmp_path / "map.npz")
    assert summary["landmark_error_max_m"] < 0.1
    assert first.id in saved.ids
    assert summary["landmarks_doubtful"] == [other.id]

"""Sensors that are mounted, printed or stamped otherwise than was said: told in the first look, with what to set."""

import logging
import re

import pytest

import tfg_drake
from tests.diagrams.rooms import DIVIDED, QUICK_LOOK, tagged
from tfg_drake.config import TagSensorConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario

ALL_ROUND = "scan.field_of_view=6.2831"
UPSIDE_DOWN = (
    r"scans turn against the odometry .*: if the scanner is mounted upside down or mirrored, .*hardware\.scanner\.flip"
)


def remarks(caplog, *settings):
    """The lines that are told of the sensors until the first turn is over."""
    scenario = ApplySettings(tagged(DIVIDED + QUICK_LOOK), settings)
    with caplog.at_level(logging.WARNING, "tfg_drake.slam.sensors"):
        assert tfg_drake.explore(scenario, until=9.0).map.stage >= 1
    return [record.getMessage() for record in caplog.records if record.name == "tfg_drake.slam.sensors"]


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (("reality.scan.flip=true",), UPSIDE_DOWN),
        (("reality.scan.flip=true", ALL_ROUND), UPSIDE_DOWN),
        (("reality.tags.range_scale=0.1",), r"are the tags (9|9\.\d|10|11) times as large as was said"),
        (("reality.tags.range_scale=5",), r"are the tags 0\.(19|2|21) times as large as was said"),
        (("reality.tags.clock_offset=0.3",), "s ahead of the base's, which is corrected"),
        (("reality.tags.clock_offset=-0.2",), "s behind the base's, which is corrected"),
        (("reality.scan.clock_offset=0.2",), r"the scans' clock is 0\.(19|20|21) s ahead of the odometry's"),
    ],
)
def test_a_fault_is_told_once_before_the_robot_drives(caplog, settings, line):
    told = remarks(caplog, *settings)
    assert len(told) == 1, told
    assert re.search(line, told[0]), told


@pytest.mark.parametrize("settings", [(), (ALL_ROUND,), ("reality.tags.clock_offset=0.05", "reality.scan.yaw=0.05")])
def test_without_a_fault_nothing_is_told(caplog, settings):
    assert remarks(caplog, *settings) == []


def test_a_robot_in_a_wide_hall_goes_on_until_it_sees_a_wall(tmp_path):
    """It sees 4 m, begins 8 m from all walls, and glances every 2 s."""
    assert TagSensorConfig().range > 4.0
    hall = "world: {start: [8, 8, 0.3], walls: [[0, 0, 16, 0], [16, 0, 16, 16], [16, 16, 0, 16], [0, 16, 0, 0]]}\n"
    scenario = ApplySettings(LoadScenario(data=hall + QUICK_LOOK), ["tags.range=4", "scan.range=4"])
    summary = run_mission(scenario, max_time=25.0, out_dir=tmp_path / "run", record=False).summary
    assert summary["outcome"] == "time_limit"
    assert summary["surface_coverage"] > 0.0

"""The scenario that a real robot's explorer gets: within what the robot does and its sensors see."""

import copy
import dataclasses

import pytest

from tfg_drake.diagrams.missions.real_robot import Bounded
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.robot_devices import RobotDevices
from tfg_drake.hardware.watchdog import Limits

LIMITS, TAGS = Limits(0.2, 1.0, 0.4, 2.0), object()


@dataclasses.dataclass
class View:
    """What a camera sees."""

    field_of_view: float = 1.0
    range: float = 3.3
    max_incidence: float = 1.05


@pytest.fixture(scope="module")
def scenario():
    return LoadScenario("house")


def test_the_limits_of_the_robot_and_its_sensors_hold(scenario):
    before = copy.deepcopy(scenario)
    bounded = Bounded(scenario, RobotDevices(None, TAGS, None, LIMITS, least_range=0.15, view=View()))
    robot, tags = bounded.robot, bounded.tags
    assert dataclasses.astuple(LIMITS) == (
        robot.max_speed, robot.max_turn_rate, robot.max_acceleration, robot.max_turn_acceleration
    )  # fmt: skip
    assert (tags.field_of_view, tags.range, tags.max_incidence) == (1.0, 3.3, 1.05)
    assert bounded.scan.least_range == 0.15
    assert bounded.field_of_view == 1.0
    assert scenario == before


def test_a_scenario_that_asks_for_less_has_it(scenario):
    narrow = copy.deepcopy(scenario)
    narrow.tags.range, narrow.scan.least_range = 2.0, 0.5
    bounded = Bounded(narrow, RobotDevices(None, TAGS, None, LIMITS, least_range=0.15, view=View(range=3.0)))
    assert (bounded.tags.range, bounded.scan.least_range) == (2.0, 0.5)
    unseen = Bounded(scenario, RobotDevices(None, None, None, LIMITS))
    assert unseen.tags == scenario.tags


def test_where_there_is_no_source_of_tags_walls_are_the_landmarks(scenario):
    assert Bounded(scenario, RobotDevices(None, TAGS, None, LIMITS)).explorer.landmarks == "both"
    tagless = RobotDevices(None, None, None, LIMITS)
    assert Bounded(scenario, tagless).explorer.landmarks == "walls"
    assert scenario.explorer.landmarks == "both"
    tags_alone = copy.deepcopy(scenario)
    tags_alone.explorer.landmarks = "tags"
    with pytest.raises(DeviceError) as error:
        Bounded(tags_alone, tagless)
    assert str(error.value) == (
        "explorer.landmarks=tags: the robot has no source of tags; give --tags, or leave it out"
    )
    gain_of_tags = copy.deepcopy(scenario)
    gain_of_tags.explorer.gain = "limit"
    with pytest.raises(DeviceError) as error:
        Bounded(gain_of_tags, tagless)
    assert str(error.value) == "explorer.gain=limit: the robot has no source of tags; give --tags, or leave it out"

"""The scenario that a real robot's explorer gets: within what the robot does and its sensors see."""

import copy
import dataclasses

import pytest

from tfg_drake.diagrams.missions.real_robot import Bounded
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.hardware.robot_devices import RobotDevices
from tfg_drake.hardware.watchdog import Limits

LIMITS = Limits(0.2, 1.0, 0.4, 2.0)


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
    bounded = Bounded(scenario, RobotDevices(None, None, None, LIMITS, least_range=0.15, view=View()))
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
    bounded = Bounded(narrow, RobotDevices(None, None, None, LIMITS, least_range=0.15, view=View(range=3.0)))
    assert (bounded.tags.range, bounded.scan.least_range) == (2.0, 0.5)
    unseen = Bounded(scenario, RobotDevices(None, None, None, LIMITS))
    assert unseen.tags == scenario.tags

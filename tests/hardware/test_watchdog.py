"""The watchdog on a clock of the test's own."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.hardware.device import BaseState
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.remarks import alarms
from tfg_drake.hardware.watchdog import SILENCE, Limits, Watchdog
from tfg_drake.messages import Hazards

LIMITS = Limits(speed=0.3, turn_rate=1.5, acceleration=0.5, turn_acceleration=3.5)


class Robot:
    """A watchdog that ticks, odometry and commands coming until told otherwise."""

    def __init__(self):
        self.watchdog, self.now = Watchdog(LIMITS), 100.0
        self.odometry = True
        self.hazards = None
        self.command = (0.3, 0.0)

    def run(self, duration):
        """The velocities sent, tick by tick."""
        sent = []
        for _ in range(round(duration / TICK)):
            self.now += TICK
            if self.odometry:
                self.watchdog.hear(self.now)
            if self.hazards:
                self.watchdog.hear_hazards(Hazards(self.now, *self.hazards))
            if self.command:
                self.watchdog.command(self.now, *self.command)
            sent.append(self.watchdog.velocity(self.now))
        return sent


@pytest.fixture
def driving():
    robot = Robot()
    robot.run(TICK)
    robot.watchdog.enable(robot.now)
    assert robot.run(1.0)[-1] == pytest.approx((0.3, 0.0))
    return robot


def still(sent):
    return all(velocity == (0.0, 0.0) for velocity in sent)


def test_nothing_moves_before_enable():
    robot = Robot()
    assert still(robot.run(2.0))
    assert robot.watchdog.locked == "not enabled yet"


def test_a_command_from_before_enable_is_forgotten():
    robot = Robot()
    robot.run(0.1)
    robot.command = None
    robot.watchdog.enable(robot.now)
    assert robot.watchdog.locked is None
    assert still(robot.run(0.2))


def test_it_cannot_be_enabled_without_odometry():
    watchdog = Watchdog(LIMITS)
    watchdog.enable(5.0)
    assert watchdog.locked == "no odometry for more than 0.5 s"


def test_limits():
    robot = Robot()
    robot.command = (-9.0, 9.0)
    robot.run(TICK)
    robot.watchdog.enable(robot.now)
    sent = robot.run(1.0)
    assert sent[0] == pytest.approx((-0.5 * TICK, 3.5 * TICK))
    assert sent[9] == pytest.approx((-0.1, 0.7))
    assert sent[-1] == pytest.approx((-0.3, 1.5))
    robot.command = (9.0, 0.0)
    assert robot.run(TICK)[0] == pytest.approx((0.5 * TICK, 0.0))


def test_a_late_tick_does_not_jump():
    robot = Robot()
    robot.run(TICK)
    robot.watchdog.enable(robot.now)
    robot.run(TICK)
    robot.now += 0.4
    assert robot.run(TICK)[0][0] <= 0.5 * 3.0 * TICK + 1e-12


def test_who_was_held_up_has_not_watched(driving):
    """Odometry that has come meanwhile does not tell how the robot moved."""
    driving.now += 3.0
    assert still(driving.run(1.0))
    assert driving.watchdog.locked == "no odometry for more than 0.5 s"
    driving.watchdog.enable(driving.now)
    assert driving.run(1.0)[-1] == pytest.approx((0.3, 0.0))


def test_commands_stop(driving):
    driving.command = None
    sent = driving.run(1.0)
    last = max(i for i, velocity in enumerate(sent) if velocity != (0.0, 0.0))
    assert (last + 1) * TICK <= SILENCE + 1e-9
    assert driving.watchdog.locked is None
    driving.command = (0.3, 0.0)
    assert driving.run(TICK)[0] == pytest.approx((0.5 * TICK, 0.0))  # from rest


def test_odometry_stops(driving):
    driving.odometry = False
    sent = driving.run(1.0)
    last = max(i for i, velocity in enumerate(sent) if velocity != (0.0, 0.0))
    assert (last + 1) * TICK <= SILENCE + 1e-9
    driving.odometry = True
    assert still(driving.run(1.0))
    assert driving.watchdog.locked == "no odometry for more than 0.5 s"
    driving.watchdog.enable(driving.now)
    assert driving.run(1.0)[-1] == pytest.approx((0.3, 0.0))


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (0.1, math.nan), (math.inf, 0.0), (0.0, -math.inf)])
def test_a_command_that_is_not_finite(driving, bad):
    driving.command = bad
    assert still(driving.run(1.0))


def test_odometry_that_is_not_a_number(driving):
    driving.odometry = False
    driving.watchdog.hear(math.nan)
    assert still(driving.run(1.0))


def test_a_lock_lasts(driving):
    driving.watchdog.lock("the clock of /odom has jumped")
    driving.watchdog.lock("something later")
    assert still(driving.run(1.0))
    assert driving.watchdog.locked == "the clock of /odom has jumped"
    driving.watchdog.enable(driving.now)
    assert not still(driving.run(1.0))


@pytest.mark.parametrize("reason", ["not enabled yet", "no odometry for more than 0.5 s"])
def test_a_reason_that_says_more_takes_the_place_of_one_that_says_little(reason):
    watchdog = Watchdog(LIMITS)
    if "odometry" in reason:
        watchdog.enable(5.0)
    assert watchdog.locked == reason
    watchdog.lock("the cable is out")
    watchdog.velocity(9.0)
    assert watchdog.locked == "the cable is out"


WHEEL = "a wheel hangs: put the robot on its wheels, then enable it"
CLIFF = "a cliff: carry the robot away from it, then enable it"


@pytest.mark.parametrize(
    ("hazards", "reason"),
    [((0, 0, 1), WHEEL), ((0, 0, 4), WHEEL), ((2, 2, 5), WHEEL), ((0, 1, 0), CLIFF), ((4, 4, 0), CLIFF)],
)
def test_after_a_wheel_drop_or_a_cliff_it_must_be_enabled_anew(driving, hazards, reason):
    driving.hazards, driving.command = hazards, (-0.2, 0.5)
    assert still(driving.run(1.0))
    assert driving.watchdog.locked == reason
    # While it lasts nobody can, and that it was tried is not remembered.
    driving.watchdog.enable(driving.now)
    assert driving.watchdog.locked == reason
    assert still(driving.run(1.0))
    driving.hazards = (0, 0, 0)
    assert still(driving.run(5.0))
    assert driving.watchdog.locked == reason
    driving.watchdog.enable(driving.now)
    assert driving.watchdog.locked is None
    assert driving.run(TICK)[0] == pytest.approx((-0.5 * TICK, 3.5 * TICK))  # from rest


def test_a_wheel_drop_that_is_over_before_the_next_tick_counts(driving):
    driving.watchdog.hear_hazards(Hazards(driving.now, 0, 0, 1))
    driving.watchdog.hear_hazards(Hazards(driving.now, 0, 0, 0))
    assert still(driving.run(1.0))
    assert driving.watchdog.locked == WHEEL


@pytest.mark.parametrize("bumper", [2, 4, 7])
def test_the_bumper_allows_to_turn_and_to_back(driving, bumper):
    driving.hazards, driving.command = (bumper, 0, 0), (0.3, 0.5)
    sent = driving.run(1.0)
    assert {velocity[0] for velocity in sent} == {0.0}
    assert sent[-1][1] == pytest.approx(0.5)
    driving.command = (-0.2, 0.0)
    assert driving.run(1.0)[-1] == pytest.approx((-0.2, 0.0))
    driving.command, driving.hazards = (0.3, 0.0), (0, 0, 0)
    assert driving.run(2.0)[-1] == pytest.approx((0.3, 0.0))


def test_alarms_last_until_they_are_taken_back(driving):
    driving.watchdog.hear_hazards(Hazards(driving.now, 0, 0, 1))
    assert still(driving.run(5.0))


def test_it_brakes_as_hard_as_it_is_told(driving):
    driving.command = (0.1, 0.0)
    assert driving.run(TICK) == [(0.1, 0.0)]
    driving.command = (0.0, 0.0)
    assert still(driving.run(TICK))


def test_it_turns_back_from_standing_still(driving):
    driving.command = (-0.3, 0.0)
    sent = [v for v, _ in driving.run(1.0)]
    assert sent[0] == pytest.approx(-0.5 * TICK)
    assert np.diff(sent).min() >= -0.5 * TICK - 1e-12
    assert sent[-1] == -0.3


@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0)), max_size=30))
def test_it_speeds_up_within_its_limits(commands):
    robot = Robot()
    robot.run(TICK)
    robot.watchdog.enable(robot.now)
    sent = [(0.0, 0.0)]
    for robot.command in commands:
        sent += robot.run(TICK)
    for before, after in itertools.pairwise(sent):
        for i, (limit, gain) in enumerate(((0.3, 0.5), (1.5, 3.5))):
            assert abs(after[i]) <= limit + 1e-12
            from_rest = before[i] if before[i] * after[i] > 0.0 else 0.0
            assert abs(after[i]) - abs(from_rest) <= gain * TICK + 1e-9


def locked_by(states, period=0.02):
    """Reasons why an enabled watchdog is locked, after each of some states of its base, which drove well before."""
    watchdog, all_of = Watchdog(Limits()), []
    watchdog.hear(0.0)
    watchdog.hear_alarms({}, 0.0)
    watchdog.enable(0.0)
    for i, one in enumerate(states):
        watchdog.hear(period * i)
        watchdog.hear_alarms(alarms(one), period * i)
        watchdog.velocity(period * i)
        all_of.append(watchdog.locked)
    return all_of


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"overcurrent": 4}, "overcurrent of the left wheel: see what blocks the wheels, then enable the base"),
        ({"overcurrent": 5}, "overcurrent of both wheels"),
        ({"charger": "adapter"}, "the base is charging by its adapter: pull the plug, then enable it"),
        ({"charger": "dock"}, "the base stands in its dock: put it on the floor, then enable it"),
        ({"battery_level": "dangerous"}, "the battery is down to 13.0 V: charge it, then enable the base"),
    ],
)
def test_what_a_base_says_of_itself_stops_it_where_it_lasts(said, words):
    ill, well = BaseState(0.0, 13.0, **said), BaseState(0.0, 16.5)
    there = locked_by([ill] * 15)
    assert there[:10] == [None] * 10
    assert all(reason.startswith(words) for reason in there[11:])
    assert locked_by(([ill] * 8 + [well]) * 10) == [None] * 90


def test_a_low_battery_is_no_reason_to_stand():
    assert locked_by([BaseState(0.0, 13.8, battery_level="low")] * 100) == [None] * 100


def test_a_base_that_is_found_in_its_dock_is_not_enabled():
    watchdog = Watchdog(Limits())
    watchdog.hear(5.0)
    watchdog.hear_alarms(alarms(BaseState(5.0, charger="dock")), 5.0)
    watchdog.enable(5.0)
    assert watchdog.locked == "the base stands in its dock: put it on the floor, then enable it"

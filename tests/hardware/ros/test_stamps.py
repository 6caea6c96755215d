"""ROS stamps on the host's clock, the test's own."""

import time

import pytest

from tfg_drake.hardware.ros.intake import JUMP, LEARN, MAX_SKEW, ClockJump, StampClock
from tfg_drake.hardware.watchdog import SILENCE

# Host's monotonic clock minus the robot's, s.
OFFSET = -1.7e9
PERIOD = 0.02


class Robot:
    """Odometry at 50 Hz with a delay of 5 to 8 ms."""

    def __init__(self):
        self.clock, self.now, self.offset, self.count = StampClock("/odom"), 50.0, OFFSET, 0

    def tick(self):
        self.now += PERIOD
        self.count += 1
        delay = 0.005 + 0.001 * (self.count % 4)
        return self.clock.host("/odom", self.now - self.offset, self.now + delay)

    def run(self, duration):
        return [self.tick() for _ in range(round(duration / PERIOD))]


@pytest.fixture
def robot():
    robot = Robot()
    robot.run(2.0)
    return robot


def test_nothing_is_believed_before_the_clock_is_learned():
    robot = Robot()
    assert set(robot.run(LEARN - 0.1)) == {None}
    assert not robot.clock.ready
    robot.run(0.3)
    assert robot.clock.ready


def test_stamps_are_the_hosts_but_for_the_least_delay(robot):
    assert robot.tick() == pytest.approx(robot.now + 0.005, abs=1e-6)
    # A scan that took 60 ms to come keeps its age.
    assert robot.clock.host("/scan", robot.now - OFFSET, robot.now + 0.06) == pytest.approx(robot.now + 0.005, abs=1e-6)
    assert robot.clock.robot(robot.now) == pytest.approx(robot.now - OFFSET, abs=0.01)


def test_order(robot):
    stamp = robot.now - OFFSET
    assert robot.clock.host("/scan", stamp, robot.now) is not None
    assert robot.clock.host("/scan", stamp, robot.now) is None
    assert robot.clock.host("/scan", stamp - 0.1, robot.now) is None


@pytest.mark.parametrize("by", [5.0, -5.0, 2.0 * JUMP, -2.0 * JUMP])
def test_a_jump_is_told_and_the_clock_learned_anew(robot, by):
    robot.offset -= by
    with pytest.raises(ClockJump, match="the clock of /odom has jumped"):
        robot.tick()
    assert robot.run(0.5)[-1] is None
    assert robot.run(1.0)[-1] == pytest.approx(robot.now + 0.005, abs=1e-6)


def test_the_jump_of_another_topic(robot):
    with pytest.raises(ClockJump, match="/scan"):
        robot.clock.host("/scan", robot.now - OFFSET + 5.0, robot.now)


def test_silence_means_to_learn_anew(robot):
    robot.now += SILENCE + 0.1
    robot.offset += 5.0  # the robot was started again, its clock is late
    assert robot.tick() is None
    assert robot.run(1.5)[-1] == pytest.approx(robot.now + 0.005, abs=1e-6)


def test_two_quartzes_drift_apart(robot):
    before = robot.tick()
    for _ in range(5000):  # 100 s at 100 ppm
        robot.offset += 1e-4 * PERIOD
        after = robot.tick()
        assert after > before
        before = after
    assert after == pytest.approx(robot.now + 0.005, abs=0.003)


def test_a_small_step_of_the_clock_is_forgotten(robot):
    robot.offset += 0.01
    robot.run(60.0)
    assert robot.tick() == pytest.approx(robot.now + 0.005, abs=1e-6)


def test_a_message_held_up_keeps_its_age(robot):
    robot.now += 0.4
    stamp = robot.now - 0.4 - OFFSET + PERIOD
    assert robot.clock.host("/odom", stamp, robot.now) < robot.now - 0.3


@pytest.mark.parametrize(("behind", "words"), [(37.5, "37.50 s behind"), (-2.0, "2.00 s ahead of")])
def test_too_large_a_skew_is_one_line(behind, words):
    clock, wall, now = StampClock("/odom"), time.time(), time.monotonic()
    clock.host("/odom", wall - behind, now)
    assert clock.skew() == (
        f"/odom is stamped {words} this computer's clock (0.25 s are allowed); "
        "synchronise both, with chrony for example"
    )


def test_a_small_skew_is_allowed():
    clock, wall, now = StampClock("/odom"), time.time(), time.monotonic()
    clock.host("/odom", wall - 0.5 * MAX_SKEW, now)
    assert clock.skew() is None


def test_a_camera_may_be_late_but_not_ahead():
    clock, wall, now = StampClock("/odom"), time.time(), time.monotonic()
    clock.host("/odom", wall, now)
    clock.host("/detections", wall - 0.4, now)
    assert clock.skew() is None
    clock.host("/scan", wall + 0.6, now)
    assert clock.skew().startswith("/scan is stamped 0.60 s ahead of this computer's clock (0.25 s are allowed)")

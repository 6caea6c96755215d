"""Dead reckoning against the simulator's motion, and velocities against the vendor's commands."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import between
from tfg_drake.hardware.kobuki import odometry as o
from tfg_drake.hardware.kobuki.codec import BaseControl, CoreSensors, Inertia

CORE = CoreSensors(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 165, 0)
PERIOD = 0.02


def frame(time, left, right, angle, rate=0.0):
    """What the base says at time (s) whose wheels have gone so far (m) and which has turned by an angle (rad)."""
    ticks = [round(distance / o.METRES_PER_TICK) % 65536 for distance in (left, right)]
    degrees = round(angle / o.GYRO_UNIT + 18000) % 36000 - 18000
    core = dataclasses.replace(CORE, stamp=round(1000 * time) % 65536, left_encoder=ticks[0], right_encoder=ticks[1])
    return core, Inertia(degrees, round(rate / o.GYRO_UNIT))


def drive(speed, turn_rate, duration, start=0.0):
    """Dead reckoning and the true pose after an arc; wheels, clock and gyro begin near where they wrap."""
    pose, state, wheel = np.zeros(3), None, np.array([5.5, 5.4])
    for k in range(round(duration / PERIOD) + 1):
        time = 65.0 + k * PERIOD
        core, inertia = frame(time, *wheel, 3.0 + turn_rate * k * PERIOD, turn_rate)
        state = o.first(core, inertia, time) if state is None else o.advanced(state, core, inertia, time)
        truth = pose
        pose = advance(pose, speed, turn_rate, PERIOD)
        wheel = wheel + PERIOD * (speed + 0.5 * o.WHEEL_BASE * turn_rate * np.array([-1.0, 1.0]))
    return o.odometry_message(state), truth


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.3, 0.0), (-0.2, 0.0), (0.0, 1.5), (0.25, 0.6), (-0.1, -0.4)])
def test_it_follows_the_simulators_motion(speed, turn_rate):
    odometry, truth = drive(speed, turn_rate, 40.0)
    # A tick is 0.085 mm and a step of the angle 0.17 mrad; neither error adds up.
    assert between(truth, odometry.X_OB) == pytest.approx(np.zeros(3), abs=2e-3)
    assert pytest.approx([speed, turn_rate], abs=5e-3) == odometry.V_B
    assert odometry.stamp == pytest.approx(105.0)
    assert not odometry.at_rest


def test_at_rest_after_a_while_without_ticks():
    state = o.first(*frame(0.0, 0.0, 0.0, 0.0), 10.0)
    seen = []
    for k in range(1, 20):
        state = o.advanced(state, *frame(k * PERIOD, 0.01 * min(k, 5), 0.01 * min(k, 5), 0.0), 10.0 + k * PERIOD)
        seen.append(o.odometry_message(state).at_rest)
    assert not any(seen[:9])
    assert all(seen[10:])


def test_stamps_are_not_late_because_frames_were():
    late = [0.0, 0.0, 0.004, 0.5, 0.48, 0.46, 0.003, 0.0]
    state, stamps = None, []
    for k, delay in enumerate(late):
        received = 50.0 + k * PERIOD + delay
        parts = frame(k * PERIOD, 0.0, 0.0, 0.0)
        state = o.first(*parts, received) if state is None else o.advanced(state, *parts, received)
        stamps.append(state.stamp)
    assert stamps == pytest.approx([50.0 + k * PERIOD for k in range(len(late))], abs=1e-4)


def test_stamps_never_decrease_even_where_the_first_frame_was_late():
    state = o.first(*frame(0.0, 0.0, 0.0, 0.0), 50.3)
    stamps = [state.stamp]
    for k in range(1, 30):
        state = o.advanced(state, *frame(k * PERIOD, 0.0, 0.0, 0.0), 50.0 + k * PERIOD)
        stamps.append(state.stamp)
    assert (np.diff(stamps) >= 0.0).all()
    assert stamps[-1] == pytest.approx(50.0 + 29 * PERIOD, abs=1e-4)


def test_repeated_frames_change_nothing():
    state = o.first(*frame(0.0, 0.0, 0.0, 0.0), 0.0)
    assert o.advanced(state, *frame(0.0, 0.001, 0.001, 0.0), 0.001) is state
    assert o.advanced(state, *frame(0.0, 0.0, 0.0, 2.0), 0.001) is state


@pytest.mark.parametrize(
    ("left", "right", "turn", "told"),
    [
        (0.0, 0.0, 90.0, "wheels moved by 0.00 and 0.00 m and its gyro turned by 90 degrees"),
        (0.0, 0.0, -90.0, "wheels moved by 0.00 and 0.00 m and its gyro turned by -90 degrees"),
        (0.0, 0.0, 8.0, "wheels moved by 0.00 and 0.00 m and its gyro turned by 8 degrees"),
        (2.0, 0.0, 0.0, "wheels moved by 2.00 and 0.00 m and its gyro turned by 0 degrees"),
        (-0.1, -0.1, 0.0, "wheels moved by -0.10 and -0.10 m and its gyro turned by 0 degrees"),
    ],
)
@pytest.mark.parametrize("stays", [True, False])
def test_what_no_base_can_have_done_is_a_fault_and_not_reckoned(left, right, turn, told, stays):
    """From frame 20 on, or in that one only, as where it was garbled."""
    state, faults = o.first(*frame(0.0, 0.0, 0.0, 0.0), 0.0), []
    for k in range(1, 100):
        jumped = k >= 20 if stays else k == 20
        wheels = [0.002 * k + jumped * jump for jump in (left, right)]
        angle = jumped * math.radians(turn)
        state = o.advanced(state, *frame(k * PERIOD, *wheels, angle), k * PERIOD)
        faults += [(k, state.fault)] if state.fault else []
    why = f"the base's {told} in 0.02 s: one of them is broken, or a frame was garbled; enable it again"
    assert faults[0] == (20, why)
    assert [k for k, _ in faults] == ([20] if stays else [20, 21])
    # It costs what the base did in these frames.
    assert pytest.approx((0.002 * (99 - len(faults)), 0.0, 0.0), abs=1e-3) == state.X_OB
    assert state.stamp == pytest.approx(99 * PERIOD)


def test_a_hand_that_turns_the_base_fast_is_no_jump():
    state = o.first(*frame(0.0, 0.0, 0.0, 0.0), 0.0)
    for k in range(1, 100):
        state = o.advanced(state, *frame(k * PERIOD, 0.0, 0.0, 5.0 * k * PERIOD), k * PERIOD, driven=False)
        assert state.fault is None
    assert state.X_OB[2] == pytest.approx(math.remainder(5.0 * 99 * PERIOD, 2.0 * math.pi), abs=1e-3)


def faults(times, received=None, turns=None):
    """The faults, frame by frame, of a base that drives ahead, its clock at `times` and the host's at `received`, s;
    turns: what its wheels have turned it by, rad, which the gyro does not notice."""
    state, found = None, []
    for k, time in enumerate(times):
        at, turned = 50.0 + (time if received is None else received[k]), 0.0 if turns is None else turns[k]
        half = 0.5 * o.WHEEL_BASE * turned
        parts = frame(time, 0.002 * k - half, 0.002 * k + half, 0.0)
        before, state = state, o.first(*parts, at) if state is None else o.advanced(state, *parts, at)
        found.append(None if state is before else state.fault)
    return found


STEADY = [PERIOD * k for k in range(50)]


@pytest.mark.parametrize("begin", [0.0, 65.1, 1000.3])
def test_a_clock_that_goes_on_is_no_fault(begin):
    assert set(faults([begin + time for time in STEADY])) == {None}
    # Nor is one whose frames come twice, late, or not at all.
    assert set(faults([begin + time for time in STEADY for _ in range(2)])) == {None}
    assert set(
        faults([begin + time for time in STEADY], [time + 0.2 * (k % 7 == 3) for k, time in enumerate(STEADY)])
    ) == {None}
    assert set(faults([begin + time for time in STEADY if not 0.3 < time < 0.7])) == {None}
    assert set(faults([begin + time + 3.0 * (time > 0.5) for time in STEADY])) == {None}


@pytest.mark.parametrize(("jump", "what"), [(-2.0, "went back by 1.98 s"), (3.0, "is 3.00 s ahead of this machine's")])
def test_a_clock_that_jumps_is_a_fault_once(jump, what):
    found = faults([time + jump * (k >= 20) for k, time in enumerate(STEADY)], STEADY)
    line = f"the base's clock {what}: it was started anew, or frames arrive out of order; enable it again"
    assert found == [line if k == 20 else None for k in range(50)]


def test_frames_out_of_order_are_a_fault():
    times = STEADY.copy()
    times[30], times[20] = times[20], times[30]
    assert "went back by 0.18 s" in faults(times, STEADY)[21]


def test_odometry_goes_on_after_a_jump():
    state, moved = o.first(*frame(9.0, 0.0, 0.0, 0.0), 50.0), 0.0
    for k in range(1, 50):
        moved += 0.002
        jump = -2.0 if k >= 25 else 0.0
        before, state = state, o.advanced(state, *frame(9.0 + k * PERIOD + jump, moved, moved, 0.0), 50.0 + k * PERIOD)
        assert state.stamp > before.stamp
    assert pytest.approx((48 * 0.002, 0.0, 0.0), abs=1e-3) == state.X_OB
    assert state.stamp == pytest.approx(50.0 + 49 * PERIOD, abs=1e-3)


def test_a_gyro_that_does_not_notice_a_turn_is_a_fault():
    found = faults(STEADY, turns=[0.8 * time for time in STEADY])
    assert [k for k, fault in enumerate(found) if fault] == [10, 20, 30, 40]
    assert found[10] == "the gyro does not turn with the wheels: it is broken, or they slip; look at the base"
    # Wheels that are not quite alike, straight ahead.
    assert set(faults(STEADY, turns=[0.1 * time for time in STEADY])) == {None}


class Drive:
    """A base whose gyro flickers, and whose wheels are told in whole ticks."""

    def __init__(self):
        self.random, self.time, self.wheels, self.angle = np.random.default_rng(0), 0.0, np.zeros(2), 0.0
        self.state = o.first(*frame(0.0, 0.0, 0.0, 0.0), 0.0)
        self.fault = None

    def go(self, seconds, by_wheels, by_gyro, speed=0.0, driven=True):
        """Turn rates, rad/s, that wheels and gyro tell. Returns after which time there is a fault, None without one."""
        for k in range(1, round(seconds / PERIOD) + 1):
            self.time += PERIOD
            self.wheels += PERIOD * (speed + 0.5 * o.WHEEL_BASE * by_wheels * np.array([-1.0, 1.0]))
            self.angle += PERIOD * by_gyro
            flicker = self.random.normal(0.0, 0.01 * math.pi / 180.0)
            parts = frame(self.time, *self.wheels, self.angle + flicker)
            self.state = o.advanced(self.state, *parts, self.time, driven)
            if self.state.fault is not None:
                self.fault = self.state.fault
                return k * PERIOD
        return None


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("by_wheels", "by_gyro", "speed", "within"),
    [
        # Dead, but it flickers: after a turn of less than 1 rad, however slowly the base turns.
        (1.5, 0.0, 0.0, 0.75 / 1.5),
        (0.5, 0.0, 0.2, 0.83 / 0.5),
        (0.3, 0.0, 0.2, 0.94 / 0.3),
        # Of another scale, or with the wrong sign.
        (1.0, 0.5, 0.0, 3.4),
        (1.0, 2.0, 0.0, 5.0),
        (0.5, 2.0, 0.2, 5.0),
        (1.0, -1.0, 0.0, 0.6),
        # It runs away while the base drives straight ahead.
        (0.0, 0.4, 0.3, 5.0),
        (0.0, 4.0, 0.3, 5.0),
    ],
)
def test_a_gyro_that_tells_another_turn_than_the_wheels_is_a_fault(side, by_wheels, by_gyro, speed, within):
    drive = Drive()
    # However long all was well before.
    assert drive.go(60.0, 1.0, 1.0) is None
    assert drive.go(20.0, side * by_wheels, side * by_gyro, speed) == pytest.approx(within, rel=0.2)
    assert drive.fault == "the gyro does not turn with the wheels: it is broken, or they slip; look at the base"


def test_wheels_as_they_are_are_no_fault():
    drive = Drive()
    for _ in range(20):
        # One wheel is 3 % larger; in turns both slip, by a quarter and more.
        assert drive.go(8.0, 0.04, 0.0, 0.3) is None
        assert drive.go(4.0, 1.5, 1.1) is None
        assert drive.go(4.0, -0.5, -0.36, 0.1) is None
    # A wheel spins for a moment, and again.
    for _ in range(5):
        assert drive.go(0.3, 1.5, 0.0) is None
        assert drive.go(8.0, 0.0, 0.0, 0.3) is None


@pytest.mark.parametrize("speed", [0.0, 0.3])
@pytest.mark.parametrize("turn_rate", [0.0, 0.3, 1.0])
def test_a_driven_base_that_is_pushed_round_is_no_fault(speed, turn_rate):
    drive = Drive()
    for _ in range(5):
        # A quarter turn in half a second, a half turn in a second, with and against its own.
        assert drive.go(0.5, turn_rate, turn_rate + 0.5 * math.pi / 0.5, speed) is None
        assert drive.go(15.0, turn_rate, turn_rate, speed) is None
        assert drive.go(0.3, turn_rate, turn_rate - 1.0, speed) is None
        assert drive.go(15.0, turn_rate, turn_rate, speed) is None


@pytest.mark.parametrize("rolling", [0.0, 0.5, 1.0, -0.5])
def test_a_base_that_stands_may_be_turned_by_hand_and_drives_on(rolling):
    drive = Drive()
    for _ in range(3):
        assert drive.go(20.0, rolling * 2.0, 2.0, driven=False) is None
        assert drive.go(20.0, 1.0, 1.0, 0.1) is None


def test_after_a_reconnection_everything_counts_from_the_new_frame():
    before = o.first(*frame(0.0, 0.0, 0.0, 0.0), 0.0)
    before = o.advanced(before, *frame(0.02, 0.01, 0.01, 0.0), 0.02)
    state = o.first(*frame(30.0, 4.0, 1.0, 2.0), 9.0, before)
    assert (state.X_OB, state.V_B, state.stamp) == (before.X_OB, (0.0, 0.0), 9.0)
    state = o.advanced(state, *frame(30.02, 4.01, 1.01, 2.0), 9.02)
    assert pytest.approx((0.02, 0.0, 0.0), abs=2e-4) == state.X_OB


@pytest.mark.parametrize(("bits", "drop"), [(0, 0), (1, 1), (2, 4), (3, 5)])
def test_hazards(bits, drop):
    hazards = o.hazards_message(dataclasses.replace(CORE, bumper=5, cliff=2, wheel_drop=bits), 3.0)
    assert (hazards.stamp, hazards.bumper, hazards.cliff, hazards.wheel_drop) == (3.0, 5, 2, drop)


# (v, w) and what the vendor's driver makes of it, kobuki_core 1.4.0.
GOLDEN = {
    (0.2, 0.0): (200, 0),
    (-0.2, 0.0): (-200, 0),
    (0.0, 0.8): (92, 1),
    (0.0, -0.8): (-92, 1),
    (0.2, 0.5): (257, 400),
    (0.15, -0.9): (253, -166),
    (-0.1, 0.3): (-134, -333),
    (-0.2, -0.5): (-257, 400),
    (0.0005, 1.0): (115, 1),
    (0.05, 2.0): (280, 25),
    (0.7, 0.02): (702, 32767),
    (0.7, -0.02): (702, -32768),
    (0.0, 0.0): (0, 0),
}


@pytest.mark.parametrize(("wanted", "command"), GOLDEN.items())
def test_commands_are_the_vendors(wanted, command):
    assert o.base_control(*wanted) == BaseControl(*command)


def test_commands_are_saturated():
    assert o.base_control(99.0, 0.0) == BaseControl(32767, 0)
    assert o.base_control(-99.0, 1e-3) == BaseControl(-32768, -32768)


@given(st.floats(-0.7, 0.7), st.floats(-math.pi, math.pi))
def test_the_base_does_what_was_wanted(speed, turn_rate):
    v, w = o.velocity(o.base_control(speed, turn_rate))
    # Speeds are whole mm/s, and so is the radius, which matters where it is small.
    assert v == pytest.approx(speed, abs=3e-3 + 2e-3 * abs(turn_rate))
    assert w == pytest.approx(turn_rate, abs=0.02 + 0.01 * abs(turn_rate))

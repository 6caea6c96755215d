"""From the Kobuki's units to SI and back: dead reckoning, alarms, state, and the command of a velocity.

Source: the vendor's driver kobuki_core 1.4.0 (diff_drive.cpp, kobuki.cpp); its numbers in whole ticks, millimetres and
hundredths of a degree are converted here and nowhere else. Plain arithmetic: the driver's process, which watches over
the base, must never wait for a kernel to compile.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tfg_drake.hardware.device import BaseState
from tfg_drake.hardware.kobuki.codec import BaseControl, Charger, CoreSensors, Inertia, Motor, Wheel
from tfg_drake.hardware.plausible import AHEAD, CLOCK_DRIFT
from tfg_drake.messages import Hazards, Odometry
from tfg_drake.mission.operation import Side

# Track width, m, and travel of a wheel per encoder tick, m.
WHEEL_BASE = 0.230
METRES_PER_TICK = 8.5292090e-5
# Unit of the gyro's angle, rad, and of its rate, rad/s.
GYRO_UNIT = math.radians(0.01)
# Greatest speed of a wheel, m/s, and turn rate, rad/s: twice the base's limits, and more than its gyro measures.
_FASTEST_WHEEL, _FASTEST_TURN = 1.4, 2.0 * math.pi
# Longest gap between two frames, s, over which dead reckoning continues; beyond it the base was not connected. Also the
# period of its state reports.
LONGEST_GAP = 1.0
# The base is at rest after _REST, s, without a tick: longer than the period at which its newest message is read.
_REST = 0.1
# The gyro is stuck if its angle does not change while the wheels turn the base by more than _UNNOTICED, rad.
_UNNOTICED = 0.15
# CUSUM test of gyro against wheels. Allowed differences: the share _SLIP of the wheels' turn, as wheels slip, and the
# rate _UNLIKE, rad/s, as they are not quite equal. The sum of the excess above _APART, rad, is a fault. An excess that
# slip cannot explain, such as a larger turn by the gyro, grows by at most _PUSHED, rad/s: a push is strong but short.
_SLIP, _UNLIKE, _APART, _PUSHED = 0.3, 0.05, 0.5, 0.15
# The vendor's limits: a battery is low at LOW, V, or less, and dangerously low at DANGEROUS, V, or less.
LOW, DANGEROUS = 14.0, 13.2
# The reason given for a jump of the base's clock.
_RESTARTED = "it was started anew, or frames arrive out of order"


@dataclasses.dataclass(frozen=True)
class Reckoning:
    """Dead reckoning up to one feedback frame.

    core, inertia: that frame's. base_time: time since the first frame by the base's clock, s. offset: host's clock
    minus base_time, s. X_OB: pose in the odometry frame, m and rad. V_B: forward speed, m/s, and turn rate, rad/s.
    stamp: host's clock, s, never decreasing. moved: stamp of the last tick, s. unnoticed: turn by the wheels since the
    gyro's angle last changed, rad. apart: accumulated disagreement of gyro and wheels, rad, see _apart. fault: why the
    base must stand now, None without a fault.
    """

    core: CoreSensors
    inertia: Inertia
    base_time: float
    offset: float
    X_OB: tuple[float, float, float]
    V_B: tuple[float, float]
    stamp: float
    moved: float
    unnoticed: float = 0.0
    apart: float = 0.0
    fault: str | None = None


def first(core: CoreSensors, inertia: Inertia, received: float, before: Reckoning | None = None) -> Reckoning:
    """Return the start of dead reckoning, or its continuation after a gap of unknown length.

    received: time of the frame's arrival, s of the host's clock. Ticks, gyro angle and base time count from this frame
    on; the pose starts at 0, or keeps its value: the motion during the gap is unknown.
    """
    pose, stamp = ((0.0, 0.0, 0.0), received) if before is None else (before.X_OB, max(before.stamp, received))
    return Reckoning(core, inertia, 0.0, received, pose, (0.0, 0.0), stamp, stamp)


def advanced(state: Reckoning, core: CoreSensors, inertia: Inertia, received: float, driven: bool = True) -> Reckoning:
    """Return dead reckoning one frame later.

    received: time of its arrival, s of the host's clock. driven: the base is commanded to move. The base drives an arc:
    its length is the mean travel of the wheels, its angle the gyro's turn. The stamp is the base's clock shifted to the
    host's by the least delay seen, so that a frame's time in queues does not count. A frame with an unchanged time
    changes nothing. After a gap of LONGEST_GAP dead reckoning starts anew; likewise, with a fault, if the base's clock
    went back or is ahead of the host's, or if the motion since the previous frame is impossible. It is a fault, too, if
    a driven base's gyro does not turn with the wheels; a standing base may be turned by hand.
    """
    duration = 1e-3 * _signed(core.stamp - state.core.stamp)
    if duration < 0.0:
        return _anew(state, core, inertia, received, f"clock went back by {-duration:.2f} s: {_RESTARTED}")
    if (ahead := state.base_time + duration + state.offset - received) > AHEAD:
        return _anew(state, core, inertia, received, f"clock is {ahead:.2f} s ahead of this machine's: {_RESTARTED}")
    if duration > LONGEST_GAP:
        return first(core, inertia, received, state)
    left = METRES_PER_TICK * _signed(core.left_encoder - state.core.left_encoder)
    right = METRES_PER_TICK * _signed(core.right_encoder - state.core.right_encoder)
    if duration == 0.0:
        return state
    # The angle is in (-180, 180] degrees.
    turn = GYRO_UNIT * ((inertia.angle - state.inertia.angle + 18000) % 36000 - 18000)
    if max(abs(left), abs(right)) > _FASTEST_WHEEL * duration or abs(turn) > _FASTEST_TURN * duration:
        told = f"wheels moved by {left:.2f} and {right:.2f} m and its gyro turned by {math.degrees(turn):.0f} degrees"
        what = f"{told} in {duration:.2f} s: one of them is broken, or a frame was garbled"
        return _anew(state, core, inertia, received, what)
    distance = 0.5 * (left + right)
    x, y, theta = state.X_OB
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if abs(half) > 1e-8 else 1.0)
    pose = (
        x + chord * math.cos(theta + half),
        y + chord * math.sin(theta + half),
        math.pi - (math.pi - theta - turn) % (2.0 * math.pi),
    )
    base_time = state.base_time + duration
    offset = min(state.offset + CLOCK_DRIFT * duration, received - base_time)
    stamp = max(state.stamp, base_time + offset)
    moved = stamp if left or right else state.moved
    speed = (distance / duration, GYRO_UNIT * inertia.rate)
    unnoticed, apart, fault = state.unnoticed, state.apart, None
    if driven:
        by_wheels = (right - left) / WHEEL_BASE
        unnoticed, apart = 0.0 if turn else unnoticed + by_wheels, _apart(apart, turn, by_wheels, duration)
    if abs(unnoticed) > _UNNOTICED or apart > _APART:
        unnoticed = apart = 0.0
        fault = "the gyro does not turn with the wheels: it is broken, or they slip; look at the base"
    return Reckoning(core, inertia, base_time, offset, pose, speed, stamp, moved, unnoticed, apart, fault)


def _apart(before: float, turn: float, by_wheels: float, duration: float) -> float:
    """Return the accumulated disagreement of gyro and wheels, rad, after `duration` s with their turns, rad.

    It grows while they disagree and falls to 0 while they agree: a cumulative sum detects a lasting change, a large one
    soon (Page, Continuous inspection schemes, 1954).
    """
    more, slip = abs(turn - by_wheels) - _SLIP * abs(by_wheels), 0.0
    if turn * by_wheels < by_wheels**2:
        slip = (1.0 - _SLIP) * abs(by_wheels)
    return max(0.0, before + min(more, slip + _PUSHED * duration) - _UNLIKE * duration)


def _anew(state: Reckoning, core: CoreSensors, inertia: Inertia, received: float, what: str) -> Reckoning:
    """Return the continuation after an impossible frame, with a fault. what: is wrong with the base."""
    return dataclasses.replace(first(core, inertia, received, state), fault=f"the base's {what}; enable it again")


def _signed(difference: int) -> int:
    """Return the difference of two 16-bit counters that wrap, in [-32768, 32768)."""
    return (difference + 32768) % 65536 - 32768


def odometry_message(state: Reckoning) -> Odometry:
    """Return the odometry message of dead reckoning. At rest: no tick of any wheel for 0.1 s."""
    at_rest = state.stamp - state.moved >= _REST
    return Odometry(state.stamp, np.array(state.X_OB), np.array(state.V_B), at_rest)


def hazards_message(core: CoreSensors, stamp: float) -> Hazards:
    """Return the base's alarms at stamp (s of the host's clock)."""
    drop = _sides(core.wheel_drop & Wheel.RIGHT, core.wheel_drop & Wheel.LEFT)
    return Hazards(stamp, core.bumper & 7, core.cliff & 7, drop)


def base_state(core: CoreSensors, stamp: float) -> BaseState:
    """Return the part of the state at stamp, s of the host's clock, that every frame carries: battery, charger, wheels'
    current and buttons."""
    volts, level = 0.1 * core.battery, "good"  # also while it is charging, or if the voltage is unknown
    if core.battery and not core.charger and volts <= LOW + 1e-9:
        level = "low" if volts > DANGEROUS + 1e-9 else "dangerous"
    return BaseState(
        stamp=stamp,
        battery=round(volts, 1) if core.battery else math.nan,
        battery_level=level,
        charger="" if not core.charger else "adapter" if core.charger & Charger.ADAPTER else "dock",
        charging=bool(core.charger & Charger.CHARGING),
        overcurrent=_sides(core.overcurrent & Motor.RIGHT, core.overcurrent & Motor.LEFT),
        buttons=core.buttons & 7,
    )


def _sides(right: int, left: int) -> int:
    """Return the bits of Side of the arguments that are not 0."""
    return (Side.RIGHT if right else 0) | (Side.LEFT if left else 0)


def base_control(speed: float, turn_rate: float) -> BaseControl:
    """Return the command for a finite forward speed (m/s) and turn rate (rad/s).

    It has the speed of the outer wheel and the radius of the centre's arc. Straight ahead is radius 0, a turn in place
    radius 1 with the direction in the speed. Fractions are truncated and values saturate at 16 bits, as in the vendor's
    driver.
    """
    half_base = 500.0 * WHEEL_BASE
    if abs(turn_rate) < 1e-4:
        return BaseControl(_int16(1000.0 * speed), 0)
    radius = 1000.0 * speed / turn_rate
    if abs(speed) < 1e-4 or abs(radius) <= 1.0:
        return BaseControl(_int16(half_base * turn_rate), 1)
    return BaseControl(_int16((radius + math.copysign(half_base, radius)) * turn_rate), _int16(radius))


def velocity(command: BaseControl) -> tuple[float, float]:
    """Return forward speed (m/s) and turn rate (rad/s) of a command: the inverse of base_control."""
    if command.radius == 0:
        return 1e-3 * command.speed, 0.0
    if abs(command.radius) == 1:
        return 0.0, command.radius * command.speed / (500.0 * WHEEL_BASE)
    turn_rate = command.speed / (command.radius + math.copysign(500.0 * WHEEL_BASE, command.radius))
    return 1e-3 * command.radius * turn_rate, turn_rate


def _int16(value: float) -> int:
    return int(min(32767.0, max(-32768.0, value)))

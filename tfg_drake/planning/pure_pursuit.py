"""Path following and turning in place: regulated pure pursuit and a ramped turn, as stateless functions.

Regulated pure pursuit (Macenski et al., Autonomous Robots 2023) steers along the arc to a point a little ahead on the
path, and slows down before bends and before the end.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit

from tfg_drake.config import RobotConfig
from tfg_drake.messages import FloatArray

# The point steered for is what the robot reaches in LOOK_AHEAD_TIME s, and this far ahead at least, m.
LOOK_AHEAD_TIME = 0.7
LOOK_AHEAD_MIN = 0.2
# A heading error beyond TURN_ABOVE stops the robot to turn in place until it is below TURN_BELOW, rad.
TURN_ABOVE = math.radians(50.0)
TURN_BELOW = math.radians(6.0)
# The share of the base's limits that plans use, so that control has something left.
PLANNED_SHARE = 0.6
# The end of the path is reached within this, m.
ARRIVED = 0.01
# At rest: below these speeds, m/s and rad/s.
REST_SPEED = 0.01
REST_TURN_RATE = 0.02
# Gain of the turn towards a heading, 1/s.
HEADING_GAIN = 3.0
# What the robot is to look at at a goal is brought this far within the field of view, rad.
VIEW_MARGIN = math.radians(15.0)
# Extra angle, rad, whose turn takes as long as stopping and turning back.
TURNING_BACK = 0.3
# All round, a heading every 5 degrees.
ALL_ROUND = np.arange(72) * (math.pi / 36.0)
# Length of path searched ahead of the progress, m.
SEARCH = 1.0


@dataclasses.dataclass(frozen=True)
class PathCommand:
    """speed: m/s. turn_rate: rad/s. progress: m along the path. turning: the robot turns in place. finished. left:
    m of the path."""

    speed: float
    turn_rate: float
    progress: float
    turning: bool
    finished: bool
    left: float = 0.0


@njit(cache=True)
def _project(points: FloatArray, x: float, y: float, progress: float, reach: float) -> tuple[float, float]:
    """Return the progress (m) of the path's point nearest to (x, y) within reach ahead, and the path's length."""
    best, found, s = np.inf, progress, 0.0
    for i in range(len(points) - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length > 0.0 and s + length >= progress and s <= progress + reach:
            t = min(1.0, max(0.0, ((x - points[i, 0]) * dx + (y - points[i, 1]) * dy) / (length * length)))
            t = min(max(t, (progress - s) / length), 1.0)
            d = (points[i, 0] + t * dx - x) ** 2 + (points[i, 1] + t * dy - y) ** 2
            if d < best:
                best, found = d, s + t * length
        s += length
    return found, s


@njit(cache=True)
def _at(points: FloatArray, s: float) -> tuple[float, float, float]:
    """Return place (m) and heading (rad) of a path at progress s; straight on beyond its end."""
    last = len(points) - 2
    for i in range(last + 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length > 0.0 and (s <= length or i == last):
            return points[i, 0] + s / length * dx, points[i, 1] + s / length * dy, math.atan2(dy, dx)
        s -= length
    return points[-1, 0], points[-1, 1], 0.0


@njit(cache=True)
def _speed_limit(points: FloatArray, progress: float, max_speed: float, turn_rate: float, braking: float) -> float:
    """Return the speed (m/s) from which the robot can brake in time for each bend ahead and for the end."""
    limit, s = max_speed, 0.0
    for i in range(1, len(points)):
        dx, dy = points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1]
        before = math.sqrt(dx * dx + dy * dy)
        s += before
        if s < progress - before:
            continue
        ahead = max(0.0, s - progress)
        if 2.0 * braking * ahead > max_speed * max_speed:
            break
        slow = 0.0
        if i < len(points) - 1:
            ex, ey = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
            after = math.sqrt(ex * ex + ey * ey)
            turn = abs(math.atan2(dx * ey - dy * ex, dx * ex + dy * ey))
            # A bend within half a step before and behind.
            slow = turn_rate * 0.5 * (before + after) / max(turn, 1e-9)
        if slow < max_speed:
            limit = min(limit, math.sqrt(slow * slow + 2.0 * braking * ahead))
    return limit


@njit(cache=True)
def _aim(
    points: FloatArray,
    X_MB: FloatArray,
    speed: float,
    progress: float,
    max_speed: float,
    turn_rate: float,
    braking: float,
) -> tuple[float, float, float, float, float, float]:
    """Return the progress (m), the remaining path, m, the vector from the robot to the target point, m along M's axes,
    the heading error to it, rad, and `_speed_limit`, m/s."""
    progress, length = _project(points, X_MB[0], X_MB[1], progress, SEARCH)
    ahead = max(LOOK_AHEAD_TIME * speed, LOOK_AHEAD_MIN)
    px, py, _ = _at(points, progress + ahead)
    dx, dy = px - X_MB[0], py - X_MB[1]
    error = math.atan2(dy, dx) - X_MB[2]
    limit = _speed_limit(points, progress, max_speed, turn_rate, braking)
    return progress, length - progress, dx, dy, math.atan2(math.sin(error), math.cos(error)), limit


def _turn_towards(error: float, robot: RobotConfig) -> float:
    """Return the turn rate, rad/s, that removes a heading error (rad) and can still brake."""
    rate = min(
        HEADING_GAIN * abs(error),
        math.sqrt(2.0 * PLANNED_SHARE * robot.max_turn_acceleration * abs(error)),
        PLANNED_SHARE * robot.max_turn_rate,
    )
    return math.copysign(rate, error)


def follow(
    points: FloatArray, X_MB: FloatArray, speed: float, progress: float, turning: bool, robot: RobotConfig
) -> PathCommand:
    """Return the command at pose X_MB (3,) and speed (m/s) on a path (k, 2), m in M, of which progress (m) is done.

    turning: True if the robot was turning in place; it continues until it faces along the path.
    """
    if len(points) < 2:
        return PathCommand(0.0, 0.0, 0.0, False, True)
    turn_rate, braking = PLANNED_SHARE * robot.max_turn_rate, PLANNED_SHARE * robot.max_acceleration
    progress, remaining, dx, dy, error, limit = _aim(points, X_MB, speed, progress, robot.max_speed, turn_rate, braking)
    if remaining < ARRIVED:
        return PathCommand(0.0, 0.0, progress, False, True)
    # This near to the end a driving robot turns in place only for a point behind it, not for one beside it.
    beside = speed > REST_SPEED and remaining < 0.5 * LOOK_AHEAD_MIN
    turn_above = 0.5 * math.pi if beside else TURN_ABOVE
    if abs(error) > (TURN_BELOW if turning else turn_above):
        return PathCommand(0.0, _turn_towards(error, robot), progress, True, False, remaining)
    curvature = 2.0 * math.sin(error) / max(math.hypot(dx, dy), 1e-3)
    limit = min(limit, turn_rate / max(abs(curvature), 1e-9))
    return PathCommand(limit, limit * curvature, progress, False, False, remaining)


def turn_to_see(look: FloatArray, heading: float, field_of_view: float) -> tuple[float, float]:
    """Return the shortest turn in place from a heading (rad) that brings all headings `look` (l,), rad, into view.

    field_of_view: rad. Without headings, the turn covers all directions that are not in view already. Returns the first
    and the final angle, both from the heading, rad: to one side and, if that is shorter, back to the other.
    """
    half = 0.5 * field_of_view - VIEW_MARGIN if field_of_view < 2.0 * math.pi else math.pi
    left = np.sort(np.mod((look if len(look) else ALL_ROUND) - heading, 2.0 * math.pi))
    # The first k are seen by turning to the left, the others by turning to the right.
    to_left = np.maximum(0.0, np.append(0.0, left) - half)
    to_right = np.maximum(0.0, np.append(2.0 * math.pi - left, 0.0) - half)
    both = TURNING_BACK * ((to_left > 0.0) & (to_right > 0.0))
    k = int(np.argmin(to_left + to_right + np.minimum(to_left, to_right) + both))
    a, b = float(to_left[k]), -float(to_right[k])
    if a == 0.0 or b == 0.0:
        return a + b, a + b
    return (a, b) if a <= -b else (b, a)


def turn_in_place(turned: float, target: float, turn_rate: float, robot: RobotConfig) -> float:
    """Return the turn rate, rad/s, towards a target (rad), of which `turned` (rad) is done; it slows down at the end.

    It brakes smoothly at a share of the base's limit. The base's own limit shapes the start.
    """
    left = target - turned
    braking = PLANNED_SHARE * robot.max_turn_acceleration
    return math.copysign(min(turn_rate, robot.max_turn_rate, max(0.05, math.sqrt(2.0 * braking * abs(left)))), left)


def at_rest(speed: float, turn_rate: float) -> bool:
    """Return whether measured speeds (m/s, rad/s) are those of a standing robot."""
    return abs(speed) < REST_SPEED and abs(turn_rate) < REST_TURN_RATE

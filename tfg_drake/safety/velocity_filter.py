"""The safety filter: limits each velocity command, and stops or backs off for hazards, obstacles and unseen space."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import RobotConfig, SafetyConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.messages import BoolArray, FloatArray, Hazards, IntArray, LaserScan, Odometry, replace
from tfg_drake.mission.operation import Side
from tfg_drake.safety.corridor import touch_distance
from tfg_drake.safety.scan_watch import HELD, REMEMBERED, ScanWatch
from tfg_drake.safety.seen_space import CELL, open_distance, open_distance_among

# Entries of the filter's state: the velocity it last let through (m/s, rad/s), the bumper bits of the running reflex
# (0: none) and the time left to it (s), the speed that the base has then, which brakes no harder than it can (m/s), and
# since it last drove ahead how many reflexes there were, and how far they backed away (m).
SPEED, TURN_RATE, REFLEX_BITS, REFLEX_LEFT, BASE_SPEED, REFLEXES, BACKED = range(7)
STATE_SIZE = 7

# A bumper that stays pressed, or is pressed again before the base has driven ahead, causes at most MOST_REFLEXES
# reflexes, which back away by at most MOST_BACKED, m, together.
MOST_REFLEXES, MOST_BACKED = 3, 0.2
PRESSED = "the bumper stays pressed: see what it pushes against; it drives ahead again when the bumper is released"
# The base drives on for this time, s, with scans that are not trusted, as a single one may be garbled.
_DOUBTED = 0.25


@njit(cache=True)
def free_distance(
    angles: FloatArray,
    ranges: FloatArray,
    X_SB: FloatArray,
    curvature: float,
    radius: float,
    margin: float,
    reach: float,
) -> float:
    """How far (m) the base can drive along an arc of some curvature (1/m) until its outline meets a scan return; inf if
    none.

    angles, ranges: (n,) of the scan, rad and m. X_SB: (3,) the body's pose now in the frame S the scan was taken in.
    Only returns ahead and inside the corridor swept by a disc of radius + margin (m) count, so neither a wall alongside
    nor a door's jambs do; those farther than reach (m) make no difference.
    """
    cosine, sine = math.cos(X_SB[2]), math.sin(X_SB[2])
    # On its way the base's centre gets no nearer to what it touches than this.
    farthest = reach + radius + margin + math.hypot(X_SB[0], X_SB[1])
    least = np.inf
    for i in range(angles.shape[0]):
        if ranges[i] < np.inf and ranges[i] <= farthest:
            dx = ranges[i] * math.cos(angles[i]) - X_SB[0]
            dy = ranges[i] * math.sin(angles[i]) - X_SB[1]
            x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
            least = min(least, touch_distance(x, y, curvature, radius, radius + margin))
    return least


@njit(cache=True)
def _things_near(
    angles: FloatArray,
    ranges: FloatArray,
    X_SB: FloatArray,
    seen: FloatArray,
    met: BoolArray,
    p_OM: FloatArray,
    newest: float,
    X_OB: FloatArray,
    reach: float,
) -> FloatArray:
    """Places (n, 2), m, in the base's frame B and no farther than reach (m) from it, where the scan met something, or
    an older one in memory did. X_SB, X_OB: the base where the scan was taken, and in odometry's frame; the others as in
    free_distance and open_distance_among."""
    places = [(0.0, 0.0) for _ in range(0)]
    for k in range(len(ranges)):
        if ranges[k] < np.inf:
            dx, dy = ranges[k] * math.cos(angles[k]) - X_SB[0], ranges[k] * math.sin(angles[k]) - X_SB[1]
            if dx * dx + dy * dy < reach * reach:
                places.append(_turned(dx, dy, X_SB[2]))
    rows, columns = np.nonzero(met)
    for k in range(len(rows)):
        i, j = rows[k], columns[k]
        dx, dy = p_OM[i, j, 0] - X_OB[0], p_OM[i, j, 1] - X_OB[1]
        if seen[i, j] != newest and dx * dx + dy * dy < reach * reach:
            places.append(_turned(dx, dy, X_OB[2]))
    p_BM = np.empty((len(places), 2))
    for k in range(len(places)):
        p_BM[k, 0], p_BM[k, 1] = places[k]
    return p_BM


@njit(cache=True)
def _turned(dx: float, dy: float, heading: float) -> tuple[float, float]:
    """A vector in the frame of a base with this heading, rad."""
    cosine, sine = math.cos(heading), math.sin(heading)
    return cosine * dx + sine * dy, cosine * dy - sine * dx


@njit(cache=True)
def _nearest_while_braking(
    p_BM: FloatArray, velocity: FloatArray, turn_wanted: float, limits: FloatArray, reach: float, period: float
) -> float:
    """How near (m) the base's centre comes to any of some places (n, 2), m in B, braking as hard as it can.

    velocity: (2,) speed > 0 (m/s) and turn rate (rad/s) before. turn_wanted: rad/s, the turn rate it goes over to
    meanwhile, nan: what keeps it on its arc. limits: (2,) of its acceleration, m/s^2, and turn acceleration, rad/s^2.
    Places farther than reach (m) make no difference.
    """
    speed, turn_rate = velocity[0], velocity[1]
    curvature = turn_rate / speed
    pose, least = np.zeros(3), reach
    while speed > 0.0 and len(p_BM) > 0:
        pose = advance(pose, speed, turn_rate, period)
        speed -= limits[0] * period
        wanted = curvature * max(0.0, speed) if math.isnan(turn_wanted) else turn_wanted
        turn_rate += min(limits[1] * period, max(-limits[1] * period, wanted - turn_rate))
        least = min(least, math.sqrt(((p_BM[:, 0] - pose[0]) ** 2 + (p_BM[:, 1] - pose[1]) ** 2).min()))
    return least


@njit(cache=True)
def _bounded(value: float, bound: float) -> float:
    return min(bound, max(-bound, value))


@njit(cache=True)
def _towards(value: float, wanted: float, step: float) -> float:
    """The value after one step at most towards what is wanted."""
    return value + _bounded(wanted - value, step)


def _reflex(bits: int, safety: SafetyConfig) -> tuple[float, float]:
    """Back away from a bumper, and turn away where only one side was hit."""
    turn_rates: dict[int, float] = {Side.LEFT: -safety.reflex_turn_rate, Side.RIGHT: safety.reflex_turn_rate}
    return -safety.reflex_speed, turn_rates.get(bits, 0.0)


def stopped(state: FloatArray, robot: RobotConfig, period: float) -> FloatArray:
    """The filter's state (STATE_SIZE,) one period (s) later where the base is told to stand: it still brakes."""
    after = np.array(state)
    after[[SPEED, TURN_RATE, REFLEX_BITS, REFLEX_LEFT]] = 0.0
    step = robot.max_acceleration * period
    after[BASE_SPEED] -= min(step, max(-step, after[BASE_SPEED]))
    return after


def filter_command(
    state: FloatArray,
    stamp: float,
    command: FloatArray,
    hazards: Hazards,
    scan: LaserScan,
    watch: ScanWatch,
    odometry: Odometry,
    robot: RobotConfig,
    safety: SafetyConfig,
    period: float,
) -> FloatArray:
    """The filter's state one period (s) later; its first two entries are the velocity for the base.

    state: (STATE_SIZE,). stamp: the time now, s. command: (2,) forward speed (m/s) and turn rate (rad/s). scan: the
    newest, watch: what is believed of it and of those before. odometry: the newest.

    - A command that is not finite is zero.
    - A cliff or a dropped wheel stops the base at once.
    - A bumper starts a reflex of reflex_time: back away, turning away from the side that was hit. It starts again as
      long as the bumper is still pressed when it ends, up to MOST_REFLEXES and MOST_BACKED; then the base does not
      drive ahead until the bumper is released.
    - Speed, turn rate and their rates stay within the robot's limits.
    - Speed, ahead or backwards, leaves room to stop stop_distance before the first scan return in the way
      (free_distance), and before the first place in the way that is not known to be free (open_distance). Without a
      scan younger than scan_timeout, and without one younger than a quarter of a second that is believed, there is
      none. Turning in place stays allowed.
    - While the base is faster than it should be, it brakes. Meanwhile it turns as it is told, unless that would take it
      nearer to a return, or to what was met before, than stop_distance, and nearer than its present arc does: then it
      brakes on that arc.
    """
    if hazards.cliff or hazards.wheel_drop:
        return stopped(state, robot, period)
    left, reflexes = float(state[REFLEX_LEFT]) - period, float(state[REFLEXES])
    bits = int(state[REFLEX_BITS]) | hazards.bumper if left > 0.0 else hazards.bumper
    if bits and not left > 0.0:
        left, reflexes = safety.reflex_time, min(reflexes, MOST_REFLEXES) + 1.0
    backing = math.inf
    if bits and reflexes <= MOST_REFLEXES:
        command, backing = np.array(_reflex(bits, safety)), MOST_BACKED - float(state[BACKED])
    elif bits:
        command, left = np.array([min(command[0], 0.0), command[1]]), 0.0
    trusted = not watch.doubt or stamp - watch.believed.stamp <= _DOUBTED
    space = watch.space
    after: FloatArray = _let_through(
        state,
        command,
        backing,
        scan.angles,
        scan.ranges,
        stamp - scan.stamp,
        trusted,
        space.corner,
        space.seen,
        space.met,
        space.p_OM,
        watch.newest,
        odometry.X_OB,
        odometry.V_B,
        stamp - odometry.stamp,
        robot.radius,
        robot.max_speed,
        robot.max_turn_rate,
        robot.max_acceleration,
        robot.max_turn_acceleration,
        safety.stop_distance,
        safety.side_margin,
        safety.scan_timeout,
        period,
    )
    if bits:
        after[REFLEX_BITS], after[REFLEX_LEFT] = bits, left
    elif after[BASE_SPEED] > 0.0:
        reflexes, after[BACKED] = 0.0, 0.0
    after[REFLEXES] = reflexes
    return after


@njit(cache=True)
def _let_through(
    state: FloatArray,
    command: FloatArray,
    backing: float,
    angles: FloatArray,
    ranges: FloatArray,
    age: float,
    trusted: bool,
    corner: IntArray,
    seen: FloatArray,
    met: BoolArray,
    p_OM: FloatArray,
    newest: float,
    X_OB: FloatArray,
    V_B: FloatArray,
    since: float,
    radius: float,
    max_speed: float,
    max_turn_rate: float,
    acceleration: float,
    turn_acceleration: float,
    stop_distance: float,
    side_margin: float,
    scan_timeout: float,
    period: float,
) -> FloatArray:
    """filter_command where there is no cliff. backing: how far a reflex may back away yet, m, inf: the command is none.
    age: of the scan, s. trusted: it, or one of a moment ago, is believed. corner, seen, met, p_OM, newest: the memory
    of what was seen. X_OB, V_B: odometry, and since: its age, s."""
    reflex = backing < math.inf
    step, turn_step = acceleration * period, turn_acceleration * period
    base_before, turn_before = state[BASE_SPEED], state[TURN_RATE]
    wanted, turn_wanted = command[0], command[1]
    if not (math.isfinite(wanted) and math.isfinite(turn_wanted)):
        wanted, turn_wanted = 0.0, 0.0
    turn_wanted = _bounded(turn_wanted, max_turn_rate)
    # A reflex begins at once.
    speed = wanted if reflex else _towards(state[SPEED], _bounded(wanted, max_speed), step)
    turn_rate = turn_wanted if reflex else _towards(turn_before, turn_wanted, turn_step)
    young = age <= scan_timeout
    # The base has moved on since the scan; its velocity changed little in that time.
    X_SB = advance(np.zeros(3), base_before, turn_before, age) if young else np.zeros(3)
    if speed != 0.0:
        room = 0.0
        if young and trusted:
            # Where it has more room than to stop in, it makes no difference how much.
            fast = abs(speed)
            curvature = turn_rate / fast
            reach = stop_distance + fast * 2.0 * period + 0.5 * fast * fast / acceleration
            ahead = _facing(X_SB, speed)
            clear = free_distance(angles, ranges, ahead, curvature, radius, side_margin, reach + CELL)
            ahead = _facing(advance(X_OB, V_B[0], V_B[1], since), speed)
            known = open_distance_among(corner, seen, met, p_OM, ahead, curvature, radius, reach, newest, speed < 0.0)
            room = min(clear - stop_distance, known - stop_distance, backing)
        speed = _bounded(speed, _speed_allowed(room, acceleration, period))
    base = _towards(base_before, speed, step)
    way = math.copysign(1.0, base_before)
    if young and not reflex and base_before != 0.0 and base * way > max(0.0, min(speed * way, wanted * way)):
        # It brakes.
        limits, near = np.array([acceleration, turn_acceleration]), radius + stop_distance
        velocity, fast = np.array([abs(base_before), turn_before]), abs(base_before)
        now = advance(X_OB, V_B[0], V_B[1], since)
        ahead, reach = _facing(X_SB, base_before), near + fast * period + 0.5 * fast * fast / acceleration
        p_BM = _things_near(angles, ranges, ahead, seen, met, p_OM, newest, _facing(now, base_before), reach)
        nearest = _nearest_while_braking(p_BM, velocity, turn_wanted, limits, near, period)
        if nearest != near and not nearest >= _nearest_while_braking(p_BM, velocity, math.nan, limits, near, period):
            turn_rate = _towards(turn_before, turn_before / base_before * base, turn_step)
    backed = state[BACKED] - speed * period if reflex else state[BACKED]
    return np.array([speed, turn_rate, 0.0, 0.0, base, 0.0, backed])


@njit(cache=True)
def _facing(pose: FloatArray, speed: float) -> FloatArray:
    """The pose (3,) of a base that drives ahead where one at this pose drives at a speed: backwards is turned round."""
    return pose if speed >= 0.0 else np.array([pose[0], pose[1], pose[2] + math.pi])


def held(watch: ScanWatch, X_OB: FloatArray, speed: float, robot: RobotConfig, safety: SafetyConfig) -> str:
    """Why the base at X_OB (3,) may not drive straight on at a speed (m/s) by what was seen: HELD, REMEMBERED or ""."""
    # A base that backs away drives ahead the other way round.
    ahead, near = X_OB + np.array([0.0, 0.0, 0.0 if speed >= 0.0 else math.pi]), safety.stop_distance
    if watch.doubt:
        return ""
    passable = replace(watch.space, seen=np.where(watch.space.met, watch.newest, watch.space.seen))
    for space, why in ((passable, HELD), (watch.space, REMEMBERED)):
        if open_distance(space, ahead, 0.0, robot.radius, near, watch.newest) <= near:
            return why
    return ""


@njit(cache=True)
def _speed_allowed(room: float, acceleration: float, period: float) -> float:
    """The greatest speed (m/s) from which the base can stop within some room (m)."""
    if room == math.inf:
        return math.inf
    # Speed v needs v * delay + v^2 / (2 a): the command takes effect a period later, and the next one too.
    delay = 2.0 * period
    return acceleration * (math.sqrt(delay * delay + 2.0 * max(0.0, room) / acceleration) - delay)

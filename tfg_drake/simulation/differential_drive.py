"""Motion of a round differential-drive base among walls.

The state is one vector, so that it fits Drake's discrete state; its entries are named by the constants below.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import RobotConfig
from tfg_drake.geometry.distance import nearest_on_segment, point_distance
from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray

# Entries of the state: the time (s) it holds at, the pose X_WB, forward speed and turn rate, rising edges of contact so
# far, whether the base touches a wall, least clearance of the outline from walls so far (m), the bumper's bits, rising
# edges of contact that others made, and whether the base touches somebody (0, or one of the two below).
TIME, X, Y, THETA, SPEED, TURN_RATE, CONTACTS, IN_CONTACT, CLEARANCE, BUMPER, RECEIVED, TOUCHES = range(12)
STATE_SIZE = 12
# Values of TOUCHES: the base is touched, or has itself moved towards the person.
TOUCHED, PRESSED = 1.0, 2.0

# A contact ends at this distance of the outline from the wall, m.
_RELEASE = 0.01
# The bumper covers the front half; its middle third reports "centre".
_BUMPER_HALF_WIDTH = 0.5 * math.pi
_CENTRE_HALF_WIDTH = math.pi / 6.0
# Greatest penetration that is rounding, m.
_ROUNDING = 1e-9

# A base that approaches a person by at most this in a step, m, stands.
_STANDS = 1e-4

# No push: only its wheels move the base.
UNMOVED = np.zeros(4)


def pose_at(state: FloatArray, time: float) -> FloatArray:
    """Pose X_WB, forward speed and turn rate (5,) at a time (s) in the step at whose end the state holds."""
    pose = advance(state[X : THETA + 1], state[SPEED], state[TURN_RATE], time - state[TIME])
    return np.concatenate([pose, state[SPEED : TURN_RATE + 1]])


@njit(cache=True)
def _near(walls: FloatArray, i: int, x: float, y: float, distance: float) -> bool:
    """Whether wall i's bounding box is within distance of (x, y) on both axes."""
    return bool(
        min(walls[i, 0], walls[i, 2]) <= x + distance
        and max(walls[i, 0], walls[i, 2]) >= x - distance
        and min(walls[i, 1], walls[i, 3]) <= y + distance
        and max(walls[i, 1], walls[i, 3]) >= y - distance
    )


@njit(cache=True)
def _deepest(walls: FloatArray, x: float, y: float, reach: float) -> tuple[float, float, float]:
    """The nearest wall point within reach, and its distance; the distance is inf where there is none."""
    least, px, py = np.inf, 0.0, 0.0
    for i in range(walls.shape[0]):
        if _near(walls, i, x, y, reach):
            qx, qy = nearest_on_segment(x, y, walls[i, 0], walls[i, 1], walls[i, 2], walls[i, 3])
            distance = math.hypot(x - qx, y - qy)
            if distance < least:
                least, px, py = distance, qx, qy
    return least, px, py


def clearance(walls: FloatArray, x: float, y: float, radius: float) -> float:
    """Distance (m) from the outline of a disc at (x, y) to the nearest wall; inf without walls, negative inside one."""
    return float(point_distance(np.array([[x, y]]), walls)[0]) - radius


@njit(cache=True)
def _push_out(walls: FloatArray, pose: FloatArray, previous: FloatArray, radius: float) -> bool:
    """Moves the disc out of the walls along their normals, in place; returns whether it had to.

    Where that does not settle (a corner too narrow for the disc) the disc stays at its previous position.
    """
    touched = False
    for _ in range(10):
        distance, px, py = _deepest(walls, pose[0], pose[1], radius)
        if distance >= radius - _ROUNDING:
            return touched
        touched = True
        if distance == 0.0:
            break
        pose[0] = px + (pose[0] - px) * (radius / distance)
        pose[1] = py + (pose[1] - py) * (radius / distance)
    pose[0], pose[1] = previous[0], previous[1]
    return touched


@njit(cache=True)
def _bit_at(bearing: float) -> int:
    """The bumper's bit (1 right, 2 centre, 4 left) pressed at a bearing, rad; 0 behind."""
    if abs(bearing) <= _CENTRE_HALF_WIDTH:
        return 2
    if abs(bearing) <= _BUMPER_HALF_WIDTH:
        return 4 if bearing > 0.0 else 1
    return 0


@njit(cache=True)
def _bumper_bits(walls: FloatArray, pose: FloatArray, reach: float) -> int:
    """The bumper's bits pressed by walls within reach (m) of the centre."""
    bits = 0
    for i in range(walls.shape[0]):
        if _near(walls, i, pose[0], pose[1], reach):
            qx, qy = nearest_on_segment(pose[0], pose[1], walls[i, 0], walls[i, 1], walls[i, 2], walls[i, 3])
            if math.hypot(qx - pose[0], qy - pose[1]) <= reach:
                bearing = math.atan2(qy - pose[1], qx - pose[0]) - pose[2]
                bits |= _bit_at(math.pi - (math.pi - bearing) % (2.0 * math.pi))
    return bits


@njit(cache=True)
def _towards(value: float, target: float, limit: float, change: float) -> float:
    """The value moved towards the target, the target kept within +-limit and the step within +-change."""
    target = min(limit, max(-limit, target))
    return value + min(change, max(-change, target - value))


@njit(cache=True)
def _step(
    state: FloatArray,
    command: FloatArray,
    moved: FloatArray,
    walls: FloatArray,
    period: float,
    radius: float,
    max_speed: float,
    max_turn_rate: float,
    max_acceleration: float,
    max_turn_acceleration: float,
) -> FloatArray:
    after = state.copy()
    after[TIME] = state[TIME] + period
    speed = _towards(state[SPEED], command[0], max_speed, max_acceleration * period)
    turn_rate = _towards(state[TURN_RATE], command[1], max_turn_rate, max_turn_acceleration * period)
    previous = state[X : THETA + 1]
    pose = advance(previous, speed, turn_rate, period)
    cosine, sine = math.cos(previous[2]), math.sin(previous[2])
    pose[0] += cosine * moved[0] - sine * moved[1]
    pose[1] += sine * moved[0] + cosine * moved[1]
    if moved[2] != 0.0:
        pose[2] = math.pi - (math.pi - pose[2] - moved[2]) % (2.0 * math.pi)
    blocked = _push_out(walls, pose, previous, radius)
    if blocked:
        # The remaining speed is the progress that the walls allowed along the heading.
        heading = previous[2] + 0.5 * turn_rate * period
        progress = (pose[0] - previous[0]) * math.cos(heading) + (pose[1] - previous[1]) * math.sin(heading)
        allowed = progress / period
        speed = min(max(allowed, 0.0), speed) if speed >= 0.0 else max(min(allowed, 0.0), speed)
    after[X : THETA + 1] = pose
    after[SPEED], after[TURN_RATE] = speed, turn_rate

    # Walls farther than the least clearance so far cannot change anything below.
    reach = radius + max(_RELEASE, state[CLEARANCE])
    gap = _deepest(walls, pose[0], pose[1], reach)[0] - radius
    after[CLEARANCE] = min(state[CLEARANCE], max(0.0, gap) if blocked else gap)
    if blocked and state[IN_CONTACT] == 0.0:
        after[RECEIVED if moved.any() else CONTACTS] += 1.0
    after[IN_CONTACT] = 1.0 if blocked or (state[IN_CONTACT] > 0.0 and gap <= _RELEASE) else 0.0
    after[BUMPER] = float(_bumper_bits(walls, pose, radius + _RELEASE)) if after[IN_CONTACT] > 0.0 else 0.0
    return after


def step(
    state: FloatArray,
    command: FloatArray,
    walls: FloatArray,
    robot: RobotConfig,
    period: float,
    moved: FloatArray = UNMOVED,
) -> FloatArray:
    """The base's state one period (s) later.

    state: (STATE_SIZE,), see the constants above. command: (2,) forward speed (m/s) and turn rate (rad/s), followed
    within the robot's limits on both and on their rates. walls: (m, 4) in W, m. moved: how far something else moves the
    base meanwhile, see tfg_drake.simulation.disturbance.displacement.

    The disc does not pass a wall: it is pushed back along the wall's normal, so it slides, and keeps the part of its
    speed that the wall leaves it. A contact is counted when it begins and lasts until the outline is 1 cm clear: in
    RECEIVED where something else moves the base as it begins, in CONTACTS otherwise.
    """
    after: FloatArray = _step(
        state,
        command,
        moved,
        walls,
        period,
        robot.radius,
        robot.max_speed,
        robot.max_turn_rate,
        robot.max_acceleration,
        robot.max_turn_acceleration,
    )
    return after


def among(before: FloatArray, after: FloatArray, discs: FloatArray, robot: RobotConfig) -> FloatArray:
    """The state (STATE_SIZE,) after a step with discs (d, 3) in the way, centre and radius in m at its end.

    before, after: the states before and after the step among walls alone. The base cannot push a disc, and a disc does
    not push it: where the step would take it into one, or farther in, it stays where it was. A contact in which it was
    the base that moved is counted in CONTACTS, any other in RECEIVED; it lasts until the outline is 1 cm clear.
    """
    offset = discs[:, :2] - after[X : Y + 1]
    gap = np.hypot(*offset.T) - discs[:, 2] - robot.radius
    if gap.min(initial=np.inf) > _RELEASE:
        if after[TOUCHES] == 0.0:
            return after
        result = after.copy()
        result[TOUCHES] = 0.0
        return result
    result, deep = after.copy(), gap < 0.0
    nearer = np.hypot(*(discs[:, :2] - before[X : Y + 1]).T) - discs[:, 2] - robot.radius - gap
    pressed = bool((deep & (nearer > _STANDS)).any())
    if pressed:
        result[X : Y + 1], result[SPEED] = before[X : Y + 1], 0.0
        offset = discs[:, :2] - result[X : Y + 1]
    if pressed and before[TOUCHES] != PRESSED:
        result[CONTACTS] += 1.0
    elif deep.any() and before[TOUCHES] == 0.0:
        result[RECEIVED] += 1.0
    result[TOUCHES] = PRESSED if pressed else max(before[TOUCHES], TOUCHED * deep.any())
    if result[TOUCHES]:
        bits = int(result[BUMPER])
        for bearing in wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - result[THETA])[gap <= _RELEASE].tolist():
            bits |= _bit_at(bearing)
        result[BUMPER] = float(bits)
    return result


def initial_state(X_WS: FloatArray, walls: FloatArray, robot: RobotConfig) -> FloatArray:
    """The state (STATE_SIZE,) of a base that stands at the pose X_WS (3,) at time 0."""
    state = np.zeros(STATE_SIZE)
    state[X : THETA + 1] = X_WS
    state[CLEARANCE] = clearance(walls, state[X], state[Y], robot.radius)
    return state

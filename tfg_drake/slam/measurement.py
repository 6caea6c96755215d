"""The measurement models, each defined and linearised once: a tag's bearing and range, a wall's direction and distance.

A measurement has two rows of 13: its Jacobian with respect to the robot's pose X_FB (x, y, theta), the sensor's mount
(5) and the landmark (2), its error, expected less measured, and its Jacobian with respect to the robot's twist (2). F
is any frame. The mount consists of shared parameters: yaw (rad), ahead and left (m), clock offset (s), and the range
scale of a camera or the sweep (s/rad) of a scanner.
"""

from __future__ import annotations

import math

from numba import njit

from tfg_drake.messages import FloatArray
from tfg_drake.slam.odometry_model import wrap
from tfg_drake.slam.shared import CAMERA_YAW, SCANNER_YAW

# Where the columns of a row begin.
OF_MOUNT, OF_LANDMARK, ERROR, OF_TWIST, COLUMNS = 3, 8, 10, 11, 13
# The first of a mount's parameters among the shared ones, and their number.
CAMERA, SCANNER, OF_SENSOR = CAMERA_YAW, SCANNER_YAW, 5
# Least range of a tag in a linearisation, m, and in planned views.
LEAST_RANGE, LEAST_RANGE_PLANNED = 1e-3, 0.05


@njit(cache=True)
def sensor_pose(X_FB: FloatArray, mount: FloatArray, twist: FloatArray, earlier: float) -> tuple[float, float, float]:
    """Return X_FS of a sensor `earlier` seconds before the robot was at X_FB (3,), with a twist (2,), m/s and rad/s."""
    c, s, ahead, left = math.cos(X_FB[2]), math.sin(X_FB[2]), mount[1] - earlier * twist[0], mount[2]
    theta = X_FB[2] + mount[0] - earlier * twist[1]
    return X_FB[0] + c * ahead - s * left, X_FB[1] + s * ahead + c * left, theta


@njit(cache=True)
def by_place(dx: float, dy: float, least: float) -> tuple[float, float, float, float, float]:
    """Return the derivatives of a tag's bearing (rad) and range (m) with respect to its place (dx, dy), m, from the
    sensor, each by x and y, and the range, m, at least `least`."""
    r = max(math.sqrt(dx * dx + dy * dy), least)
    return -dy / (r * r), dx / (r * r), dx / r, dy / r, r


@njit(cache=True)
def linearise_tag(
    rows: FloatArray,
    X_FB: FloatArray,
    mount: FloatArray,
    offset: float,
    twist: FloatArray,
    bearing: float,
    range_: float,
    p_FL: FloatArray,
) -> None:
    """Set the rows of a sighting: bearing (rad) and range (m) of a tag at p_FL (2,).

    X_FB is the robot's pose for a camera clock that is `offset` ahead, s.
    """
    earlier, scale = mount[3] - offset, 1.0 + mount[4]
    x, y, theta = sensor_pose(X_FB, mount, twist, earlier)
    dx, dy, c, s = p_FL[0] - x, p_FL[1] - y, math.cos(X_FB[2]), math.sin(X_FB[2])
    b_x, b_y, r_x, r_y, r = by_place(dx, dy, LEAST_RANGE)
    rows[0, OF_LANDMARK], rows[0, OF_LANDMARK + 1] = b_x, b_y
    rows[1, OF_LANDMARK], rows[1, OF_LANDMARK + 1] = scale * r_x, scale * r_y
    for a in range(2):
        u, v = rows[a, OF_LANDMARK], rows[a, OF_LANDMARK + 1]
        rows[a, 0], rows[a, 1], rows[a, 2] = -u, -v, u * (y - X_FB[1]) - v * (x - X_FB[0])
        rows[a, 3], rows[a, 4], rows[a, 5], rows[a, 7] = 0.0, -u * c - v * s, u * s - v * c, 0.0
        rows[a, 6] = -twist[0] * rows[a, 4]
        rows[a, OF_TWIST], rows[a, OF_TWIST + 1] = -earlier * rows[a, 4], 0.0
    rows[0, 2] -= 1.0
    rows[0, 3], rows[1, 7] = -1.0, r
    rows[0, 6] += twist[1]
    rows[0, OF_TWIST + 1] = earlier
    rows[0, ERROR], rows[1, ERROR] = wrap(math.atan2(dy, dx) - theta - bearing), scale * r - range_


@njit(cache=True)
def linearise_wall(
    rows: FloatArray,
    X_FB: FloatArray,
    mount: FloatArray,
    twist: FloatArray,
    look: FloatArray,
    wall: FloatArray,
    p_FC: FloatArray,
) -> None:
    """Set the rows of a look (7,), see `look_of`: the direction (rad) of a wall, and the distance (m) from it of the
    middle of the seen line.

    wall: (2,) the angle of its normal in F, rad, and its distance along that from p_FC (2,), m.
    """
    speed, rate, c, s, sweep = twist[0], twist[1], math.cos(X_FB[2]), math.sin(X_FB[2]), mount[4]
    bearing = math.atan2(look[2], look[1])
    earlier = mount[3] + sweep * bearing
    p_x, p_y, theta = sensor_pose(X_FB, mount, twist, earlier)
    m_x = math.cos(theta) * look[1] - math.sin(theta) * look[2]
    m_y = math.sin(theta) * look[1] + math.cos(theta) * look[2]
    p_x, p_y = p_x - X_FB[0] + m_x, p_y - X_FB[1] + m_y
    x, y = X_FB[0] + p_x - p_FC[0], X_FB[1] + p_y - p_FC[1]
    n_x, n_y = math.cos(wall[0]), math.sin(wall[0])
    n_ahead, n_left, by_turn = c * n_x + s * n_y, c * n_y - s * n_x, n_y * m_x - n_x * m_y
    # Derivatives of direction and distance on the sweep, and what these add to the derivatives on the heading.
    swept, swept_off = rate * look[3] + speed * n_ahead * look[5], rate * look[4] + speed * n_ahead * look[6]
    bend, bend_off = sweep * speed * n_left * look[5], sweep * speed * n_left * look[6]
    rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3] = 0.0, 0.0, bend - 1.0, -1.0
    rows[0, 4], rows[0, 5], rows[0, 6], rows[0, 7] = 0.0, 0.0, rate, swept
    rows[0, 8], rows[0, 9] = 1.0 - bend, 0.0
    rows[1, 0], rows[1, 1], rows[1, 2] = n_x, n_y, n_y * p_x - n_x * p_y - bend_off
    rows[1, 3], rows[1, 4], rows[1, 5] = by_turn, n_ahead, n_left
    rows[1, 6] = -speed * n_ahead - rate * by_turn
    rows[1, 7] = bearing * rows[1, 6] - swept_off
    rows[1, 8], rows[1, 9] = n_x * y - n_y * x + bend_off, -1.0
    rows[0, ERROR] = wrap(wall[0] - X_FB[2] - mount[0] + mount[3] * rate + sweep * swept - look[0])
    rows[1, ERROR] = n_x * x + n_y * y - wall[1] - sweep * swept_off
    rows[0, OF_TWIST], rows[0, OF_TWIST + 1] = sweep * n_ahead * look[5], mount[3] + sweep * look[3]
    rows[1, OF_TWIST] = -earlier * n_ahead - sweep * n_ahead * look[6]
    rows[1, OF_TWIST + 1] = -earlier * by_turn - sweep * look[4]


@njit(cache=True)
def look_of(line: FloatArray, look: FloatArray) -> None:
    """Set a look (7,) from a line (11,) of `scan_lines`: direction of its normal, rad, and its middle, m, both in the
    scanner's frame, and the effects of a sweep, as there."""
    c, s = math.cos(line[0]), math.sin(line[0])
    look[0], look[1], look[2] = line[0], c * line[1] - s * line[4], s * line[1] + c * line[4]
    look[3:] = line[7:]


@njit(cache=True)
def whitened_tag(dx: float, dy: float, noise: FloatArray) -> tuple[float, float, float, float]:
    """Return, for planning, the Jacobian (2, 2), row by row, of range and bearing with respect to a landmark at
    (dx, dy), m, from the robot, divided by their deviations.

    noise: (base range noise, range noise per metre, range floor, bearing deviation), for the whole turn.
    """
    b_x, b_y, r_x, r_y, r = by_place(dx, dy, LEAST_RANGE_PLANNED)
    sigma_range = max(noise[0] + noise[1] * r, noise[2])
    return r_x / sigma_range, r_y / sigma_range, b_x / noise[3], b_y / noise[3]

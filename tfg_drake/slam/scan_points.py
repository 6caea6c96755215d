"""Scan points: points of one laser scan with the normals of their surfaces, straight or not, large or small."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray, LaserScan
from tfg_drake.slam.scan_lines import LEAST_SIGMA, NORMAL, RAYS

# Least and greatest number of rays of a normal's window: the fewest that can bend; and 0.3 m of a wall 1.5 m away for a
# scanner of three rays a degree, as in 30 mm of noise a shorter piece has no direction.
FEWEST, MOST = 3, 33
# Greatest length of a window, m: the normal is that of a place, not of a wall.
LENGTH = 1.2
# Assumed curvature of surfaces, 1/m, by which a normal turns between the middle of its window and the ray. A column of
# half a metre radius has 2, the round end of a hall 0.1.
CURVATURE = 1.0
# Greatest standard deviation of a normal, rad, so that surfaces that meet at 30 degrees are distinguished.
WORST = 0.2
# A window is straight if the rays' squared errors and their bend are within this many deviations of chance.
STRAIGHT = 2.0
# Least cosine of the incidence of a ray with a normal, of 82.5 degrees: more obliquely, 8 m away, the rays of a scanner
# of one ray a degree are a metre apart, and what is between them is unknown.
SLANT = math.cos(math.radians(82.5))
# Rays are neighbours if at most two rays between them met nothing.
BESIDE = 3
# An edge is EDGE, m, in front of what is seen beside it, more than noise or the depth of a door frame. It lies between
# its ray and the next, which meet its surface within APART, m, of each other, so that its deviation is at most what the
# weight `surfaces.EDGE` stands for.
EDGE, APART = 0.2, 0.14


def scan_points(scan: LaserScan) -> FloatArray:
    """Return points with normals (p, 4) of the surfaces in a scan: x, y (m), n_x, n_y, in the scanner's frame.

    They are in the order of their rays. Normals have unit length and point towards the scanner. The normal of an edge
    is (0, 0): a ray without a normal that is EDGE or more in front of its neighbours, such as on legs and corners. All
    other rays are dropped, above all those of walls seen obliquely, whose points slide along the wall.
    """
    return np.asarray(_points(scan.angles, scan.ranges, scan.range_max, max(scan.sigma, LEAST_SIGMA)))


@njit(cache=True)
def _points(angles: FloatArray, ranges: FloatArray, range_max: float, sigma: float) -> FloatArray:
    measured = (ranges > 0.0) & (ranges < range_max - 3.0 * sigma)
    met = np.flatnonzero(measured)
    n, m = len(met), len(angles)
    if n < FEWEST:
        return np.empty((0, 4))
    # A scanner may be noisier than its data sheet. Most rays and their neighbours lie on planes.
    mid = np.flatnonzero(measured[:-2] & measured[1:-1] & measured[2:]) + 1
    if len(mid) > RAYS:
        left, right, half = ranges[mid - 1], ranges[mid + 1], 0.5 * (angles[mid + 1] - angles[mid - 1])
        off = np.median(np.abs(ranges[mid] - 2.0 * np.cos(half) * left * right / (left + right)))
        sigma = max(sigma, off / (NORMAL * math.sqrt(1.5)))
    # For a scanner with a full field of view the first rays are repeated after the last.
    swept = angles[-1] - angles[0]
    around = (2.0 * math.pi - swept) * (m - 1) < 2.0 * swept
    again = np.arange(n + min(n, MOST) - 1 if around else n)
    rays, bearings = met[again % n] + again // n * m, angles[met][again % n] + again // n * (2.0 * math.pi)
    r = ranges[met][again % n]
    x, y = r * np.cos(bearings), r * np.sin(bearings)
    normals = _normals(x, y, r, bearings, rays, n, sigma)
    points, p = np.empty((n, 4)), 0
    for k in range(n):
        flat = normals[k, 0] != 0.0 or normals[k, 1] != 0.0
        if flat or ((around or 0 < k < n - 1) and _is_edge(k, r, bearings, rays, n, m)):
            points[p] = x[k], y[k], normals[k, 0], normals[k, 1]
            p += 1
    return points[:p].copy()


@njit(cache=True)
def _normals(
    x: FloatArray, y: FloatArray, r: FloatArray, bearings: FloatArray, rays: IntArray, n: int, sigma: float
) -> FloatArray:
    """Return normals (n, 2) of the first n rays, (0, 0) if there is none: of several estimates that of least variance.

    Each window of neighbouring rays that look straight gives an estimate, the direction of least variation. Its
    variance is that of the window's line plus the turn of a curve between the ray and the window's middle.
    """
    normals, variance = np.zeros((n, 2)), np.full(n, WORST**2)
    for i in range(n):
        s_x, s_y, s_xx, s_xy, s_yy, t_x, t_y, tt_x, tt_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(i + 1, min(len(x), i + min(n, MOST))):
            step = min(r[j], r[j - 1]) * (bearings[j] - bearings[j - 1])
            if rays[j] - rays[j - 1] > BESIDE or abs(r[j] - r[j - 1]) > step / SLANT + 4.0 * sigma:
                break
            # Relative to the window's first ray, m; t: number of the ray in the window.
            dx, dy, t = x[j] - x[i], y[j] - y[i], float(j - i)
            s_x, s_y, s_xx, s_xy, s_yy = s_x + dx, s_y + dy, s_xx + dx * dx, s_xy + dx * dy, s_yy + dy * dy
            t_x, t_y, tt_x, tt_y = t_x + t * dx, t_y + t * dy, tt_x + t * t * dx, tt_y + t * t * dy
            # 3, 5, 7, 9, 17, 25 and 33 rays.
            m = j - i + 1
            if m < FEWEST or m % (2 if m < 9 else 8) != 1 or math.hypot(dx, dy) > LENGTH:
                continue
            m_x, m_y = s_x / m, s_y / m
            C_xx, C_xy, C_yy = s_xx - s_x * m_x, s_xy - s_x * m_y, s_yy - s_y * m_y
            half = 0.5 * math.hypot(C_xx - C_yy, 2.0 * C_xy)
            along, off = 0.5 * (C_xx + C_yy) + half, max(0.5 * (C_xx + C_yy) - half, 0.0)
            if off > sigma * sigma * (m - 2 + STRAIGHT * math.sqrt(2.0 * (m - 2))):
                continue
            of_line = (sigma * sigma + off / (m - 2)) / along if along > 0.0 else np.inf
            if of_line >= WORST**2:
                continue
            n_x, n_y = (-C_xy, along - C_yy) if C_xx > C_yy else (C_xx - along, C_xy)
            length = math.hypot(n_x, n_y)
            n_x, n_y = n_x / length, n_y / length
            # The rays' offsets along the normal, projected on the parabola in t that is orthogonal to all lines.
            mid, mean = 0.5 * (m - 1), (m * m - 1) / 12.0
            bend = n_x * (tt_x - 2.0 * mid * t_x + (mid * mid - mean) * s_x)
            bend += n_y * (tt_y - 2.0 * mid * t_y + (mid * mid - mean) * s_y)
            if bend * bend > (STRAIGHT * sigma) ** 2 * m * (m * m - 1) * (m * m - 4) / 180.0:
                continue
            for k in range(i, j + 1):
                dx, dy, ray = x[k] - x[i] - m_x, y[k] - y[i] - m_y, k % n
                turned = of_line + (CURVATURE * (n_x * dy - n_y * dx)) ** 2
                if turned < variance[ray] and abs(n_x * dx + n_y * dy) < STRAIGHT * sigma:
                    variance[ray], normals[ray, 0], normals[ray, 1] = turned, n_x, n_y
    for k in range(n):
        cosine = (normals[k, 0] * x[k] + normals[k, 1] * y[k]) / r[k]
        normals[k] *= 0.0 if abs(cosine) < SLANT else -math.copysign(1.0, cosine)
    return normals


@njit(cache=True)
def _is_edge(k: int, r: FloatArray, bearings: FloatArray, rays: IntArray, n: int, m: int) -> bool:
    """Return whether the k-th of n rays is EDGE in front of a neighbour, and of its own surface extended to that ray.

    The surface is extended straight from the ray on the other side: a wall seen obliquely meets the next ray, however
    far.
    """
    for side in (1, -1):
        far, other = (k + side) % n, (k - side) % n
        if (side * (rays[far] - rays[k])) % m > BESIDE or (side * (rays[k] - rays[other])) % m > BESIDE:
            continue
        ahead, behind = side * (bearings[far] - bearings[k]), side * (bearings[k] - bearings[other])
        # Behind an object that only one ray hits the next ray is on another surface.
        slant = r[k] - r[other] if r[other] < r[k] + EDGE else 0.0
        if math.hypot(slant, r[k] * behind) > APART:
            continue
        # The inverse of where the line meets the ray ahead, times the sine of the angle behind.
        inverse = math.sin(ahead + behind) / r[k] - math.sin(ahead) / r[other]
        before = r[far] - EDGE
        if r[k] <= before and inverse * before > math.sin(behind):
            return True
    return False

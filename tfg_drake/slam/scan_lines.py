"""Scan lines: the straight pieces of wall in one laser scan, each with its covariance."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray, LaserScan
from tfg_drake.slam.odometry_model import wrap

# Least length of a line, m, and number of its rays.
LENGTH, RAYS = 0.5, 8
# Rays whose incidence on the line has a smaller cosine than this, of 75 degrees, are left out.
SLANT = math.cos(math.radians(75.0))
# Neighbouring rays are on one surface if their ranges differ by at most what they would on a plane seen at SLANT, plus
# STEP, m, and four deviations.
STEP = 0.01
# A stretch is split at the ray farthest from its chord if that is more than this many deviations off.
SPLIT = 4.0
# Rays left out at either end, as they may be on the next surface.
TRIM = 1
# A stretch is straight if the rays' squared errors and their bend are within this many deviations of chance.
STRAIGHT = 3.5
# A line is a chord of a curve if a parabola fits it and the surface up to FARTHER times its length beyond either end,
# and bends by more than BENDS deviations and by more than BEND, rad, along the line.
FARTHER, BENDS, BEND = 1.0, 4.0, 0.03
# The median of the absolute value of a standard normal variable.
NORMAL = 0.6745
# Least standard deviation of a range, m: no wall is straighter.
LEAST_SIGMA = 0.002
# The length, m, over which an uneven wall is off its plane to one side.
STRETCH = 0.5
# Unevenness of walls: half a STRETCH has MOST_RAYS rays at most; a scan with fewer than LEAST_RAYS rays on lines is
# ignored. Each scan changes the variance by the share SLOWLY of its value, taken as at least LEAST_UNEVEN^2, m^2. The
# unevenness is at most MOST_UNEVEN, m, that of walls in inhabited buildings: what is more uneven is no wall.
MOST_RAYS, LEAST_RAYS, SLOWLY, LEAST_UNEVEN, MOST_UNEVEN = 24, 30, 0.05, 0.004, 0.03
# A ray within this distance of a line, m, is on it.
ON_LINE = 0.1


def scan_lines(scan: LaserScan) -> FloatArray:
    """Return the straight pieces (n, 11) in a scan, at least LENGTH long and of RAYS rays, in the scanner's frame.

    The columns: angle (rad) of the normal, which points away from the scanner, so that n . p = offset > 0; offset (m);
    start and end of the seen piece, and its middle, m along the line from the foot of the perpendicular in the
    direction of the normal turned left by 90 degrees; the errors of angle and of distance normal to the line are
    uncorrelated at the middle; standard deviations of the angle (rad) and of that distance (m) by the noise of the rays
    alone; the derivatives of angle and middle distance on the sweep of a turning scanner, which enlarges bearings by a
    share of themselves, beyond the effect of the bearing of the middle; and their derivatives on the motion of a
    scanner along the normal, which lengthens ranges by a length per radian of bearing. Chords of curves are excluded,
    as a curve has other chords from elsewhere.
    """
    # A scanner may be noisier than its data sheet. Most rays lie on planes, where second differences of ranges are
    # noise.
    sigma = max(scan.sigma, _bend(scan.ranges) / (NORMAL * math.sqrt(6.0)), LEAST_SIGMA)
    return np.asarray(_lines(scan.angles, scan.ranges, scan.range_max, sigma))


def on_uneven(lines: FloatArray, unevenness: float) -> FloatArray:
    """Return lines (n, 11) of `scan_lines` with deviations enlarged for uneven walls.

    unevenness: m, see `unevenness_after`, the independent deviation of neighbouring half metres from a plane: single
    looks, each at other stretches of a wall, agree no better.
    """
    lines = lines.copy()
    # The mean, and the slope, of n such stretches.
    length = lines[:, 3] - lines[:, 2]
    off = unevenness / np.sqrt(np.maximum(length / STRETCH, 1.0))
    lines[:, 5] = np.hypot(lines[:, 5], math.sqrt(12.0) * off / length)
    lines[:, 6] = np.hypot(lines[:, 6], off)
    return lines


def unevenness_after(scan: LaserScan, lines: FloatArray, unevenness: float) -> float:
    """Update the unevenness, m, with one scan and its lines (n, 11): the deviation from a plane over STRETCH of walls
    and of errors that neighbouring rays share, as the median of all scans so far.

    It is the excess of the deviation of a stretch's middle from its ends over that of a ray from its two neighbours. An
    excess below half the variance of the latter is noise.
    """
    with np.errstate(invalid="ignore"):
        x, y = scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)
        of = np.zeros(len(x), dtype=np.int64)
        for k, (angle, offset, begin, end) in enumerate(lines[:, :4].tolist(), 1):
            c, s = math.cos(angle), math.sin(angle)
            along = c * y - s * x
            of[(np.abs(c * x + s * y - offset) < ON_LINE) & (along > begin) & (along < end)] = k
    near, far = _off_planes(scan.angles, scan.ranges, of)
    if not math.isfinite(far):
        return unevenness
    step = SLOWLY * max(unevenness**2, LEAST_UNEVEN**2)
    changed = unevenness**2 + math.copysign(step, far - 1.5 * near - unevenness**2)
    return min(math.sqrt(max(changed, 0.0)), MOST_UNEVEN)


@njit(cache=True)
def _off_planes(angles: FloatArray, ranges: FloatArray, of: IntArray) -> tuple[float, float]:
    """Return the variance of a ray, m^2, from its neighbours, and from the ends of a STRETCH around it, all on one
    line; of: (m,) the line of each ray, 0 for none. nan if there are few. Rays in between may lack a return."""
    ray = np.flatnonzero(of[1:-1]) + 1
    half = np.round(0.5 * STRETCH / (ranges[ray] * (angles[ray + 1] - angles[ray])))
    half = np.maximum(2, np.minimum(half, MOST_RAYS)).astype(np.int64)
    inside = (ray >= half) & (ray + half < len(ranges))
    ray, half = ray[inside], half[inside]
    line = of[ray]
    same = (of[ray - half] == line) & (of[ray - 1] == line) & (of[ray + 1] == line) & (of[ray + half] == line)
    ray, half = ray[same], half[same]
    if len(ray) < LEAST_RAYS:
        return np.nan, np.nan
    off = np.empty(2)
    for i, m in enumerate((np.ones_like(half), half)):
        left, right, turn = ranges[ray - m], ranges[ray + m], 0.5 * (angles[ray + m] - angles[ray - m])
        off[i] = np.median(np.abs(ranges[ray] - 2.0 * np.cos(turn) * left * right / (left + right))) / NORMAL
    # A ray, and half of each of two others.
    return off[0] * off[0] / 1.5, off[1] * off[1] / 1.5


def surface_seen(scan: LaserScan) -> float:
    """Return the length, m, of connected surfaces in a scan, straight or not, of at least LENGTH each."""
    rays = np.flatnonzero((scan.ranges > 0.0) & (scan.ranges < scan.range_max - 3.0 * scan.sigma))
    r, angle = scan.ranges[rays], scan.angles[rays]
    most = np.minimum(r[1:], r[:-1]) * np.diff(angle) / SLANT + 4.0 * scan.sigma + STEP
    apart = np.flatnonzero((np.diff(rays) > 3) | (np.abs(np.diff(r)) > most)) + 1
    points, total = np.column_stack([r * np.cos(angle), r * np.sin(angle)]), 0.0
    for stretch in np.split(points, apart):
        # The length by every fourth ray, as noise lengthens that by every ray.
        length = float(np.hypot(*np.diff(stretch[::4], axis=0).T).sum())
        total += length if len(stretch) >= RAYS and length >= LENGTH else 0.0
    return total


@njit(cache=True)
def bearing_of(line: FloatArray) -> float:
    """Return the bearing (rad) of a line's middle, in (-pi, pi] like those of rays; it determines the time of a
    sweep."""
    c, s = math.cos(line[0]), math.sin(line[0])
    return math.atan2(s * line[1] + c * line[4], c * line[1] - s * line[4])


@njit(cache=True)
def _bend(ranges: FloatArray) -> float:
    """Return the median, m, of the second differences of ranges from ray to ray, 0 for few rays."""
    r = ranges[np.isfinite(ranges)]
    return float(np.median(np.abs((r[2:] - r[1:-1]) - (r[1:-1] - r[:-2])))) if len(r) > RAYS else 0.0


@njit(cache=True)
def _lines(angles: FloatArray, ranges: FloatArray, range_max: float, sigma: float) -> FloatArray:
    rays = np.flatnonzero((ranges > 0.0) & (ranges < range_max - 3.0 * sigma))
    x, y, r = ranges[rays] * np.cos(angles[rays]), ranges[rays] * np.sin(angles[rays]), ranges[rays]
    found, n = np.empty((len(rays) // RAYS + 1, 11)), 0
    # A stack of stretches to be split or fitted, the first on top: their rays, and those of their whole surface.
    begin = len(rays)
    stack = np.empty((len(rays) + 1, 4), dtype=np.int64)
    top, end = 0, len(rays)
    for i in range(len(rays) - 1, -1, -1):
        if i == 0 or _apart(i - 1, i, rays, angles, r, sigma):
            stack[top] = np.array([i, end, i, end])
            top, end = top + 1, i
    while top:
        top -= 1
        begin, end, first, beyond = stack[top]
        if end - begin < RAYS:
            continue
        if _fitted(x[begin:end], y[begin:end], r[begin:end], sigma, found[n]):
            line = found[n]
            along = -math.sin(line[0]) * x + math.cos(line[0]) * y
            farther = FARTHER * (line[3] - line[2])
            left, right = end, begin
            while left < beyond and along[left] < line[3] + farther:
                left += 1
            while right > first and along[right - 1] > line[2] - farther:
                right -= 1
            chord = False
            for i, j in ((right, left), (begin, left), (right, end)):
                chord = chord or _is_chord(x[i:j], y[i:j], r[i:j], sigma, line)
            n += not chord
            continue
        dx, dy = x[end - 1] - x[begin], y[end - 1] - y[begin]
        length, u, v = math.hypot(dx, dy), x[begin + 1 : end - 1], y[begin + 1 : end - 1]
        off = np.abs(dx * (v - y[begin]) - dy * (u - x[begin])) / max(length, 1e-9)
        cosine = np.maximum(np.abs(u * dy - v * dx) / np.maximum(length * r[begin + 1 : end - 1], 1e-9), 0.25)
        off /= sigma * cosine
        at = begin + 1 + np.argmax(off)
        if off.max() > SPLIT:
            stack[top] = np.array([at, end, first, beyond])
            stack[top + 1] = np.array([begin, at + 1, first, beyond])
            top += 2
    return found[:n].copy()


@njit(cache=True)
def _apart(i: int, j: int, rays: IntArray, angles: FloatArray, r: FloatArray, sigma: float) -> bool:
    """Return whether ray j, which follows ray i, is on another surface."""
    if rays[j] - rays[i] > 3:
        return True
    step = angles[rays[j]] - angles[rays[i]]
    return bool(abs(r[j] - r[i]) > min(r[i], r[j]) * step / SLANT + 4.0 * sigma + STEP)


@njit(cache=True)
def _fitted(x: FloatArray, y: FloatArray, r: FloatArray, sigma: float, line: FloatArray) -> bool:
    """Set the maximum likelihood line (11,) through rays without TRIM at either end; returns whether they are a
    line."""
    x, y, r = x[TRIM : len(x) - TRIM], y[TRIM : len(y) - TRIM], r[TRIM : len(r) - TRIM]
    m = len(x)
    if m < RAYS - 2 * TRIM:
        return False
    m_x, m_y = x.mean(), y.mean()
    u, v = x - m_x, y - m_y
    angle = 0.5 * math.atan2(2.0 * (u * v).sum(), (u**2 - v**2).sum()) + 0.5 * math.pi
    offset = math.cos(angle) * m_x + math.sin(angle) * m_y
    for _ in range(4):
        c, s = math.cos(angle), math.sin(angle)
        if offset < 0.0:
            c, s, offset, angle = -c, -s, -offset, angle + math.pi
        normal = (c * x + s * y) / r
        met = normal >= SLANT
        normal, along = normal[met], ((-s * x + c * y) / r)[met]
        # The range by the line, and its derivatives.
        error = (offset / normal - r[met]) / sigma
        by_offset, by_angle = 1.0 / normal / sigma, -offset * along / (normal * normal) / sigma
        H00, H01, H11 = (by_angle * by_angle).sum(), (by_angle * by_offset).sum(), (by_offset * by_offset).sum()
        g0, g1 = (by_angle * error).sum(), (by_offset * error).sum()
        det = H00 * H11 - H01 * H01
        if not det > 1e-9 * H00 * H11:
            return False
        angle -= (H11 * g0 - H01 * g1) / det
        offset -= (H00 * g1 - H01 * g0) / det
    c, s = math.cos(angle), math.sin(angle)
    if offset <= 0.0:
        return False
    normal = (c * x + s * y) / r
    met = normal >= SLANT
    x, y, r, normal = x[met], y[met], r[met], normal[met]
    if len(x) < RAYS - 2 * TRIM:
        return False
    along, off = -s * x + c * y, offset / normal - r
    begin, end, freedoms = along.min(), along.max(), len(x) - 2
    if end - begin < LENGTH:
        return False
    error, part = off / sigma, (along - 0.5 * (begin + end)) / (0.5 * (end - begin))
    u = (3.0 * (part * part) - 1.0) * 0.5
    squares, bend, u2 = (error * error).sum(), (u * off / sigma).sum(), (u * u).sum()
    if squares > freedoms + STRAIGHT * math.sqrt(2.0 * freedoms) or abs(bend) > STRAIGHT * math.sqrt(u2):
        return False
    # The distance at t along the line changes by -t dangle; at the middle its error is uncorrelated with the angle's.
    V00, V01, V11 = H11 / det, -H01 / det, H00 / det
    middle = V01 / V00
    line[0], line[1], line[2], line[3], line[4] = math.atan2(s, c), offset, begin, end, middle
    line[5] = math.sqrt(V00)
    line[6] = math.sqrt(max(V11 - V01 * V01 / V00, 1e-12))
    of_middle, scale = bearing_of(line), normal * sigma
    bearing = np.array([of_middle + wrap(math.atan2(y[i], x[i]) - of_middle) for i in range(len(x))])
    on_angle, on_offset = -offset * along / (r * normal) / scale, 1.0 / scale
    for k, swept, expected in ((7, -bearing * along / scale, -middle * of_middle), (9, bearing / scale, of_middle)):
        by_angle, by_offset = (swept * on_angle).sum(), (swept * on_offset).sum()
        line[k] = V00 * by_angle + V01 * by_offset
        line[k + 1] = V01 * by_angle + V11 * by_offset - middle * line[k] - expected
    return True


@njit(cache=True)
def _is_chord(x: FloatArray, y: FloatArray, r: FloatArray, sigma: float, line: FloatArray) -> bool:
    """Return whether a line (11,) is a chord of a curve: a parabola fitted to these rays bends."""
    c, s, length = math.cos(line[0]), math.sin(line[0]), line[3] - line[2]
    x, y, r = x[TRIM : len(x) - TRIM], y[TRIM : len(y) - TRIM], r[TRIM : len(r) - TRIM]
    normal, t = (c * x + s * y) / r, (-s * x + c * y - 0.5 * (line[2] + line[3])) / length
    met = normal >= SLANT
    t, scale, off = t[met], normal[met] * sigma, (c * x + s * y - line[1])[met]
    off /= scale
    rows, H, g = (np.ones_like(t) / scale, t / scale, t * t / scale), np.empty((3, 3)), np.empty(3)
    for a in range(3):
        g[a] = (rows[a] * off).sum()
        for b in range(3):
            H[a, b] = (rows[a] * rows[b]).sum()
    inverse = np.linalg.inv(H + 1e-9 * np.eye(3))
    by = inverse @ g
    squares, freedoms = (off * off).sum() - by @ g, len(t) - 3
    if freedoms < 1 or squares > freedoms + STRAIGHT * math.sqrt(2.0 * freedoms):
        return False
    bend = abs(by[2])
    return bool(bend > BENDS * math.sqrt(inverse[2, 2]) and 2.0 * bend / length > BEND)

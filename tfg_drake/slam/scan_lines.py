"""The straight pieces of wall that one laser scan sees, each as a line with its covariance."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray, LaserScan
from tfg_drake.slam.odometry_model import wrap

# Least length of a line, m, and number of its rays.
LENGTH, RAYS = 0.5, 8
# Rays that meet the line more slantwise than this are left out (cosine of 75 degrees).
SLANT = math.cos(math.radians(75.0))
# Neighbouring rays are on one surface where their ranges differ by no more than those of a plane seen at SLANT, and by
# this, m, and four deviations beside.
STEP = 0.01
# A stretch is cut at the ray farthest from its chord where that is more than so many deviations off.
SPLIT = 4.0
# Rays left out at either end: they may be on the next surface.
TRIM = 1
# Squared errors of the rays and their bend, in deviations, beyond which a stretch is not straight by chance.
STRAIGHT = 3.5
# A line is a chord of a curve where the stretch that it is of, so much of its length farther, is smooth but bends by so
# many deviations, and by more than this, rad, along the line.
FARTHER, BENDS, BEND = 1.0, 4.0, 0.03
# Median of what is normal, in deviations.
NORMAL = 0.6745
# Least standard deviation of a range, m: no wall is straighter.
LEAST_SIGMA = 0.002
# Over this length, m, an uneven wall is off its plane one way.
STRETCH = 0.5
# Rays of half a stretch, at most, and rays that tell it, at least. Its variance changes by such a share of itself a
# scan, or of that of so much, m; it is no greater than that of walls in buildings that are lived in, m: what is more is
# no wall.
MOST_RAYS, LEAST_RAYS, SLOWLY, LEAST_UNEVEN, MOST_UNEVEN = 24, 30, 0.05, 0.004, 0.03
# A ray is on a line within this, m.
ON_LINE = 0.1


def scan_lines(scan: LaserScan, unevenness: float = 0.0) -> FloatArray:
    """The straight pieces (n, 11) that the scan sees, at least LENGTH long and of RAYS rays, in the scanner's frame.

    Angle (rad) of the normal, which points away from the scanner, so that n . p = offset > 0; offset (m); where along
    the line, m from the foot of the perpendicular along the normal turned left by 90 degrees, the seen piece begins and
    ends, and its middle, where the errors of angle and of distance normal to the line are uncorrelated; standard
    deviations of the angle (rad) and of that distance (m), by the noise of the rays alone. And what a scanner that
    sweeps while it turns, so that bearings are larger by a share of themselves, makes of the angle and of the distance
    in the middle beside what its bearing does, over that share; and what one that moves along the normal, so that
    ranges are longer by a length a radian of bearing, makes of both, over that length. Chords of curves are none: what
    is seen of a curve from elsewhere looks another way.

    unevenness: m, as of `unevenness_after`, by which neighbouring half metres are off a plane independently: single
    looks, each at other stretches of one, agree no better.
    """
    # A scanner may be noisier than its data sheet: most rays lie on planes, where ranges hardly bend.
    sigma = max(scan.sigma, _bend(scan.ranges) / (NORMAL * math.sqrt(6.0)), LEAST_SIGMA)
    return on_uneven(np.asarray(_lines(scan.angles, scan.ranges, scan.range_max, sigma)), unevenness)


def on_uneven(lines: FloatArray, unevenness: float) -> FloatArray:
    """Lines (n, 11) whose deviations are by the noise of the rays alone, with those of walls that are so uneven, m,
    see `scan_lines`."""
    if not unevenness:
        return lines
    lines = lines.copy()
    # The mean, and the slope, of n such stretches.
    length = lines[:, 3] - lines[:, 2]
    off = unevenness / np.sqrt(np.maximum(length / STRETCH, 1.0))
    lines[:, 5] = np.hypot(lines[:, 5], math.sqrt(12.0) * off / length)
    lines[:, 6] = np.hypot(lines[:, 6], off)
    return lines


def unevenness_after(scan: LaserScan, lines: FloatArray, unevenness: float) -> float:
    """How far, m, walls and the errors that rays beside each other have in common are off a plane over STRETCH, the
    median of all scans so far, from what it was before this one, in which there are these lines (n, 11).

    The middle of a stretch is off what its ends say by more than a ray is off the two beside it. What is less than half
    of the variance of these is noise.
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
    """Variance of a ray, m^2, by those beside it and by those at the ends of a STRETCH round it, all of one line, of
    (m,) which, 0 for none; nan where these are few. What is between them may have met nothing."""
    n, count = len(ranges), 0
    off = np.empty((n, 2))
    for i in range(1, n - 1):
        if of[i] == 0:
            continue
        half = round(0.5 * STRETCH / (ranges[i] * (angles[i + 1] - angles[i])))
        half = max(2, min(half, MOST_RAYS))
        first, last = i - half, i + half
        if first < 0 or last >= n or np.any(of[np.array([first, i - 1, i + 1, last])] != of[i]):
            continue
        for column, m in enumerate((1, half)):
            left, right, turn = ranges[i - m], ranges[i + m], 0.5 * (angles[i + m] - angles[i - m])
            off[count, column] = abs(ranges[i] - 2.0 * math.cos(turn) * left * right / (left + right))
        count += 1
    if count < LEAST_RAYS:
        return np.nan, np.nan
    # A ray, and half of each of two others.
    near, far = np.median(off[:count, 0]) / NORMAL, np.median(off[:count, 1]) / NORMAL
    return near * near / 1.5, far * far / 1.5


def surface_seen(scan: LaserScan) -> float:
    """Length, m, of the surfaces that a scan sees, straight or not, as far as LENGTH of it or more hangs together."""
    rays = np.flatnonzero((scan.ranges > 0.0) & (scan.ranges < scan.range_max - 3.0 * scan.sigma))
    if len(rays) < RAYS:
        return 0.0
    r, angle = scan.ranges[rays], scan.angles[rays]
    most = np.minimum(r[1:], r[:-1]) * np.diff(angle) / SLANT + 4.0 * scan.sigma + STEP
    apart = np.flatnonzero((np.diff(rays) > 3) | (np.abs(np.diff(r)) > most)) + 1
    points, total = np.column_stack([r * np.cos(angle), r * np.sin(angle)]), 0.0
    for stretch in np.split(points, apart):
        # By every fourth ray: noise makes longer ways of it.
        length = float(np.hypot(*np.diff(stretch[::4], axis=0).T).sum())
        total += length if len(stretch) >= RAYS and length >= LENGTH else 0.0
    return total


@njit(cache=True)
def bearing_of(line: FloatArray) -> float:
    """The bearing (rad) of a line's middle, in (-pi, pi] as those of rays: a scanner that sweeps was there then."""
    c, s = math.cos(line[0]), math.sin(line[0])
    return math.atan2(s * line[1] + c * line[4], c * line[1] - s * line[4])


@njit(cache=True)
def _bend(ranges: FloatArray) -> float:
    """Median, m, of the second differences of ranges from ray to ray, 0 where there are few."""
    r = ranges[np.isfinite(ranges)]
    return float(np.median(np.abs((r[2:] - r[1:-1]) - (r[1:-1] - r[:-2])))) if len(r) > RAYS else 0.0


@njit(cache=True)
def _lines(angles: FloatArray, ranges: FloatArray, range_max: float, sigma: float) -> FloatArray:
    rays = np.flatnonzero((ranges > 0.0) & (ranges < range_max - 3.0 * sigma))
    x, y, r = ranges[rays] * np.cos(angles[rays]), ranges[rays] * np.sin(angles[rays]), ranges[rays]
    found, n = np.empty((len(rays) // RAYS + 1, 11)), 0
    # Stretches that are still to be looked at, the first on top.
    begin = len(rays)
    stack = np.empty((len(rays) + 1, 4), dtype=np.int64)
    top, end = 0, len(rays)
    for i in range(len(rays) - 1, -1, -1):
        if i == 0 or _apart(i - 1, i, rays, angles, r, sigma):
            # With what of its surface is seen.
            stack[top] = np.array([i, end, i, end])
            top, end = top + 1, i
    while top:
        top -= 1
        begin, end, first, beyond = stack[top]
        if end - begin < RAYS:
            continue
        last = end - 1
        dx, dy = x[last] - x[begin], y[last] - y[begin]
        length = math.hypot(dx, dy)
        worst, at = 0.0, begin
        for i in range(begin + 1, last):
            off = abs(dx * (y[i] - y[begin]) - dy * (x[i] - x[begin])) / max(length, 1e-9)
            cosine = max(abs(x[i] * dy - y[i] * dx) / max(length * r[i], 1e-9), 0.25)
            off /= sigma * cosine
            if off > worst:
                worst, at = off, i
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
        elif worst > SPLIT and last - begin >= 2:
            stack[top] = np.array([at, end, first, beyond])
            stack[top + 1] = np.array([begin, at + 1, first, beyond])
            top += 2
    return found[:n].copy()


@njit(cache=True)
def _apart(i: int, j: int, rays: IntArray, angles: FloatArray, r: FloatArray, sigma: float) -> bool:
    """Whether ray j, which follows ray i, is on another surface."""
    if rays[j] - rays[i] > 3:
        return True
    step = angles[rays[j]] - angles[rays[i]]
    return bool(abs(r[j] - r[i]) > min(r[i], r[j]) * step / SLANT + 4.0 * sigma + STEP)


@njit(cache=True)
def _fitted(x: FloatArray, y: FloatArray, r: FloatArray, sigma: float, line: FloatArray) -> bool:
    """Set the line (11,) of maximum likelihood through rays, but for TRIM at either end; whether it is one."""
    x, y, r = x[TRIM : len(x) - TRIM], y[TRIM : len(y) - TRIM], r[TRIM : len(r) - TRIM]
    m = len(x)
    if m < RAYS - 2 * TRIM:
        return False
    m_x, m_y = x.mean(), y.mean()
    angle = (
        0.5 * math.atan2(2.0 * ((x - m_x) * (y - m_y)).sum(), ((x - m_x) ** 2 - (y - m_y) ** 2).sum()) + 0.5 * math.pi
    )
    offset = math.cos(angle) * m_x + math.sin(angle) * m_y
    for _ in range(4):
        c, s = math.cos(angle), math.sin(angle)
        if offset < 0.0:
            c, s, offset, angle = -c, -s, -offset, angle + math.pi
        H00, H01, H11, g0, g1 = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(m):
            normal, along = (c * x[i] + s * y[i]) / r[i], (-s * x[i] + c * y[i]) / r[i]
            if normal < SLANT:
                continue
            # Range that the line says, and its derivatives.
            error = (offset / normal - r[i]) / sigma
            by_offset, by_angle = 1.0 / normal / sigma, -offset * along / (normal * normal) / sigma
            H00 += by_angle * by_angle
            H01 += by_angle * by_offset
            H11 += by_offset * by_offset
            g0 += by_angle * error
            g1 += by_offset * error
        det = H00 * H11 - H01 * H01
        if not det > 1e-9 * H00 * H11:
            return False
        angle -= (H11 * g0 - H01 * g1) / det
        offset -= (H00 * g1 - H01 * g0) / det
    c, s = math.cos(angle), math.sin(angle)
    if offset <= 0.0:
        return False
    squares, used, begin, end = 0.0, 0, np.inf, -np.inf
    u2, bend, by_turn, by_way = 0.0, 0.0, np.zeros(2), np.zeros(2)
    # The offset at tangential t changes by -t dangle; where that is uncorrelated with the angle.
    V00, V01, V11 = H11 / det, -H01 / det, H00 / det
    middle = V01 / V00
    line[0], line[1], line[4] = math.atan2(s, c), offset, middle
    of_middle = bearing_of(line)
    for i in range(m):
        normal, along = (c * x[i] + s * y[i]) / r[i], -s * x[i] + c * y[i]
        if normal < SLANT:
            continue
        error = (offset / normal - r[i]) / sigma
        squares += error * error
        used += 1
        bearing = of_middle + wrap(math.atan2(y[i], x[i]) - of_middle)
        on_line = np.array([-offset * along / (r[i] * normal), 1.0]) / (normal * sigma)
        by_turn -= bearing * along / (normal * sigma) * on_line
        by_way += bearing / (normal * sigma) * on_line
        begin, end = min(begin, along), max(end, along)
    if used < RAYS - 2 * TRIM or end - begin < LENGTH:
        return False
    centre, half = 0.5 * (begin + end), 0.5 * (end - begin)
    for i in range(m):
        normal, along = (c * x[i] + s * y[i]) / r[i], -s * x[i] + c * y[i]
        if normal < SLANT:
            continue
        u = (3.0 * ((along - centre) / half) ** 2 - 1.0) * 0.5
        bend += u * (offset / normal - r[i]) / sigma
        u2 += u * u
    freedoms = used - 2
    if squares > freedoms + STRAIGHT * math.sqrt(2.0 * freedoms) or abs(bend) > STRAIGHT * math.sqrt(u2):
        return False
    line[2], line[3] = begin, end
    line[5] = math.sqrt(V00)
    line[6] = math.sqrt(max(V11 - V01 * V01 / V00, 1e-12))
    for k, swept, expected in ((7, by_turn, -middle * of_middle), (9, by_way, of_middle)):
        line[k] = V00 * swept[0] + V01 * swept[1]
        line[k + 1] = V01 * swept[0] + V11 * swept[1] - middle * line[k] - expected
    return True


@njit(cache=True)
def _is_chord(x: FloatArray, y: FloatArray, r: FloatArray, sigma: float, line: FloatArray) -> bool:
    """Whether a line (11,) is a chord of what these rays see: a parabola is fitted to them."""
    c, s, length = math.cos(line[0]), math.sin(line[0]), line[3] - line[2]
    H, g, squares, used = np.zeros((3, 3)), np.zeros(3), 0.0, 0
    for i in range(TRIM, len(x) - TRIM):
        normal, t = (c * x[i] + s * y[i]) / r[i], (-s * x[i] + c * y[i] - 0.5 * (line[2] + line[3])) / length
        if normal < SLANT:
            continue
        row = np.array([1.0, t, t * t]) / (normal * sigma)
        off = (c * x[i] + s * y[i] - line[1]) / (normal * sigma)
        for a in range(3):
            for b in range(3):
                H[a, b] += row[a] * row[b]
            g[a] += row[a] * off
        squares += off * off
        used += 1
    inverse = np.linalg.inv(H + 1e-9 * np.eye(3))
    by = inverse @ g
    squares, freedoms = squares - float(by @ g), used - 3
    if freedoms < 1 or squares > freedoms + STRAIGHT * math.sqrt(2.0 * freedoms):
        return False
    bend = abs(by[2])
    return bool(bend > BENDS * math.sqrt(inverse[2, 2]) and 2.0 * bend / length > BEND)

"""Whether a scan is to be believed: a scanner that says nothing new, or nothing at all, is as good as silent.

A scan is held against the one that was believed before it, moved along by odometry: most of what was met then must be
met now, and what it tells must change where the robot moves. Rays that are lost here and there do not matter.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.se2 import between, wrap_angle
from tfg_drake.messages import FloatArray, LaserScan, message
from tfg_drake.safety.seen_space import SeenSpace, nothing_seen, remembered

# A scan is empty if it shows less than the share SHOWN_SHARE of the expected returns; this takes LEAST_SHOWN of them.
SHOWN_SHARE, LEAST_SHOWN = 0.1, 10
# Returns are expected up to the share _REACH_SHARE of the range, and _BLIND_MARGIN, m, beyond the blind zone.
_REACH_SHARE, _BLIND_MARGIN = 0.8, 0.1
# An unchanged scan is frozen if, after the robot's motion, more than the share _WRONG_SHARE of its ranges is wrong by
# more than _WRONG, m.
_WRONG_SHARE, _WRONG = 0.2, 0.04

FROZEN = "the scan does not change while the robot moves: start its driver again"
EMPTY = (
    "the scan shows nothing where there were walls a moment ago: see whether something covers the scanner; of one that "
    "sees nothing near, set scan.least_range"
)
HELD = (
    "what lies in its way was not seen: see whether the scanner works, or turn the robot; it goes on when it has seen"
)
REMEMBERED = (
    "what the scan met before is in its way, where it does not look now: turn the robot; it goes on when that is seen "
    "to be free"
)


@message
class ScanWatch:
    """The state of a watch over a scanner.

    newest: stamp of its newest scan, s. believed: the newest scan that was believed, taken at X_OS (3,). content: the
    first scan of those that say the same as the newest one, X_OC (3,) where the robot was when its wheels last rested
    since. doubt: why the newest scan is not believed, "" if it is. space: what was seen to be free. held: scans in a
    row during which the base stood for want of a way that was seen.
    """

    newest: float
    believed: LaserScan
    X_OS: FloatArray
    content: LaserScan
    X_OC: FloatArray
    doubt: str
    space: SeenSpace
    held: int = 0


def no_watch(scan: LaserScan) -> ScanWatch:
    """Before the first scan; scan: stamped -inf."""
    return ScanWatch(scan.stamp, scan, np.zeros(3), scan, np.zeros(3), "", nothing_seen())


def watched(
    watch: ScanWatch,
    scan: LaserScan,
    X_OB: FloatArray,
    at_rest: bool,
    radius: float,
    least_range: float,
    barred: LaserScan | None = None,
) -> ScanWatch:
    """The watch after a scan that is newer than the one before.

    X_OB: (3,) odometry where it was taken. at_rest: no wheel turns. radius: of the robot, m. least_range: m, nearer the
    scanner sees nothing. barred: what is remembered of it where the base may not go all the way that it saw.
    """
    same = len(scan.ranges) > 0 and scan.ranges.tobytes() == watch.content.ranges.tobytes()  # nan is nan
    content, X_OC = (watch.content, watch.X_OC) if same else (scan, X_OB)
    X_OC = X_OB if at_rest else X_OC
    believed, reach = watch.believed, _REACH_SHARE * scan.range_max
    doubt = ""
    if same and (watch.doubt == FROZEN or _should_differ(content.angles, content.ranges, between(X_OC, X_OB), reach)):
        doubt = FROZEN
    elif not _shows(believed, scan, between(watch.X_OS, X_OB), least_range + _BLIND_MARGIN, reach):
        doubt = EMPTY
    if doubt:
        return ScanWatch(scan.stamp, believed, watch.X_OS, content, X_OC, doubt, watch.space)
    space = remembered(watch.space, barred or scan, X_OB, radius)
    return ScanWatch(scan.stamp, scan, X_OB, content, X_OC, "", space)


def _shows(before: LaserScan, scan: LaserScan, X_SB: FloatArray, least: float, reach: float) -> bool:
    """Whether a scan taken at X_SB (3,) in the frame of the one before meets enough of what that one met; what lies
    nearer than least (m) or farther than reach (m) is not expected."""
    met = np.count_nonzero(np.isfinite(scan.ranges))
    # No more is expected than was met then.
    if met >= SHOWN_SHARE * np.count_nonzero(np.isfinite(before.ranges)):
        return True
    expected = _in_view(before.angles, before.ranges, X_SB, least, reach)
    return expected < LEAST_SHOWN or bool(met >= SHOWN_SHARE * expected)


def _moved(angles: FloatArray, ranges: FloatArray, X_SB: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bearing (n,), rad, and range (n,), m, from B of points at these angles and ranges from S."""
    dx, dy = ranges * np.cos(angles) - X_SB[0], ranges * np.sin(angles) - X_SB[1]
    return wrap_angle(np.arctan2(dy, dx) - X_SB[2]), np.hypot(dx, dy)


def _in_view(angles: FloatArray, ranges: FloatArray, X_SB: FloatArray, least: float, reach: float) -> int:
    """How many returns of a scan the same scanner sees from B, between two ranges (m)."""
    met = np.isfinite(ranges)
    bearing, distance = _moved(angles[met], ranges[met], X_SB)
    seen = (bearing >= angles[0]) & (bearing <= angles[-1])
    return int(np.count_nonzero(seen & (distance > least) & (distance < reach)))


def _should_differ(angles: FloatArray, ranges: FloatArray, X_SB: FloatArray, reach: float) -> bool:
    """Whether a scan from B would have to say something else than the same scan from S did."""
    near = ranges < reach
    bearing, distance = _moved(angles[near], ranges[near], X_SB)
    n = np.searchsorted(angles, bearing)
    within = (n > 0) & (n < len(angles))
    n, bearing, distance = n[within], bearing[within], distance[within]
    n -= bearing - angles[n - 1] < angles[n] - bearing
    met = ranges[n] < np.inf
    wrong = np.abs(ranges[n[met]] - distance[met]) > _WRONG
    return len(wrong) >= LEAST_SHOWN and bool(np.count_nonzero(wrong) > _WRONG_SHARE * len(wrong))

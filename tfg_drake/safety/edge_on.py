"""Whether what was met somewhere may stand there yet where rays pass by: a wall or a door leaf that is seen edge-on.

A thin thing whose plane leads through the scanner is met by no ray, or by few and far behind its end. So what was met
has not gone because a ray has passed it, or has met something behind it. It has where the same is true of what was met
beside it: no plane through both is seen edge-on.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Places within _ONE_THING, m, may be of one object; their relative position is known within _KNOWN, m.
_ONE_THING, _KNOWN = 0.12, 0.02
# A ray within this distance of a place, m, observes it; a return at most as far behind it is of the same object.
_NEAR = 0.06
# Two places in line are a plane. A single one that is not seen again is gone after this time, s.
_ALONE = 1.5

_UNKNOWN, _BEHIND, _PASSED = range(3)


@njit(cache=True)
def may_stand(p_BM: FloatArray, age: FloatArray, angles: FloatArray, ranges: FloatArray) -> BoolArray:
    """Whether something may stand yet at each place (n,) where it was met.

    p_BM: (n, 2) the places in the scanner's frame, m. age: (n,) how long ago it was met, s. angles, ranges: (m,) of the
    newest scan, rad and m.
    """
    told = np.empty(len(p_BM), dtype=np.int64)
    for i in range(len(p_BM)):
        told[i] = _told(p_BM[i], angles, ranges)
    stands: BoolArray = told == _UNKNOWN
    for i in range(len(p_BM)):
        if not stands[i]:
            in_line = _in_line(i, p_BM, age, told)
            stands[i] = in_line > 0 or (in_line == 0 and told[i] == _PASSED and age[i] <= _ALONE)
    return stands


@njit(cache=True)
def _in_line(i: int, p_BM: FloatArray, age: FloatArray, told: IntArray) -> int:
    """How many other places near the i-th are in line with it; -1 if one that is not has gone."""
    x, y = p_BM[i]
    count = 0
    for j in range(len(p_BM)):
        dx, dy = p_BM[j, 0] - x, p_BM[j, 1] - y
        if _KNOWN < math.hypot(dx, dy) < _ONE_THING:
            if abs(x * dy - y * dx) <= _KNOWN * math.hypot(x, y):
                count += 1
            elif told[j] != _UNKNOWN and abs(age[j] - age[i]) <= _ALONE:
                return -1
    return count


@njit(cache=True)
def _told(p_BM: FloatArray, angles: FloatArray, ranges: FloatArray) -> int:
    """The verdict of the nearest rays on both sides of a place (2,): _PASSED, _BEHIND, or _UNKNOWN if they disagree."""
    bearing, away = math.atan2(p_BM[1], p_BM[0]), math.hypot(p_BM[0], p_BM[1])
    first, passed = np.searchsorted(angles, bearing), 0
    for k, step in ((first - 1, -1), (first, 1)):
        while 0 <= k < len(ranges) and not ranges[k] >= 0.0:
            k += step
        if not 0 <= k < len(ranges) or abs(angles[k] - bearing) * away > _NEAR or ranges[k] < away:
            return _UNKNOWN
        passed += ranges[k] > away + _NEAR
    return (_BEHIND, _UNKNOWN, _PASSED)[passed]

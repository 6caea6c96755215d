"""When a scanner's turns began, from when their first rays arrived: its motor turns evenly, but bytes wait for us."""

from __future__ import annotations

import collections

# Turns that are remembered, four seconds of an A1's.
_REMEMBERED = 24
# A turn that seems late by so much of a turn, so often in a row, was not late: one before it was lost.
_LATE, _IN_A_ROW = 0.5, 5


class TurnClock:
    """Lays a line under the arrivals, as near to them as it goes (Moon, Skelly, Towsley 1999): it goes by those that
    came at once, however late the others were. Times are s."""

    def __init__(self) -> None:
        self._marks: collections.deque[tuple[int, float]] = collections.deque(maxlen=_REMEMBERED)
        self._late = 0

    def mark(self, arrival: float) -> tuple[float, float] | None:
        """A turn begins, as seen at `arrival`; when it began and how long one takes, None where that is not known yet.

        Arrivals do not decrease.
        """
        number = self._marks[-1][0] + 1 if self._marks else 0
        self._marks.append((number, arrival))
        if len(self._marks) < 2:
            return None
        (one, when), (other, later) = self._edge()
        period = (later - when) / (other - one)
        began = when + (number - one) * period
        self._late = self._late + 1 if arrival - began > _LATE * period else 0
        if self._late >= _IN_A_ROW:
            self._late = 0
            self._marks.clear()
            self._marks.append((number, arrival))
            return None
        return (began, period) if period > 0.0 else None

    def _edge(self) -> tuple[tuple[int, float], tuple[int, float]]:
        """The edge of the marks' lower convex hull below their middle: no other line below them is nearer to all."""
        hull: list[tuple[int, float]] = []
        for turn, when in self._marks:
            while len(hull) > 1 and _is_above(hull[-2], hull[-1], (turn, when)):
                hull.pop()
            hull.append((turn, when))
        middle = 0.5 * (self._marks[0][0] + self._marks[-1][0])
        right = next(k for k in range(1, len(hull)) if hull[k][0] >= middle)
        return hull[right - 1], hull[right]


def _is_above(a: tuple[int, float], b: tuple[int, float], c: tuple[int, float]) -> bool:
    """True if b is not below the line a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])

"""The stamps of a recording as time that goes on: a clock that is set amid it, cut off or another one for each sensor.

Messages are in the order in which they were recorded. The recorder's clock (arrivals) tells how far a clock was set;
without it a message comes one usual period after the one before.
"""

from __future__ import annotations

import bisect
import math

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.messages import FloatArray
from tfg_drake.notes import Note

# A clock has jumped if a message was recorded JUMP, s, before its stamp, or if a recording pauses for longer than
# PAUSE, s.
JUMP, PAUSE = 0.5, 600.0
# A late message fills a gap of this many periods.
HOLE = 1.5
# Number of messages whose least delay compares two clocks, and whose order is checked.
NEAR = 50
# Stamps have lost digits if more than the share CUT equals the previous one. A clock that jumps at more than the share
# OFTEN of its messages is refused.
CUT, OFTEN = 0.3, 0.02
# Greatest delay of scans, s, by the same clock as odometry.
LATE = 1.0


def steady(stamps: FloatArray, arrivals: FloatArray, what: str) -> tuple[FloatArray, tuple[Note, ...]]:
    """Stamps (n,), s, in the order of the log as time that goes on, the first one's clock kept, and what was not
    believed of them. They are as they were where the clock was never set, and not sorted: a message that is late fills
    a hole.

    arrivals: (n,) s of the recorder's clock, or none. what: of these messages, in words.

    Raises:
        DatasetError: the clock jumps all the time and there are no arrivals.
    """
    if len(stamps) < 2:
        return stamps, ()
    if len(arrivals):
        arrivals, _ = steady(arrivals, arrivals[:0], what)
        if np.mean(np.diff(stamps) == 0.0) > CUT:
            note = Note("clock", float(stamps[0]), f"stamps of {what} are cut off; those of the recorder serve")
            return arrivals - np.min(arrivals - stamps), (note,)
    period = _period(stamps)
    begins = _set(stamps, arrivals, period)
    if len(begins) > max(5.0, OFTEN * len(stamps)):
        complaint = f"the clock of {what} jumps {len(begins)} times"
        if not len(arrivals):
            raise DatasetError(f"{complaint}; record once more, with a clock that is not set")
        begin = float(stamps[0])
        return arrivals - arrivals[0] + begin, (Note("clock", begin, f"{complaint}; the recorder's serves"),)
    times, notes = stamps.copy(), []
    for begin, end in zip(begins, [*begins, len(stamps)][1:], strict=True):
        before, after = slice(max(0, begin - NEAR), begin), slice(begin, min(end, begin + NEAR))
        if len(arrivals):
            times[begin:end] += np.min((arrivals - stamps)[after]) - np.min((arrivals - times)[before])
        else:
            times[begin:end] += np.max(times[before]) + period - stamps[begin]
        jump = float((stamps - times)[begin] - (stamps - times)[begin - 1])
        notes.append(Note("clock", float(times[begin]), f"the clock of {what} jumps by {jump:.1f} s; time goes on"))
    return times, tuple(notes)


def together(
    times: tuple[FloatArray, FloatArray], arrivals: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, tuple[Note, ...]]:
    """Times of scans by the clock of odometry, and a note where that was another one. Both arguments: (n,) of odometry
    and (m,) of scans, s.

    Raises:
        DatasetError: the clocks differ and there are no arrivals.
    """
    scans = times[1]
    if all(len(one) for one in arrivals):
        behind = [float(np.median(at - time)) for at, time in zip(arrivals, times, strict=True)]
        apart = behind[1] - behind[0]
        if abs(apart) <= LATE:
            return scans, ()
        # The other clock may be that of a simulation, which is fast or slow.
        ran = [float(np.ptp(one)) for one in (scans, arrivals[1])]
        moved = scans + apart if abs(ran[0] - ran[1]) < LATE else arrivals[1] - behind[0]
        text = f"scans are stamped {-apart:+.1f} s by another clock than odometry; that of the recorder joins them"
        return moved, (Note("clock", float(moved[0]), text.replace("+", "")),)
    spans = [(float(one.min()), float(one.max())) for one in times]
    if min(spans[0][1], spans[1][1]) < max(spans[0][0], spans[1][0]):
        (a, b), (c, d) = spans
        clocks = f"odometry is stamped {a:.1f} to {b:.1f} s, scans are {c:.1f} to {d:.1f} s: two clocks"
        raise DatasetError(f"{clocks}; record both by one, such as the simulation's with use_sim_time")
    return scans, ()


def _period(stamps: FloatArray) -> float:
    steps = np.diff(stamps)
    return float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0


def _set(stamps: FloatArray, arrivals: FloatArray, period: float) -> list[int]:
    """The messages from which on a clock is another one."""
    begins: list[int] = []
    recent: list[float] = []
    least = math.inf
    told = arrivals.tolist()
    for number, stamp in enumerate(stamps.tolist()):
        offset = told[number] - stamp if told else 0.0
        if not recent:
            jumps = False
        elif stamp < recent[-1]:
            at = bisect.bisect_left(recent, stamp)
            jumps = recent[at] - recent[at - 1] < HOLE * period if at else recent[0] - stamp > JUMP
        elif told:
            jumps = offset < least - JUMP
        else:
            jumps = stamp - recent[-1] > PAUSE
        if jumps:
            begins.append(number)
            recent.clear()
            least = math.inf
        least = min(least, offset)
        bisect.insort(recent, stamp)
        del recent[:-NEAR]
    return begins

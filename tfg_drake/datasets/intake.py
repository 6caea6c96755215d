"""The intake of recordings: what of one is believed, as of a robot's messages while it drives.

Time first: messages in the order of one clock that goes on. Then the rules of motion, scans that are frozen, and
odometry held against scans: what is wrong all along is corrected, or the recording refused; where odometry is silent,
jumps or slips, the way is that of the scans if these tell it, else it is unknown.
"""

from __future__ import annotations

import bisect
import collections
import itertools
import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from tfg_drake.datasets.recorded_clock import steady, together
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, LaserScan, Odometry, message, replace
from tfg_drake.notes import Note
from tfg_drake.slam.odometry_rules import SILENCE, WatchedOdometry, velocity, watch
from tfg_drake.slam.scan_matching import bridged, compare, corrected, judged

# Odometry is silent after this many of its periods.
PERIODS = 5.0
# Odometry is refused if it jumps more than FEW times and in more than the share OFTEN of its messages.
FEW, OFTEN = 5, 0.02
# Scans are frozen if they do not change for FROZEN, s, while the odometry moves by MOVED, m or rad.
FROZEN, MOVED = 1.0, 0.1
# Scans with a longer period, s, are not compared with odometry, as consecutive ones have too little in common; nor is
# its silence reported.
SPARSE = 1.0
# Number of notes of one kind that are reported one by one.
MOST_NOTES = 20
# Kinds of notes after which the motion is unknown.
UNKNOWN = ("jump", "silence", "slip")
# A motion by scans agrees with odometry within AGREES, m and rad; otherwise odometry slips if MATCHES scans tell it.
AGREES, MATCHES = 0.1, 4
# Greatest speed of a motion by scans: FASTER times the odometry's greatest usual speed plus SLACK, m/s and rad/s.
# Beyond it two similar places were confused.
FASTER, SLACK = 1.5, np.array([0.3, 0.5])

T = TypeVar("T", Odometry, LaserScan)


@message
class Doubt:
    """Messages of odometry, begin before end, between which the way is not known, and why."""

    begin: int
    end: int
    note: Note


def believed(recording: Recording) -> Recording:
    """A recording as far as it is believed, itself where all of it is, with notes of what is not.

    Raises:
        DatasetError: it cannot be used.
    """
    if not recording.odometry:
        return recording
    notes: list[Note] = []
    told, scans, told_stamps = recording.odometry, recording.scans, recording.told_stamps
    if not recording.detections:
        told, scans = _in_time(recording, notes)
    is_dense = min(len(scans), len(told)) > 1 and float(np.median(np.diff([one.stamp for one in scans]))) < SPARSE
    silence = max(SILENCE, PERIODS * float(np.median(np.diff([one.stamp for one in told])))) if is_dense else math.inf
    odometry, doubts = watched(told, silence)
    if is_dense:
        scans = _moving(scans, odometry, notes)
        often = _often(doubts, odometry)
        found = compare(told if often else odometry, scans, recording.mount_known)
        verdict = judged(found)
        if verdict.refusal:
            raise DatasetError(f"{recording.name}: {verdict.refusal}")
        notes += [replace(one, text=f"{one.text}; the map is corrected for it") for one in verdict.notes]
        odometry, scans = corrected(told if often else odometry, scans, verdict)
        if verdict.lag:
            stamps = np.array([one.stamp for one in recording.scans])
            told_stamps = told_stamps if len(told_stamps) else np.column_stack([stamps, stamps])
            told_stamps = told_stamps - [0.0, verdict.lag]
        if often:
            odometry, doubts = watched(odometry, silence)
        doubts += _contradicted(odometry, found.contradicts - found.lag)
        doubts.sort(key=lambda one: one.begin)
    if _often(doubts, odometry):
        jumps = f"odometry jumps {len(doubts)} times, first at {doubts[0].note.time_s:.2f} s"
        raise DatasetError(f"{recording.name}: {jumps}; see its units, m and rad, and its clock")
    odometry, scans = _bridged(odometry, scans, doubts, notes)
    if recording.scans and len(scans) < 2:
        raise DatasetError(f"{recording.name}: fewer than two scans while there is odometry; record both at once")
    if not notes and _same(odometry, recording.odometry) and _same(scans, recording.scans):
        return recording
    return replace(
        recording,
        odometry=odometry,
        scans=scans,
        odometry_arrivals=np.empty(0),
        scan_arrivals=np.empty(0),
        notes=recording.notes + _summed_up(notes),
        told_stamps=told_stamps,
    )


def _often(doubts: Sequence[Doubt], odometry: Sequence[Odometry]) -> bool:
    """True if odometry jumps all along."""
    return sum(doubt.note.kind == "jump" for doubt in doubts) > max(FEW, OFTEN * len(odometry))


def watched(told: Sequence[Odometry], silence: float) -> tuple[tuple[Odometry, ...], list[Doubt]]:
    """Odometry in order by the rules of motion (see `odometry_rules`), and where it is not believed."""
    state, passed, doubts = WatchedOdometry(), [], []
    for one in told:
        state, believed, note = watch(state, one, silence)
        passed += [] if believed is None else [believed]
        if note is not None:
            doubts.append(Doubt(max(0, len(passed) - 2), max(0, len(passed) - 1), note))
    return tuple(passed), doubts


def _in_time(recording: Recording, notes: list[Note]) -> tuple[tuple[Odometry, ...], tuple[LaserScan, ...]]:
    """Odometry and scans sorted by one clock that goes on, each once, and scans while there is odometry."""
    odometry, at_odometry = _once(recording.odometry, recording.odometry_arrivals)
    scans, at_scans = _once(recording.scans, recording.scan_arrivals)
    times, said = steady(np.array([one.stamp for one in odometry]), at_odometry, "odometry")
    notes += said
    order = np.argsort(times, kind="stable")
    told = tuple(_at(odometry[k], times[k]) for k in order)
    if not scans:
        return told, scans
    seen, said = steady(np.array([one.stamp for one in scans]), at_scans, "scans")
    notes += said
    seen, said = together((times, seen), (at_odometry, at_scans))
    notes += said
    kept: list[LaserScan] = []
    for k in np.argsort(seen, kind="stable"):
        if told[0].stamp <= seen[k] <= told[-1].stamp and (not kept or seen[k] > kept[-1].stamp):
            kept.append(_at(scans[k], seen[k]))
    return told, tuple(kept)


def _once(messages: tuple[T, ...], arrivals: FloatArray) -> tuple[tuple[T, ...], FloatArray]:
    """The messages and their arrivals without those that were recorded twice."""
    known: dict[int, int] = {}
    for number, one in enumerate(messages):
        values = one.X_OB if isinstance(one, Odometry) else one.ranges
        known.setdefault(hash((one.stamp, values.tobytes())), number)
    if len(known) == len(messages):
        return messages, arrivals
    kept = list(known.values())
    return tuple(messages[k] for k in kept), arrivals[kept] if len(arrivals) else arrivals


def _at(one: T, stamp: float) -> T:
    return one if one.stamp == stamp else replace(one, stamp=float(stamp))


def _moving(scans: Sequence[LaserScan], odometry: Sequence[Odometry], notes: list[Note]) -> tuple[LaserScan, ...]:
    """The scans without those that stay equal while the robot moves."""
    stamps = [one.stamp for one in odometry]
    kept: list[LaserScan] = []
    for _, equal in itertools.groupby(scans, lambda scan: scan.ranges.tobytes()):
        run = list(equal)
        begin, end = (odometry[max(0, bisect.bisect_right(stamps, one.stamp) - 1)] for one in (run[0], run[-1]))
        step = np.abs(se2.between(begin.X_OB, end.X_OB))
        seconds = run[-1].stamp - run[0].stamp
        if seconds > FROZEN and step.max() > MOVED and np.isfinite(run[0].ranges).any():
            notes.append(Note("frozen", run[0].stamp, f"scans stay equal for {seconds:.1f} s; they are left out"))
            run = run[:1]
        kept += run
    return tuple(kept)


def _contradicted(odometry: Sequence[Odometry], stretches: FloatArray) -> list[Doubt]:
    """Doubts of the odometry in stretches (n, 2) of time, s."""
    stamps = [one.stamp for one in odometry]
    doubts = []
    for begin, end in stretches.tolist():
        first = max(0, bisect.bisect_right(stamps, begin) - 1)
        last = min(bisect.bisect_left(stamps, end), len(stamps) - 1)
        doubts.append(Doubt(first, last, Note("slip", begin, "odometry contradicts the scans")))
    return doubts


def _bridged(
    odometry: Sequence[Odometry],
    scans: Sequence[LaserScan],
    doubts: Sequence[Doubt],
    notes: list[Note],
) -> tuple[tuple[Odometry, ...], tuple[LaserScan, ...]]:
    """Odometry with the way by the scans where it is in doubt and these tell it, else unknown, and the scans without
    those amid an unknown way."""
    stamps = [one.stamp for one in scans]
    way: list[Odometry] = []
    broken: list[int] = []
    fastest = np.zeros(2)
    if doubts:
        X_OB = np.array([one.X_OB for one in odometry])
        fastest = FASTER * np.quantile(_rates([one.stamp for one in odometry], X_OB), 0.99, axis=0)
    lost: list[tuple[float, float]] = []
    # The frame in which the odometry goes on, in the one that it had.
    X, done = np.zeros(3), 0
    for doubt in doubts:
        first, last = max(doubt.begin, done - 1), doubt.end
        if doubt.note.kind not in UNKNOWN or last <= first:
            notes += [] if doubt.note.kind in UNKNOWN else [doubt.note]
            continue
        before, after = odometry[first], odometry[last]
        near = slice(max(0, bisect.bisect_right(stamps, before.stamp) - 1), bisect.bisect_left(stamps, after.stamp) + 1)
        at, X_BB = _by_scans(scans[near], before, after, fastest)
        step = se2.between(before.X_OB, after.X_OB)
        # Two scans may be matched wrongly: all of them, one after the other, must contradict the odometry.
        if doubt.note.kind == "slip" and (len(at) < MATCHES or np.abs(se2.between(step, X_BB[-1])).max() < AGREES):
            continue
        way += [_moved(one, X) for one in odometry[done : first + 1]]
        begin, done = way[-1].X_OB, last + 1
        for k in range(1, len(at)):
            V_B = velocity(se2.between(X_BB[k - 1], X_BB[k]), float(at[k] - at[k - 1]))
            way.append(Odometry(float(at[k]), se2.compose(begin, X_BB[k]), V_B))
        if len(at):
            X = se2.compose(way[-1].X_OB, se2.inverse(after.X_OB))
        else:
            way += [_moved(one, X) for one in odometry[first + 1 : last]]
            broken.append(len(way))
            way.append(replace(_moved(after, X), at_rest=False))
            lost.append((before.stamp, after.stamp))
        told = "the scans tell the way there" if len(at) else "the way is unknown there"
        notes.append(replace(doubt.note, text=f"{doubt.note.text}; {told}"))
    way += [_moved(one, X) for one in odometry[done:]]
    begins = [begin for begin, _ in lost]
    known = []
    for scan in scans:
        newest = bisect.bisect_left(begins, scan.stamp) - 1
        known += [scan] if newest < 0 or scan.stamp >= lost[newest][1] else []
    breaks = np.searchsorted(broken, np.arange(len(way)), "right").tolist()
    counted = (
        one if one.breaks == count else replace(one, breaks=count) for one, count in zip(way, breaks, strict=True)
    )
    return tuple(counted), tuple(known)


def _by_scans(
    scans: Sequence[LaserScan], before: Odometry, after: Odometry, fastest: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times (k,), s, from one message to another, and the body then (k, 3) in the body at the first, by scans; none
    where these do not tell it, or a robot faster than it ever was (2,), m/s and rad/s: alike places were mistaken."""
    bridge = bridged(scans, before.stamp, after.stamp, se2.between(before.X_OB, after.X_OB))
    if bridge is None or np.any(_rates(bridge[0], bridge[1]) > fastest + SLACK):
        return np.empty(0), np.empty((0, 3))
    return bridge[:2]


def _rates(stamps: Sequence[float] | FloatArray, X: FloatArray) -> FloatArray:
    """(n - 1, 2) speeds, m/s, and turn rates, rad/s, between poses X (n, 3) at stamps (n,)."""
    step, dt = se2.between(X[:-1], X[1:]), np.maximum(np.diff(stamps), 1e-3)
    return np.asarray(np.abs(np.column_stack([np.hypot(step[:, 0], step[:, 1]), step[:, 2]])) / dt[:, None])


def _moved(one: Odometry, X: FloatArray) -> Odometry:
    return replace(one, X_OB=se2.compose(X, one.X_OB)) if X.any() else one


def _same(some: Sequence[object], others: Sequence[object]) -> bool:
    return len(some) == len(others) and all(one is other for one, other in zip(some, others, strict=True))


def _summed_up(notes: Sequence[Note]) -> tuple[Note, ...]:
    """The notes in their order, of a kind that there is often the first ones and how many there are."""
    counts = collections.Counter(one.kind for one in notes)
    told: collections.Counter[str] = collections.Counter()
    kept = []
    for one in sorted(notes, key=lambda one: -math.inf if one.time_s is None else one.time_s):
        told[one.kind] += 1
        more = counts[one.kind] - MOST_NOTES
        if told[one.kind] == MOST_NOTES and more:
            kept.append(replace(one, text=f"{one.text}; and {more} times more"))
        elif told[one.kind] <= MOST_NOTES:
            kept.append(one)
    return tuple(kept)

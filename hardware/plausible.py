"""Plausibility of a robot's messages: every message of every source is judged here before anybody uses it.

Comparisons with bounds that no ground robot, scanner or camera leaves; no other numerics. What is refused is counted,
and told once for each source and kind of reason.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tfg_drake.hardware.device import Message, Refusals
from tfg_drake.messages import FloatArray, Hazards, IntArray, LaserScan, Odometry, TagDetections, replace
from tfg_drake.mission.operation import Side
from tfg_drake.slam.odometry_rules import FASTEST, FASTEST_TURN
from tfg_drake.table import misfit, take

# A message is refused if its stamp is more than AHEAD, s, ahead of the host's clock, or more than OLD, s, old on
# arrival. A larger lead, once the offset of the other clock is known, is a jump of that clock.
AHEAD, OLD = 0.25, 30.0
# Greatest drift of the robot's clock against the host's, s/s.
CLOCK_DRIFT = 2e-4
# Greatest distance of a base from where it was switched on, m.
FARTHEST = 1e5
# Greatest number of tag sightings, and of rays, in a message.
MOST_TAGS, MOST_RAYS = 2000, 50_000
# Greatest range of a tag, m; its id is below IDS.
TAG_RANGE, IDS = 100.0, 2**31
# Detections are false if, of the tags in FRAMES frames, at least LEAST_ONCE and at least the share ONCE_SHARE occur in
# one frame only: even a camera of two frames a second that turns at 1.2 rad/s sees most tags twice in that time.
FRAMES, LEAST_ONCE, ONCE_SHARE = 20, 15, 0.8
# Bounds of the standard deviations that a sensor states: of a tag's range, m, its bearing, rad, and a ray's range, m.
SIGMA_RANGE, SIGMA_BEARING, SIGMA_RAY = (1e-4, 10.0), (1e-5, 1.0), (1e-4, 1.0)
# Greatest range_max of a scanner, m; a return beyond range_max by more than BEYOND standard deviations is rejected.
SCAN_RANGE, BEYOND = 1000.0, 6.0
# Bound of the magnitude of an angle in (-pi, pi], rad, with rounding.
_HALF_TURN = math.pi + 1e-6
_ALL_SIDES = int(Side.RIGHT | Side.CENTRE | Side.LEFT)


class Judge:
    """Judges the messages of one driver; those of sensors must also be in order."""

    def __init__(self, sources: Mapping[type, str]) -> None:
        """sources: names of the kinds of messages in remarks, such as "tags of /detections"."""
        self.refusals = Refusals()
        self._sources = sources
        self._newest: dict[type, float] = {}
        self._ids: collections.deque[IntArray] = collections.deque(maxlen=FRAMES)

    def judged(self, message: Message, now: float) -> Message | None:
        """Return the plausible part of a message at `now`, s of the host's clock; None if it is refused."""
        kind = type(message)
        believed, reasons = judged(message, now)
        for reason, why in reasons.items():
            self.refusals.add(self._sources.get(kind, kind.__name__), reason, why)
        if believed is not None and kind in (LaserScan, TagDetections):
            if believed.stamp <= self._newest.get(kind, -math.inf):
                return None
            self._newest[kind] = believed.stamp
        if isinstance(believed, TagDetections) and len(believed.ids):
            self._ids.append(believed.ids)
            if len(self._ids) == FRAMES and (why := made_up(self._ids)):
                self.refusals.add(self._sources.get(kind, kind.__name__), "made up", f"{why}; none is used")
                return None
        return believed


def made_up(ids: Sequence[IntArray]) -> str:
    """Return why the tags of frames are false, in words, "" if they may be true. ids: those of each frame."""
    tags, times = np.unique(np.concatenate(ids), return_counts=True)
    once = int(np.count_nonzero(times == 1))
    if once < max(LEAST_ONCE, ONCE_SHARE * len(tags)):
        return ""
    return (
        f"{once} of {len(tags)} tags are in one frame of {len(ids)} alone, so they are none: check their family and "
        "the camera's focus"
    )


def judged(message: Message, now: float) -> tuple[Message | None, dict[str, str]]:
    """Return the plausible part of a message at `now` (s of the host's clock), None for none, and why the rest is
    refused, in words by kind of reason."""
    if not message.stamp <= now + AHEAD:
        return None, {
            "stamp": f"stamp {message.stamp:g} s is {message.stamp - now:.6g} s ahead of this machine's clock"
        }
    if not message.stamp >= now - OLD:
        return None, {"stamp": f"stamp {message.stamp:g} s is {now - message.stamp:.6g} s old"}
    judge = _JUDGES.get(type(message))
    return (message, {}) if judge is None else judge(message)


def _odometry(message: Odometry) -> tuple[Odometry | None, dict[str, str]]:
    x, y, theta = (float(value) for value in message.X_OB)
    v, w = (float(value) for value in message.V_B)
    if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(theta) <= _HALF_TURN):
        return None, {"pose": f"pose ({x:g} m, {y:g} m, {theta:g} rad) is not plausible; check the base's driver"}
    if not (abs(v) <= FASTEST and abs(w) <= FASTEST_TURN):
        return None, {"speed": f"speed ({v:g} m/s, {w:g} rad/s) is not plausible; check the base's driver"}
    return message, {}


def _hazards(message: Hazards) -> tuple[Hazards, dict[str, str]]:
    """Return the hazards; invalid bits may be an alarm and count as all bits."""
    reasons = {}
    for name in ("bumper", "cliff", "wheel_drop"):
        bits = getattr(message, name)
        if not 0 <= bits <= _ALL_SIDES:
            message = replace(message, **{name: _ALL_SIDES})
            reasons[name] = f"{name} {bits:g} is no set of bits; it counts as an alarm on every side"
    return message, reasons


def _detections(message: TagDetections) -> tuple[TagDetections | None, dict[str, str]]:
    """Return the detections without implausible sightings."""
    n = len(message.ids)
    if misfit(message):
        return None, {"shape": "ids, ranges, bearings and deviations are not as many of each; check the detector"}
    if n > MOST_TAGS:
        return None, {"number": f"{n} sightings in one message are not plausible; check the detector"}
    # By column: mask of the plausible sightings, and the words for a bad value.
    plausible = {
        "ids": ((message.ids >= 0) & (message.ids < IDS), "id {:d}"),
        "range": ((message.range > 0.0) & (message.range <= TAG_RANGE), "range {:g} m"),
        "bearing": (np.abs(message.bearing) <= _HALF_TURN, "bearing {:g} rad"),
        "sigma_range": (_within(message.sigma_range, *SIGMA_RANGE), "deviation {:g} m of a range"),
        "sigma_bearing": (_within(message.sigma_bearing, *SIGMA_BEARING), "deviation {:g} rad of a bearing"),
    }
    reasons = {}
    for name, (good, told) in plausible.items():
        if not good.all():
            first, bad = told.format(getattr(message, name)[~good][0]), n - int(good.sum())
            others = "; the others are used" if bad < n else ""
            reasons[name] = f"{bad} of {n} sightings refused: {first} is not plausible; check the detector{others}"
    if not reasons:
        return message, {}
    return take(message, np.logical_and.reduce([good for good, _ in plausible.values()])), reasons


def _scan(message: LaserScan) -> tuple[LaserScan | None, dict[str, str]]:
    """Return the scan; implausible ranges become nan, which means unknown."""
    angles, ranges, farthest, sigma = message.angles, message.ranges, message.range_max, message.sigma
    n = len(angles)
    if misfit(message):
        return None, {"shape": "not as many ranges as angles; check the scanner's driver"}
    if n > MOST_RAYS:
        return None, {"number": f"{n} rays in one message are not plausible; check the scanner's driver"}
    if not (np.abs(angles) <= _HALF_TURN).all() or (n and not (angles[1:] > angles[:-1]).all()):
        return None, {"angles": "angles do not increase within (-pi, pi]; check the scanner's driver"}
    if not 0.0 < farthest <= SCAN_RANGE:
        return None, {"range_max": f"range_max {farthest:g} m is not plausible; check the scanner's driver"}
    if not SIGMA_RAY[0] <= sigma <= SIGMA_RAY[1]:
        return None, {"sigma": f"deviation {sigma:g} m of a range is not plausible; check the preset or the server"}
    known = ranges > 0.0
    known &= (ranges <= farthest + BEYOND * sigma) | (ranges == math.inf)
    if (known | np.isnan(ranges)).all():
        return message, {}
    nonsense = ~known & ~np.isnan(ranges) & (ranges != 0.0)
    reasons = {}
    if nonsense.any():
        first, bad = ranges[nonsense][0], int(nonsense.sum())
        reasons["ranges"] = f"{bad} of {n} ranges are none ({first:g} m); nothing is taken as known there"
    return replace(message, ranges=np.where(known, ranges, math.nan)), reasons


def _within(values: FloatArray, least: float, most: float) -> Any:
    return (values >= least) & (values <= most)


_JUDGES: dict[type, Callable[[Any], tuple[Any, dict[str, str]]]] = {
    Odometry: _odometry,
    Hazards: _hazards,
    TagDetections: _detections,
    LaserScan: _scan,
}

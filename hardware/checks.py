"""Checks of a standing robot before its wheels may be enabled: a line a check, and how to mend what fails.

Faults that show only in motion (a mirrored scan, a wrong clock of the scanner) are checked in the first turn by
`tfg_drake.hardware.base`; that the gyro turns with the wheels, always by `tfg_drake.hardware.kobuki.odometry`.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tfg_drake.hardware.device import BaseState, Device, DeviceError
from tfg_drake.hardware.plausible import made_up
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.remarks import battery, charge_left, where
from tfg_drake.hardware.robot_devices import STALE, RobotDevices
from tfg_drake.hardware.sensor_reader import SILENT
from tfg_drake.hardware.sensor_source import Source
from tfg_drake.messages import FloatArray, Hazards, LaserScan, Odometry, TagDetections
from tfg_drake.safety.scan_watch import LEAST_SHOWN, SHOWN_SHARE

# A sighting is compared with a ray less than BESIDE, rad, off its bearing: that ray meets the tag's surface.
BESIDE = 0.02
# Tag size or calibration is wrong if the ranges of at least TAGS tags differ from the scan's by one factor above GREAT,
# or below its inverse, up to the share AGREE; a single tag may hang above the surface that the scan meets.
TAGS, AGREE, GREAT = 2, 0.25, 1.5
# The scanner is frozen if at least SAME_SCANS scans are identical: ranges are noisy.
SAME_SCANS = 5
# Tag ids are judged by more than FEW_FRAMES frames with tags: cameras that take turns see different tags.
FEW_FRAMES = 3


@dataclasses.dataclass(frozen=True)
class Check:
    """name: of the checked part. found: the result. mend: how to mend a fault, "" for none."""

    name: str
    found: str
    mend: str = ""

    def __str__(self) -> str:
        return f"{self.name:<14}{self.found}" + (f"  FAILS: {self.mend}" if self.mend else "")


@dataclasses.dataclass(frozen=True)
class Heard:
    """The messages of a kind that arrived within SILENT, s. age: their least age on arrival, s."""

    messages: Sequence[Any] = ()
    age: float = math.inf


def check(devices: RobotDevices) -> list[Check]:
    """Return the checks of open devices, after listening to them for SILENT, s."""
    sources: dict[Any, Device | Source] = {Odometry: devices.base, Hazards: devices.base, LaserScan: devices.scan}
    if devices.tags is not None:
        sources[TagDetections] = devices.tags
    for kind, source in sources.items():
        source.take(kind, time.monotonic())  # Discard the queued messages.
    heard, end = dict.fromkeys(sources, Heard()), time.monotonic() + SILENT
    while (now := time.monotonic()) < end:
        for kind, source in sources.items():
            new, before = source.take(kind, now), heard[kind]
            heard[kind] = Heard([*before.messages, *new], min([before.age, *(now - one.stamp for one in new)]))
        time.sleep(TICK)
    found = judged(heard, devices.base.newest(BaseState), on_ros=devices.frames is not None)
    return found + [Check("told", line) for line in devices.take_remarks()]


def judged(heard: Mapping[type, Heard], state: BaseState | None, *, on_ros: bool) -> list[Check]:
    """Return all checks, in the order of the report. heard: by kind of message, without tags if the robot has no source
    of them. state: the base's own report. on_ros: its bumper and cliff sensors may have no topic."""
    scans = heard[LaserScan].messages
    checks = [
        _battery(state),
        _hazards(heard[Hazards].messages, on_ros),
        _arrives("odometry", heard[Odometry], "see the base's driver"),
        _arrives("scan", heard[LaserScan], "see the scanner's driver"),
        _rays(scans),
    ]
    if TagDetections not in heard:
        return [*checks, Check("tags", "no source of them: walls are the landmarks")]
    frames = heard[TagDetections].messages
    return [
        *checks,
        _arrives("tags", heard[TagDetections], "see the camera and the tags' detector"),
        _ids(frames),
        _sizes(tag_factors(scans[-1], frames) if scans and len(scans[-1].ranges) else np.zeros(0)),
    ]


def refuse(checks: Sequence[Check]) -> None:
    """Raise DeviceError if a check has failed."""
    if failed := [one.name for one in checks if one.mend]:
        raise DeviceError(f"checks that failed: {'; '.join(failed)}; mend that, or leave all out by --skip-checks")


def _battery(state: BaseState | None) -> Check:
    if state is None:
        return Check("battery", "the base says nothing of it")
    charger = f"take the robot off its {state.charger}" if state.charger else ""
    return Check("battery", charge_left(state), "charge it" if battery(state) else charger)


def _hazards(said: Sequence[Hazards], on_ros: bool) -> Check:
    if not said:
        return Check("bumper, cliff", "the base says nothing of them", "" if on_ros else "see the base's driver")
    sides = {name: getattr(said[-1], name) for name in ("bumper", "cliff", "wheel_drop")}
    found = ", ".join(f"{name.replace('_', ' ')} {where(bits)}" for name, bits in sides.items() if bits)
    return Check("bumper, cliff", found or "answer, none is pressed", "see what presses it" if found else "")


def _arrives(name: str, heard: Heard, mend: str) -> Check:
    """Return the check of the rate of a kind of message and of the least age on arrival."""
    if not heard.messages:
        return Check(name, f"none in {SILENT:g} s", f"{mend}, and whether its clock is this computer's")
    late = "" if heard.age <= STALE[name] else f"its clock is behind this computer's, or it is slow: {mend}"
    return Check(name, f"{len(heard.messages) / SILENT:.0f} a second, {heard.age:.2f} s old", late)


def _rays(scans: Sequence[LaserScan]) -> Check:
    if not scans:
        return Check("rays", "no scan to count them in")
    rays = max(len(one.ranges) for one in scans)
    met = int(np.median([np.count_nonzero((one.ranges > 0.0) & (one.ranges < np.inf)) for one in scans]))
    frozen = len(scans) >= SAME_SCANS and len({one.ranges.tobytes() for one in scans}) == 1
    mend = ""
    if met < max(LEAST_SHOWN, SHOWN_SHARE * rays):
        mend = "see whether something covers the scanner, and put the robot a metre or two before a wall"
    elif frozen:
        mend = "all scans are the same to the last bit, so they are one: start the scanner's driver anew"
    return Check("rays", f"{met} of {rays} meet something", mend)


def _ids(frames: Sequence[TagDetections]) -> Check:
    """Return the check that a robot at rest sees the same tags in several frames."""
    ids = [one.ids for one in frames if len(one.ids)]
    return Check(
        "tag ids", f"{len({*np.concatenate(ids)}) if ids else 0}", made_up(ids) if len(ids) > FEW_FRAMES else ""
    )


def _sizes(factors: FloatArray) -> Check:
    """Return the check of tag size and calibration by the tags' range factors (t,), see tag_factors."""
    if not len(factors):
        return Check("tag size", "no tag in view where the scan meets something: not compared")
    factor = float(np.median(factors))
    agree = len(factors) >= TAGS and (np.abs(factors / factor - 1.0) < AGREE).all()
    size = f"are the tags {1.0 / factor:.2g} times as large as was said, or is the calibration another camera's?"
    found = f"ranges of {len(factors)} tags are {factor:.2f} times the scan's"
    return Check("tag size", found, size if agree and abs(math.log(factor)) > math.log(GREAT) else "")


def tag_factors(scan: LaserScan, frames: Sequence[TagDetections]) -> FloatArray:
    """Return the ratio (t,) of each tag's range to the scan's range at its bearing, the median over all frames."""
    columns = ([np.zeros(0), *(getattr(one, name) for one in frames)] for name in ("ids", "range", "bearing"))
    ids, ranges, bearings = map(np.concatenate, columns)
    ray = np.searchsorted(scan.angles, bearings - 0.5 * BESIDE).clip(max=len(scan.angles) - 1)
    met = scan.ranges[ray]
    seen = (np.abs(scan.angles[ray] - bearings) < BESIDE) & (met > 0.0) & (met < np.inf)
    return np.array([np.median((ranges[seen] / met[seen])[ids[seen] == tag]) for tag in np.unique(ids[seen])])

"""The first look: compares scan and tags with odometry while the robot turns in place.

This detects a sensor that is mounted upside down, or whose clock is wrong, before anything is mapped: the sensor's
messages determine how far the robot has turned from one to the next, and so does odometry. With a mirrored sensor the
turns have opposite signs; with a wrong clock they begin and end too early or too late. (Tag ranges are compared with
the scan in `tfg_drake.slam.scan_ranges`.)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray, LaserScan, Odometry, TagDetections, replace
from tfg_drake.slam.evidence import sanitized
from tfg_drake.slam.scan_matching import (
    EXPLAINED,
    LEAST_YAW,
    MOST,
    SURELY,
    TELL,
    Pairs,
    Verdict,
    apart,
    compare,
    compared,
    judged,
)

# A clock error up to this, s, is no fault: the camera's is learnt with the map, and a scan may be stamped with its
# first ray.
LEAST_OFFSET = 0.1
# Scans and odometry determine the scanner's yaw if their distances differ by at most this share, and if five deviations
# of the yaw are at most this, rad.
ALIKE = 0.3
# Standard deviation of a turn between two frames by their tags, rad.
STEP = 0.008
TAGS_AGAINST = (
    "the tags turn against the robot: is the camera mounted upside down, or its image mirrored? "
    "Set hardware.camera.roll, or mend the image"
)
BOTH_AGAINST = "tags and scan turn against the robot: its odometry counts turns to the right, not to the left"

Message = Odometry | TagDetections | LaserScan


def held_against_odometry(messages: Sequence[Message], known: float = 0.0) -> tuple[Verdict, Verdict]:
    """Return the verdicts on tags and scans of a first look; a sensor without information counts as agreeing. known: s,
    the known offset of the camera's clock ahead of the odometry's, to which `lag` is added."""
    odometry = [one for one in messages if isinstance(one, Odometry)]
    frames = [sanitized(one)[0] for one in messages if isinstance(one, TagDetections)]
    scans = [one for one in messages if isinstance(one, LaserScan) and len(one.angles)]
    by_tags = turns_of_tags(apart([frame for frame in frames if len(frame.ids)])) - [known, known, 0.0]
    found = compare(odometry, scans, mount_known=True)
    turning, explained = found.turning
    if explained >= max(TELL, EXPLAINED * turning):
        # The robot turns on the spot: a motion that the scans show is a passer-by's.
        found = replace(found, travelling=np.zeros(2))
    return agreement(odometry, by_tags), judged(found, LEAST_OFFSET)


def off_by_way(messages: Sequence[Message]) -> list[str] | None:
    """Return one line if a drive shows that the scanner's yaw is wrong by more than can be learnt with the map, no line
    if it is right; None if the drive does not determine it. Turns are not compared."""
    odometry = [one for one in messages if isinstance(one, Odometry)]
    found = compare(odometry, [one for one in messages if isinstance(one, LaserScan) and len(one.angles)], True)
    # Somebody who walks by in a corridor biases the scans' distance and yaw.
    if abs(found.travel - 1.0) > ALIKE or SURELY * found.deviations[3] > ALIKE:
        return None
    wrong = abs(found.yaw) > max(LEAST_YAW, SURELY * found.deviations[3])
    return judged(replace(found, turning=np.zeros(2)), math.inf).lines[-1:] if wrong else []


def remedies(tags: Verdict, scan: Verdict) -> list[str]:
    """Return remedies for the user, one line each."""
    if tags.against and scan.against:
        return [BOTH_AGAINST]
    lines = [TAGS_AGAINST] if tags.against else []
    if tags.lag:
        lines.append(
            f"the camera's clock is {abs(tags.lag):.2f} s {'ahead of' if tags.lag > 0.0 else 'behind'} the base's, "
            "which is corrected: mend hardware.camera.latency, on ROS the clocks"
        )
    return lines + scan.lines


def turns_of_tags(frames: Sequence[TagDetections]) -> FloatArray:
    """Return stamps (s) of consecutive frames and the robot's turn between them (rad), (n, 3): the median over all tags
    in both. Ids are unique in each frame."""
    seen = []
    for before, after in itertools.pairwise([frame for frame in frames if len(frame.ids)]):
        _, i, j = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
        if len(i):
            turn = np.median(wrap_angle(before.bearing[i] - after.bearing[j]))
            seen.append((before.stamp, after.stamp, float(turn)))
    return np.array(seen).reshape(-1, 3)


def agreement(odometry: Sequence[Odometry], seen: FloatArray) -> Verdict:
    """Return the verdict on turns (n, 3), see `turns_of_tags`, which do not determine distances."""
    n = len(seen)
    X, covariance = np.zeros((n, 3)), np.tile(np.diag(np.square([MOST, MOST, STEP])), (n, 1, 1))
    X[:, 2] = seen[:, 2]
    return judged(compared(odometry, Pairs(seen[:, 0], seen[:, 1], X, covariance), mount_known=True), LEAST_OFFSET)

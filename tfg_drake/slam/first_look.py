"""The first look: scan and tags held against odometry while the robot turns round where it stands.

A sensor that is mounted upside down, or whose clock is wrong, shows it before anything is mapped: it says by itself how
far the robot has turned from one of its messages to the next, and odometry says so of any two instants. Mirrored, all
turns against the robot; by a wrong clock, it begins and ends to turn too soon or too late. (Whether the tags' ranges
are those of the scan is the subject of `tfg_drake.slam.scan_ranges`.)
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray, LaserScan, Odometry, TagDetections, message, replace
from tfg_drake.slam.evidence import sanitized
from tfg_drake.slam.scan_matching import EXPLAINED, TELL, Verdict, compare, judged

# Clocks are compared up to so much before or after each other, in steps of so much, s.
MOST_OFFSET, OFFSET_STEP = 1.0, 0.02
# A clock that is wrong by no more than this is no fault, s: the camera's is learnt with the map, and a scan may be
# stamped with its first ray.
LEAST_OFFSET = 0.1
# A turn that differs from the odometry's by more than this says no more than that, rad: it is no turn at all.
OUTLIER = 0.06
# Turns of more than this, rad, must have been seen so often.
LEAST_TURN, LEAST_TURNS = 0.03, 15
# What explains the turns has less than this share of the cost of what does not, and of outliers alone.
EXPLAINS = 0.5
# A clock is wrong when what is seen is so many deviations less likely with a right one.
SIGNIFICANT = 5.0
# Least standard deviation of a turn seen, rad.
STEP = 0.01
TAGS_AGAINST = (
    "the tags turn against the robot: is the camera mounted upside down, or its image mirrored? "
    "Set hardware.camera.roll, or mend the image"
)
BOTH_AGAINST = "tags and scan turn against the robot: its odometry counts turns to the right, not to the left"

Message = Odometry | TagDetections | LaserScan


@message
class Agreement:
    """How the tags' turns agree with the odometry's. against: they go the other way. ahead: the camera's clock less the
    odometry's, s, 0 where that is no fault."""

    against: bool = False
    ahead: float = 0.0


def held_against_odometry(messages: Sequence[Message], known: float = 0.0) -> tuple[Agreement, Verdict]:
    """The verdicts of the tags and the scans of a first look, one that says nothing like one that agrees. known: s, how
    far the camera's clock is ahead of the odometry's as far as is known: `ahead` comes on top."""
    odometry = [one for one in messages if isinstance(one, Odometry)]
    stamps = np.array([one.stamp for one in odometry])
    heading = np.unwrap([one.X_OB[2] for one in odometry])
    frames = [sanitized(one)[0] for one in messages if isinstance(one, TagDetections)]
    scans = [one for one in messages if isinstance(one, LaserScan) and len(one.angles)]
    by_tags = turns_of_tags(frames) - [known, known, 0.0]
    found = compare(odometry, scans, mount_known=True)
    turning, explained = found.turning
    if explained >= max(TELL, EXPLAINED * turning):
        # The robot turns on the spot: what travels is somebody who walks by.
        found = replace(found, travelling=np.zeros(2))
    return agreement(by_tags, stamps, heading), judged(found, LEAST_OFFSET)


def remedies(tags: Agreement, scan: Verdict) -> list[str]:
    """Remedies that somebody can take, a line each."""
    if tags.against and scan.against:
        return [BOTH_AGAINST]
    lines = [TAGS_AGAINST] if tags.against else []
    if tags.ahead:
        lines.append(
            f"the camera's clock is {abs(tags.ahead):.2f} s {'ahead of' if tags.ahead > 0.0 else 'behind'} the base's, "
            "which is corrected: mend hardware.camera.latency, on ROS the clocks"
        )
    return lines + scan.lines


def turns_of_tags(frames: Sequence[TagDetections]) -> FloatArray:
    """Stamps (s) of two frames one after the other and how far the robot has turned between them (rad), (n, 3): the
    median of all tags in both. Ids are unique in each frame."""
    seen = []
    for before, after in itertools.pairwise([frame for frame in frames if len(frame.ids)]):
        _, i, j = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
        if len(i):
            turn = np.median(wrap_angle(before.bearing[i] - after.bearing[j]))
            seen.append((before.stamp, after.stamp, float(turn)))
    return np.array(seen).reshape(-1, 3)


def agreement(seen: FloatArray, stamps: FloatArray, heading: FloatArray) -> Agreement:
    """How turns seen (n, 3), see `turns_of_tags`, agree with the odometry's heading (m,), rad and not wrapped, at its
    stamps (m,), s."""
    if not len(seen) or not len(stamps):
        return Agreement()
    steps = round(MOST_OFFSET / OFFSET_STEP)
    offsets = OFFSET_STEP * np.arange(-steps, steps + 1)
    turned = np.array([np.subtract(*(np.interp(seen[:, k] - o, stamps, heading) for k in (1, 0))) for o in offsets])
    cost = np.array([_cost(seen[:, 2] - turned), _cost(seen[:, 2] + turned)])
    least = cost.min(axis=1)
    way = int(np.argmin(least))
    best = int(np.argmin(cost[way]))
    turns = np.count_nonzero(np.abs(turned[best]) > LEAST_TURN)
    if turns < LEAST_TURNS or least[way] > EXPLAINS * min(least[1 - way], len(seen) * OUTLIER**2):
        return Agreement()
    variance = max(least[way] / len(seen), STEP**2)
    is_wrong = cost[way, steps] - least[way] > SIGNIFICANT**2 * variance and abs(offsets[best]) > LEAST_OFFSET
    return Agreement(way == 1, float(offsets[best]) if is_wrong else 0.0)


def _cost(error: FloatArray) -> FloatArray:
    """The sum (k,) of squared errors (k, n), rad, that of an outlier bounded."""
    return np.asarray(np.minimum(wrap_angle(error) ** 2, OUTLIER**2).sum(axis=1))

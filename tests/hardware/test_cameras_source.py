"""Tags of several cameras, one message at a time."""

import math

import numpy as np

from tfg_drake.hardware.sensor_source import CamerasSource
from tfg_drake.messages import TagDetections


def seen(stamp):
    return TagDetections(stamp, np.array([7]), *[np.ones(1)] * 4)


class Camera:
    """Says what a test puts in."""

    def __init__(self, *stamps):
        self.waiting = [seen(stamp) for stamp in stamps]

    def take(self, kind, until):
        taken = [one for one in self.waiting if one.stamp <= until]
        self.waiting = [one for one in self.waiting if one.stamp > until]
        return taken


def test_messages_come_in_order_one_at_a_time_and_none_is_lost():
    left, right = Camera(1.0, 1.1), Camera(1.01, 1.11)
    cameras, taken = CamerasSource([left, right]), []
    for now in (1.05, 1.08, 1.15, 1.2, 1.25):
        taken += [one.stamp for one in cameras.take(TagDetections, now)]
    assert taken == [1.0, 1.01, 1.1, 1.11]


def test_what_is_too_much_or_too_late_is_missed():
    left, right = Camera(1.0, 1.1, 1.2), Camera(1.01, 1.11)
    cameras = CamerasSource([left, right])
    assert [one.stamp for one in cameras.take(TagDetections, math.inf)] == [1.11]
    right.waiting.append(seen(1.105))
    assert [one.stamp for one in cameras.take(TagDetections, math.inf)] == [1.2]
    assert cameras.take(TagDetections, math.inf) == []

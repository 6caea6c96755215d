"""Removes impossible or ambiguous sightings from a frame of tags."""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, TagDetections


def sanitized(detections: TagDetections) -> tuple[TagDetections, int]:
    """The detections without those that are not finite, have no positive range or deviation, or share their id with
    another one of the frame (which of the two is wrong cannot be told); and how many those were."""
    good = _good(detections.ids, detections.range, detections.bearing, detections.sigma_range, detections.sigma_bearing)
    if good.all():
        return detections, 0
    return select(detections, good), int(np.count_nonzero(~good))


@njit(cache=True)
def _good(
    ids: IntArray, range_: FloatArray, bearing: FloatArray, sigma_range: FloatArray, sigma_bearing: FloatArray
) -> BoolArray:
    good = np.empty(len(ids), dtype=np.bool_)
    for i in range(len(ids)):
        good[i] = (
            0.0 < range_[i] < np.inf
            and np.isfinite(bearing[i])
            and 0.0 < sigma_range[i] < np.inf
            and 0.0 < sigma_bearing[i] < np.inf
            and np.sum(ids == ids[i]) == 1
        )
    return good


def select(detections: TagDetections, keep: BoolArray) -> TagDetections:
    """Some of a frame's sightings, keep: (n,)."""
    return TagDetections(
        stamp=detections.stamp,
        ids=detections.ids[keep],
        range=detections.range[keep],
        bearing=detections.bearing[keep],
        sigma_range=detections.sigma_range[keep],
        sigma_bearing=detections.sigma_bearing[keep],
    )

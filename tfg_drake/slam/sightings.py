"""Frames of tags: which sightings of one to use."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import BoolArray, TagDetections


def sanitized(detections: TagDetections) -> tuple[TagDetections, int]:
    """The detections without those that are not finite, have no positive range or deviation, or share their id with
    another one of the frame (which of the two is wrong cannot be told); and how many those were."""
    _, index, count = np.unique(detections.ids, return_inverse=True, return_counts=True)
    values = np.stack(
        [detections.range, detections.bearing, detections.sigma_range, detections.sigma_bearing], axis=-1
    ).reshape(-1, 4)
    good = np.isfinite(values).all(axis=1) & (values[:, [0, 2, 3]] > 0.0).all(axis=1)
    good &= count[index] == 1
    if good.all():
        return detections, 0
    return select(detections, good), int(np.count_nonzero(~good))


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

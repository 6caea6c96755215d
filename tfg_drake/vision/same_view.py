"""Views that are no new ones: a tag that stays where it is in the image is seen with the same error again.

How far off a corner is found depends on where in its pixel it lies. A robot that stands for twenty seconds has two
hundred frames of each tag and one error in all of them: their mean is no better than the first.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, IntArray, TagDetections, message, replace
from tfg_drake.vision.tag_detector import TagsInImage

# Displacement of a corner, pixels, after which its error is a new one.
_NEW = 0.5
# Factor on the deviations of a view that is not new: four hundred of them count as one.
_WORTH_LESS = 20.0
# Greatest deviation of a bearing that is used, rad.
_NOTHING = 1.0


@message
class Views:
    """Where the tags of the newest image were when their view was last new. ids: (n,), corners: (n, 4, 2) pixels."""

    ids: IntArray
    corners: FloatArray


def no_views() -> Views:
    """Before the first image."""
    return Views(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))


def weighed(detections: TagDetections, tags: TagsInImage, views: Views) -> tuple[TagDetections, Views]:
    """The detections of an image with the deviations that they have after all that was seen before, and the views."""
    corners = tags.corners.copy()
    old = np.zeros(len(tags.ids), dtype=bool)
    for k, tag in enumerate(tags.ids.tolist()):
        before = views.corners[views.ids == tag]
        if len(before) == 1 and np.abs(corners[k] - before[0]).max() < _NEW:
            old[k], corners[k] = True, before[0]
    times = np.where(np.isin(detections.ids, tags.ids[old]), _WORTH_LESS, 1.0)
    sigma_bearing = np.minimum(times * detections.sigma_bearing, np.maximum(_NOTHING, detections.sigma_bearing))
    less = replace(detections, sigma_range=times * detections.sigma_range, sigma_bearing=sigma_bearing)
    return less, Views(tags.ids, corners)

"""AprilTags in images, found by AprilRobotics' detector (Wang, Olson 2016)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import robotpy_apriltag

from tfg_drake.messages import FloatArray, IntArray, message
from tfg_drake.vision.image import Image, grey
from tfg_drake.vision.tag_corners import FAMILIES, refined

# The detector's own default (10 degrees), as robotpy's 45 misses oblique tags.
_CRITICAL_ANGLE = math.radians(10.0)
# Offset of the detector's coordinates, from the corner of the first pixel, to OpenCV's, from its centre.
_PIXEL_CENTRE = 0.5
# Least side of an image, pixels: the detector reads tiles of 4 pixels after decimation.
_LEAST_SIDE = 16


@message
class TagsInImage:
    """The tags that were found in one image, by their ids and from left to right.

    width, height: of the image, pixels. ids: (n,). corners: (n, 4, 2) pixels, (0, 0) the first one's centre, in order
    round the black square. margin: (n,) how much brighter or darker than doubtful its bits are, grey levels. likeness:
    (n,) correlation of the image with the tag's cells, 1 where they are exactly so. families: (n,) names.
    """

    width: int
    height: int
    ids: IntArray
    corners: FloatArray
    margin: FloatArray
    likeness: FloatArray
    families: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class DetectorConfig:
    """families: of FAMILIES. threads: of the detector's own. decimation: squares are looked for in an image so many
    times smaller, their corners in the whole one. least_cluster: pixels of an edge; robotpy's 300 loses what is far.
    corrected_bits: of a tag that may be wrong."""

    families: tuple[str, ...] = ("tag36h11",)
    threads: int = 1
    decimation: float = 2.0
    least_cluster: int = 5
    corrected_bits: int = 2


class TagDetector:
    """Finds tags; what it finds depends on the image alone."""

    def __init__(self, config: DetectorConfig | None = None) -> None:
        """Raises ValueError where the configuration is none."""
        config = config or DetectorConfig()
        if not (config.threads >= 1 and config.decimation >= 1.0):
            raise ValueError(f"{config.threads} threads, decimation {config.decimation:g}: both must be 1 or more")
        self._detector = robotpy_apriltag.AprilTagDetector()
        settings = self._detector.getConfig()
        settings.numThreads, settings.quadDecimate = config.threads, config.decimation
        self._detector.setConfig(settings)
        quads = self._detector.getQuadThresholdParameters()
        quads.minClusterPixels, quads.criticalAngle = config.least_cluster, _CRITICAL_ANGLE
        self._detector.setQuadThresholdParameters(quads)
        for family in config.families:
            if family not in FAMILIES or not self._detector.addFamily(family, config.corrected_bits):
                raise ValueError(f"{family}: unknown family of tags; known are {', '.join(FAMILIES)}")
        self._least_side = math.ceil(_LEAST_SIDE * config.decimation)

    def detect(self, image: Image) -> TagsInImage:
        """The tags in an image: (h, w), (h, w, 3) or (h, w, 4). Raises ValueError where it is none."""
        grey_image = grey(image)
        height, width = grey_image.shape
        found = self._detector.detect(grey_image) if min(width, height) >= self._least_side else []
        corners = np.array([one.getCorners((0.0,) * 8) for one in found]).reshape(-1, 4, 2) - _PIXEL_CENTRE
        ids = np.array([one.getId() for one in found], dtype=np.int64)
        likeness = np.zeros(len(found))
        for k, one in enumerate(found):
            corners[k], likeness[k] = refined(grey_image, corners[k], one.getId(), one.getFamily())
        # Threads end in any order.
        order = np.lexsort((corners[:, 0, 0], ids))
        return TagsInImage(
            width=width,
            height=height,
            ids=ids[order],
            corners=corners[order],
            margin=np.array([one.getDecisionMargin() for one in found], dtype=float)[order],
            likeness=likeness[order],
            families=tuple(found[i].getFamily() for i in order),
        )

"""A camera's tags, image after image: found, seen from the body, and worth less where a view is no new one."""

from __future__ import annotations

from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.image import Image
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.same_view import no_views, weighed
from tfg_drake.vision.sighting import Sighting, TagNoise, TagSizes, sighted
from tfg_drake.vision.tag_detector import DetectorConfig, TagDetector


class TagEyes:
    """Finds the tags in the images of one camera."""

    def __init__(
        self, tag_size: float, mount: CameraMount, noise: TagNoise | None = None, config: DetectorConfig | None = None
    ) -> None:
        """tag_size: side of the tags' black squares, m. config: of the detector; raises ValueError where it is none."""
        self._detector = TagDetector(config)
        self._sheet = TagSizes(tag_size), mount, noise
        self._views = no_views()

    def look(self, image: Image, stamp: float, calibration: CameraCalibration) -> Sighting:
        """The tags in the next image, taken at stamp, s; raises ValueError where it is none."""
        tags = self._detector.detect(image)
        seen = sighted(tags, stamp, calibration, *self._sheet)
        detections, self._views = weighed(seen.detections, tags, self._views)
        return Sighting(detections, seen.remarks)

"""Data sheets of a camera's tags and of its depth, for the explorer to believe."""

from __future__ import annotations

import math
from dataclasses import replace

from tfg_drake.config import CameraConfig, ScanConfig, TagSensorConfig

# Field of view of a webcam or depth camera, rad.
FIELD_OF_VIEW = math.radians(65.0)
# A tag is detected if its black square is at least this wide in the image, pixels, that is three per cell, at an
# incidence of at most this, rad.
LEAST_WIDTH, MOST_INCIDENCE = 24.0, math.radians(60.0)
# Frame rate, Hz.
RATE = 10.0
# Range of structured light and stereo cameras, m.
LEAST_DEPTH, MOST_DEPTH = 0.2, 5.0
# Standard deviation of a range in a depth image, m.
DEPTH_NOISE = 0.01


def focal_length(width: int, field_of_view: float) -> float:
    """Pixels, of an image so many pixels wide that shows a field of view, rad."""
    return 0.5 * width / math.tan(0.5 * field_of_view)


def camera_sheets(camera: CameraConfig, tags: TagSensorConfig, scan: ScanConfig) -> tuple[TagSensorConfig, ScanConfig]:
    """The sections tags and scan of a robot that sees with such a camera; what they say of anything else stays."""
    focal = focal_length(camera.width, FIELD_OF_VIEW)
    seen = replace(
        tags,
        range=focal * camera.tag_size / LEAST_WIDTH,
        field_of_view=FIELD_OF_VIEW,
        max_incidence=MOST_INCIDENCE,
        rate=RATE,
        range_noise=0.005,
        range_noise_per_metre=0.005,
        bearing_noise=0.002,
    )
    met = replace(
        scan,
        range=MOST_DEPTH,
        least_range=LEAST_DEPTH,
        field_of_view=FIELD_OF_VIEW,
        resolution=FIELD_OF_VIEW / camera.width,
        rate=RATE,
        noise=DEPTH_NOISE,
    )
    return seen, met

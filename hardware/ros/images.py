"""ROS images to tags, where no detector node runs: sensor_msgs/Image or CompressedImage and the camera's CameraInfo."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import COMPRESSED_IMAGE, Camera
from tfg_drake.messages import FloatArray, replace
from tfg_drake.vision.calibration import BROWN, FISHEYE, CameraCalibration
from tfg_drake.vision.image import Image
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.same_view import no_views, weighed
from tfg_drake.vision.sighting import Sighting, TagNoise, TagSizes, sighted
from tfg_drake.vision.tag_detector import TagDetector

# By an image's encoding: bytes a pixel, and where in them red, green and blue are; one byte is grey.
ENCODINGS = {
    "mono8": (1, (0,)),
    "8UC1": (1, (0,)),
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
}
# No image has more rows or columns, or more bytes in a row; no coefficient of a lens is larger, and no lens has more.
_WIDEST, _LONGEST_ROW, _GREATEST, _COEFFICIENTS = 10_000, 100_000, 1e6, 14


class ImageTags:
    """Finds the tags in the images of one topic."""

    def __init__(self, kind: str, name: str, camera: Camera) -> None:
        """kind, name: of the topic. camera: where it is, and its tags. A topic of rectified images is called so, as
        image_proc does it."""
        self._compressed, self._rectified = kind == COMPRESSED_IMAGE, "rect" in name
        self._detector = TagDetector()
        mount = CameraMount(camera.x, camera.y, 0.0, camera.yaw, camera.pitch)
        self._sheet = TagSizes(camera.tag_size), mount, TagNoise(pixels=camera.corner_sigma)
        self._views = no_views()

    def sighting(self, message: Any, camera_info: Any, stamp: float) -> Sighting:
        """The tags in an image; raises ValueError if it cannot be read. stamp: s."""
        image = decompressed(message) if self._compressed else plain(message)
        calibration = lens(camera_info, self._rectified)
        tags = self._detector.detect(image)
        seen = sighted(tags, stamp, calibration, *self._sheet)
        detections, self._views = weighed(seen.detections, tags, self._views)
        return Sighting(detections, seen.remarks)


def plain(message: Any) -> Image:
    """sensor_msgs/Image as an array (h, w) or (h, w, 3)."""
    height, width = (conversions.count(message, name, _WIDEST, 1) for name in ("height", "width"))
    step = conversions.count(message, "step", _LONGEST_ROW, 1)
    encoding = str(conversions.field(message, "encoding"))
    if encoding not in ENCODINGS:
        raise ValueError(f"images are encoded as {encoding[:50]}; known are {', '.join(ENCODINGS)}")
    size, channels = ENCODINGS[encoding]
    data = _bytes(message)
    if len(data) < height * step or step < width * size:
        raise ValueError(f"an image of {height} rows of {step} bytes has {len(data)} bytes")
    pixels = data[: height * step].reshape(height, step)[:, : width * size].reshape(height, width, size)
    return np.ascontiguousarray(pixels[..., channels] if size > 1 else pixels[..., 0])


def decompressed(message: Any) -> Image:
    """sensor_msgs/CompressedImage as an array (h, w), grey."""
    data = _bytes(message)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise ValueError("a compressed image is none that OpenCV reads")
    return np.asarray(image, dtype=np.uint8)


def lens(camera_info: Any, rectified: bool) -> CameraCalibration:
    """sensor_msgs/CameraInfo of either ROS: of the raw image its K and distortion, of the rectified one its P."""
    width, height = (conversions.count(camera_info, name, _WIDEST, 1) for name in ("width", "height"))
    if rectified:
        return replace(conversions.calibration(camera_info), width=width, height=height)
    K = _numbers(camera_info, "k", 9)
    if len(K) != 9 or not min(K[0], K[4]) >= 1.0:
        raise ValueError("camera_info holds no calibration (its K is zero)")
    model = str(conversions.field(camera_info, "distortion_model")) or BROWN[0]
    if model not in BROWN + FISHEYE:
        raise ValueError(f"camera_info has the distortion_model {model[:50]}; known are {', '.join(BROWN + FISHEYE)}")
    D = _numbers(camera_info, "d", _COEFFICIENTS)
    model = "equidistant" if model in FISHEYE else "plumb_bob"
    if len(D) not in ((4,) if model == "equidistant" else (0, 4, 5, 8, 12, 14)):
        raise ValueError(f"camera_info has {len(D)} coefficients of distortion")
    return CameraCalibration(width, height, K.reshape(3, 3), model, D)


def _numbers(camera_info: Any, name: str, most: int) -> FloatArray:
    """A list of camera_info, called as in ROS 2 or, in capitals, as in ROS 1."""
    try:
        values = conversions.field(camera_info, name)
    except ValueError:
        values = conversions.field(camera_info, name.upper())
    if not hasattr(values, "__len__") or len(values) > most:
        raise ValueError(f"camera_info's {name.upper()} is no list of up to {most} numbers")
    numbers = np.array(list(values), dtype=float)
    if numbers.ndim != 1 or not (np.abs(numbers) <= _GREATEST).all():
        raise ValueError(f"camera_info's {name.upper()} is not plausible")
    return numbers


def _bytes(message: Any) -> Image:
    """The data of an image (n,)."""
    return np.frombuffer(conversions.content(message, 2 * _WIDEST * _LONGEST_ROW), dtype=np.uint8)

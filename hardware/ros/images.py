"""ROS images to tags, where no detector node runs: sensor_msgs/Image or CompressedImage and the camera's CameraInfo."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import COMPRESSED_IMAGE, Camera
from tfg_drake.messages import replace
from tfg_drake.vision.calibration import WIDEST_IMAGE, CalibrationError, CameraCalibration, calibration_of
from tfg_drake.vision.image import Image
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import Sighting, TagNoise
from tfg_drake.vision.tag_eyes import TagEyes

# Bytes per pixel, and the positions of red, green and blue in them, by encoding; a single position is grey.
ENCODINGS = {
    "mono8": (1, (0,)),
    "8UC1": (1, (0,)),
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
}
# Fields of camera_info that are compared: in ROS 2 and, in capitals, in ROS 1.
_LENS = ("width", "height", "distortion_model", "k", "K", "d", "D")


class ImageTags:
    """Finds the tags in the images of one topic."""

    def __init__(self, kind: str, name: str, camera: Camera) -> None:
        """kind, name: of the topic. camera: where it is, and its tags. A topic of rectified images is called so, as
        image_proc does it."""
        self._compressed, self._rectified = kind == COMPRESSED_IMAGE, "rect" in name
        mount = CameraMount(camera.x, camera.y, 0.0, camera.yaw, camera.pitch)
        self._eyes = TagEyes(camera.tag_size, mount, TagNoise(pixels=camera.corner_sigma))

    def sighting(self, message: Any, camera_info: Any, stamp: float) -> Sighting:
        """The tags in an image; raises ValueError if it cannot be read. stamp: s."""
        image = decompressed(message) if self._compressed else plain(message)
        return self._eyes.look(image, stamp, lens(camera_info, self._rectified))


def plain(message: Any) -> Image:
    """sensor_msgs/Image as an array (h, w) or (h, w, 3)."""
    height, width = (conversions.count(message, name, WIDEST_IMAGE, 1) for name in ("height", "width"))
    step = conversions.count(message, "step", 4 * WIDEST_IMAGE, 1)
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
    if rectified:
        width, height = (conversions.count(camera_info, name, WIDEST_IMAGE, 1) for name in ("width", "height"))
        return replace(conversions.calibration(camera_info), width=width, height=height)
    found = {name: conversions.field(camera_info, name) for name in _LENS if conversions.has(camera_info, name)}
    plain_lists = {name: np.asarray(value).tolist() for name, value in found.items()}
    try:
        return calibration_of(plain_lists)
    except CalibrationError as error:
        what, _, _ = str(error).partition(";")
        raise ValueError(f"camera_info: {what}; calibrate the camera with its driver") from None


def _bytes(message: Any) -> Image:
    """The data of an image (n,)."""
    return np.frombuffer(conversions.content(message, WIDEST_IMAGE**2), dtype=np.uint8)

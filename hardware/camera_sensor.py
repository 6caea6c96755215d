"""A camera and the tags that it sees, as a sensor's process reads it; see tfg_drake.hardware.device."""

from __future__ import annotations

import collections
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tfg_drake.config import RobotCameraConfig
from tfg_drake.hardware.device import DeviceError, Refusals, imported
from tfg_drake.hardware.remarks import Remark, Spells, begun
from tfg_drake.hardware.sensor_reader import PATIENCE, SensorReader
from tfg_drake.messages import TagDetections

if TYPE_CHECKING:
    from tfg_drake.vision.calibration import CameraCalibration
    from tfg_drake.vision.camera_view import CameraView
    from tfg_drake.vision.frames import Frame

# An image rate below LOW_RATE, 1/s, averaged over COUNTED, s, causes a remark; tags are mapped nevertheless.
LOW_RATE, COUNTED = 4.0, 3.0
# An image is too dark or too bright if its mean grey level, of every _SPARSE-th pixel, is below DARK or above BRIGHT.
DARK, BRIGHT, _SPARSE = 25.0, 230.0, 16
# A remark is made after LASTS, s, of bad light or a low rate, and after WITHOUT_TAG, s, without a tag in sight.
LASTS, WITHOUT_TAG = 2.0, 30.0


class CameraDriver(SensorReader):
    """Finds tags in the newest image; see tfg_drake.hardware.device.Driver. A camera that was unplugged or a stream
    that ended is opened again.

    refusals: rejected tags, with the reasons.
    """

    def __init__(self, source: str, camera: RobotCameraConfig) -> None:
        """Waits for an image of the calibration's size; raises DeviceError. source: as tfg_drake.vision.frames.frames
        has it."""
        name = f"camera:{source}"
        super().__init__(name, {TagDetections: f"tags of {name}"})
        self._source, self._latency, self._family = source, camera.latency, camera.family
        self._calibration = known_calibration(self.name, camera)
        from tfg_drake.vision.mount import CameraMount
        from tfg_drake.vision.tag_detector import DetectorConfig
        from tfg_drake.vision.tag_eyes import TagEyes

        mount = CameraMount(camera.x, camera.y, 0.0, camera.yaw, camera.pitch, camera.roll)
        config = DetectorConfig((camera.family,), camera.threads, camera.decimation)
        try:
            self._eyes = TagEyes(camera.tag_size, mount, config=config)
        except ValueError as error:
            raise DeviceError(f"{self.name}: {error}") from None
        self._spells: Spells = {}
        # Any image was processed; the times of those in the last COUNTED s, s; the newest one's mean grey level, and
        # whether it shows a tag.
        self._seen = False
        self._looked: collections.deque[float] = collections.deque()
        self._light, self._tag_seen = DARK, False
        self._begin()

    def _connect(self) -> None:
        from tfg_drake.hardware.frame_reader import FrameReader

        size = self._calibration.width, self._calibration.height
        self._device = FrameReader(self._source, size, self._latency)
        self._looked.clear()
        self._opened = math.inf

    def _missing(self) -> str:
        return "" if self._messages else f"no image in {PATIENCE:.0f} s; is it there, and free?"

    def _receive(self, left: float) -> None:
        """Looks at one image."""
        from tfg_drake.vision.frames import is_live

        frame = self._device.take(left)
        now = time.monotonic()
        if frame is not None:
            self._look_at(frame, now)
        elif error := self._device.error:
            then = ": is it plugged in? It is looked for" if is_live(self._source) else "; they begin again"
            self._lose(f"no more images{then}" if self._seen else error)
            return
        while self._looked and self._looked[0] < now - COUNTED:
            self._looked.popleft()
        self._spells, names = begun(self._spells, holds := self._holding(now), now)
        for name in names:
            self._remark(holds[name].line)

    def _lose(self, why: str) -> None:
        """Close the camera and connect again later. Raises DeviceError before the first usable image."""
        if not self._seen:
            self.close()
            raise DeviceError(f"{self.name}: {why}")
        super()._lose(why)

    def _look_at(self, frame: Frame, now: float) -> None:
        (height, width), calibrated = frame.image.shape[:2], self._calibration
        if (width, height) != (calibrated.width, calibrated.height):
            known = f"the calibration is of {calibrated.width} x {calibrated.height}"
            self._lose(f"images of {width} x {height} pixels, {known}; calibrate the camera as it is used")
            return
        seen = self._eyes.look(frame.image, frame.stamp, calibrated)
        self._messages.append(seen.detections)
        tell(self.refusals, self.name, seen.remarks)
        self._seen = True
        self._opened = min(self._opened, now)
        self._looked.append(now)
        self._light = float(frame.image[::_SPARSE, ::_SPARSE].mean())
        self._tag_seen = bool(len(seen.detections.ids))

    def _holding(self, now: float) -> dict[str, Remark]:
        rate = len(self._looked) / COUNTED
        if not rate:  # the frame reader reports missing images
            return {}
        holds = {}
        if rate < LOW_RATE and now - self._opened > COUNTED:
            why = f"fewer than {LOW_RATE:g}: more light, smaller images or another cable may help"
            holds["rate"] = Remark(f"{rate:.1f} images a second, {why}", LASTS)
        if self._light < DARK:
            holds["dark"] = Remark("images are dark; switch on a light, or take the cap off", LASTS)
        if self._light > BRIGHT:
            holds["bright"] = Remark("images are too bright; lower the exposure", LASTS)
        if not self._tag_seen:
            line = f"no tag of {self._family} in sight for {WITHOUT_TAG:.0f} s"
            holds["no tag"] = Remark(line, WITHOUT_TAG)
        return holds


def tell(refusals: Refusals, source: str, remarks: Sequence[str]) -> None:
    """Report the tags rejected in an image to the operator, each kind of reason once."""
    for remark in remarks:
        if "edge of the image" not in remark:  # every passed tag crosses the edge
            refusals.add(source, "margin" if "margin" in remark else remark, remark)


def known_calibration(name: str, camera: RobotCameraConfig) -> CameraCalibration:
    """The calibration of the camera that is called `name`; raises DeviceError."""
    # OpenCV and FFmpeg are silenced, as faults are reported here.
    os.environ.update(OPENCV_LOG_LEVEL="SILENT", OPENCV_FFMPEG_LOGLEVEL="-8")
    imported(name, "robotpy_apriltag", "camera")
    from tfg_drake.vision.calibration import CalibrationError, load_calibration

    if not camera.calibration:
        raise DeviceError(
            f"{name}: has no calibration; make one with tfg-drake camera calibrate, and give --set "
            "hardware.camera.calibration=FILE"
        )
    try:
        return load_calibration(Path(camera.calibration))
    except CalibrationError as error:
        raise DeviceError(f"{name}: {error}") from None


def known_view(name: str, camera: RobotCameraConfig) -> CameraView:
    """The camera's view; raises DeviceError."""
    calibration = known_calibration(name, camera)
    from tfg_drake.vision.camera_view import camera_view

    return camera_view(calibration, camera.tag_size)

"""A RealSense depth camera as a scanner, as a sensor's process reads it; see tfg_drake.hardware.device."""

from __future__ import annotations

import contextlib
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.config import RobotScannerConfig
from tfg_drake.hardware.device import DeviceError, imported
from tfg_drake.hardware.sensor_reader import PATIENCE, SILENT, SensorReader, stamped
from tfg_drake.messages import LaserScan
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.depth_scan import DepthScanConfig, depth_rays, depth_scan
from tfg_drake.vision.mount import CameraMount

# Modes in order of preference, of the D400 series and the L515: width and height, pixels, and rate, 1/s.
MODES = ((848, 480, 15), (640, 480, 15), (640, 480, 30))
# Least and greatest depth along the axis, and standard deviation of a range, m.
LEAST_DEPTH, MOST_DEPTH, SIGMA = 0.3, 5.0, 0.03
# Standard deviation of a pixel's depth at 1 m, m: a D435 has 0.08 pixels of disparity error, a focal length of 424
# pixels and a baseline of 5 cm.
NOISE = 0.004


class RealsenseDriver(SensorReader):
    """Makes a scan of each depth image; see tfg_drake.hardware.device.Driver. A camera that was unplugged is opened
    again."""

    def __init__(self, device: str, mount: RobotScannerConfig) -> None:
        """Waits for the first image; raises DeviceError. device: serial number of the camera, path of a recording, or
        empty for any camera."""
        name = f"realsense:{device}"
        super().__init__(name, {LaserScan: f"scan of {name}"})
        self._rs = imported(name, "pyrealsense2", "realsense")
        self._wants = device
        self._mount = CameraMount(mount.x, mount.y, mount.z, mount.yaw, mount.pitch, math.pi if mount.flip else 0.0)
        try:
            limits = mount.low, mount.high, LEAST_DEPTH, MOST_DEPTH, MOST_DEPTH
            self._config = DepthScanConfig(*limits, SIGMA, noise=NOISE)
        except ValueError as error:
            raise DeviceError(f"{name}: {error}") from None
        self._begin()

    def _missing(self) -> str:
        return "" if self._messages else f"no depth image in {PATIENCE:.0f} s; plug the camera into a USB 3 port"

    def _connect(self) -> None:
        """Raises DeviceError."""
        rs, pipeline = self._rs, self._rs.pipeline()
        try:
            profile = pipeline.start(self._wanted(pipeline))
            stream = profile.get_stream(rs.stream.depth).as_video_stream_profile()
            self._unit = profile.get_device().first_depth_sensor().get_depth_scale()
        except DeviceError:
            raise
        except RuntimeError as error:
            raise DeviceError(f"{self.name}: {' '.join(str(error).split())}; is the camera there, and free?") from None
        sees = stream.get_intrinsics()
        matrix = np.array([[sees.fx, 0.0, sees.ppx], [0.0, sees.fy, sees.ppy], [0.0, 0.0, 1.0]])
        # Depth images are rectified by the camera.
        calibration = CameraCalibration(sees.width, sees.height, matrix, "plumb_bob", np.zeros(0))
        self._rays = depth_rays(calibration, self._mount, self._config)
        self._device, self._heard = pipeline, time.monotonic()

    def _wanted(self, pipeline: Any) -> Any:
        """The configuration of the first mode that the camera has; raises RuntimeError, DeviceError."""
        rs = self._rs
        config = rs.config()
        if Path(self._wants).is_file():
            config.enable_device_from_file(self._wants, repeat_playback=False)
            config.enable_stream(rs.stream.depth)
            return config
        for width, height, rate in MODES:
            config = rs.config()
            if self._wants:
                config.enable_device(self._wants)
            config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
            if config.can_resolve(rs.pipeline_wrapper(pipeline)):
                return config
        raise DeviceError(f"{self.name}: no such camera; plug one in, give its serial number or name a recording")

    def _receive(self, left: float) -> None:
        try:
            arrived, frames = self._device.try_wait_for_frames(max(1, round(1000.0 * left)))
        except RuntimeError:
            arrived, frames = False, None
        now = time.monotonic()
        depth = frames.get_depth_frame() if arrived else None
        if depth:
            self._heard = now
            image = np.asanyarray(depth.get_data()) * np.float32(self._unit)
            self._messages.append(depth_scan(image, self._rays, self._stamp(depth, now), self._config))
        elif now - self._heard > SILENT:
            self._lose("no more depth images: is the camera plugged in? It is looked for")

    def _stamp(self, depth: Any, arrival: float) -> float:
        """When the image was taken, s of the host's monotonic clock."""
        if depth.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock:
            return arrival
        return stamped(1e-3 * float(depth.get_timestamp()) - time.time() + time.monotonic(), arrival, arrival)

    def _hang_up(self) -> None:
        if self._device is not None:
            with contextlib.suppress(RuntimeError):  # the camera is gone already
                self._device.stop()
        self._device = None

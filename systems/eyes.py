"""Eyes of pixels: a camera's images to the messages of tag sensor and laser scanner."""

from __future__ import annotations

import math

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from tfg_drake.config import CameraRealityConfig
from tfg_drake.messages import LaserScan
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.depth_noise import with_noise
from tfg_drake.vision.depth_scan import DepthScanConfig, depth_rays, depth_scan
from tfg_drake.vision.exposure import exposed
from tfg_drake.vision.hue import photographed
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.same_view import no_views, weighed
from tfg_drake.vision.sighting import Sighting, TagNoise, TagSizes, nothing_sighted, sighted
from tfg_drake.vision.tag_detector import TagDetector as Detector

# A number between 0 and 1 is so many seeds.
_SEEDS = 2**32
# Between the seeds of a depth image and of a grey one of the same instant.
_OTHER = 1


class Exposure(LeafSystem):
    """Makes grey of hues, blurs, darkens, puts noise on it, see tfg_drake.vision.hue and tfg_drake.vision.exposure.

    .. pydrake_system::

        name: Exposure
        input_ports:
        - image
        - pose
        - noise
        output_ports:
        - image

    image: an ImageRgba8U; the output's is grey. pose: x, y, theta, v, w of the plant: an image moves sideways as the
    robot turns. noise: a uniform number, fresh every frame.
    """

    def __init__(self, width: int, height: int, focal_length: float, reality: CameraRealityConfig):
        """width, height: of the image, focal_length: pixels."""
        super().__init__()
        self._reality, self._blur = reality, focal_length * reality.exposure_time
        self._image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageRgba8U()))
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._noise = self.DeclareVectorInputPort("noise", 1, RandomDistribution.kUniform)
        self.DeclareAbstractOutputPort(
            "image",
            lambda: AbstractValue.Make(ImageRgba8U(width, height)),
            self._CalcImage,
            {self._image.ticket(), self._pose.ticket(), self._noise.ticket()},
        )

    @metered("camera")
    def _CalcImage(self, context: Context, output: AbstractValue) -> None:
        rendered = self._image.Eval(context).data
        seed = int(_SEEDS * self._noise.Eval(context)[0])
        seen = exposed(photographed(rendered), self._blur * self._pose.Eval(context)[4], self._reality, seed)
        data = output.get_mutable_value().mutable_data
        data[..., :3], data[..., 3] = seen[..., None], 255


class TagDetector(LeafSystem):
    """Range and bearing of the tags in a camera's images, once a frame, see tfg_drake.vision.

    .. pydrake_system::

        name: TagDetector
        input_ports:
        - image
        output_ports:
        - detections
        - remarks

    image: an ImageRgba8U, as the port color_image of Drake's RgbdSensor has it. detections: a TagDetections message,
    stamped with the time of its image; stamped -inf and empty before the first. remarks: tuple of lines, what was left
    out of the newest image and why. What Drake renders is calibrated by tfg_drake.systems.rendered_world.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        sizes: TagSizes,
        mount: CameraMount,
        rate: float = 8.0,
        noise: TagNoise | None = None,
        least_side: float = 0.0,
    ):
        """rate: frames a second, Hz. Else see tfg_drake.vision.sighting.sighted."""
        super().__init__()
        self._detector = Detector()
        self._sheet = (calibration, sizes, mount, noise)
        self._least_side = least_side
        self._image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageRgba8U()))
        self._state = MessageState(self, nothing_sighted())
        self._views = MessageState(self, no_views())
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / rate, 0.0, self._Detect)
        self._state.declare_outputs(self, "detections", "remarks")

    @metered("tag_detector")
    def _Detect(self, context: Context, state: State) -> None:
        tags = self._detector.detect(self._image.Eval(context).data)
        sighting = sighted(tags, context.get_time(), *self._sheet, least_side=self._least_side)
        detections, views = weighed(sighting.detections, tags, self._views(context))
        self._state.set(state, Sighting(detections, sighting.remarks))
        self._views.set(state, views)


class DepthScanner(LeafSystem):
    """Ranges to what stands within a band of heights, see tfg_drake.vision.depth_scan.

    .. pydrake_system::

        name: DepthScanner
        input_ports:
        - image
        - noise
        output_ports:
        - ranges

    image: an ImageDepth32F, m, as the port depth_image_32f of Drake's RgbdSensor has it. noise: a uniform number, fresh
    every frame; without it the image is taken as it is, with it the configuration's noise is added. ranges: a LaserScan
    message as seen from the body's origin, stamped with the time of its image; stamped -inf and empty before the first.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        mount: CameraMount,
        config: DepthScanConfig | None = None,
        rate: float = 8.0,
    ):
        """rate: scans a second, Hz."""
        super().__init__()
        self._config = config or DepthScanConfig()
        self._rays = depth_rays(calibration, mount, self._config)
        self._image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageDepth32F()))
        self._noise = self.DeclareVectorInputPort("noise", 1, RandomDistribution.kUniform)
        nothing = LaserScan(-math.inf, np.zeros(0), np.zeros(0), self._config.range_max, self._config.sigma)
        self._message = MessageState(self, nothing)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / rate, 0.0, self._Scan)
        self.DeclareStateOutputPort("ranges", self._message.index)

    @metered("depth_scanner")
    def _Scan(self, context: Context, state: State) -> None:
        depth = self._image.Eval(context).data[..., 0]
        if self._noise.HasValue(context):
            depth = with_noise(depth, self._config.noise, int(_SEEDS * self._noise.Eval(context)[0]) + _OTHER)
        self._message.set(state, depth_scan(depth, self._rays, context.get_time(), self._config))

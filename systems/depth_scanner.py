"""The depth scanner: converts a depth camera's images to LaserScan messages."""

from __future__ import annotations

import math

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F

from tfg_drake.messages import LaserScan
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.depth_scan import DepthScanConfig, depth_rays, depth_scan, with_noise
from tfg_drake.vision.mount import CameraMount

# _SEEDS: number of seeds that a random number in [0, 1) selects from. _OTHER: offset from the seed of the grey image
# of the same instant.
_SEEDS, _OTHER = 2**32, 1


class DepthScanner(LeafSystem):
    """Measures ranges to obstacles within a band of heights, see tfg_drake.vision.depth_scan.

    .. pydrake_system::

        name: DepthScanner
        input_ports:
        - image
        - noise
        output_ports:
        - ranges

    image: an ImageDepth32F, m, as the port depth_image_32f of Drake's RgbdSensor. noise: a uniform number, drawn anew
    for every frame; if connected, the configuration's noise is added to the image. ranges: a LaserScan message as seen
    from the body's origin, stamped with the time of its image; stamped -inf and empty before the first image.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        mount: CameraMount,
        config: DepthScanConfig | None = None,
        rate: float = 8.0,
    ):
        """rate: of scans, Hz."""
        super().__init__()
        self._config = config or DepthScanConfig()
        self._rays = depth_rays(calibration, mount, self._config)
        self._image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageDepth32F()))
        self._noise = self.DeclareVectorInputPort("noise", 1, RandomDistribution.kUniform)
        nothing = LaserScan(-math.inf, np.zeros(0), np.zeros(0), self._config.range_max, self._config.sigma)
        self.DeclareStateOutputPort("ranges", MessageState(self, nothing, self._Scan, 1.0 / rate).index)

    @metered("depth_scanner")
    def _Scan(self, context: Context, _before: LaserScan) -> LaserScan:
        depth = self._image.Eval(context).data[..., 0]
        if self._noise.HasValue(context):
            depth = with_noise(depth, self._config.noise, int(_SEEDS * self._noise.Eval(context)[0]) + _OTHER)
        return depth_scan(depth, self._rays, context.get_time(), self._config)

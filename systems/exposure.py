"""The exposure: adds the imperfections of a real camera to rendered images."""

from __future__ import annotations

from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageRgba8U

from tfg_drake.config import CameraRealityConfig
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.vision.exposure import exposed
from tfg_drake.vision.hue import photographed

# Number of seeds that a random number in [0, 1) selects from.
_SEEDS = 2**32


class Exposure(LeafSystem):
    """Converts hue-coded images to grey, blurs and darkens them and adds noise, see tfg_drake.vision.hue and
    tfg_drake.vision.exposure.

    .. pydrake_system::

        name: Exposure
        input_ports:
        - image
        - pose
        - noise
        output_ports:
        - image

    image: an ImageRgba8U; the output image is grey. pose: x, y, theta, v, w of the plant, whose turn rate blurs the
    image sideways. noise: a uniform number, drawn anew for every frame.
    """

    def __init__(self, width: int, height: int, focal_length: float, reality: CameraRealityConfig):
        """width, height: size of the image, focal_length; all in pixels."""
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

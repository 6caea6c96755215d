"""The tag detector: converts a camera's images to TagDetections messages."""

from __future__ import annotations

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State
from pydrake.systems.sensors import ImageRgba8U

from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.same_view import no_views, weighed
from tfg_drake.vision.sighting import Sighting, TagNoise, TagSizes, nothing_sighted, sighted
from tfg_drake.vision.tag_detector import TagDetector as Detector


class TagDetector(LeafSystem):
    """Measures range and bearing of the tags in each frame of a camera, see tfg_drake.vision.

    .. pydrake_system::

        name: TagDetector
        input_ports:
        - image
        output_ports:
        - detections
        - remarks

    image: an ImageRgba8U, as the port color_image of Drake's RgbdSensor. detections: a TagDetections message, stamped
    with the time of its image; stamped -inf and empty before the first. remarks: tuple of lines, the tags rejected in
    the newest image and why. tfg_drake.systems.rendered_world makes the calibration of Drake's images.
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
        """rate: of frames, Hz. For the others see tfg_drake.vision.sighting.sighted."""
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

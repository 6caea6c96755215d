"""The tag detector: a camera's images to the tag sensor's message."""

from __future__ import annotations

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State
from pydrake.systems.sensors import ImageRgba8U

from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import declare_message_output, set_state_message, state_message
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.same_view import Views, no_views, weighed
from tfg_drake.vision.sighting import Sighting, TagNoise, TagSizes, nothing_sighted, sighted
from tfg_drake.vision.tag_detector import TagDetector as Detector


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
    out of the newest image and why. What Drake renders is calibrated by tfg_drake.systems.camera_info.
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
        self._state = self.DeclareAbstractState(AbstractValue.Make(nothing_sighted()))
        self._views = self.DeclareAbstractState(AbstractValue.Make(no_views()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / rate, 0.0, self._Detect)
        tickets = {self.abstract_state_ticket(self._state)}
        declare_message_output(self, "detections", lambda context: self._Newest(context).detections, tickets)
        declare_message_output(self, "remarks", lambda context: self._Newest(context).remarks, tickets)

    def _Newest(self, context: Context) -> Sighting:
        return state_message(context, self._state, Sighting)

    @metered("tag_detector")
    def _Detect(self, context: Context, state: State) -> None:
        tags = self._detector.detect(self._image.Eval(context).data)
        sighting = sighted(tags, context.get_time(), *self._sheet, least_side=self._least_side)
        detections, views = weighed(sighting.detections, tags, state_message(context, self._views, Views))
        set_state_message(state, self._state, Sighting(detections, sighting.remarks))
        set_state_message(state, self._views, views)

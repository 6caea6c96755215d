"""The simulated tag sensor."""

from __future__ import annotations

from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State

from tfg_drake.config import TagSensorConfig
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect, no_detections
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import set_state_message
from tfg_drake.world.world import World


class TagSensor(LeafSystem):
    """Range and bearing of the tags in view, once a frame, see tfg_drake.simulation.tag_sensor.

    .. pydrake_system::

        name: TagSensor
        input_ports:
        - pose
        - noise
        output_ports:
        - detections

    pose: x, y, theta, v, w of the plant. noise: NOISE_PER_TAG standard normal numbers for each of the world's tags,
    fresh every frame. detections: a TagDetections message; stamped -inf and empty before the first frame.
    """

    def __init__(self, world: World, config: TagSensorConfig):
        super().__init__()
        self._world, self._config = world, config
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._noise = self.DeclareVectorInputPort(
            "noise", NOISE_PER_TAG * len(world.tag_ids), RandomDistribution.kGaussian
        )
        self._message = self.DeclareAbstractState(AbstractValue.Make(no_detections()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / config.rate, 0.0, self._Detect)
        self.DeclareStateOutputPort("detections", self._message)

    @metered("tag_sensor")
    def _Detect(self, context: Context, state: State) -> None:
        X_WB = self._pose.Eval(context)[:3]
        noise = self._noise.Eval(context).reshape(-1, NOISE_PER_TAG)
        message = detect(self._world, X_WB, context.get_time(), noise, self._config)
        set_state_message(state, self._message, message)

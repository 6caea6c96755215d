"""The simulated tag sensor."""

from __future__ import annotations

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import Context, LeafSystem
from scipy.special import ndtr

from tfg_drake.config import TagRealityConfig, TagSensorConfig, as_it_is
from tfg_drake.geometry.se2 import compose
from tfg_drake.messages import FloatArray, TagDetections, message, replace
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, correlated, detect, no_detections
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState
from tfg_drake.systems.surroundings import Surroundings
from tfg_drake.world.world import World


@message
class _SensorState:
    """The newest frame, and the noise (n, 2) with which the next frame's is correlated, empty for white noise."""

    frame: TagDetections
    noise: FloatArray


class TagSensor(LeafSystem):
    """Measures range and bearing of the tags in view in each frame, see tfg_drake.simulation.tag_sensor.

    .. pydrake_system::

        name: TagSensor
        input_ports:
        - pose
        - noise
        - tag_errors
        - frame_noise
        - people
        - world
        output_ports:
        - detections

    pose: x, y, theta, v, w of the plant. noise: NOISE_PER_TAG standard normal numbers for each of the world's tags,
    drawn anew for every frame; tag_errors: 2 for each tag, constant during a run; frame_noise: 2, drawn anew for every
    frame. The last two may be unconnected if reality does not use them. people: a People message, who hide tags;
    unconnected without people. world: a WorldNow message, unconnected if the world is constant. detections: a
    TagDetections message; stamped -inf and empty before the first frame.
    """

    def __init__(self, world: World, config: TagSensorConfig, reality: TagRealityConfig | None = None):
        """config: the data sheet. reality: deviations of the real sensor from it."""
        super().__init__()
        reality = reality or TagRealityConfig()
        self._world, self._stated, self._reality = world, config, reality
        self._config = as_it_is(config, reality)
        self._X_BS = np.array([reality.ahead, reality.left, reality.yaw])
        self._pose = self.DeclareVectorInputPort("pose", 5)
        n, gaussian = len(world.tag_ids), RandomDistribution.kGaussian
        self._noise = self.DeclareVectorInputPort("noise", NOISE_PER_TAG * n, gaussian)
        self._tag_errors = self.DeclareVectorInputPort("tag_errors", 2 * n, gaussian)
        self._frame_noise = self.DeclareVectorInputPort("frame_noise", 2, gaussian)
        self._around = Surroundings(self, world)
        self.has_tag_errors = reality.tag_range_error > 0.0 or reality.tag_bearing_error > 0.0
        self.has_frame_noise = reality.clock_jitter > 0.0 or reality.frame_loss_probability > 0.0
        is_white = reality.correlation_time == 0.0
        initial = _SensorState(no_detections(), np.zeros((0, 2)) if is_white else np.zeros((n, 2)))
        state = MessageState(self, initial, self._Detect, 1.0 / config.rate)
        state.declare_outputs(self, detections=lambda now: now.frame)

    @metered("tag_sensor")
    def _Detect(self, context: Context, now: _SensorState) -> _SensorState:
        reality, pose = self._reality, self._pose.Eval(context)
        fresh = self._noise.Eval(context).reshape(-1, NOISE_PER_TAG)
        noise = now.noise
        if len(noise):
            first = not np.isfinite(now.frame.stamp)
            interval = np.inf if first else 1.0 / self._config.rate
            noise = correlated(noise, fresh[:, :2], interval, reality.correlation_time)
            fresh = np.column_stack([noise, fresh[:, 2]])
        stamp = context.get_time() + reality.clock_offset
        if self.has_frame_noise:
            lost, late = self._frame_noise.Eval(context)
            if ndtr(lost) < reality.frame_loss_probability:
                return now
            stamp += reality.clock_jitter * late
        if 0.0 < reality.blurring_turn_rate < abs(pose[4]):
            return _SensorState(replace(no_detections(), stamp=stamp), noise)
        errors = None
        if self.has_tag_errors:
            errors = self._tag_errors.Eval(context).reshape(-1, 2)
            errors = errors * np.array([reality.tag_range_error, reality.tag_bearing_error])
        world = self._around.world(context)
        if len(world.tag_ids) < len(fresh):
            # Some tags have fallen off the walls.
            there = np.isin(self._world.tag_ids, world.tag_ids)
            fresh, errors = fresh[there], errors[there] if errors is not None else None
        X_WS = compose(pose[:3], self._X_BS) if self._X_BS.any() else pose[:3]
        discs = self._around.people(context)
        frame = detect(world, X_WS, stamp, fresh, self._config, self._stated, errors, discs, reality.detection_range)
        return _SensorState(frame, noise)

"""The simulated laser scanner."""

from __future__ import annotations

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import ScanConfig, ScanRealityConfig, as_it_is
from tfg_drake.geometry.se2 import compose
from tfg_drake.messages import LaserScan, replace
from tfg_drake.simulation.laser_scanner import along_rays, no_scan, ray_angles, scan, spoilt, swept
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState
from tfg_drake.systems.surroundings import Surroundings
from tfg_drake.world.world import World


class LaserScanner(LeafSystem):
    """Measures ranges to walls and people, see tfg_drake.simulation.laser_scanner.

    .. pydrake_system::

        name: LaserScanner
        input_ports:
        - pose
        - noise
        - ray_faults
        - people
        - world
        output_ports:
        - ranges

    pose: x, y, theta, v, w of the plant. noise: one standard normal number per ray, drawn anew for every scan;
    ray_faults: one uniform number per ray, likewise, unconnected if no ray fails in reality. people: a People message,
    unconnected without people. world: a WorldNow message, unconnected if the world is constant. ranges: a LaserScan
    message; stamped -inf and empty before the first scan.
    """

    def __init__(self, world: World, config: ScanConfig, reality: ScanRealityConfig | None = None):
        """config: the data sheet. reality: deviations of the real scanner from it."""
        super().__init__()
        reality = reality or ScanRealityConfig()
        self._stated, self._reality = config, reality
        self._config, self._X_BS = as_it_is(config, reality), np.array([reality.ahead, reality.left, reality.yaw])
        self.has_ray_faults = reality.dropout_probability > 0.0 or reality.mixed_probability > 0.0
        # Arrays as a message holds them, shared by all messages.
        self._angles = replace(no_scan(config), angles=ray_angles(config)).angles
        self._towards = replace(no_scan(config), angles=-self._angles).angles if reality.flip else self._angles
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._noise = self.DeclareVectorInputPort("noise", len(self._angles), RandomDistribution.kGaussian)
        self._ray_faults = self.DeclareVectorInputPort("ray_faults", len(self._angles), RandomDistribution.kUniform)
        self._around = Surroundings(self, world)
        state = MessageState(self, no_scan(config), self._Scan, 1.0 / config.rate)
        self.DeclareStateOutputPort("ranges", state.index)

    @metered("laser_scanner")
    def _Scan(self, context: Context, _before: LaserScan) -> LaserScan:
        robot, sweep_time = self._pose.Eval(context), self._reality.sweep_time
        noise, stamp = self._noise.Eval(context), context.get_time() + self._reality.clock_offset
        if self._reality.correlation_angle > 0.0:
            noise = along_rays(noise, self._angles, self._reality.correlation_angle)
        walls = self._around.world(context).walls
        discs = self._around.people(context)
        sheets = (stamp, self._towards, noise, self._config, self._stated, discs)
        if sweep_time > 0.0:
            message = swept(walls, robot, self._X_BS, sweep_time, *sheets)
        else:
            message = scan(walls, compose(robot[:3], self._X_BS) if self._X_BS.any() else robot[:3], *sheets)
        message = replace(message, angles=self._angles)
        return spoilt(message, self._ray_faults.Eval(context), self._reality) if self.has_ray_faults else message

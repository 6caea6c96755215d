"""The simulated laser scanner."""

from __future__ import annotations

from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State

from tfg_drake.config import ScanConfig
from tfg_drake.messages import replace
from tfg_drake.simulation.laser_scanner import no_scan, ray_angles, scan
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import set_state_message
from tfg_drake.world.world import World


class LaserScanner(LeafSystem):
    """Ranges to the walls ahead, see tfg_drake.simulation.laser_scanner.

    .. pydrake_system::

        name: LaserScanner
        input_ports:
        - pose
        - noise
        output_ports:
        - ranges

    pose: x, y, theta, v, w of the plant. noise: one standard normal number a ray, fresh every scan. ranges: a LaserScan
    message; stamped -inf and empty before the first scan.
    """

    def __init__(self, world: World, config: ScanConfig):
        super().__init__()
        self._walls, self._config = world.walls, config
        # A message's own, which every other shares.
        self._angles = replace(no_scan(config), angles=ray_angles(config)).angles
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._noise = self.DeclareVectorInputPort("noise", len(self._angles), RandomDistribution.kGaussian)
        self._message = self.DeclareAbstractState(AbstractValue.Make(no_scan(config)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / config.rate, 0.0, self._Scan)
        self.DeclareStateOutputPort("ranges", self._message)

    @metered("laser_scanner")
    def _Scan(self, context: Context, state: State) -> None:
        X_WB = self._pose.Eval(context)[:3]
        noise = self._noise.Eval(context)
        message = scan(self._walls, X_WB, context.get_time(), self._angles, noise, self._config)
        set_state_message(state, self._message, message)

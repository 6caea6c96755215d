"""The simulated wheel encoders and gyro."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from tfg_drake.config import DisturbanceConfig, OdometryConfig, OdometryRealityConfig, as_it_is
from tfg_drake.messages import FloatArray
from tfg_drake.simulation.differential_drive import UNMOVED
from tfg_drake.simulation.disturbance import Pushes, displacement, with_pushes
from tfg_drake.simulation.odometry import TIME, initial_state, integrate, message, run_errors
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import PERIOD, MessageInputs, declare_message_output


class Odometry(LeafSystem):
    """Integrates the true motion with the errors of wheels and gyro, see tfg_drake.simulation.odometry.

    .. pydrake_system::

        name: Odometry
        input_ports:
        - pose
        - noise
        - run_errors
        - pushes
        output_ports:
        - odometry

    pose: x, y, theta, v, w of the plant. noise: 2 standard normal numbers, drawn anew every PERIOD. run_errors: 3
    standard normal numbers, constant during a run. pushes: a Pushes message, unconnected without pushes. odometry: an
    Odometry message; X_OB is 0 at the start X_WS (3,).
    """

    def __init__(
        self,
        X_WS: FloatArray,
        config: OdometryConfig,
        disturbances: Sequence[DisturbanceConfig] = (),
        reality: OdometryRealityConfig | None = None,
    ):
        """config: the data sheet. disturbances: motions of the base that its wheels do not measure. reality: deviations
        of wheels and gyro from the data sheet."""
        super().__init__()
        reality = reality or OdometryRealityConfig()
        self._config, self._disturbances = as_it_is(config, reality), tuple(disturbances)
        self._reality = reality
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._noise = self.DeclareVectorInputPort("noise", 2, RandomDistribution.kGaussian)
        self._run_errors = self.DeclareVectorInputPort("run_errors", 3, RandomDistribution.kGaussian)
        self._inputs = MessageInputs(self, pushes=Pushes)
        self.DeclareDiscreteState(initial_state(X_WS))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._Integrate)
        declare_message_output(self, "odometry", self._Message, {self.xd_ticket()})

    def _Message(self, context: Context) -> object:
        return message(context.get_discrete_state_vector().value())

    @metered("odometry")
    def _Integrate(self, context: Context, update: DiscreteValues) -> None:
        state = context.get_discrete_state_vector().value()
        errors = run_errors(self._run_errors.Eval(context), self._config)
        noise, pose, now = self._noise.Eval(context), self._pose.Eval(context), context.get_time()
        disturbances = with_pushes(self._disturbances, self._inputs.optional(context, "pushes"))
        moved = displacement(disturbances, state[TIME], now) if disturbances else UNMOVED
        update.set_value(integrate(state, now, pose, errors, noise, self._config, moved, self._reality))

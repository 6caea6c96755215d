"""The filter between any controller and the base."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from tfg_drake.config import RobotConfig, SafetyConfig
from tfg_drake.cpu_meter import metered_in_detail
from tfg_drake.messages import Hazards, LaserScan
from tfg_drake.simulation.safety import STATE_SIZE, filter_command, stopped
from tfg_drake.systems.ports import declare_message_input, eval_message

PERIOD = 1.0 / 32.0


class SafetyFilter(LeafSystem):
    """Lets through what is safe, see tfg_drake.simulation.safety. An unconnected command is zero.

    .. pydrake_system::

        name: SafetyFilter
        input_ports:
        - velocity_commanded
        - hazards
        - scan
        - enable
        output_ports:
        - velocity
        - enabled

    velocity_commanded, velocity: forward speed (m/s) and turn rate (rad/s). hazards: a Hazards message. scan: a
    LaserScan message. enable, enabled: vectors of size 1; the base stands while it is 0, unconnected it is 1.
    """

    def __init__(self, robot: RobotConfig, safety: SafetyConfig):
        super().__init__()
        self._robot, self._safety = robot, safety
        self._command = self.DeclareVectorInputPort("velocity_commanded", 2)
        self._hazards = declare_message_input(self, "hazards")
        self._scan = declare_message_input(self, "scan")
        self._enable = self.DeclareVectorInputPort("enable", 1)
        # The filter's own state, and whether the base may move.
        self.DeclareDiscreteState(np.append(np.zeros(STATE_SIZE), 1.0))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._Filter)
        self.DeclareVectorOutputPort("velocity", 2, self._CalcVelocity, {self.xd_ticket()})
        self.DeclareVectorOutputPort("enabled", 1, self._CalcEnabled, {self.xd_ticket()})

    @metered_in_detail("safety_filter")
    def _Filter(self, context: Context, update: DiscreteValues) -> None:
        enabled = not self._enable.HasValue(context) or self._enable.Eval(context)[0] != 0.0
        state = context.get_discrete_state_vector().value()[:STATE_SIZE]
        if not enabled:
            update.set_value(np.append(stopped(state, self._robot, PERIOD), 0.0))
            return
        command = self._command.Eval(context) if self._command.HasValue(context) else np.zeros(2)
        hazards = eval_message(self._hazards, context, Hazards)
        scan = eval_message(self._scan, context, LaserScan)
        now = context.get_time()
        after = filter_command(state, now, command, hazards, scan, self._robot, self._safety, PERIOD)
        update.set_value(np.append(after, 1.0))

    def _CalcVelocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[:2])

    def _CalcEnabled(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, context.get_discrete_state_vector().value()[STATE_SIZE])

"""The simulated base: a round differential drive among walls."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from tfg_drake.config import DisturbanceConfig, RobotConfig
from tfg_drake.messages import FloatArray, Hazards
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation.disturbance import Pushes, displacement, with_pushes
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import COMMAND_PERIOD, MessageInputs, declare_message_output
from tfg_drake.systems.surroundings import Surroundings
from tfg_drake.world.world import World


class DifferentialDrivePlant(LeafSystem):
    """Follows a velocity command within the robot's limits until it hits a wall, see
    tfg_drake.simulation.differential_drive.

    .. pydrake_system::

        name: DifferentialDrivePlant
        input_ports:
        - velocity_commanded
        - people
        - world
        - pushes
        output_ports:
        - pose
        - hazards
        - contacts
        - clearance
        - contacts_received

    velocity_commanded: forward speed (m/s) and turn rate (rad/s). people: a People message, unconnected without people.
    world: a WorldNow message, unconnected if the world is constant. pushes: a Pushes message, unconnected without
    pushes. pose: x, y, theta of X_WB (m, rad), speed (m/s) and turn rate (rad/s), continuous in time, also between
    steps. hazards: a Hazards message. contacts: number of contacts with walls, and with people whom the base moved
    towards. clearance: least distance of the outline to any wall so far, m. contacts_received: number of contacts that
    people caused, and with walls during a push or slip.
    """

    def __init__(self, world: World, robot: RobotConfig, disturbances: Sequence[DisturbanceConfig] = ()):
        """disturbances: motions of the base that its wheels do not cause."""
        super().__init__()
        self._robot, self._disturbances = robot, tuple(disturbances)
        self._command = self.DeclareVectorInputPort("velocity_commanded", 2)
        self._around = Surroundings(self, world)
        self._inputs = MessageInputs(self, pushes=Pushes)
        self.DeclareDiscreteState(drive.initial_state(world.start, world.walls, robot))
        self.DeclarePeriodicDiscreteUpdateEvent(COMMAND_PERIOD, 0.0, self._Step)
        state = self.xd_ticket()
        self.DeclareVectorOutputPort("pose", 5, self._CalcPose, {state, self.time_ticket()})
        declare_message_output(self, "hazards", self._Hazards, {state, self.time_ticket()})
        told = {"contacts": drive.CONTACTS, "clearance": drive.CLEARANCE, "contacts_received": drive.RECEIVED}
        for name, entry in told.items():
            self.DeclareVectorOutputPort(name, 1, partial(self._CalcEntry, entry), {state})

    @metered("differential_drive_plant")
    def _Step(self, context: Context, update: DiscreteValues) -> None:
        command, state = self._command.Eval(context), self._State(context)
        walls, moved = self._around.world(context).walls, drive.UNMOVED
        disturbances = with_pushes(self._disturbances, self._inputs.optional(context, "pushes"))
        if disturbances:
            moved = displacement(disturbances, state[drive.TIME], state[drive.TIME] + COMMAND_PERIOD)
        after = drive.step(state, command, walls, self._robot, COMMAND_PERIOD, moved)
        discs = self._around.people(context, after[drive.TIME])
        if discs is not None:
            after = drive.among(state, after, discs, self._robot)
        update.set_value(after)

    def _State(self, context: Context) -> FloatArray:
        state: FloatArray = context.get_discrete_state_vector().value()
        return state

    @metered("differential_drive_plant")
    def _CalcPose(self, context: Context, output: BasicVector) -> None:
        # Sensors whose period is no multiple of COMMAND_PERIOD read the pose in the middle of a step.
        output.SetFromVector(drive.pose_at(self._State(context), context.get_time()))

    def _Hazards(self, context: Context) -> Hazards:
        return Hazards(context.get_time(), int(self._State(context)[drive.BUMPER]), cliff=0, wheel_drop=0)

    def _CalcEntry(self, entry: int, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._State(context)[entry])

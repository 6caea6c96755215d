"""The people who walk about in the simulated building."""

from __future__ import annotations

from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, InputPort, LeafSystem, State

from tfg_drake.messages import FloatArray
from tfg_drake.simulation.people import NUMBERS, People, discs_at, first_met, ground, nobody, step
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import eval_message, set_state_message, state_message
from tfg_drake.world.world import World

PERIOD = 1.0 / 8.0


def people_at(port: InputPort, context: Context) -> FloatArray | None:
    """The people at a port for People messages as discs (n, 3), m in W, at the context's time; None where it is not
    connected."""
    return discs_at(eval_message(port, context, People), context.get_time()) if port.HasValue(context) else None


class PeopleWalking(LeafSystem):
    """People among the walls, and the robot among them, see tfg_drake.simulation.people.

    .. pydrake_system::

        name: PeopleWalking
        input_ports:
        - pose
        - numbers
        output_ports:
        - people

    pose: x, y, theta, v, w of the plant. numbers: NUMBERS uniform numbers a person, fresh every PERIOD. people: a
    People message, nobody before the first step.
    """

    def __init__(self, world: World, robot_radius: float, count: int):
        """robot_radius: m. count: of people. Raises WorldError where there is no room for any."""
        super().__init__()
        self._ground, self._robot_radius, self._count = ground(world, robot_radius), robot_radius, count
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._numbers = self.DeclareVectorInputPort("numbers", NUMBERS * count, RandomDistribution.kUniform)
        self._people = self.DeclareAbstractState(AbstractValue.Make(nobody()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Step)
        self.DeclareStateOutputPort("people", self._people)

    @metered("people")
    def _Step(self, context: Context, state: State) -> None:
        now, time = state_message(context, self._people, People), context.get_time()
        robot, numbers = self._pose.Eval(context), self._numbers.Eval(context).reshape(self._count, NUMBERS)
        if len(now.p_WP):
            after = step(now, time, PERIOD, robot, self._robot_radius, numbers, self._ground)
        else:
            after = first_met(time, robot, numbers, self._ground)
        set_state_message(state, self._people, after)

"""Simulated people who walk in the building."""

from __future__ import annotations

import functools

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.simulation.people import NUMBERS, People, astray, first_met, ground, nobody, step
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState
from tfg_drake.systems.surroundings import PERIOD
from tfg_drake.world.changing import WorldNow
from tfg_drake.world.world import World


class PeopleWalking(LeafSystem):
    """Moves people between walls and robot, see tfg_drake.simulation.people.

    .. pydrake_system::

        name: PeopleWalking
        input_ports:
        - pose
        - numbers
        - world
        output_ports:
        - people

    pose: x, y, theta, v, w of the plant. numbers: NUMBERS uniform numbers per person, drawn anew every PERIOD. world: a
    WorldNow message, unconnected if the world is constant. people: a People message, empty before the first step.
    """

    def __init__(self, world: World, robot_radius: float, count: int):
        """robot_radius: m. count: of people. Raises WorldError if there is no room for anyone."""
        super().__init__()
        self._ground, self._robot_radius, self._count = ground(world, robot_radius), robot_radius, count
        self._ChangedGround = functools.lru_cache(maxsize=1)(lambda changed: ground(changed, robot_radius))
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._numbers = self.DeclareVectorInputPort("numbers", NUMBERS * count, RandomDistribution.kUniform)
        self._inputs = MessageInputs(self, world=WorldNow)
        self.DeclareStateOutputPort("people", MessageState(self, nobody(), self._Step, PERIOD).index)

    @metered("people")
    def _Step(self, context: Context, now: People) -> People:
        time, robot = context.get_time(), self._pose.Eval(context)
        numbers = self._numbers.Eval(context).reshape(self._count, NUMBERS)
        floor = self._ground
        changing = self._inputs.optional(context, "world")
        if changing is not None and changing.count:
            floor = self._ChangedGround(changing.world)
            if changing.since >= now.stamp:
                now = astray(now)
        if len(now.p_WP):
            return step(now, time, PERIOD, robot, self._robot_radius, numbers, floor)
        return first_met(time, robot, numbers, floor)

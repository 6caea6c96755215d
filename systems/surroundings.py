"""What surrounds a simulated robot and moves: a world that changes, people who walk about in it."""

from __future__ import annotations

import functools
from collections.abc import Sequence

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ChangeConfig
from tfg_drake.messages import FloatArray
from tfg_drake.simulation.people import NUMBERS, People, astray, discs_at, first_met, ground, nobody, step
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState
from tfg_drake.world.changing import WorldNow, is_due, successive
from tfg_drake.world.world import World

PERIOD = 1.0 / 8.0


class ChangingWorld(LeafSystem):
    """Makes one change after the other, each when it is due, see tfg_drake.world.changing.

    .. pydrake_system::

        name: ChangingWorld
        input_ports:
        - pose
        output_ports:
        - world

    pose: x, y, theta, v, w of the plant. world: a WorldNow message.
    """

    def __init__(self, world: World, changes: Sequence[ChangeConfig], robot_radius: float):
        """changes: in their order. robot_radius: m. Raises WorldError where a change cannot be made."""
        super().__init__()
        self._changes, self._worlds, self._robot_radius = tuple(changes), successive(world, changes), robot_radius
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._now = MessageState(self, WorldNow(world, 0, 0.0))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Change)
        self.DeclareStateOutputPort("world", self._now.index)

    def _Change(self, context: Context, state: State) -> EventStatus:
        count, time = self._now(context).count, context.get_time()
        p_WB, made = self._pose.Eval(context)[:2], count
        while made < len(self._changes) and is_due(self._changes[made], time, p_WB, self._robot_radius):
            made += 1
        if made == count:
            return EventStatus.DidNothing()
        return self._now.set(state, WorldNow(self._worlds[made], made, time))


class Surroundings:
    """Inputs "people" and "world" of a simulated system, People and WorldNow; either may be unconnected."""

    def __init__(self, system: LeafSystem, world: World) -> None:
        """Declares them. world: as it is at the beginning."""
        self._world = world
        self._inputs = MessageInputs(system, people=People, world=WorldNow)

    def world(self, context: Context) -> World:
        """The world now."""
        changed = self._inputs.optional(context, "world")
        return self._world if changed is None else changed.world

    def people(self, context: Context, time: float | None = None) -> FloatArray | None:
        """The people as discs (n, 3), m in W, at a time, s, by default the context's; None where there are none."""
        walking = self._inputs.optional(context, "people")
        return None if walking is None else discs_at(walking, context.get_time() if time is None else time)


class PeopleWalking(LeafSystem):
    """People among the walls, and the robot among them, see tfg_drake.simulation.people.

    .. pydrake_system::

        name: PeopleWalking
        input_ports:
        - pose
        - numbers
        - world
        output_ports:
        - people

    pose: x, y, theta, v, w of the plant. numbers: NUMBERS uniform numbers a person, fresh every PERIOD. world: a
    WorldNow message, left unconnected where nothing changes. people: a People message, nobody before the first step.
    """

    def __init__(self, world: World, robot_radius: float, count: int):
        """robot_radius: m. count: of people. Raises WorldError where there is no room for any."""
        super().__init__()
        self._ground, self._robot_radius, self._count = ground(world, robot_radius), robot_radius, count
        self._ChangedGround = functools.lru_cache(maxsize=1)(lambda changed: ground(changed, robot_radius))
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._numbers = self.DeclareVectorInputPort("numbers", NUMBERS * count, RandomDistribution.kUniform)
        self._inputs = MessageInputs(self, world=WorldNow)
        self._people = MessageState(self, nobody())
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Step)
        self.DeclareStateOutputPort("people", self._people.index)

    @metered("people")
    def _Step(self, context: Context, state: State) -> None:
        now, time = self._people(context), context.get_time()
        robot, numbers = self._pose.Eval(context), self._numbers.Eval(context).reshape(self._count, NUMBERS)
        floor = self._ground
        changing = self._inputs.optional(context, "world")
        if changing is not None and changing.count:
            floor = self._ChangedGround(changing.world)
            if changing.since >= now.stamp:
                now = astray(now)
        if len(now.p_WP):
            after = step(now, time, PERIOD, robot, self._robot_radius, numbers, floor)
        else:
            after = first_met(time, robot, numbers, floor)
        self._people.set(state, after)

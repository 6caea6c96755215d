"""The world and the people round a simulated robot, as its systems see them."""

from __future__ import annotations

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import FloatArray
from tfg_drake.simulation.people import People, discs_at
from tfg_drake.systems.ports import MessageInputs
from tfg_drake.world.changing import WorldNow
from tfg_drake.world.world import World

# Period of what changes or walks about there, s.
PERIOD = 1.0 / 8.0


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

"""The world and the people around a simulated robot, as inputs of its systems."""

from __future__ import annotations

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import FloatArray
from tfg_drake.simulation.people import People, discs_at
from tfg_drake.systems.ports import MessageInputs
from tfg_drake.world.changing import WorldNow
from tfg_drake.world.world import World

# Period at which people and changes are updated, s.
PERIOD = 1.0 / 8.0


class Surroundings:
    """The inputs "people" and "world" of a simulated system, People and WorldNow; either may be unconnected."""

    def __init__(self, system: LeafSystem, world: World) -> None:
        """Declare the inputs. world: the initial world."""
        self._world = world
        self._inputs = MessageInputs(system, people=People, world=WorldNow)

    def world(self, context: Context) -> World:
        """Return the current world."""
        changed = self._inputs.optional(context, "world")
        return self._world if changed is None else changed.world

    def people(self, context: Context, time: float | None = None) -> FloatArray | None:
        """Return the people as discs (n, 3), m in W, at a time, s, by default the context's; None without people."""
        walking = self._inputs.optional(context, "people")
        return None if walking is None else discs_at(walking, context.get_time() if time is None else time)

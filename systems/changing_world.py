"""The changing simulated world."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import ChangeConfig
from tfg_drake.systems.ports import MessageState
from tfg_drake.systems.surroundings import PERIOD
from tfg_drake.world.changing import WorldNow, is_due, successive
from tfg_drake.world.world import World


class ChangingWorld(LeafSystem):
    """Applies changes to the world in their order, each at its time, see tfg_drake.world.changing.

    .. pydrake_system::

        name: ChangingWorld
        input_ports:
        - pose
        output_ports:
        - world

    pose: x, y, theta, v, w of the plant. world: a WorldNow message.
    """

    def __init__(self, world: World, changes: Sequence[ChangeConfig], robot_radius: float):
        """changes: in their order. robot_radius: m. Raises WorldError if a change is impossible."""
        super().__init__()
        self._changes, self._worlds, self._robot_radius = tuple(changes), successive(world, changes), robot_radius
        self._pose = self.DeclareVectorInputPort("pose", 5)
        now = MessageState(self, WorldNow(world, 0, 0.0), self._Change, PERIOD)
        self.DeclareStateOutputPort("world", now.index)

    def _Change(self, context: Context, now: WorldNow) -> WorldNow:
        made, time, p_WB = now.count, context.get_time(), self._pose.Eval(context)[:2]
        while made < len(self._changes) and is_due(self._changes[made], time, p_WB, self._robot_radius):
            made += 1
        return now if made == now.count else WorldNow(self._worlds[made], made, time)

"""The goal selector of grid methods: chooses the next frontier once a stage."""

from __future__ import annotations

from collections.abc import Callable

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import RobotConfig
from tfg_drake.grid.frontier_goal import TriedPlaces, is_spent, no_tries
from tfg_drake.messages import GoalChoice, GridMap, MissionStatus, PoseEstimate, message, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.systems.cpu_meter import measured, metered
from tfg_drake.systems.ports import MessageInputs, MessageState


@message
class _SelectorState:
    """The newest goal and the places tried so far."""

    goal: GoalChoice
    tried: TriedPlaces


class FrontierGoalSelector(LeafSystem):
    """Chooses a goal when the mission asks for one, and reports on the way if the goal has become obsolete.

    .. pydrake_system::

        name: FrontierGoalSelector
        input_ports:
        - grid
        - pose
        - mission
        - path
        - path_status
        output_ports:
        - goal

    grid: GridMap, pose: PoseEstimate, mission: MissionStatus, path: Path, path_status: PathStatus, goal: GoalChoice,
    all in M.
    """

    def __init__(
        self,
        choose: Callable[[GridMap, PoseEstimate, TriedPlaces], tuple[GoalChoice, TriedPlaces]],
        robot: RobotConfig,
        eager: bool,
    ):
        """choose: the rule, such as `tfg_drake.grid.frontier_goal.choose`. eager: see GridConfig."""
        super().__init__()
        self._choose, self._robot, self._eager = choose, robot, eager
        self._inputs = MessageInputs(self, "grid", "pose", "mission", "path", "path_status")
        MessageState(self, _SelectorState(empty_choice(), no_tries()), self._Update).declare_outputs(self, "goal")

    def _Update(self, context: Context, now: _SelectorState) -> _SelectorState:
        grid, mission = self._inputs.each(context, "grid", "mission")
        if mission.phase == "choose" and mission.stage == grid.stage > now.goal.stage:
            pose = self._inputs(context, "pose")
            return _SelectorState(*measured(self, "goal", self._choose, grid, pose, now.tried))
        if now.goal.stage == mission.stage and not now.goal.spent and self._Pointless(context, now, mission, grid):
            return replace(now, goal=replace(now.goal, spent=True))
        return now

    @metered("goal_selector")
    def _Pointless(self, context: Context, now: _SelectorState, mission: MissionStatus, grid: GridMap) -> bool:
        """Return True if the goal is obsolete: no path leads there, or a newer map has no frontier there."""
        if mission.phase == "plan":
            path, status = self._inputs.each(context, "path", "path_status")
            return status.unreachable and path.stage == mission.stage
        return mission.phase == "follow" and self._eager and is_spent(grid, now.tried, self._robot)

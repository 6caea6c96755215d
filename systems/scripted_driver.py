"""The scripted driver: goals and paths of a predefined drive."""

from __future__ import annotations

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import FloatArray, GoalChoice, Path, PathStatus, message
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.scripted_drive import next_place, straight_path
from tfg_drake.systems.ports import MessageInputs, MessageState


@message
class _Scripted:
    """The newest goal and path, and the mission's count of replans when the path was made."""

    goal: GoalChoice
    path: Path
    replans: int


class ScriptedDriver(LeafSystem):
    """Outputs the places of its drive as goals, one after the other, with straight paths.

    .. pydrake_system::

        name: ScriptedDriver
        input_ports:
        - tfg
        - pose
        - mission
        output_ports:
        - goal
        - path
        - path_status

    tfg: TfgMap, pose: PoseEstimate, mission: MissionStatus, goal: GoalChoice, path: Path, path_status: PathStatus, all
    in M.
    """

    def __init__(self, p_MG: FloatArray):
        """p_MG: (n, 2) places where the robot looks around, m."""
        super().__init__()
        self._drive = p_MG
        self._inputs = MessageInputs(self, "tfg", "pose", "mission")
        state = MessageState(self, _Scripted(empty_choice(), Path(0, 0, p_MG[:0]), 0), self._Update)
        state.declare_outputs(self, "goal", "path", path_status=lambda now: PathStatus(now.path.id, free=True))

    def _Update(self, context: Context, now: _Scripted) -> _Scripted:
        mission, goal, path = self._inputs(context, "mission"), now.goal, now.path
        if mission.phase == "choose" and mission.stage > goal.stage:
            goal = next_place(self._drive, mission.stage, self._inputs(context, "tfg"))
        elif mission.phase == "plan" and (path.stage, now.replans) != (mission.stage, mission.replans):
            X_MB = self._inputs(context, "pose").X_MB
            path = straight_path(path.id + 1, mission.stage, X_MB, goal.p_MG)
        else:
            return now
        return _Scripted(goal, path, mission.replans)

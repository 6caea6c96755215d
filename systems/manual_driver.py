"""The manual driver: a person drives by keys while the mission maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from tfg_drake.config import RobotConfig
from tfg_drake.messages import FollowerStatus, GoalChoice, MissionStatus, Path, PathStatus, message, replace
from tfg_drake.mission.manual_drive import END, LOOK, Pressed, place_sent, send, steered
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.requested_goal import RequestedGoal, Sent, goal_there, where_sent
from tfg_drake.planning.scripted_drive import end_of_drive
from tfg_drake.systems.ports import MessageInputs, MessageState, declare_message_output

# Length of the reported path straight ahead of the robot, m: the driver's way is unknown.
AHEAD = 0.5
# Reported remaining length of that path, m: enough for another glance.
LEFT = 10.0


@message
class _Driving:
    """goal and path as output to the mission. velocity: (v, w) of the keys, m/s and rad/s. looks: the driver wants to
    look around here; ends: to end after that. pressed: all keys so far. requested: the last place that the driver has
    sent the robot to, heard: number of such places from the port; sent: the place that it is driving to. planned: id of
    the planner's current or last path."""

    goal: GoalChoice
    path: Path
    velocity: tuple[float, float] = (0.0, 0.0)
    looks: bool = False
    ends: bool = False
    pressed: tuple[Pressed, ...] = ()
    requested: RequestedGoal = RequestedGoal()
    heard: int = 0
    sent: Sent = Sent()
    planned: int = 0


class ManualDriver(LeafSystem):
    """Commands the base by the keys; while the mission looks around, the follower turns it.

    .. pydrake_system::

        name: ManualDriver
        input_ports:
        - map
        - tfg
        - roadmap
        - pose
        - mission
        - requested_goal
        - planned_path
        - planned_status
        - following_commanded
        - following_status
        output_ports:
        - velocity_commanded
        - goal
        - planned_goal
        - path
        - path_status
        - follower_status
        - pressed

    map: MapEstimate, tfg: TfgMap, roadmap: Roadmap, pose: PoseEstimate, mission: MissionStatus, planned_path and path:
    Path, planned_status and path_status: PathStatus, goal and planned_goal: GoalChoice, following_status and
    follower_status: FollowerStatus. velocity_commanded and following_commanded: forward speed, m/s, and turn rate,
    rad/s. pressed: a tuple of Pressed, all keys so far.

    following_commanded, following_status: the follower's velocity_commanded and follower_status. While the robot moves
    the mission glances ahead as on any way. The key "look" ends the way, so that the robot turns around; so does "end",
    after which the mission ends. requested_goal: a RequestedGoal message, optional: the robot drives there by itself
    until a key is pressed, on the planner's path (planned_path, planned_status) to planned_goal, which then equals goal
    and otherwise is empty.
    """

    def __init__(
        self, robot: RobotConfig, keys: Callable[[], Sequence[str]], drive: Sequence[Pressed] = (), glances: bool = True
    ):
        """keys: returns the keys of `manual_drive.KEYS` pressed since its last call; drive: keys pressed at given
        times; glances: the mission glances ahead and so reaches a choice without looking around."""
        super().__init__()
        self._robot, self._keys, self._drive, self._glances = robot, keys, tuple(drive), glances
        self._inputs = MessageInputs(
            self,
            *("map", "tfg", "roadmap", "pose", "mission"),
            requested_goal=RequestedGoal,
            planned_path=Path,
            planned_status=PathStatus,
            following_status=FollowerStatus,
        )
        self._following = self.DeclareVectorInputPort("following_commanded", 2)
        self._state = MessageState(self, _Driving(empty_choice(), Path(0, 0, np.zeros((0, 2)))), self._Update)
        self.DeclareVectorOutputPort("velocity_commanded", 2, self._CalcVelocity)
        planned = lambda now: now.goal if now.sent.node >= 0 else empty_choice()  # noqa: E731
        self._state.declare_outputs(self, "goal", "path", "pressed", planned_goal=planned)
        declare_message_output(self, "path_status", self._PathStatus, {self.all_sources_ticket()})
        declare_message_output(self, "follower_status", self._Status, {self.all_sources_ticket()})

    def _CalcVelocity(self, context: Context, output: BasicVector) -> None:
        mission = self._inputs(context, "mission")
        if mission.phase == "observe" or self._state(context).sent.node >= 0:
            output.SetFromVector(self._following.Eval(context))
        elif mission.phase in ("done", "paused"):
            output.SetFromVector([0.0, 0.0])
        else:
            output.SetFromVector(list(self._state(context).velocity))

    def _Status(self, context: Context) -> FollowerStatus:
        mission, now = self._inputs(context, "mission"), self._state(context)
        following = self._inputs(context, "following_status")
        if mission.phase == "observe" or now.sent.node >= 0:
            return following
        # While the robot stands, no path is reported and the mission waits. A goal from the page waits for a stage.
        waits = now.requested.count > now.sent.count
        told = now.path.id if now.looks or waits or any(now.velocity) else -1
        arrived = now.looks or (waits and not self._glances)
        return replace(following, path_id=told, arrived=arrived, turn_done=False, stalled=False, left=LEFT)

    def _PathStatus(self, context: Context) -> PathStatus:
        now, planned = self._state(context), self._inputs(context, "planned_status")
        is_free = now.sent.node < 0 or planned.path_id != now.planned or planned.free
        return PathStatus(now.path.id, free=is_free)

    def _Update(self, context: Context, before: _Driving) -> _Driving:
        mission, now = self._inputs(context, "mission"), self._Press(before, context)
        if mission.phase == "paused" and any(now.velocity):
            now = replace(now, velocity=(0.0, 0.0))  # After a pause the robot stands until the next key.
        if mission.phase == "observe" and now.looks:
            now = replace(now, looks=False, velocity=(0.0, 0.0))
        if mission.phase == "choose" and mission.stage > now.goal.stage:
            now = self._Choose(context, mission, now)
        if mission.phase == "plan" and now.sent.node >= 0:
            planned = self._inputs(context, "planned_path")
            if planned.stage == mission.stage and planned.id > now.planned:
                now = replace(now, path=replace(planned, id=now.path.id + 1), planned=planned.id)
        elif mission.phase == "plan" and now.path.id <= mission.path_id:
            x, y, theta = self._inputs(context, "pose").X_MB.tolist()
            points = np.array([[x, y], [x + AHEAD * np.cos(theta), y + AHEAD * np.sin(theta)]])
            now = replace(now, path=Path(now.path.id + 1, mission.stage, points))
        return now

    def _Press(self, now: _Driving, context: Context) -> _Driving:
        """Return the state after the due keys; a requested place counts as a key."""
        time, keys = context.get_time(), list(self._keys())
        requested = self._inputs.optional(context, "requested_goal") or RequestedGoal()
        if requested.count > now.heard:
            keys.append(send(*requested.p_MG))
            now = replace(now, heard=requested.count)
        replayed = sum(one.time <= time for one in self._drive) if self._drive else 0
        keys += [one.key for one in self._drive[len(now.pressed) : replayed]]
        for key in keys:
            now, place = replace(now, pressed=(*now.pressed, Pressed(time, key))), place_sent(key)
            if place is not None:
                now = replace(now, requested=RequestedGoal(now.requested.count + 1, np.array(place)))
            else:
                looks, ends = now.looks or key in (LOOK, END), now.ends or key == END
                velocity, sent = steered(now.velocity, key, self._robot), replace(now.sent, node=-1)
                now = replace(now, velocity=velocity, looks=looks, ends=ends, sent=sent)
        return now

    def _Choose(self, context: Context, mission: MissionStatus, now: _Driving) -> _Driving:
        if now.ends:
            return replace(now, goal=end_of_drive(mission.stage, self._inputs(context, "tfg")))
        p_MB = self._inputs(context, "pose").X_MB[:2]
        goal = replace(empty_choice(), stage=mission.stage, node=0, p_MG=p_MB, reason="Somebody drives.")
        if now.sent.node < 0 and now.requested.count == now.sent.count:
            return replace(now, goal=goal)
        roadmap = self._inputs(context, "roadmap")
        if roadmap.stage != mission.stage:
            return now  # The planner extends it in a moment.
        p_MA = self._inputs(context, "map").X_MA[-1, :2]
        sent = where_sent(now.sent, now.requested, roadmap, mission, p_MA)
        if sent.node < 0:
            return replace(now, goal=goal, sent=sent)
        return replace(now, goal=goal_there(goal, sent.node, roadmap), sent=sent, velocity=(0.0, 0.0))

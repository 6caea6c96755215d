"""The follower: drives along the path and turns in place at goals."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray, FollowerStatus, GoalChoice, MissionStatus, Path, PoseEstimate
from tfg_drake.planning.pure_pursuit import at_rest, follow, turn_in_place, turn_to_see
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import PERIOD, MessageInputs, declare_message_output

# Least duration of a look around, s: long enough to see a tag in several frames.
LOOK_TIME = 0.75

# The robot is stalled if it has not moved for PATIENCE, s, despite a command.
PATIENCE = 3.0
# With less than AT_GOAL, m, of the path left it counts as arrived after SHORT_PATIENCE, s: a corner may block the rest.
SHORT_PATIENCE, AT_GOAL = 0.5, 0.2

# The discrete state. STAMP: time of the last update, s. TURN_SINCE: when the turn began, s. TURNED, HEADING: angle
# turned since and last heading, rad. FIRST, THEN: targets of the turn's two legs, rad. LEGS: number of legs done. PATH:
# its id. PROGRESS: arc length along it, m. TURNING: the robot turns in place on it. FINISHED: it is driven. OBEYED:
# when the robot last moved as commanded or had no command, s. LEFT: remaining length of the path, m.
(
    STAMP, TURN_SINCE, TURNED, HEADING, FIRST, THEN, LEGS, PATH, PROGRESS, TURNING, FINISHED, OBEYED, LEFT,
) = range(13)  # fmt: skip


class PurePursuitFollower(LeafSystem):
    """Follows the path in the mission's driving phases, turns in place in phase "observe", and stands still otherwise.

    At a goal it turns until it has seen the directions that the goal names; at the start it stands and turns as long as
    the explorer's configuration says; anywhere else it turns all around.

    .. pydrake_system::

        name: PurePursuitFollower
        input_ports:
        - pose
        - path
        - goal
        - mission
        output_ports:
        - velocity_commanded
        - follower_status

    pose: PoseEstimate, path: Path, goal: GoalChoice, mission: MissionStatus, all in M. follower_status: FollowerStatus.
    velocity_commanded: (2,) forward speed, m/s, and turn rate, rad/s.
    """

    def __init__(self, robot: RobotConfig, explorer: ExplorerConfig, field_of_view: float | None):
        """field_of_view: rad, common to all sensors; None to turn all around at every goal."""
        super().__init__()
        self._field_of_view = field_of_view
        self._robot, self._explorer = robot, explorer
        self._inputs = MessageInputs(self, "pose", "path", "goal", "mission")
        initial = np.zeros(13)
        initial[[TURN_SINCE, PATH]] = -1.0
        self._state, self._command = self.DeclareDiscreteState(initial), self.DeclareDiscreteState(2)
        self.DeclareStateOutputPort("velocity_commanded", self._command)
        declare_message_output(self, "follower_status", self._CalcStatus, {self.discrete_state_ticket(self._state)})
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._Update)

    def _CalcStatus(self, context: Context) -> FollowerStatus:
        x = context.get_discrete_state(self._state).value().tolist()
        return FollowerStatus(
            stamp=x[STAMP],
            path_id=int(x[PATH]),
            arrived=bool(x[FINISHED]),
            turn_done=x[LEGS] == 2.0 and x[STAMP] - x[TURN_SINCE] >= LOOK_TIME,
            stalled=x[STAMP] - x[OBEYED] > PATIENCE,
            left=x[LEFT],
        )

    @metered("follower")
    def _Update(self, context: Context, discrete: DiscreteValues) -> None:
        x = context.get_discrete_state(self._state).value().tolist()
        pose, mission = self._inputs.each(context, "pose", "mission")
        moving = pose.speed.tolist()
        x[STAMP] = context.get_time()
        speed = turn_rate = 0.0
        if mission.phase == "observe":
            turn_rate = self._Turn(x, mission, self._inputs(context, "goal"), pose)
        elif mission.drives:
            speed, turn_rate = self._Follow(x, self._inputs(context, "path"), pose.X_MB, moving[0])
        # A small turn does not count as motion: the gyro's noise alone looks like it.
        if (speed == 0.0 and turn_rate == 0.0) or not at_rest(moving[0], moving[1] if speed == 0.0 else 0.0):
            x[OBEYED] = x[STAMP]
        elif mission.drives and x[LEFT] < AT_GOAL and x[STAMP] - x[OBEYED] > SHORT_PATIENCE:
            x[FINISHED] = float(self._inputs(context, "goal").verdict == "goal")
        discrete.set_value(self._state, x)
        discrete.set_value(self._command, [speed, turn_rate])

    def _Turn(self, x: list[float], mission: MissionStatus, goal: GoalChoice, pose: PoseEstimate) -> float:
        """Return the turn rate, rad/s."""
        heading = float(pose.X_MB[2])
        if x[TURN_SINCE] != mission.since:
            x[TURN_SINCE], x[TURNED], x[HEADING], x[LEGS] = mission.since, 0.0, heading, 0.0
            # Half of the first turns go back: then a scale error of the measured turns does not rotate the map.
            turns = self._explorer.first_turns if mission.stage == 0 else 1
            x[FIRST], x[THEN] = 2.0 * np.pi * np.array([(turns + 1) // 2, (turns + 1) // 2 - turns // 2])
            if mission.stage > 0 and self._field_of_view is not None:
                at_goal = goal.stage == mission.stage and mission.failures == 0 and x[FINISHED]
                x[FIRST], x[THEN] = turn_to_see(goal.look if at_goal else goal.look[:0], heading, self._field_of_view)
        x[TURNED] += float(wrap_angle(heading - x[HEADING]))
        x[HEADING] = heading
        turn_rate = 0.0
        if mission.stage == 0 and x[STAMP] < mission.since + self._explorer.first_look:
            return turn_rate
        before = 0.0
        for leg, target in enumerate((x[FIRST], x[THEN])):
            if x[LEGS] == leg:
                x[LEGS] += (target - x[TURNED]) * (target - before) <= 0.0
            if x[LEGS] == leg:
                turn_rate = turn_in_place(x[TURNED], target, self._explorer.turn_rate, self._robot)
            before = target
        return turn_rate

    def _Follow(self, x: list[float], path: Path, X_MB: FloatArray, speed: float) -> tuple[float, float]:
        """Return forward speed, m/s, and turn rate, rad/s, for a robot at X_MB (3,) with a speed (m/s)."""
        if x[PATH] != path.id:
            x[TURNING], x[PATH], x[PROGRESS], x[FINISHED] = 0.0, path.id, 0.0, 0.0
        if x[FINISHED]:
            return 0.0, 0.0
        command = follow(path.points, X_MB, speed, x[PROGRESS], bool(x[TURNING]), self._robot)
        x[PROGRESS], x[LEFT] = command.progress, command.left
        x[TURNING], x[FINISHED] = command.turning, command.finished
        return command.speed, command.turn_rate

import math

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.messages import GoalChoice, MissionStatus, Path, PoseEstimate, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.pure_pursuit import VIEW_MARGIN, turn_to_see
from tfg_drake.systems.pure_pursuit_follower import LOOK_TIME, PERIOD, PurePursuitFollower

ROBOT = RobotConfig()
FIELD_OF_VIEW = 2.2


class Rig:
    """A follower and a unicycle with the base's limits, stepped by hand."""

    def __init__(self, path=(), field_of_view=FIELD_OF_VIEW, explorer=None):
        self.follower = PurePursuitFollower(ROBOT, explorer or ExplorerConfig(), field_of_view)
        self.simulator = Simulator(self.follower)
        self.context = self.simulator.get_mutable_context()
        self.X, self.V = np.zeros(3), np.zeros(2)
        self.mission = MissionStatus(phase="observe", stage=1, since=0.0)
        self.goal: GoalChoice = replace(empty_choice(), stage=1)
        self.path = Path(id=1, stage=1, points=np.reshape(path, (-1, 2)).astype(float))
        self._fix()
        self.simulator.Initialize()

    def _fix(self):
        none = np.zeros(0)
        pose = PoseEstimate(self.context.get_time(), self.X, np.eye(3), self.V, 0, none.astype(int), np.zeros((0, 2)))
        for name, value in (("pose", pose), ("path", self.path), ("goal", self.goal), ("mission", self.mission)):
            self.follower.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))

    def command(self):
        return self.follower.GetOutputPort("velocity_commanded").Eval(self.context)

    def status(self):
        return self.follower.GetOutputPort("follower_status").Eval(self.context)

    def run(self, seconds, until=lambda status: False):
        for _ in range(round(seconds / PERIOD)):
            limit = PERIOD * np.array([ROBOT.max_acceleration, ROBOT.max_turn_acceleration])
            self.V = self.V + np.clip(self.command() - self.V, -limit, limit)
            heading = self.X[2] + 0.5 * PERIOD * self.V[1]
            self.X = self.X + PERIOD * np.array(
                [*self.V[0] * np.array([math.cos(heading), math.sin(heading)]), self.V[1]]
            )
            self._fix()
            self.simulator.AdvanceTo(self.context.get_time() + PERIOD)
            if until(self.status()):
                return True
        return False

    def phase(self, phase):
        self.mission = MissionStatus(phase=phase, stage=1, since=self.context.get_time())


def test_turns_until_all_was_in_view_and_slows_down():
    rig = Rig()
    first, then = turn_to_see(np.zeros(0), 0.0, FIELD_OF_VIEW)
    assert first == then
    assert rig.run(12, lambda status: status.turn_done)
    assert abs(first) <= abs(rig.X[2]) < abs(first) + 0.05
    assert abs(rig.V[1]) < 0.1
    assert rig.context.get_time() < abs(first) + 2.0


def arrived():
    """At the goal that its path led to."""
    rig = Rig([[-0.1, 0.0], [0.0, 0.0]])
    rig.phase("follow")
    assert rig.run(1.0, lambda status: status.arrived)
    rig.phase("observe")
    return rig


def test_on_its_way_to_a_goal_it_looks_all_round_whatever_the_goal_asks_for():
    rig = Rig([[0.0, 0.0], [9.0, 0.0]])
    rig.goal = replace(rig.goal, look=np.array([0.2]))
    rig.phase("follow")
    rig.run(3.0)
    rig.phase("observe")
    rig.run(2.0)
    assert not rig.status().turn_done
    assert rig.run(12, lambda status: status.turn_done)


def test_looks_where_the_goal_says_to_either_side():
    rig = arrived()
    rig.goal = replace(rig.goal, look=np.array([1.2, -1.5]))
    headings = []
    assert rig.run(12, lambda status: headings.append(rig.X[2]) or status.turn_done)
    assert np.max(headings) == pytest.approx(1.2 - (FIELD_OF_VIEW / 2 - VIEW_MARGIN), abs=0.05)
    assert np.min(headings) == pytest.approx(-1.5 + (FIELD_OF_VIEW / 2 - VIEW_MARGIN), abs=0.05)


def test_what_is_in_view_already_is_looked_at_for_a_moment():
    rig = arrived()
    rig.goal = replace(rig.goal, look=np.array([0.2]))
    assert not rig.run(LOOK_TIME - PERIOD, lambda status: status.turn_done)
    assert rig.run(2 * PERIOD, lambda status: status.turn_done)
    assert rig.X[2] == 0.0


def test_a_robot_that_could_not_reach_its_goal_looks_all_round():
    rig = Rig()
    rig.goal = replace(rig.goal, look=np.array([0.2]))
    rig.mission = replace(rig.mission, failures=1)
    rig._fix()
    assert rig.run(12, lambda status: status.turn_done)
    assert abs(rig.X[2]) > 3.0


def test_drives_on_while_a_glance_is_mapped():
    rig = Rig([[0.0, 0.0], [5.0, 0.0]])
    for phase in ("follow", "glance", "map", "choose", "plan"):
        rig.mission = MissionStatus(phase=phase, stage=1, since=rig.context.get_time(), moving=phase != "follow")
        rig.run(1.0)
        assert rig.V[0] > 0.3
    left = rig.status().left
    assert left == pytest.approx(5.0 - rig.X[0], abs=0.1)
    # A new path is taken up without a stop.
    rig.path = Path(id=2, stage=2, points=np.array([rig.X[:2], [6.0, 1.0]]))
    rig.run(0.5)
    assert rig.V[0] > 0.3
    rig.phase("paused")
    rig.mission = replace(rig.mission, moving=True)
    rig.run(2.0)
    assert not rig.V.any()


@pytest.mark.parametrize(("turns", "there", "left"), [(1, 1, 1), (2, 1, 0), (3, 2, 1)])
def test_a_mission_begins_with_a_look_and_turns_round_and_back(turns, there, left):
    rig = Rig(explorer=ExplorerConfig(first_turns=turns))
    rig.mission = MissionStatus(phase="observe", stage=0, since=0.0)
    rig._fix()
    assert not rig.run(ExplorerConfig().first_look, lambda _: rig.V[1] != 0.0)
    furthest = 0.0

    def turned(status):
        nonlocal furthest
        furthest = max(furthest, rig.X[2])
        return status.turn_done

    assert rig.run(22, turned)
    assert 2 * there * math.pi <= furthest < 2 * there * math.pi + 0.2
    assert rig.X[2] == pytest.approx(2 * left * math.pi, abs=0.05)


def test_every_observation_turns_anew():
    rig = Rig()
    rig.run(12, lambda status: status.turn_done)
    rig.phase("map")
    rig.run(0.5)
    assert rig.status().turn_done
    before = rig.X[2]
    rig.phase("observe")
    rig.run(0.1)
    assert not rig.status().turn_done
    assert rig.run(12, lambda status: status.turn_done)
    assert abs(rig.X[2] - before) > 4.0


def test_follows_the_path_and_says_so():
    points = np.stack([np.arange(0, 3.05, 0.1), np.zeros(31)], axis=1)
    rig = Rig(points)
    rig.phase("follow")
    assert rig.run(15, lambda status: status.arrived)
    assert rig.status().path_id == 1
    np.testing.assert_allclose(rig.X[:2], points[-1], atol=0.05)
    rig.path = Path(id=2, stage=1, points=points[::-1].copy())
    rig.run(0.1)
    assert (rig.status().path_id, rig.status().arrived) == (2, False)
    assert rig.run(20, lambda status: status.arrived)
    np.testing.assert_allclose(rig.X[:2], [0, 0], atol=0.06)


@pytest.mark.parametrize("phase", ["map", "choose", "plan", "done", "paused"])
def test_stands_still_in_other_phases(phase):
    rig = Rig(np.array([[0.0, 0.0], [1.0, 0.0]]))
    rig.run(1)
    rig.phase(phase)
    rig.run(1)
    assert rig.command().tolist() == [0.0, 0.0]
    assert not rig.V.any()
    assert not rig.status().turn_done


def test_a_cloned_context_goes_on_alike():
    rig = Rig(np.array([[0.0, 0.0], [2.0, 0.5]]))
    rig.phase("follow")
    rig.run(2)
    clone = rig.context.Clone()
    port = rig.follower.GetOutputPort("velocity_commanded")
    assert (port.Eval(clone) == rig.command()).all()
    for index in range(clone.num_discrete_state_groups()):
        assert (clone.get_discrete_state(index).value() == rig.context.get_discrete_state(index).value()).all()


def test_a_robot_that_does_not_move_when_told_to_is_held_up():
    rig = Rig([[0.0, 0.0], [5.0, 0.0]])
    rig.phase("follow")
    assert not rig.run(1.0, lambda status: status.stalled)
    for k in range(round(4.0 / PERIOD)):
        # Its gyro is not quiet.
        rig.V = np.array([0.0, 0.05 * (-1) ** k])
        rig._fix()
        rig.simulator.AdvanceTo(rig.context.get_time() + PERIOD)
    assert rig.status().stalled


@pytest.mark.parametrize(
    ("verdict", "off", "is_there"), [("goal", 0.1, True), ("goal", 0.3, False), ("complete", 0.1, False)]
)
def test_a_robot_that_is_held_up_at_its_goal_is_there_but_home_is_where_it_began(verdict, off, is_there):
    rig = Rig([[0.0, 0.0], [off, 0.0]])
    rig.goal = replace(rig.goal, verdict=verdict)
    rig.phase("follow")
    rig._fix()
    rig.simulator.AdvanceTo(1.0)
    assert rig.command()[0] > 0.0 or is_there
    assert rig.status().arrived == is_there


def test_without_a_field_of_view_it_turns_all_round():
    rig = Rig(field_of_view=None)
    rig.goal = replace(rig.goal, look=np.array([1.2]))
    assert rig.run(12, lambda status: status.turn_done)
    assert rig.X[2] == pytest.approx(2.0 * np.pi, abs=0.05)

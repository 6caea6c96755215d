"""The mission's sequence, phase by phase."""

import dataclasses

import numpy as np
import pytest

from tfg_drake.messages import FollowerStatus, GoalChoice, Path, PathStatus
from tfg_drake.mission.sequence import (
    GLANCE_TIME,
    MAX_CHANGES,
    MAX_FAILURES,
    MAX_REPLANS,
    MissionInputs,
    initial_status,
    step,
)


def goal(stage: int, verdict: str = "goal", node: int | None = None, latest_arrival: float = np.inf) -> GoalChoice:
    empty = np.zeros(0)
    node = (3 if verdict == "goal" else -1) if node is None else node
    none = np.zeros(0, dtype=np.int64)
    fields = empty, empty, empty, empty, empty
    return GoalChoice(stage, node, np.zeros(2), none, *fields, verdict, "because.", latest_arrival)


def inputs(time: float, **changes) -> MissionInputs:
    asked = {
        "follower": FollowerStatus(time, 0, False, False),
        "goal": goal(0),
        "path": Path(0, 0, np.zeros((0, 2))),
        "path_status": PathStatus(0, True),
        "mapped_stage": 0,
    }
    asked |= {name: changes.pop(name) for name in asked if name in changes}
    return MissionInputs(time, **{name: (lambda value=value: value) for name, value in asked.items()}, **changes)


def following(time: float = 10.0):
    status = step(initial_status(), inputs(time - 3, follower=FollowerStatus(time - 3, 0, False, True)))
    status = step(status, inputs(time - 2, mapped_stage=1))
    status = step(status, inputs(time - 1, goal=goal(1)))
    return step(status, inputs(time, path=Path(7, 1, np.ones((5, 2)))))


def test_one_stage_runs_through_every_phase():
    status = initial_status()
    assert status.phase == "observe"
    assert step(status, inputs(1.0)) is status
    status = step(status, inputs(7.0, follower=FollowerStatus(7.0, 0, False, True)))
    assert (status.phase, status.stage) == ("map", 0)
    assert step(status, inputs(7.1, mapped_stage=0)) is status
    status = step(status, inputs(7.2, mapped_stage=1))
    assert (status.phase, status.stage) == ("choose", 1)
    assert step(status, inputs(7.3, goal=goal(0))) is status
    status = step(status, inputs(7.4, goal=goal(1)))
    assert status.phase == "plan"
    status = step(status, inputs(7.5, path=Path(1, 1, np.ones((5, 2)))))
    assert (status.phase, status.path_id) == ("follow", 1)
    assert step(status, inputs(9.0, follower=FollowerStatus(9.0, 0, True, False))) is status
    status = step(status, inputs(9.5, follower=FollowerStatus(9.5, 1, True, False)))
    assert (status.phase, status.stage, status.since) == ("observe", 1, 9.5)


@pytest.mark.parametrize(
    ("phase", "asked"),
    [
        ("observe", {"follower"}),
        ("map", {"mapped_stage"}),
        ("choose", {"goal"}),
        ("plan", {"path", "goal"}),
        ("follow", {"follower", "goal", "path_status"}),
        ("paused", set()),
    ],
)
def test_a_phase_asks_only_for_what_it_is_interested_in(phase, asked):
    """A map or a goal that nobody waits for would be computed 16 times a second."""
    named = set()

    def noting(name, ask):
        return lambda: named.add(name) or ask()

    seen = inputs(5.0, pause=phase == "paused")
    kinds = "follower", "goal", "path", "path_status", "mapped_stage"
    seen = dataclasses.replace(seen, **{name: noting(name, getattr(seen, name)) for name in kinds})
    step(dataclasses.replace(initial_status(), phase=phase, resume_phase="map", stage=3), seen)
    assert named == asked


def test_a_turn_reported_done_before_the_phase_settled_is_the_last_one_and_ignored():
    status = dataclasses.replace(initial_status(), since=5.0)
    assert step(status, inputs(5.1, follower=FollowerStatus(5.1, 0, False, True))) is status


@pytest.mark.parametrize("verdict", ["complete", "stuck"])
def test_the_selectors_verdict_ends_the_mission_with_its_reason(verdict):
    status = dataclasses.replace(initial_status(), phase="choose", stage=4)
    status = step(status, inputs(50.0, goal=goal(4, verdict)))
    assert (status.phase, status.outcome, status.reason) == ("done", verdict, "because.")
    assert step(status, inputs(51.0, stop=True)) is status


@pytest.mark.parametrize(
    ("verdict", "node", "words"),
    [("go", 3, "'go' is none of the verdicts"), ("goal", -1, "there is no node")],
)
def test_a_choice_that_cannot_be_one_is_refused(verdict, node, words):
    status = dataclasses.replace(initial_status(), phase="choose", stage=1)
    with pytest.raises(ValueError, match=f"goal of stage 1: .*{words}"):
        step(status, inputs(5.0, goal=goal(1, verdict, node)))


def test_a_blocked_path_is_planned_again_and_given_up_in_the_end():
    status = following()
    for replan in range(1, MAX_REPLANS + 1):
        status = step(status, inputs(20.0, path_status=PathStatus(status.path_id, False)))
        assert (status.phase, status.replans) == ("plan", replan)
        status = step(status, inputs(20.0, path=Path(status.path_id + 1, 1, np.ones((5, 2)))))
    status = step(status, inputs(21.0, path_status=PathStatus(status.path_id, False)))
    assert (status.phase, status.failures) == ("observe", 1)


def test_the_status_of_another_path_does_not_count():
    status = following()
    assert step(status, inputs(20.0, path_status=PathStatus(status.path_id - 1, False))) is status


def test_goals_that_cannot_be_reached_end_the_mission_stuck():
    status = dataclasses.replace(following(), phase="plan", failures=MAX_FAILURES - 1)
    status = step(status, inputs(30.0, path=Path(status.path_id + 1, 1, np.zeros((0, 2)))))
    assert (status.phase, status.outcome) == ("done", "stuck")
    assert status.reason == f"{MAX_FAILURES} goals in a row could not be reached."


def test_a_bumper_hit_asks_for_a_new_path_once_the_reflex_is_over():
    status = following(10.0)
    assert step(status, inputs(11.0, bumper=True)) is status
    assert step(status, inputs(12.5, bumper=True)).phase == "plan"


def test_a_robot_that_is_held_up_gets_a_new_path():
    status = following(10.0)
    held = FollowerStatus(14.0, status.path_id, False, False, stalled=True)
    planned = step(status, inputs(14.0, follower=held))
    assert (planned.phase, planned.replans) == ("plan", 1)
    # Nothing is in the way, and it does not move: what it has not seen it looks at. Something is: there are other ways.
    again = dataclasses.replace(status, replans=1)
    assert step(again, inputs(14.0, follower=held)).phase == "observe"
    blocked = PathStatus(status.path_id, free=False)
    assert step(again, inputs(14.0, follower=held, path_status=blocked)).phase == "plan"


def test_a_glance_does_not_keep_a_robot_that_does_not_move_from_turning():
    status = dataclasses.replace(following(10.0), phase="glance", moving=True)
    held = FollowerStatus(10.5, status.path_id, False, False, stalled=True)
    turns = step(status, inputs(10.5, follower=held))
    assert (turns.phase, turns.moving, turns.failures) == ("observe", False, status.failures + 1)


def test_a_path_that_takes_far_too_long_is_planned_again():
    status = following(10.0)
    path = Path(7, 1, np.array([[0.0, 0.0], [0.5, 0.0]]))
    assert step(status, inputs(73.0, path=path)) is status
    assert step(status, inputs(75.0, path=path)).phase == "plan"


@pytest.mark.parametrize(("phase", "resumed"), [("observe", "observe"), ("choose", "choose"), ("follow", "plan")])
def test_pause_holds_and_resumes(phase, resumed):
    status = dataclasses.replace(following(), phase=phase)
    paused = step(status, inputs(20.0, pause=True))
    assert (paused.phase, paused.resume_phase) == ("paused", phase)
    assert step(paused, inputs(21.0, pause=True)) is paused
    assert step(paused, inputs(22.0)).phase == resumed


def test_nothing_moves_before_the_operator_enables_it():
    status = step(initial_status(), inputs(0.0, enable=False))
    assert status.phase == "paused"
    assert step(status, inputs(5.0)).phase == "observe"


def test_stop_ends_the_mission_as_interrupted():
    status = step(following(), inputs(20.0, stop=True))
    assert (status.phase, status.outcome, status.reason) == ("done", "interrupted", "told to end")


def test_a_robot_that_must_come_home_ends_its_mission_there():
    home = goal(1, "budget", node=5)
    status = dataclasses.replace(following(), since=10.0)
    assert step(status, inputs(12.0, goal=home)) is status
    arrived = inputs(15.0, goal=home, follower=FollowerStatus(15.0, 7, True, False))
    status = step(status, arrived)
    assert (status.phase, status.outcome) == ("done", "budget")
    assert status.reason == "because. The robot is where it began."


def test_a_verdict_with_a_way_home_is_driven_first():
    status = dataclasses.replace(initial_status(), phase="choose", stage=4)
    assert step(status, inputs(50.0, goal=goal(4, "complete", node=5))).phase == "plan"


def test_a_robot_too_late_for_its_goal_looks_round_where_it_is():
    status = following(10.0)
    in_time = inputs(30.0, goal=goal(1, latest_arrival=30.0))
    assert step(status, in_time) is status
    assert step(status, dataclasses.replace(in_time, time=30.1)).phase == "observe"


def test_a_goal_that_became_pointless_on_the_way_is_chosen_anew_without_a_look_round():
    status = following(10.0)
    spent = dataclasses.replace(goal(1), spent=True)
    status = step(status, inputs(11.0, goal=spent))
    assert (status.phase, status.stage, status.failures) == ("map", 1, 0)
    status = step(status, inputs(11.1, mapped_stage=2, goal=spent))
    assert (status.phase, status.stage) == ("choose", 2)


def test_a_goal_to_which_no_path_leads_is_chosen_anew():
    status = step(following(10.0), inputs(11.0, path_status=PathStatus(7, False)))
    assert (status.phase, status.replans) == ("plan", 1)
    status = step(status, inputs(11.1, goal=dataclasses.replace(goal(1), spent=True)))
    assert (status.phase, status.stage) == ("map", 1)


def driving(time: float, left: float = 5.0, path_id: int = 7) -> FollowerStatus:
    return FollowerStatus(time, path_id, False, False, left=left)


def test_on_its_way_the_robot_glances_maps_and_chooses_anew_without_a_stop():
    status = following(10.0)
    still = step(status, inputs(11.9, glance_period=2.0, follower=driving(11.9)))
    assert still is status
    status = step(status, inputs(12.0, glance_period=2.0, follower=driving(12.0)))
    assert (status.phase, status.drives) == ("glance", True)
    assert step(status, inputs(12.5, follower=driving(12.5))) is status
    status = step(status, inputs(12.0 + GLANCE_TIME, follower=driving(12.75)))
    assert (status.phase, status.drives) == ("map", True)
    status = step(status, inputs(13.0, mapped_stage=2))
    assert (status.phase, status.stage, status.drives) == ("choose", 2, True)
    status = step(status, inputs(13.1, goal=goal(2)))
    assert (status.phase, status.drives) == ("plan", True)
    status = step(status, inputs(13.2, path=Path(8, 2, np.ones((5, 2)))))
    assert (status.phase, status.moving, status.drives) == ("follow", False, True)


def test_the_last_glance_is_a_metre_before_the_goal_once_a_way():
    long, short = (Path(7, 1, np.array([[0.0, 0.0], [length, 0.0]])) for length in (5.0, 0.9))
    near = {"glance_period": 2.0, "follower": driving(10.5, left=0.9)}
    assert step(following(10.0), inputs(10.5, path=long, **near)).phase == "glance"
    assert step(following(10.0), inputs(15.0, path=short, **near)).phase == "follow"


def test_no_glance_near_the_goal_nor_where_there_shall_be_none():
    status = following(10.0)
    assert step(status, inputs(15.0, glance_period=2.0, follower=driving(15.0, left=0.5))) is status
    assert step(status, inputs(15.0, glance_period=0.0, follower=driving(15.0))) is status
    assert step(status, inputs(15.0, glance_period=2.0, follower=driving(15.0, path_id=6))) is status


def test_a_robot_that_pushes_against_something_does_not_glance_but_takes_another_path():
    status = following(10.0)
    pushing = {"bumper": True, "glance_period": 2.0}
    assert step(status, inputs(12.0, follower=driving(12.0), **pushing)) is status
    status = step(status, inputs(12.1, follower=driving(12.1), **pushing))
    assert (status.phase, status.replans) == ("plan", 1)


def test_what_is_in_the_way_ends_a_glance_and_stops_the_robot():
    status = step(following(10.0), inputs(12.0, glance_period=2.0, follower=driving(12.0)))
    status = step(status, inputs(12.1, path_status=PathStatus(7, False), follower=driving(12.1)))
    assert (status.phase, status.drives) == ("map", False)


def test_replans_are_counted_on_over_glances():
    status = dataclasses.replace(following(10.0), replans=3)
    status = step(status, inputs(12.0, glance_period=2.0, follower=driving(12.0)))
    status = step(status, inputs(13.0, follower=driving(13.0)))
    assert step(status, inputs(13.1, mapped_stage=2)).replans == 3


def test_a_pause_in_a_glance_ends_it_and_the_robot_stands_until_there_is_a_new_path():
    status = step(following(10.0), inputs(12.0, glance_period=2.0, follower=driving(12.0)))
    status = step(status, inputs(12.2, pause=True))
    assert (status.phase, status.drives) == ("paused", False)
    status = step(status, inputs(20.0))
    assert (status.phase, status.drives) == ("map", False)


def test_two_goals_do_not_send_the_robot_to_and_fro_for_ever():
    """At each glance the other goal looks better; after a few the robot goes to the end of its way."""
    status, stage, time = following(10.0), 1, 10.0
    places = np.array([[1.0, 1.0], [5.0, 5.0]])
    for glance in range(2 * MAX_CHANGES):
        time += 2.0
        after = step(status, inputs(time, glance_period=2.0, follower=driving(time, path_id=status.path_id)))
        if after is status:
            break
        path = Path(status.path_id, stage, np.tile(places[glance % 2], (5, 1)))
        stage, time = stage + 1, time + GLANCE_TIME
        status = step(after, inputs(time, follower=driving(time, path_id=status.path_id)))
        status = step(status, inputs(time, mapped_stage=stage))
        other = dataclasses.replace(goal(stage), p_MG=places[(glance + 1) % 2])
        status = step(status, inputs(time, goal=other, path=path))
        points = np.tile(places[(glance + 1) % 2], (5, 1))
        status = step(status, inputs(time, goal=other, path=Path(status.path_id + 1, stage, points)))
        assert status.phase == "follow"
    assert glance == MAX_CHANGES
    observing = dataclasses.replace(status, phase="observe", since=time)
    done = FollowerStatus(time + 5.0, 7, True, True)
    assert step(observing, inputs(time + 5.0, follower=done)).changes == 0


def test_where_it_is_to_look_again_the_robot_turns_where_it_stands():
    status = dataclasses.replace(initial_status(), phase="choose", stage=1)
    status = step(status, inputs(50.0, goal=goal(1, "look")))
    assert (status.phase, status.stage, status.since) == ("observe", 1, 50.0)
    status = step(status, inputs(58.0, follower=FollowerStatus(58.0, 0, False, True)))
    assert (status.phase, step(status, inputs(58.1, mapped_stage=2)).stage) == ("map", 2)

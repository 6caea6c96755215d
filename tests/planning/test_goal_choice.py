import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.planning.goal_choice import decide, thin_candidates
from tfg_drake.planning.information_gain import Gains


def verdict(gain, value, sees, frontier=0.0, barred=0.0, given_up=0.0, cut_off=False, stop_gain=20.0):
    gain = np.asarray(gain, dtype=float)
    n = len(gain)
    gains = Gains(exploitation=gain, exploration=np.zeros(n), pose_price=np.zeros(n))
    points = np.stack([np.arange(n), np.zeros(n)], axis=1).astype(float)
    candidates = 10 + np.arange(n)
    value, sees = np.asarray(value, dtype=float), np.asarray(sees, dtype=bool)
    return decide(5, candidates, points, gains, value, sees, barred, given_up, frontier, cut_off, stop_gain)


def test_the_best_gain_per_time_wins_and_the_first_of_equals():
    goal = verdict([30, 50, 40, 40], [3, 2, 4, 4], [1, 0, 0, 0], frontier=2.0)
    assert (goal.verdict, goal.node, goal.p_MG.tolist(), goal.stage) == ("goal", 12, [2.0, 0.0], 5)


def test_a_visible_frontier_keeps_the_mission_going_whatever_the_gain():
    goal = verdict([5, 6], [1, 2], [1, 0], frontier=1.0)
    assert (goal.verdict, goal.node) == ("goal", 10)


def test_without_a_frontier_a_goal_must_promise_more_than_the_stop_gain():
    goal = verdict([15, 25], [9, 1], [0, 0])
    assert (goal.verdict, goal.node) == ("goal", 11)
    done = verdict([15, 20], [9, 1], [0, 0])
    assert (done.verdict, done.node) == ("complete", -1)
    assert done.reason == "No frontier is left and no place promises more than 20 nats."


def test_a_frontier_behind_a_passage_too_narrow_for_the_uncertainty_is_stuck():
    assert verdict([25], [1], [0], frontier=3.25, barred=30.25).verdict == "goal"
    assert verdict([5], [1], [0], frontier=3.25, barred=19.0).verdict == "complete"
    stuck = verdict([5], [1], [0], frontier=3.25, barred=30.25)
    assert stuck.verdict == "stuck"
    assert stuck.reason == "30.2 nats lie behind a passage too narrow for the uncertainty of the map."


def test_an_open_frontier_that_was_given_up_is_stuck():
    stuck = verdict([5], [1], [0], given_up=0.8)
    assert (stuck.verdict, stuck.reason) == ("stuck", "0.8 m of open frontier were tried again and again in vain.")


def test_a_frontier_where_the_robot_does_not_fit_is_named_and_closed():
    done = verdict([5], [1], [0], frontier=3.25)
    assert done.verdict == "complete"
    assert done.reason == (
        "No frontier is left but 3.2 m out of reach or not worth it, and no place promises more than 20 nats."
    )


def test_a_robot_cut_off_from_its_start_is_stuck_while_there_is_a_frontier():
    stuck = verdict([5], [1], [0], frontier=3.25, cut_off=True)
    assert stuck.verdict == "stuck"
    assert stuck.reason == "The robot cannot get back to where it began, and 3.2 m of frontier are left."
    assert verdict([25], [1], [0], frontier=3.25, cut_off=True).verdict == "goal"
    assert verdict([5], [1], [0], cut_off=True).verdict == "complete"


def test_nowhere_to_go_is_stuck():
    stuck = verdict([], [], [])
    assert (stuck.verdict, stuck.reason) == ("stuck", "The robot cannot reach any other place.")


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 40))
def test_candidates_are_thinned_evenly_and_frontiers_come_first(sees, count):
    nodes = 3 * np.arange(len(sees))
    flags = np.array(sees, dtype=np.int64)
    kept = thin_candidates(nodes, flags, count)
    assert len(kept) == len(np.unique(kept)) == min(count, len(nodes))
    assert (np.diff(kept) > 0).all()
    assert set(kept) <= set(nodes)
    seeing = set(nodes[flags > 0])
    assert len(seeing & set(kept)) == min(len(seeing), count)

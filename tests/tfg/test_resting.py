"""What is far from the robot rests: whatever is cut and joined, it stays the same, and little of it is touched."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.tfg.resting import LEAST_GOALS, SLACK, awake, extended, rearranged, undivided, whole

REACH = 20.0


def cut(content, goals, stays):
    """Content is a dictionary of what each goal noted."""
    assert sorted(content) == goals.tolist()
    return {k: content[k] for k in goals[stays]}, {k: content[k] for k in goals[~stays]}


def join(contents, goals):
    for content, theirs in zip(contents, goals, strict=True):
        assert sorted(content) == theirs.tolist()
    return dict(item for content in contents for item in content.items())


def drive(X_MA):
    """The content after all goals, and which were near at each."""
    parted, near = undivided({}), []
    for k in range(len(X_MA)):
        parted = rearranged(parted, awake(parted.part, X_MA[: k + 1], REACH), cut, join)
        parted = extended(parted, parted.near | {k: f"goal {k}"}, k + 1)
        near.append(parted.goals)
    return parted, near


def line(x):
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)), min_size=1, max_size=60))
def test_nothing_is_lost_and_all_within_reach_is_near(places):
    X_MA = np.column_stack([places, np.zeros(len(places))])
    parted, near = drive(X_MA)
    assert whole(parted, join) == {k: f"goal {k}" for k in range(len(X_MA))}
    for k, goals in enumerate(near):
        within = np.flatnonzero(np.hypot(*(X_MA[: k + 1, :2] - X_MA[k, :2]).T) <= REACH)
        assert np.isin(within, goals).all()
    assert sorted(parted.near) == parted.goals.tolist()
    for name, content in parted.resting.items():
        assert sorted(content) == np.flatnonzero(parted.part == name).tolist()
        assert name == min(content)


def test_what_is_near_stays_as_small_as_the_neighbourhood_and_wakes_on_the_way_back():
    out = np.arange(0.0, 300.0, 2.0)
    parted, near = drive(line(np.append(out, out[::-1])))
    most = (REACH + SLACK) / 2.0 + LEAST_GOALS
    assert max(len(goals) for goals in near[: len(out)]) <= most + 1
    # On the way back there are twice as many within reach.
    assert max(len(goals) for goals in near) <= 2 * most + 2 * LEAST_GOALS
    assert 0 in near[-1]
    assert len(parted.resting) > 5


def test_nothing_moves_to_and_fro_where_the_robot_stays():
    X_MA = line(np.append(np.arange(0.0, 100.0, 2.0), 100.0 + 3.0 * (np.arange(40) % 2)))
    _, near = drive(X_MA)
    settled = [goals[goals < 50].tolist() for goals in near[60:]]
    assert all(goals == settled[0] for goals in settled)


def test_a_loop_that_closes_wakes_what_comes_near():
    X_MA = line(np.arange(0.0, 100.0, 2.0))
    parted, _ = drive(X_MA)
    assert 0 not in parted.goals
    moved = X_MA.copy()
    moved[:5] += [100.0, 0.0, 0.0]
    near = awake(parted.part, moved, REACH)
    again = rearranged(parted, near, cut, join)
    assert np.isin(np.arange(5), again.goals).all()
    assert whole(again, join) == whole(parted, join)

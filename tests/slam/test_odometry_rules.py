"""Odometry that a base can drive passes as it is; what it cannot drive is not believed, and it goes on where it was."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, replace
from tfg_drake.slam.odometry_rules import WatchedOdometry, velocity, watch


def arc(speed, turn_rate, seconds, dt=0.05, start=(1.0, -2.0, 3.0)):
    """Odometry along an arc, in closed form."""
    messages = []
    for t in np.arange(0.0, seconds, dt):
        turn = turn_rate * t
        chord = speed * t * np.sinc(0.5 * turn / math.pi)
        X = se2.compose(np.array(start), np.array([chord * math.cos(turn / 2), chord * math.sin(turn / 2), turn]))
        messages.append(Odometry(float(t), X, np.array([speed, turn_rate])))
    return messages


def watched(messages, **rules):
    state, passed, notes = WatchedOdometry(), [], []
    for one in messages:
        state, believed, note = watch(state, one, **rules)
        passed += [] if believed is None else [believed]
        notes += [] if note is None else [note]
    return passed, notes


@given(
    st.floats(-1.45, 1.45),
    st.floats(-6.0, 6.0),
    st.floats(0.01, 1.9),
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-3.1, 3.1)),
)
def test_what_a_base_can_drive_passes_as_it_is(speed, turn_rate, dt, start):
    messages = arc(speed, turn_rate, 40.0 * dt, dt, start)
    if abs(turn_rate) * dt > math.pi:  # steps wrap: their turn is another one
        messages = messages[:2]
    passed, notes = watched(messages)
    assert all(one is other for one, other in zip(passed, messages, strict=True))
    assert notes == []


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ((4.0, 0.0, 0.0), "odometry jumps by 4.0 m and 3 degrees"),
        ((0.0, 0.7, 0.0), "odometry jumps by 0.7 m and 3 degrees"),
        # No farther than lost messages explain, but none are lost.
        ((0.0, 0.3, 0.0), "odometry jumps by 0.3 m and 3 degrees"),
        ((0.0, 0.0, 2.0), "odometry jumps by 0.0 m and 117 degrees"),
    ],
)
def test_after_a_jump_it_goes_on_by_its_velocity(step, text):
    told, at = arc(1.0, 1.0, 4.0), 40
    frame = se2.compose(se2.compose(told[at].X_OB, np.array(step)), se2.inverse(told[at].X_OB))
    jumping = [*told[:at], *(replace(one, X_OB=se2.compose(frame, one.X_OB)) for one in told[at:])]
    passed, notes = watched(jumping)
    assert [(one.kind, one.time_s, one.text) for one in notes] == [("jump", told[at].stamp, text)]
    assert [one.breaks for one in passed] == [0] * at + [1] * (len(told) - at)
    # An arc goes on as an arc: next to nothing is left of the jump.
    for one, true in zip(passed, told, strict=True):
        np.testing.assert_allclose(se2.between(true.X_OB, one.X_OB), 0.0, atol=1e-4)


def test_a_base_that_drives_too_fast_all_the_time_is_not_believed():
    # Of no step alone could that be said.
    messages = [Odometry(0.05 * k, np.array([0.3 * k, 0.0, 0.0]), np.array([0.3, 0.0])) for k in range(60)]
    passed, notes = watched(messages)
    assert {one.kind for one in notes} == {"jump"}
    assert passed[-1].X_OB[0] < 3.0 * 1.5 + 0.5 + 0.3


def test_one_that_says_so_itself_may_be_faster():
    passed, notes = watched(messages := arc(4.0, 0.0, 3.0))
    assert passed == messages
    assert notes == []


@pytest.mark.parametrize(("way", "silent"), [(0.6, True), (0.4, False)])
def test_a_silence_in_which_it_moved_is_an_unknown_way(way, silent):
    before, after = arc(0.0, 0.0, 0.2)[:2], Odometry(5.0, np.array([1.0 + way, -2.0, 3.0]), np.zeros(2), at_rest=True)
    passed, notes = watched([*before, after])
    assert passed[-1].breaks == silent
    assert [one.text for one in notes] == ["no odometry for 5.0 s while the robot moves"] * silent
    np.testing.assert_array_equal(passed[-1].X_OB, after.X_OB)
    assert passed[-1].at_rest != silent
    assert watched([*before, after], silence=6.0) == ([*before, after], [])


def test_messages_out_of_order_or_without_numbers_are_left_out():
    messages = arc(0.5, 0.2, 0.5)
    late = replace(messages[3], stamp=0.1)
    nowhere = replace(messages[6], X_OB=np.array([math.nan, 0.0, 0.0]))
    passed, notes = watched([*messages[:5], late, messages[5], nowhere, *messages[7:]])
    assert passed == [*messages[:6], *messages[7:]]
    assert [(one.kind, one.time_s) for one in notes] == [("odometry", messages[6].stamp)]


def test_a_velocity_that_no_base_has_is_that_of_the_poses():
    messages = arc(0.5, -0.4, 0.5)
    passed, notes = watched([*messages[:4], replace(messages[4], V_B=np.array([500.0, math.nan])), *messages[5:]])
    np.testing.assert_allclose(passed[4].V_B, [0.5, -0.4], rtol=1e-3)
    assert [(one.kind, one.time_s) for one in notes] == [("speed", messages[4].stamp)]


def test_velocity_is_of_an_arc_and_backwards_too():
    for before, after in itertools.pairwise(arc(-0.7, 0.9, 0.5)):
        np.testing.assert_allclose(velocity(se2.between(before.X_OB, after.X_OB), 0.05), [-0.7, 0.9], rtol=1e-3)

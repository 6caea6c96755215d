"""Promises of goals: kept, broken, and made anew."""

import math

import numpy as np
import pytest

from tests.walls import no_walls
from tfg_drake.messages import replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.mission_end import REASONS, why_end
from tfg_drake.planning.promises import MOST_BROKEN, Promise, judged, promised
from tfg_drake.slam.keyframe_graph import empty_map

PRIOR = 10.0


def goal(gain, node=3, at=(1.0, 2.0)):
    candidates = np.array([1, 3])
    gains = np.array([50.0, gain])
    return replace(empty_choice(), node=node, p_MG=np.array(at), candidates=candidates, gain=gains)


def seen_from(place, entropy, landmarks=0):
    ids = np.arange(landmarks)
    pose, known = np.array([[*place, 0.0]]), no_walls(landmarks)
    return replace(empty_map(), ids=ids, p_ML=np.zeros((landmarks, 2)), **known, X_MA=pose, entropy=entropy)


def went(promise, gained, new=0, place=(1.1, 2.0)):
    """Follows a promise of 20 nats to its end."""
    promise = promised(goal(20.0), seen_from((0.0, 0.0), -100.0), promise, 10.0)
    entropy = -100.0 - gained + new * math.log(2.0 * math.pi * math.e * PRIOR**2)
    return judged(promise, seen_from(place, entropy, new), PRIOR)


def test_none_is_believed_any_more_after_so_many_that_were_broken_in_a_row():
    promise = Promise()
    for _ in range(MOST_BROKEN):
        assert promise.believed
        promise = went(promise, 1.9)
    assert not promise.believed
    assert went(promise, 2.1).believed


@pytest.mark.parametrize("new", [0, 4])
def test_what_was_gained_of_new_landmarks_counts(new):
    assert went(Promise(broken=2), 5.0, new).broken == 0
    assert went(Promise(broken=1), 0.5, new).broken == 2


def test_a_look_from_elsewhere_breaks_nothing_and_a_goal_without_gain_promises_none():
    assert went(Promise(broken=1), 0.0, place=(5.0, 2.0)).broken == 1
    ended = replace(empty_choice(), verdict="complete")
    after = promised(ended, seen_from((0.0, 0.0), 0.0), Promise(broken=2), 10.0)
    assert (after.gain, after.broken) == (0.0, 2)
    assert promised(goal(9.0), seen_from((0.0, 0.0), 0.0), Promise(), 10.0).gain == 0.0


def test_the_reason_says_so():
    assert why_end(True, 0.0, 0.0, np.zeros(len(REASONS)), math.inf) == (
        "complete",
        "Places give less than 10% of what they promise, 3 times in a row.",
    )


def test_looks_after_exploring_are_worth_what_they_have_given():
    """Each as much as all before it, whatever they promise, and they break no promise of other goals."""
    again, promise = replace(goal(4.0), explored=3.0), Promise(broken=1)
    for gained, kept in ((1.0, 0.625), (0.0, 0.3125), (9.0, 0.65625)):
        promise = promised(again, seen_from((0.0, 0.0), 0.0), promise, 10.0)
        promise = judged(promise, seen_from((1.0, 2.0), -gained), PRIOR)
        assert (promise.broken, promise.kept) == (1, kept)
    assert went(promise, 1.0).kept == promise.kept

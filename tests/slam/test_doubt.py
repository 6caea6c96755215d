"""What is believed of a tag by a few keyframes made by hand: seen in so many frames, here or there."""

import numpy as np
import pytest

from tests.slam.rings import NOTHING, observed, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam.doubt import (
    MOST,
    MOST_AT_ONCE,
    Sighted,
    believable,
    contradicted,
    disputed,
    doubtful,
    forgotten,
    no_evidence,
    only,
    overturned,
    weighed,
    with_doubts,
)
from tfg_drake.slam.keyframe_graph import empty_graph, extended, taken_back
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.shared import exactly_known

# Four tags; the robot stands at the origin, and moves a step and a turn from keyframe to keyframe.
P_ML = np.array([[3.0, 1.0], [2.0, -1.0], [5.0, 0.0], [4.0, 2.0]])
X_AD = np.array([0.1, 0.0, 0.2])
TAG = 102


class Account:
    """Keyframes of the four tags, one after the other, each where the one before ends, and what speaks for the tags."""

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.graph, self.evidence = empty_graph(exactly_known()), no_evidence()

    def see(self, frames, p_ML=P_ML, agrees=(True, True, True, True)):
        """One keyframe more, with each tag seen in so many frames; agrees: where the map has it."""
        X_MA, frames = self.graph.X_MN[-1], np.array(frames)
        seen = Sighted(observed(self.rng, p_ML, X_MA, X_AD, np.arange(4)), frames)
        seen, agrees = only(seen, frames > 0), np.array(agrees)[frames > 0]
        believed = believable(self.evidence, seen, X_MA, self.graph)
        self.graph = extended(self.graph, only(seen, agrees).keyframe, se2.compose(X_MA, X_AD), is_view=True)
        self.evidence = weighed(self.evidence, seen, agrees, self.graph)
        return dict(zip(seen.keyframe.ids.tolist(), believed.tolist(), strict=True))

    def frames(self, tag=TAG):
        """For each place of the tag, whether the map has it there: the frames that speak for it."""
        of_tag = self.evidence.kept(self.evidence.ids == tag)
        return sorted(zip(of_tag.is_mapped.tolist(), of_tag.frames.tolist(), strict=True))


def elsewhere(by):
    p_ML = P_ML.copy()
    p_ML[TAG - 100] += by
    return p_ML


def test_a_tag_is_believed_when_three_frames_saw_it_of_whatever_keyframes():
    account = Account()
    assert account.see([3, 9, 1, 2], agrees=(True, True, False, False)) == {
        100: True,
        101: True,
        102: False,
        103: False,
    }
    np.testing.assert_array_equal(doubtful(account.evidence), [102, 103])
    assert account.see([5, 5, 1, 1], agrees=(True, True, False, True)) == {100: True, 101: True, 102: False, 103: True}
    assert account.frames() == [(False, 2)]
    assert account.frames(103) == [(True, 3)]
    assert account.see([5, 5, 1, 1])[TAG]
    assert account.frames() == [(True, 3)]
    assert len(doubtful(account.evidence)) == 0


def test_a_doubtful_tag_is_where_most_frames_saw_it():
    account = Account()
    account.see([9, 9, 1, 2], agrees=(True, True, False, True))
    account.see([9, 9, 2, 0], elsewhere(2.0), agrees=(True, True, False, True))
    graph, estimate = solve(account.graph, 0.0, NOTHING)
    estimate = with_doubts(estimate, account.evidence, graph)
    np.testing.assert_array_equal(estimate.doubtful, [TAG, 103])
    np.testing.assert_allclose(estimate.doubtful_places, [elsewhere(2.0)[2], P_ML[3]], atol=0.1)


def test_frames_that_say_different_things_do_not_add_up():
    account = Account()
    for by in (0.0, 2.0, 4.0, 6.0, 8.0):
        assert not account.see([5, 5, 1, 5], elsewhere(by), agrees=(True, True, False, True))[TAG]
    np.testing.assert_array_equal(doubtful(account.evidence), [TAG])


def test_a_misread_that_was_believed_is_overturned_by_true_sightings():
    account = Account()
    account.see([9, 9, 3, 9], elsewhere(11.0))
    assert len(overturned(account.evidence)) == 0
    account.see([9, 9, 7, 9], agrees=(True, True, False, True))
    assert account.frames() == [(False, 7), (True, 0)]
    np.testing.assert_array_equal(overturned(account.evidence), [TAG])
    np.testing.assert_array_equal(doubtful(account.evidence), [TAG])
    account.evidence = forgotten(account.evidence, overturned(account.evidence))
    assert account.see([9, 9, 1, 9])[TAG]
    assert account.frames() == [(True, 8)]
    assert len(doubtful(account.evidence)) == 0


def test_what_is_well_known_is_overturned_by_two_keyframes_in_a_row():
    account = Account()
    for _ in range(3):
        account.see([20, 20, 20, 20])
    assert account.frames() == [(True, MOST)]
    account.see([20, 20, 20, 20], elsewhere(1.0), agrees=(True, True, False, True))
    assert account.frames() == [(False, MOST_AT_ONCE), (True, MOST - MOST_AT_ONCE)]
    assert len(overturned(account.evidence)) == 0
    np.testing.assert_array_equal(doubtful(account.evidence), [TAG])
    account.see([20, 20, 20, 20])
    assert account.frames() == [(True, MOST)]
    for _ in range(2):
        account.see([20, 20, 20, 20], elsewhere(1.0), agrees=(True, True, False, True))
    np.testing.assert_array_equal(overturned(account.evidence), [TAG])


def test_single_errors_here_and_there_hardly_count():
    account = Account()
    for k in range(8):
        account.see([9, 9, 9, 9])
        account.see([9, 9, 1, 9], elsewhere(0.7 * k + 1.0), agrees=(True, True, False, True))
        assert len(overturned(account.evidence)) == len(doubtful(account.evidence)) == 0


def test_places_follow_the_views_they_were_seen_from():
    account = Account()
    account.see([9, 9, 9, 9])
    account.see([9, 9, 2, 9], elsewhere(3.0), agrees=(True, True, False, True))
    # A loop closes and moves the map as a whole.
    move = np.array([1.0, -2.0, 0.3])
    account.graph = replace(account.graph, X_MN=se2.compose(move, account.graph.X_MN))
    account.see([9, 9, 2, 9], se2.transform(move, elsewhere(3.0)), agrees=(True, True, False, True))
    assert account.frames() == [(False, 4), (True, 5)]


def test_the_audit_finds_what_one_keyframe_has_elsewhere():
    keyframes, _, _ = ring(3, views=12, laps=0.3)
    tag = next(int(tag) for tag in keyframes[4].ids if sum(tag in one.ids for one in keyframes) > 3)
    for by in (0.0, 0.02, 0.8):
        y_AL = keyframes[4].y_AL + by * (keyframes[4].ids == tag)[:, None]
        seen = [*keyframes[:4], replace(keyframes[4], y_AL=y_AL), *keyframes[5:]]
        graph, _ = solve(reckoned(seen), 0.0, NOTHING)
        assert contradicted(graph) == ((tag, 4) if by == 0.8 else None)
    assert contradicted(solve(taken_back(graph, tag, 4), 0.0, NOTHING)[0]) is None


def test_a_disputed_tag_is_doubtful():
    account = Account()
    account.see([20, 20, 20, 20])
    np.testing.assert_array_equal(doubtful(disputed(account.evidence, np.array([TAG]))), [TAG])


@pytest.mark.parametrize("frames", [[0, 0, 0, 0], [3, 0, 0, 0]])
def test_few_tags_or_none(frames):
    account = Account()
    account.see(frames)
    account.see(frames)
    assert len(account.evidence.ids) == np.count_nonzero(frames)
    assert len(doubtful(account.evidence)) == 0

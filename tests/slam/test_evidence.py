"""Sightings that cannot be; tags believed when many frames saw them, here or there; tags that are gone."""

import numpy as np
import pytest

from tests.slam.rings import NOTHING, observed, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import LaserScan, TagDetections, replace
from tfg_drake.slam.evidence import (
    LEAST_FRAMES,
    MOST,
    MOST_AT_ONCE,
    STEEPEST,
    Evidence,
    Sighted,
    TagWatch,
    believable,
    contradicted,
    disputed,
    doubtful,
    forgotten,
    missing,
    overturned,
    renewed,
    sanitized,
    watch_of,
    watched,
    weighed,
    with_doubts,
)
from tfg_drake.slam.keyframe_graph import empty_graph, extended, taken_back
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.shared import exactly_known
from tfg_drake.table import empty, take

# Four tags; the robot stands at the origin, and moves a step and a turn from keyframe to keyframe.
P_ML = np.array([[3.0, 1.0], [2.0, -1.0], [5.0, 0.0], [4.0, 2.0]])
X_AD = np.array([0.1, 0.0, 0.2])
TAG = 102
# Three tags on a wall 3 m ahead, one of which fell off.
WALL_IDS = np.array([3, 5, 8])
ON_WALL = np.array([[3.0, -1.0], [3.0, 0.2], [3.0, 1.0]])
ANGLES = np.linspace(-1.1, 1.1, 221)
HERE, SCAN = np.zeros(3), LaserScan(0.0, ANGLES, 3.0 / np.cos(ANGLES), 10.0, 0.01)


def sightings_of(ids, distance, bearing=None, sigma=None):
    n = len(ids)
    bearing = np.zeros(n) if bearing is None else np.array(bearing)
    sigma = np.full(n, 0.1) if sigma is None else np.array(sigma)
    return TagDetections(1.0, np.array(ids), np.array(distance, dtype=float), bearing, sigma, np.full(n, 0.01))


def test_a_good_frame_is_left_alone():
    detections = sightings_of([3, 1, 2], [1.0, 2.0, 3.0])
    assert sanitized(detections) == (detections, 0)
    empty = sightings_of(np.zeros(0, dtype=int), [])
    assert sanitized(empty) == (empty, 0)


def test_what_cannot_be_is_left_out():
    detections = sightings_of(
        [1, 2, 3, 4, 5, 6], [1.0, np.nan, np.inf, -1.0, 2.0, 2.0], [0, 0, 0, 0, np.nan, 0], [0.1, 0.1, 0.1, 0.1, 0.1, 0]
    )
    kept, ignored = sanitized(detections)
    assert kept.ids.tolist() == [1]
    assert ignored == 5


def test_of_two_sightings_with_one_id_neither_is_believed():
    kept, ignored = sanitized(sightings_of([7, 8, 7], [1.0, 2.0, 5.0]))
    assert kept.ids.tolist() == [8]
    assert ignored == 2
    assert kept.stamp == 1.0


def test_select_keeps_rows_together():
    kept = take(sightings_of([7, 8, 9], [1.0, 2.0, 3.0]), np.array([True, False, True]))
    assert kept.ids.tolist() == [7, 9]
    assert kept.range.tolist() == [1.0, 3.0]


class Account:
    """Keyframes of the four tags, one after the other, each where the one before ends, and what speaks for the tags."""

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.graph, self.evidence = empty_graph(exactly_known()), empty(Evidence)

    def see(self, frames, p_ML=P_ML, agrees=(True, True, True, True)):
        """One keyframe more, with each tag seen in so many frames; agrees: where the map has it."""
        X_MA, frames = self.graph.X_MN[-1], np.array(frames)
        seen = Sighted(observed(self.rng, p_ML, X_MA, X_AD, np.arange(4)), frames)
        seen, agrees = seen.only(frames > 0), np.array(agrees)[frames > 0]
        believed = believable(self.evidence, seen, X_MA, self.graph)
        self.graph = extended(self.graph, seen.only(agrees).keyframe, se2.compose(X_MA, X_AD), is_view=True)
        self.evidence = weighed(self.evidence, seen, agrees, self.graph)
        return dict(zip(seen.keyframe.ids.tolist(), believed.tolist(), strict=True))

    def frames(self, tag=TAG):
        """For each place of the tag, whether the map has it there: the frames that speak for it."""
        of_tag = take(self.evidence, self.evidence.ids == tag)
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


def frame_of(ids, X_MC=HERE):
    d = ON_WALL[np.searchsorted(WALL_IDS, ids)] - X_MC[:2]
    bearing = np.arctan2(d[:, 1], d[:, 0]) - X_MC[2]
    one = np.ones(len(ids))
    return TagDetections(0.0, np.array(ids), np.hypot(*d.T), bearing, one, one)


def look(watch, ids, frames, X_MC=HERE, scan=SCAN):
    for _ in range(frames):
        watch = watched(watch, ON_WALL, X_MC, 0.0, frame_of(ids, X_MC), scan)
    return watch


def gone(watch):
    return WALL_IDS[missing(watch)].tolist()


@pytest.fixture
def known():
    """All three were seen for ten frames, up to 0.6 rad aside, before the newest view."""
    watch = look(renewed(empty(TagWatch), WALL_IDS), [3, 5, 8], 10)
    assert gone(watch) == []
    return renewed(replace(watch, widest=0.6, farthest=6.0, all_expected=1000, all_seen=1000), WALL_IDS)


def test_a_tag_that_frames_should_show_and_do_not_is_missing(known):
    assert gone(look(known, [3, 8], LEAST_FRAMES - 1)) == []
    after = look(known, [3, 8], LEAST_FRAMES)
    assert gone(after) == [5]
    assert gone(renewed(after, WALL_IDS)) == []


def test_frames_count_from_view_to_view_until_one_shows_it(known):
    nearly = renewed(look(known, [3, 8], LEAST_FRAMES - 1), WALL_IDS)
    assert gone(look(nearly, [3, 8], 1)) == [5]
    assert gone(look(look(nearly, [5], 1), [3, 8], 1)) == []


def test_frames_without_any_tag_of_the_map_say_nothing(known):
    after = look(known, [], 20)
    assert (after.all_expected, after.widest) == (known.all_expected, known.widest)
    assert np.array_equal(after.failed, known.failed)
    assert np.array_equal(after.seen_from, known.seen_from)


def test_who_stands_before_it_hides_it(known):
    person = replace(SCAN, ranges=np.where(np.abs(ANGLES - 0.07) < 0.1, 1.5, SCAN.ranges))
    assert gone(look(known, [3, 8], 20, scan=person)) == []


@pytest.mark.parametrize("beside", [0.015, 0.02, 0.033])
def test_what_hides_a_part_of_it_hides_it(beside, known):
    """The corner of a cupboard, 1.2 m ahead, so far, rad, beside the line of sight: its ray, or one next to it."""
    right = np.arctan2(0.2, 3.0) - beside
    corner = replace(SCAN, ranges=np.where(right > ANGLES, np.minimum(SCAN.ranges, 1.2 / np.cos(ANGLES)), SCAN.ranges))
    assert gone(look(known, [3, 8], 20, scan=corner)) == []


@pytest.mark.parametrize("beyond", [[6.0, 0.0, np.pi], [4.5, -1.2, 2.39]])
def test_from_the_other_side_of_a_thin_wall_it_is_not_expected(known, beyond):
    """The second place is not far from where it was seen from, but for the wall between."""
    beyond = np.array(beyond)
    known = replace(known, seen_from=np.tile([-1.0, -9.0], (3, 1)), widest=1.3)
    d = (3.0 - beyond[0]) / np.cos(ANGLES + beyond[2])
    scan = replace(SCAN, ranges=np.where(d > 0.0, d, np.inf))
    assert gone(look(known, [8], 20, X_MC=beyond, scan=scan)) == []


def test_beyond_the_farthest_sighting_it_is_not_expected(known):
    beside = np.array([0.0, -1.0, 0.0])
    assert gone(look(known, [3], 20, X_MC=beside)) == [5]
    assert gone(look(replace(known, farthest=3.0), [3], 20, X_MC=beside)) == []


def test_neither_a_gross_range_nor_a_misread_id_is_a_far_sighting():
    watch, frame = renewed(empty(TagWatch), WALL_IDS), frame_of([3, 5, 8])
    gross = watched(watch, ON_WALL, HERE, 0.0, replace(frame, range=3.0 * frame.range), SCAN)
    misread = watched(watch, ON_WALL + np.array([9.0, 0.0]), HERE, 0.0, frame, SCAN)
    assert gross.farthest == misread.farthest == pytest.approx(np.hypot(3.0, 1.0))


def test_more_aslant_than_the_data_sheet_says_it_is_not_expected(known):
    assert watch_of(np.radians(75.0)).steepest == STEEPEST
    assert gone(look(replace(known, steepest=watch_of(0.3).steepest), [3, 8], 20)) == []


def test_where_detection_fails_often_more_frames_must(known):
    poor = replace(known, all_expected=1000, all_seen=300)
    assert gone(look(poor, [3, 8], 20)) == []
    assert gone(look(poor, [3, 8], 40)) == [5]


def test_a_new_map_keeps_from_where_its_tags_were_seen(known):
    after = renewed(look(known, [3, 8], 2), np.array([5, 6, 8]))
    np.testing.assert_array_equal(after.seen_from[0], known.seen_from[1])
    assert not after.seen_from[1].any()
    assert after.failed.tolist() == [2, 0, 0]

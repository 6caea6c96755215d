"""Tags on a wall 3 m ahead, one of which fell off: which frames should have shown it."""

import numpy as np
import pytest

from tfg_drake.messages import LaserScan, TagDetections, replace
from tfg_drake.slam.missing_tags import LEAST_FRAMES, missing, no_watch, renewed, watched

IDS = np.array([3, 5, 8])
P_ML = np.array([[3.0, -1.0], [3.0, 0.2], [3.0, 1.0]])
ANGLES = np.linspace(-1.1, 1.1, 221)
HERE, SCAN = np.zeros(3), LaserScan(0.0, ANGLES, 3.0 / np.cos(ANGLES), 10.0, 0.01)


def frame(ids, X_MC=HERE):
    d = P_ML[np.searchsorted(IDS, ids)] - X_MC[:2]
    bearing = np.arctan2(d[:, 1], d[:, 0]) - X_MC[2]
    one = np.ones(len(ids))
    return TagDetections(0.0, np.array(ids), np.hypot(*d.T), bearing, one, one)


def look(watch, ids, frames, X_MC=HERE, scan=SCAN):
    for _ in range(frames):
        watch = watched(watch, P_ML, X_MC, 0.0, frame(ids, X_MC), scan)
    return watch


def gone(watch):
    return IDS[missing(watch)].tolist()


@pytest.fixture
def known():
    """All three were seen for ten frames, up to 0.6 rad aside, before the newest view."""
    watch = look(renewed(no_watch(), IDS), [3, 5, 8], 10)
    assert gone(watch) == []
    return renewed(replace(watch, widest=0.6, all_expected=1000, all_seen=1000), IDS)


def test_a_tag_that_frames_should_show_and_do_not_is_missing(known):
    assert gone(look(known, [3, 8], LEAST_FRAMES - 1)) == []
    after = look(known, [3, 8], LEAST_FRAMES)
    assert gone(after) == [5]
    assert gone(renewed(after, IDS)) == []


def test_frames_count_from_view_to_view_until_one_shows_it(known):
    nearly = renewed(look(known, [3, 8], LEAST_FRAMES - 1), IDS)
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


def test_where_detection_fails_often_more_frames_must(known):
    poor = replace(known, all_expected=1000, all_seen=300)
    assert gone(look(poor, [3, 8], 20)) == []
    assert gone(look(poor, [3, 8], 40)) == [5]


def test_a_new_map_keeps_from_where_its_tags_were_seen(known):
    after = renewed(look(known, [3, 8], 2), np.array([5, 6, 8]))
    np.testing.assert_array_equal(after.seen_from[0], known.seen_from[1])
    assert not after.seen_from[1].any()
    assert after.failed.tolist() == [2, 0, 0]

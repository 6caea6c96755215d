"""Frames of a tag that stays where it is in the image tell what the first of them told."""

import numpy as np

from tests.vision.test_sighting import AHEAD, CAMERA, SIZES, seen
from tfg_drake.vision.same_view import no_views, weighed
from tfg_drake.vision.sighting import sighted


def sigmas(p_CT, views, ids=None):
    """Deviations of range in an image of tags at p_CT, over those of the image alone, and the views."""
    tags = seen(p_CT, ids)
    alone = sighted(tags, 0.0, CAMERA, SIZES, AHEAD).detections
    found, views = weighed(alone, tags, views)
    np.testing.assert_array_equal(found.sigma_bearing / alone.sigma_bearing, found.sigma_range / alone.sigma_range)
    return (found.sigma_range / alone.sigma_range).tolist(), views


def test_a_tag_that_has_not_moved_tells_little():
    # Half a pixel is 2 mm at 2 m.
    there, nearly, moved = [[0.0, 0.0, 2.0]], [[0.001, 0.0, 2.0]], [[0.0025, 0.0, 2.0]]
    first, views = sigmas(there, no_views())
    assert first == [1.0]
    for place, times in ((there, 20.0), (nearly, 20.0), (moved, 1.0), (moved, 20.0), (there, 1.0)):
        found, views = sigmas(place, views)
        assert found == [times]


def test_a_slow_drift_is_new_when_it_has_come_far_enough():
    views, told = no_views(), []
    for x in np.arange(0.0, 0.01, 0.0005):
        found, views = sigmas([[x, 0.0, 2.0]], views)
        told += found
    assert 3 <= told.count(1.0) <= 5


def test_each_tag_for_itself_and_anew_when_it_comes_back():
    _, views = sigmas([[0.0, 0.0, 2.0], [0.4, 0.0, 2.0]], no_views(), [3, 7])
    found, views = sigmas([[0.0, 0.0, 2.0], [0.41, 0.0, 2.0]], views, [3, 7])
    assert found == [20.0, 1.0]
    _, views = sigmas([[0.0, 0.0, 2.0]], views, [3])
    found, _ = sigmas([[0.0, 0.0, 2.0], [0.41, 0.0, 2.0]], views, [3, 7])
    assert found == [20.0, 1.0]

"""A look tells of two places as far as the map says that they look different from there."""

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import Hypotheses
from tfg_drake.planning.which_place import place_information
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.surface_fit import points_along

# Faces seen from their left: a hall of 12 by 3 m that ends in a niche, whose mouth does not show from its other end.
HALL = [[0.0, 0, 12, 0], [12, 0, 12, 3], [12, 3, 11, 3], [11, 3, 11, 5], [11, 5, 9, 5], [9, 5, 9, 3], [9, 3, 0, 3]]
PLAIN = [[0.0, 0, 12, 0], [12, 0, 12, 3], [12, 3, 0, 3]]
END = [[0.0, 3, 0, 0]]
THERE = np.array([30.0, 4.0, 2.0])


def surfaces(hall, at=(0.0, 0.0, 0.0)):
    return moved_points(np.array(at), points_along(np.array(hall + END).reshape(-1, 2, 2)))


def hypotheses(*poses, of=(HALL, PLAIN)):
    both = np.vstack([surfaces(of[0]), surfaces(of[1], THERE)])
    return Hypotheses(np.array(poses), np.full(len(poses), 0.5), both)


HERE = np.zeros(3)
POINTS = np.array([[1.5, 1.5], [10.0, 1.5]])


def test_it_tells_where_the_places_differ_and_not_where_they_are_alike():
    far, at_niche = place_information(POINTS, hypotheses(HERE, THERE), 5.0)
    assert far < 1e-6
    assert 0.5 < at_niche <= math.log(2.0)


def test_it_is_the_same_whichever_way_the_map_lies():
    """From a place at the niche the view is the same, turned."""
    X_WK = np.array([-3.0, 8.0, -1.1])
    known = hypotheses(HERE, THERE)
    turned = Hypotheses(se2.compose(X_WK, known.X_KM), known.probability, moved_points(X_WK, known.surfaces))
    told = place_information(POINTS, turned, 5.0)
    np.testing.assert_allclose(told, place_information(POINTS, known, 5.0), atol=0.03)


def test_equal_places_are_never_told_apart():
    assert np.all(place_information(POINTS, hypotheses(HERE, THERE, of=(HALL, HALL)), 5.0) < 0.03)


def test_it_is_no_more_than_the_logarithm_of_their_number():
    """However unlikely one is: it keeps the other from being believed."""
    two, one = hypotheses(HERE, THERE), hypotheses(HERE)
    unlikely = Hypotheses(two.X_KM, np.array([0.999, 0.001]), two.surfaces)
    np.testing.assert_array_equal(place_information(POINTS, unlikely, 5.0), place_information(POINTS, two, 5.0))
    assert np.all(place_information(POINTS, two, 5.0) <= math.log(2.0))
    assert not place_information(POINTS, one, 5.0).any()
    assert not place_information(POINTS, None, 5.0).any()

"""The probability of an undiscovered room against its formula by hand."""

import math

import numpy as np
import pytest

from tfg_drake.planning import undiscovered as model
from tfg_drake.planning.openings import KEPT_OUT, NOT_WORTH, TOO_NARROW, Openings
from tfg_drake.planning.undiscovered import NO_OPENING, undiscovered


def openings(*rows, why=NOT_WORTH):
    width, unknown = np.array(rows, dtype=float).reshape(-1, 2).T
    zero = np.zeros(len(width))
    return Openings(np.zeros((len(width), 2)), width, zero, zero, unknown, np.full(len(width), why))


def test_without_an_opening_little_is_left():
    np.testing.assert_allclose(undiscovered(openings()), NO_OPENING)
    assert 0.0 < NO_OPENING < 0.1


def test_where_the_map_leaves_no_room_there_is_none():
    np.testing.assert_allclose(undiscovered(openings((1.0, 5.0)), (5.5, 10.0)), NO_OPENING)
    assert undiscovered(openings((1.0, 5.0)), (4.9,)) > 2.0 * NO_OPENING


@pytest.mark.parametrize("why", [NOT_WORTH, TOO_NARROW])
def test_one_opening_is_a_logistic_of_its_width_and_of_the_room_behind_it(why):
    logit = model.BIAS + model.BY_WIDTH * math.log(0.8) + model.BY_UNKNOWN * math.log(20.0 / 4.0)
    logit += model.IMPASSABLE * (why == TOO_NARROW)
    expected = 1.0 - (1.0 - NO_OPENING) * (1.0 - 1.0 / (1.0 + math.exp(-logit)))
    assert undiscovered(openings((0.8, 20.0), why=why), (4.0,))[0] == pytest.approx(expected)


def test_openings_tell_each_by_itself():
    one, other, both = (
        1.0 - undiscovered(openings(*rows)) for rows in ([(0.8, 20.0)], [(2.0, 12.0)], [(0.8, 20.0), (2.0, 12.0)])
    )
    np.testing.assert_allclose(both * (1.0 - NO_OPENING), one * other)


def test_larger_rooms_are_less_likely_and_so_are_those_that_nobody_may_enter():
    stated = undiscovered(openings((0.8, 20.0)))
    assert (np.diff(stated) <= 0.0).all()
    for why in (TOO_NARROW, KEPT_OUT):
        assert (undiscovered(openings((0.8, 20.0), why=why)) < stated).all()

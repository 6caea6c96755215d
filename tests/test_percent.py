"""Shares as a person reads them."""

import math
from decimal import Decimal

import pytest

from tfg_drake.percent import percent


@pytest.mark.parametrize(
    ("share", "digits", "shown"),
    [
        (1.0, 1, "100.0"),
        (0.9996, 1, "99.9"),
        (0.99949, 1, "99.9"),
        (0.9994, 2, "99.94"),
        (1.0 - 1e-12, 2, "99.99"),
        (0.996, 0, "99"),
        (0.5, 0, "50"),
        (0.0, 1, "0.0"),
        (1.25, 0, "125"),
    ],
)
def test_less_than_all_is_never_shown_as_all(share, digits, shown):
    assert f"{percent(share, digits):.{digits}f}" == shown


def test_of_whole_numbers_every_share_but_all_is_below_100():
    for whole in (3, 999, 1999, 2001, 10**6):
        assert percent((whole - 1) / whole) < 100.0
        assert percent(whole / whole) == 100.0
        below = Decimal(100 * (whole - 1)) / whole
        assert abs(Decimal(percent((whole - 1) / whole)) - below) <= Decimal("0.1")


def test_what_is_not_known_stays_so():
    assert math.isnan(percent(math.nan))

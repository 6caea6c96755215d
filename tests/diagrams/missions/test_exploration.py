"""A mission from Python: what is asked for that cannot be."""

import pytest

import tfg_drake


def test_time_does_not_run_backwards():
    told = "^-3 s: must be 0 or more; time does not run backwards$"
    with pytest.raises(ValueError, match=told):
        tfg_drake.explore("house", until=-3)
    house = tfg_drake.explore("house", until=0.0)
    with pytest.raises(ValueError, match=told):
        house.advance(-3)
    assert house.time == 0.0

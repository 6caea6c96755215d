import numpy as np
import pytest

from tfg_drake.geometry.motion import advance


def test_advance_is_the_exact_arc():
    # A quarter of a circle of radius 1, to the left.
    assert advance(np.zeros(3), 1.0, 1.0, np.pi / 2) == pytest.approx([1, 1, np.pi / 2], abs=1e-14)
    assert advance(np.array([1.0, 2.0, np.pi / 2]), 0.5, 0.0, 2.0) == pytest.approx([1, 3, np.pi / 2])
    there = advance(np.array([1.0, 2.0, 3.0]), 0.5, -0.7, 2.0)
    assert advance(there, 0.5, -0.7, -2.0) == pytest.approx([1, 2, 3], abs=1e-14)

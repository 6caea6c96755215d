"""Walls in the figure of a recording."""

import numpy as np

from tfg_drake.datasets.figure import met


def test_a_wall_is_drawn_where_scans_met_something():
    """Legs of chairs in a row, and nothing in between."""
    legs = np.array([[0.0, 0.05], [2.0, -0.05], [2.1, 0.0], [4.0, 0.05], [1.0, 0.3]])
    pieces = met(np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 2.0], [4.0, 2.0]]]), legs)
    np.testing.assert_allclose(pieces[:, :, 1], 0.0)
    np.testing.assert_allclose(pieces[:, :, 0], [[0.0, 0.14], [1.86, 2.25], [3.86, 4.0]], atol=0.05)
    assert met(np.zeros((0, 2, 2)), legs).shape == (0, 2, 2)

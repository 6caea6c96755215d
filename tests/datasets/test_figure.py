"""Walls in the figure of a recording."""

import numpy as np

from tfg_drake.datasets import figure as figure_module
from tfg_drake.datasets.figure import draw_laser_map, met


def test_a_wall_is_drawn_where_scans_met_something():
    """Legs of chairs in a row, and nothing in between."""
    legs = np.array([[0.0, 0.05], [2.0, -0.05], [2.1, 0.0], [4.0, 0.05], [1.0, 0.3]])
    pieces = met(np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 2.0], [4.0, 2.0]]]), legs)
    np.testing.assert_allclose(pieces[:, :, 1], 0.0)
    np.testing.assert_allclose(pieces[:, :, 0], [[0.0, 0.14], [1.86, 2.25], [3.86, 4.0]], atol=0.05)
    assert met(np.zeros((0, 2, 2)), legs).shape == (0, 2, 2)


def test_a_wall_that_few_rays_met_is_within_the_limits(monkeypatch):
    """Hits that are as few are not drawn."""
    drawn = []
    monkeypatch.setattr(figure_module, "write_figure", lambda _path, figure: drawn.append(figure))
    hits = np.vstack([np.random.default_rng(0).uniform(0.0, 5.0, (5000, 2)), [[9.0, 1.0], [9.0, 1.05]]])
    walls, way, true_way = np.array([[[9.0, 0.0], [9.0, 4.0]]]), np.ones((2, 2)), np.array([[1.0, 1.0], [1.0, 7.0]])
    draw_laser_map("f.png", "far", hits, walls, way, true_way)
    (axes,) = drawn[0].axes
    assert max(one.get_xdata().max() for one in axes.lines if len(one.get_xdata())) < 5.0
    assert axes.get_xlim()[1] == 10.0
    assert axes.get_ylim()[1] == 8.0

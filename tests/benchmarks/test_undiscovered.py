"""The largest undiscovered room against rooms drawn by hand."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.world.reachability import CELL

RADIUS = 0.18


@pytest.fixture
def largest_room(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("undiscovered").largest_room


def floor(width, depth):
    """Cells that a robot can reach in an empty hall of 6 x 6 m of which all is discovered but a part, m."""
    cells, covered = np.ones((120, 120), dtype=bool), np.ones((120, 120), dtype=bool)
    covered[20 : 20 + round(depth / CELL), 20 : 20 + round(width / CELL)] = False
    return cells, covered


@pytest.mark.parametrize(("width", "depth"), [(2.0, 2.0), (1.0, 4.0), (3.0, 0.5)])
def test_a_room_is_as_large_as_what_the_robot_sweeps_there(largest_room, width, depth):
    corners = (4.0 - np.pi) * RADIUS**2
    area = largest_room(*floor(width, depth), RADIUS)
    assert area == pytest.approx(width * depth - corners, abs=2.0 * CELL * (width + depth))


def test_a_strip_narrower_than_the_robot_is_no_room(largest_room):
    assert largest_room(*floor(4.0, 0.3), RADIUS) == 0.0


def test_what_the_robot_cannot_reach_is_no_room(largest_room):
    cells, covered = floor(2.0, 2.0)
    assert largest_room(np.zeros_like(cells), covered, RADIUS) == 0.0


def test_the_largest_of_two_counts_alone(largest_room):
    cells, covered = floor(1.0, 1.0)
    alone = largest_room(cells, covered, RADIUS)
    covered[80:110, 80:110] = False
    assert largest_room(cells, covered, RADIUS) > 2.0 * alone

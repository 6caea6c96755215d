"""The laser scanner's system: one that is mounted upside down."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tfg_drake.config import ScanConfig, ScanRealityConfig
from tfg_drake.messages import LaserScan
from tfg_drake.systems.laser_scanner import LaserScanner
from tfg_drake.world.world import World

# A room with a wall nearer on the robot's left than on its right.
WALLS = np.array([[5.0, -4.0, 5.0, 2.0], [5.0, 2.0, -5.0, 2.0], [-5.0, 2.0, -5.0, -4.0], [-5.0, -4.0, 5.0, -4.0]])
NO_TAGS = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0)


def scanned(field_of_view, V_B=(0.0, 0.0), **reality):
    """The second scan of a robot at the origin with a velocity (2,), without noise."""
    config = ScanConfig(field_of_view=field_of_view, noise=0.0)
    scanner = LaserScanner(World(WALLS, *NO_TAGS, np.zeros(3)), config, ScanRealityConfig(**reality))
    simulator = Simulator(scanner)
    context = simulator.get_mutable_context()
    scanner.GetInputPort("pose").FixValue(context, [0.0, 0.0, 0.0, *V_B])
    rays = scanner.GetInputPort("noise").size()
    scanner.GetInputPort("noise").FixValue(context, np.zeros(rays))
    simulator.AdvanceTo(0.15)
    return scanner.GetOutputPort("ranges").Eval(context)


@pytest.mark.parametrize("field_of_view", [math.radians(124.0), 2.0 * math.pi])
@pytest.mark.parametrize("sweep_time", [0.0, 0.05])
def test_upside_down_what_is_on_the_left_is_told_on_the_right(field_of_view, sweep_time):
    right, wrong = (scanned(field_of_view, flip=flip, sweep_time=sweep_time) for flip in (False, True))
    assert isinstance(wrong, LaserScan)
    np.testing.assert_array_equal(wrong.angles, right.angles)
    np.testing.assert_allclose(wrong.ranges, right.ranges[::-1])
    assert not np.allclose(wrong.ranges, right.ranges)
    # It is flipped about where it looks, not about where the robot does.
    aside, ahead = (scanned(field_of_view, flip=True, yaw=yaw) for yaw in (0.3, 0.0))
    assert np.interp(0.3, aside.angles, aside.ranges) == pytest.approx(
        np.interp(0.0, ahead.angles, ahead.ranges), abs=0.01
    )


def test_upside_down_it_sweeps_the_other_way():
    """So a robot that turns sees the first ray where it looked a sweep ago, on its other side."""
    right, wrong = (scanned(2.0, (0.0, 1.0), flip=flip, sweep_time=0.09) for flip in (False, True))
    first, last = (5.0 / math.cos(1.0 - 0.09), 2.0 / math.sin(1.0))
    assert wrong.ranges[0] == pytest.approx(min(first, 2.0 / math.sin(1.0 - 0.09)), rel=0.01)
    assert right.ranges[-1] == pytest.approx(last, rel=0.01)

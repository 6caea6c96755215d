"""The mapper of a grid, message by message."""

import numpy as np
import pytest

from tests.systems.grid_bench import Bench, scan
from tfg_drake.config import GridConfig, OdometryConfig
from tfg_drake.messages import MissionStatus, Odometry, replace
from tfg_drake.systems.grid_mapper import GridMapper


def test_a_map_grows_and_its_stage_follows_the_mission():
    mapper = GridMapper(GridConfig(particles=3), OdometryConfig(), seed=1)
    still = Odometry(0.0, np.zeros(3), np.zeros(2), at_rest=True)
    bench = Bench(mapper, odometry=still, scan=scan(0.0, 2.0), mission=MissionStatus("observe", 0, 0.0)).run()
    assert bench.output("grid").stage == 0
    bench.set(odometry=replace(still, stamp=0.25), scan=scan(0.2, 2.0), mission=MissionStatus("map", 0, 0.25)).run(0.25)
    first = bench.output("grid")
    assert first.stage == 1
    assert (first.probability > 0.55).any()
    assert (first.probability < 0.45).any()
    assert bench.run(0.25).output("grid").stage == 1  # until the mission is at stage 1 and maps again
    assert bench.output("pose").stage == 1
    assert pytest.approx([0.0, 0.0, 0.0], abs=0.02) == bench.output("pose").X_MB

"""The TFG builder as a system: which scans it takes, when it adds a view, and that its state is all it keeps."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.config import ExplorerConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, MapEstimate, MissionStatus, Observation, replace
from tfg_drake.systems.tfg_builder import TfgBuilder
from tfg_drake.tfg.star_polygon import looked_round

ROOM = np.array([[-3.0, -2.0, 3.0, -2.0], [3.0, -2.0, 3.0, 2.0], [3.0, 2.0, -3.0, 2.0], [-3.0, 2.0, -3.0, -2.0]])
TAGS = np.array([[0.0, -1.99], [2.99, 0.0], [0.0, 1.99], [-2.99, 0.0]])
ANGLES = np.arange(-124, 125) * ScanConfig().resolution
NONE = np.zeros(0, dtype=np.int64)
# 1 rad/s.
TURN_TIME = 6.5


def estimate(stage: int, stop: float = TURN_TIME) -> MapEstimate:
    """The map after a turn that ended at a time, s; without a view the empty map."""
    stamps = np.arange(0.0, stop, 0.1)
    X_AB = np.stack([0.0 * stamps, 0.0 * stamps, stamps], axis=1)
    ids, p = (np.arange(4), TAGS) if stage else (NONE, TAGS[:0])
    observation = Observation(ids, stamps, X_AB)
    own = np.tile(np.eye(2), (len(ids), 1, 1))
    joint = np.eye(2 * len(ids) + 3)
    none, X_MA = np.zeros((len(ids), 2)), np.zeros((stage, 3))
    return MapEstimate(stage, stop, ids, p, none, none, np.zeros(3), ids, joint, own, X_MA, observation, 0.0)


class Builder:
    def __init__(self) -> None:
        self.system = TfgBuilder(TagSensorConfig(), ScanConfig(), RobotConfig(), ExplorerConfig())
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix(map=estimate(0), mission=MissionStatus("observe", 0, 0.0), scan=self.scan(-np.inf))

    def scan(self, stamp: float) -> LaserScan:
        heading = stamp if np.isfinite(stamp) else 0.0
        return LaserScan(stamp, ANGLES, cast_rays(ROOM, np.zeros(2), ANGLES + heading, 10.0), 10.0, 0.015)

    def fix(self, **messages: object) -> None:
        for name, value in messages.items():
            self.system.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))

    def run_to(self, time: float) -> None:
        self.simulator.AdvanceTo(time)

    def turn(self, start: float = 0.0) -> None:
        """A turn as the scanner shows it, at 10 Hz."""
        for n in range(65):
            self.fix(scan=self.scan(n * 0.1))
            self.run_to(start + (n + 1) * 0.1)

    def tfg(self):
        return self.system.GetOutputPort("tfg").Eval(self.context)


@pytest.fixture
def builder() -> Builder:
    return Builder()


def test_nothing_is_known_before_the_first_view(builder: Builder) -> None:
    builder.run_to(1.0)
    assert builder.tfg().stage == 0
    assert builder.tfg().segments.shape == (0, 4)


def test_a_turn_becomes_a_map_when_the_estimator_has_it(builder: Builder) -> None:
    builder.turn()
    assert builder.tfg().stage == 0
    builder.fix(map=estimate(1), mission=MissionStatus("map", 0, 6.5))
    builder.run_to(7.0)
    tfg = builder.tfg()
    assert tfg.stage == 1
    assert {tuple(sorted(ids)) for ids in tfg.segment_ids.tolist()} == {(0, 1), (1, 2), (2, 3), (0, 3)}
    assert len(tfg.frontiers) == 0
    np.testing.assert_allclose(tfg.facing, [[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]], atol=0.05)


def test_scans_outside_a_turn_are_not_kept(builder: Builder) -> None:
    builder.fix(mission=MissionStatus("follow", 0, 0.0))
    builder.turn()
    builder.fix(map=estimate(1))
    with pytest.raises(ValueError, match="scan"):
        builder.run_to(7.0)


def test_a_missed_view_is_an_error(builder: Builder) -> None:
    builder.turn()
    builder.fix(map=estimate(2))
    with pytest.raises(ValueError, match="cannot take stage 2"):
        builder.run_to(7.0)


def test_all_state_is_in_the_context(builder: Builder) -> None:
    builder.turn()
    clone = builder.context.Clone()
    builder.fix(map=estimate(1))
    builder.run_to(7.0)
    again = Simulator(builder.system, clone)
    builder.system.GetInputPort("map").FixValue(clone, AbstractValue.Make(estimate(1)))
    again.AdvanceTo(7.0)
    tfg = builder.system.GetOutputPort("tfg").Eval(clone)
    assert tfg is not builder.tfg()
    np.testing.assert_array_equal(tfg.segments, builder.tfg().segments)
    np.testing.assert_array_equal(tfg.star_vertices, builder.tfg().star_vertices)


def test_of_a_glance_the_first_scans_count(builder: Builder) -> None:
    builder.turn()
    builder.fix(map=estimate(1), mission=MissionStatus("map", 0, 6.5))
    builder.run_to(7.0)
    builder.fix(mission=MissionStatus("glance", 1, 7.0, moving=True))
    for n in range(8):
        builder.fix(scan=replace(builder.scan(0.0), stamp=7.0 + 0.1 * n))
        builder.run_to(7.1 + 0.1 * n)
    second = estimate(2)
    stamps = np.arange(7.0, 7.8, 0.1)
    observation = replace(second.observation, stamps=stamps, X_AB=np.zeros((len(stamps), 3)))
    builder.fix(map=replace(second, observation=observation), mission=MissionStatus("map", 1, 7.8, moving=True))
    builder.run_to(8.2)
    tfg = builder.tfg()
    assert looked_round(tfg.star_offsets, tfg.star_vertices, tfg.star_centers).tolist() == [True, False]
    star = tfg.star_vertices[tfg.star_offsets[1] :]
    far = np.hypot(*star.T) > 0.5
    widest = np.abs(np.arctan2(star[far, 1], star[far, 0])).max()
    assert widest == pytest.approx(ANGLES.max(), abs=0.02)
    # What lies beside the glance was seen by the turn before.
    assert len(tfg.frontiers) == 0

"""The estimator's system against its pure steps, on a scripted mission."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tfg_drake.config import ExplorerConfig, OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.messages import LaserScan, MapEstimate, MissionStatus, Odometry, PoseEstimate, TagDetections, replace
from tfg_drake.systems import slam_estimator
from tfg_drake.systems.ports import declare_message_output
from tfg_drake.systems.slam_estimator import PERIOD, SlamEstimator

ONLY_GOALS = ExplorerConfig(path_keyframe_period=0.0)
TURN_TIME = 6.5
POINTS = np.array([[3.0, 0.5], [1.0, 4.0], [-3.0, 2.0], [-2.0, -3.0], [2.5, -2.0]])


class Script(LeafSystem):
    """A robot that turns on the spot at 1 rad/s without noise, then rests; odometry every PERIOD, tags at 10 Hz."""

    def __init__(self):
        super().__init__()
        self.set_name("script")
        declare_message_output(self, "odometry", self._odometry, {self.time_ticket()})
        declare_message_output(self, "detections", self._detections, {self.time_ticket()})
        declare_message_output(self, "scan", self._scan, {self.time_ticket()})
        declare_message_output(self, "mission", self._mission, {self.time_ticket()})

    def _odometry(self, context):
        stamp = np.floor(context.get_time() / PERIOD + 1e-6) * PERIOD
        return Odometry(stamp, np.array([0.0, 0.0, min(stamp, TURN_TIME)]), np.zeros(2))

    def _detections(self, context):
        stamp = np.floor(context.get_time() * 10.0 + 1e-6) / 10.0
        r, b = np.hypot(*POINTS.T), np.arctan2(POINTS[:, 1], POINTS[:, 0]) - min(stamp, TURN_TIME)
        return TagDetections(stamp, np.arange(len(r)), r, b, np.full(len(r), 0.05), np.full(len(r), 0.01))

    def _scan(self, context):
        return LaserScan(-np.inf, np.zeros(0), np.zeros(0), 10.0, 0.015)

    def _mission(self, context):
        time = context.get_time()
        phase = "observe" if time < TURN_TIME else "map" if time < TURN_TIME + 0.5 else "choose"
        return MissionStatus(phase=phase, stage=int(phase == "choose"), since=0.0)


def build():
    builder = DiagramBuilder()
    script = builder.AddSystem(Script())
    estimator = builder.AddSystem(SlamEstimator(OdometryConfig(), TagSensorConfig(), ScanConfig(), ONLY_GOALS))
    for name in ("odometry", "detections", "scan", "mission"):
        builder.Connect(script.GetOutputPort(name), estimator.GetInputPort(name))
    return builder.Build(), estimator


def outputs(estimator, context):
    context = estimator.GetMyContextFromRoot(context)
    return estimator.GetOutputPort("pose").Eval(context), estimator.GetOutputPort("map").Eval(context)


def test_a_turn_becomes_a_map():
    diagram, estimator = build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(6.0)
    pose, empty = outputs(estimator, simulator.get_context())
    assert isinstance(pose, PoseEstimate)
    assert isinstance(empty, MapEstimate)
    assert empty.stage == 0
    assert len(pose.new_ids) == len(POINTS)
    np.testing.assert_allclose(pose.X_MB, [0.0, 0.0, 6.0 - PERIOD - 2.0 * np.pi], atol=0.01)
    simulator.AdvanceTo(8.0)
    pose, estimate = outputs(estimator, simulator.get_context())
    assert estimate.stage == pose.stage == 1
    assert len(pose.new_ids) == 0
    np.testing.assert_allclose(estimate.p_ML, POINTS, atol=1e-6)
    np.testing.assert_allclose(pose.X_MB, [0.0, 0.0, TURN_TIME - 2.0 * np.pi], atol=1e-6)
    assert pose.stamp == 8.0 - PERIOD


def test_the_robot_is_placed_since_its_poses_are_published_in_the_frame_of_its_map(monkeypatch):
    process = slam_estimator.process_odometry

    def found(state, odometry):
        """From 1 s on it has found itself by what it saw at 0.3 s."""
        state = process(state, odometry)
        return replace(state, placed=0.3) if odometry.stamp == 1.0 else state

    monkeypatch.setattr(slam_estimator, "process_odometry", found)
    diagram, estimator = build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.5)
    context = estimator.GetMyContextFromRoot(simulator.get_context())
    assert estimator.GetOutputPort("estimator_state").Eval(context).placed == 1.0


def test_a_second_run_and_a_cloned_context_repeat_to_the_bit():
    diagram, estimator = build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(3.0)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(7.0)
    _, one = outputs(estimator, simulator.get_context())
    resumed = Simulator(diagram, clone)
    resumed.AdvanceTo(7.0)
    _, two = outputs(estimator, resumed.get_context())
    again = Simulator(diagram)
    again.AdvanceTo(7.0)
    _, three = outputs(estimator, again.get_context())
    for other in (two, three):
        np.testing.assert_array_equal(one.covariance, other.covariance)
        np.testing.assert_array_equal(one.p_ML, other.p_ML)


def test_nothing_happens_without_new_messages():
    estimator = SlamEstimator(OdometryConfig(), TagSensorConfig(), ScanConfig(), ONLY_GOALS)
    context = estimator.CreateDefaultContext()
    script = Script()
    source = script.CreateDefaultContext()
    for name in ("odometry", "detections", "scan", "mission"):
        value = AbstractValue.Make(script.GetOutputPort(name).Eval(source))
        estimator.GetInputPort(name).FixValue(context, value)
    simulator = Simulator(estimator, context)
    simulator.AdvanceTo(0.5)
    pose = estimator.GetOutputPort("pose").Eval(simulator.get_context())
    assert pose.stamp == 0.0
    np.testing.assert_array_equal(pose.X_MB, np.zeros(3))

"""A push moves the base and not its wheels; nobody who pushes changes nothing."""

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.systems.operator import Operator


def drive(asked):
    """True poses and odometry (x, y, theta), one a quarter of a second, of a robot that drives straight ahead."""
    builder = DiagramBuilder()
    scenario = LoadScenario("house")
    station = builder.AddNamedSystem("station", MakeTurtlebotStation(scenario))
    velocity = builder.AddSystem(ConstantVectorSource([0.1, 0.0]))
    builder.Connect(velocity.get_output_port(), station.GetInputPort("base.velocity_commanded"))
    if asked is not None:
        operator = builder.AddNamedSystem("operator", Operator([asked], enabled=True))
        builder.Connect(operator.GetOutputPort("pushes"), station.GetInputPort("truth.pushes"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    diagram.SetRandomContext(simulator.get_mutable_context(), RandomGenerator(0))
    poses, odometry = [], []
    for time in np.arange(0.25, 3.01, 0.25):
        simulator.AdvanceTo(time)
        context = station.GetMyContextFromRoot(simulator.get_context())
        poses.append(station.GetOutputPort("truth.pose").Eval(context)[:3])
        odometry.append(station.GetOutputPort("base.odometry").Eval(context).X_OB)
    return np.array(poses), np.array(odometry)


def test_a_push_moves_the_base_half_a_metre_and_thirty_degrees():
    asked = iter([[]] * 16 + [["push"]])  # at 1 s
    poses, odometry = drive(lambda: next(asked, []))
    alone, felt = drive(None)
    np.testing.assert_array_equal(poses[:4], alone[:4])
    moved = poses[7] - alone[7]
    assert 0.45 < np.hypot(moved[0], moved[1]) < 0.55
    assert abs(moved[2] - np.pi / 6) < 1e-9
    # The wheels notice nothing, the gyro feels the turn.
    assert np.hypot(*(odometry[7] - felt[7])[:2]) < 0.1
    assert abs((odometry[7] - felt[7])[2] - np.pi / 6) < 0.02


def test_nobody_who_pushes_changes_nothing():
    for one, other in zip(drive(list), drive(None), strict=True):
        np.testing.assert_array_equal(one, other)

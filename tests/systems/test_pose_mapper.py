"""An estimator from a pose alone: what it maps, against the same by hand."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from tfg_drake.diagrams.pose_estimator import MakePoseEstimator
from tfg_drake.messages import MissionStatus, Odometry, TagDetections
from tfg_drake.systems.pose_mapper import PoseMapper

X_MB = np.array([1.0, 2.0, np.pi / 2])
SIGMA = (0.1, 0.1, 0.05)


def seen(stamp, ids, distance, bearing):
    n = len(ids)
    return TagDetections(
        stamp, np.array(ids), np.array(distance), np.array(bearing), np.full(n, 0.03), np.full(n, 0.02)
    )


@pytest.fixture
def mapper():
    """The system, its context, and a function that updates it with a frame and a phase."""
    system = PoseMapper(SIGMA)
    context = system.CreateDefaultContext()
    system.GetInputPort("X_MB").FixValue(context, X_MB)
    system.GetInputPort("odometry").FixValue(context, Odometry(0.0, np.zeros(3), np.array([0.2, 0.1])))

    def update(time, frame, phase, stage=0):
        context.SetTime(time)
        system.GetInputPort("detections").FixValue(context, frame)
        system.GetInputPort("mission").FixValue(context, MissionStatus(phase, stage, 0.0))
        before = context.get_abstract_state(0).get_value()
        context.SetAbstractState(0, system._Update(context, before))

    return system, context, update


def test_tags_are_where_they_are_seen_on_average(mapper):
    system, context, update = mapper
    update(1.0, seen(1.0, [7, 3], [2.0, 1.0], [0.0, np.pi / 2]), "observe")
    update(2.0, seen(2.0, [7], [2.2], [0.0]), "observe")
    assert system.GetOutputPort("map").Eval(context).stage == 0
    update(3.0, seen(2.0, [7], [2.2], [0.0]), "map")
    made = system.GetOutputPort("map").Eval(context)
    assert (made.stage, made.ids.tolist(), made.stamp) == (1, [3, 7], 2.0)
    # 7 is straight ahead, which is along y; 3 to the left.
    across = [d**2 * (0.02**2 + 0.05**2) + 0.03**2 for d in (2.0, 2.2)]
    y = (4.0 / across[0] + 4.2 / across[1]) / (1.0 / across[0] + 1.0 / across[1])
    np.testing.assert_allclose(made.p_ML, [[0.0, 2.0], [1.0, y]], atol=1e-12)
    variance = 1.0 / (1.0 / across[0] + 1.0 / across[1]) + 0.1**2
    np.testing.assert_allclose(made.landmark_covariance[1], variance * np.eye(2))
    np.testing.assert_allclose(made.X_MD, X_MB)
    np.testing.assert_allclose(made.observation.X_AB, np.zeros((2, 3)), atol=1e-12)
    assert made.entropy == pytest.approx(
        0.5 * sum(np.linalg.slogdet(2 * np.pi * np.e * one)[1] for one in made.landmark_covariance)
    )


def test_a_frame_counts_once_and_an_old_one_not_at_all(mapper):
    system, context, update = mapper
    frame = seen(1.0, [7], [2.0], [0.0])
    for time in (1.0, 1.05, 1.5):
        update(time, frame, "observe")
    update(2.0, seen(1.5, [8], [2.0], [0.0]), "map")
    made = system.GetOutputPort("map").Eval(context)
    variance = 2.0**2 * (0.02**2 + 0.05**2) + 0.03**2 + 0.1**2
    assert made.ids.tolist() == [7]
    assert made.landmark_covariance[0, 0, 0] == pytest.approx(variance)


def test_the_pose_is_the_one_given(mapper):
    system, context, _ = mapper
    context.SetTime(4.0)
    pose = system.GetOutputPort("pose").Eval(context)
    assert (pose.stamp, pose.stage, pose.speed.tolist()) == (4.0, 0, [0.2, 0.1])
    np.testing.assert_array_equal(pose.X_MB, X_MB)
    np.testing.assert_allclose(np.sqrt(np.diag(pose.covariance)), SIGMA)


def test_a_pose_that_is_none_is_named(mapper):
    system, context, update = mapper
    system.GetInputPort("X_MB").FixValue(context, [0.0, np.nan, 0.0])
    with pytest.raises(ValueError, match=r"X_MB.* of System ::pose_mapper .* must be finite, .* at 1\.0 s"):
        update(1.0, seen(1.0, [7], [2.0], [0.0]), "observe")


def test_an_estimator_has_the_inputs_of_its_source_and_of_the_mapper():
    made = MakePoseEstimator(PassThrough(3))
    assert {made.get_input_port(i).get_name() for i in range(made.num_input_ports())} == {
        "u",
        "odometry",
        "detections",
        "mission",
    }
    builder = DiagramBuilder()
    builder.AddSystem(MakePoseEstimator(ConstantVectorSource(X_MB)))
    with pytest.raises(TypeError, match=r"^ConstantVectorSource: must have one output, a vector X_MB of size 3$"):
        MakePoseEstimator(ConstantVectorSource([0.0]))

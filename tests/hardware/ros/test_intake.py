"""What both transports do with what they receive."""

import pytest

from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import load_preset


def odometry(stamp, frame="odom", x=0.0):
    pose = {"position": {"x": x, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    twist = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}
    header = {"stamp": {"sec": int(stamp), "nanosec": int(1e9 * (stamp % 1.0))}, "frame_id": frame}
    return {"header": header, "pose": {"pose": pose}, "twist": {"twist": twist}}


@pytest.mark.parametrize(
    ("frame", "lines"),
    [
        ("odom", []),
        ("/odom", []),
        ("robot7/odom", ["/odom is in the frame robot7/odom, the preset has odom: set its frames.odom"]),
    ],
)
def test_the_frame_of_the_odometry(frame, lines):
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("odometry", preset.topics.odometry)])
    for i in range(20):
        intake.receive("odometry", preset.topics.odometry, odometry(100.0 + 0.1 * i, frame), 5.0 + 0.1 * i)
    assert len(intake.take()) > 10
    assert intake.remarks() == lines


def test_a_base_that_counts_anew_goes_on_where_it_was():
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("odometry", preset.topics.odometry)])
    at = [5.0 + 0.01 * i for i in range(20)] + [0.01 * i for i in range(20)]
    for i, x in enumerate(at):
        intake.receive("odometry", preset.topics.odometry, odometry(100.0 + 0.1 * i, x=x), 5.0 + 0.1 * i)
        if i == 19:
            assert intake.fault() is None
    assert intake.fault() == "/odom was reset, its base was started anew; see that the robot stands where it was"
    assert [one.X_OB[0] for one in intake.take()][-21:] == pytest.approx(
        [5.19] + [5.19 + 0.01 * i for i in range(20)], abs=1e-9
    )


def test_an_alarm_without_a_stamp_is_not_lost_while_the_clock_is_learned():
    preset = load_preset("turtlebot3")
    topic = next(one for one in preset.topics.hazards if one.type == "turtlebot3_msgs/msg/SensorState")
    intake = Intake(preset, [("odometry", preset.topics.odometry), ("hazards", topic)])
    fields = {"bumper": 1, "cliff": 0.0, "sonar": 0.0, "illumination": 0.0, "led": 0, "button": 0, "torque": True}
    intake.receive("hazards", topic, fields | {"left_encoder": 0, "right_encoder": 0, "battery": 12.0}, 5.0)
    assert [one.bumper != 0 for one in intake.take()] == [True]

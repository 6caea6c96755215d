"""What both transports do with what they receive."""

import pytest

from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import load_preset


def odometry(stamp, frame):
    pose = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
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
def test_the_frame_of_the_odometry(frame, lines, caplog):
    preset = load_preset("turtlebot4")
    intake = Intake(preset)
    for i in range(20):
        intake.receive("odometry", preset.topics.odometry, odometry(100.0 + 0.1 * i, frame), 5.0 + 0.1 * i)
    assert len(intake.take()) > 10
    assert caplog.messages == lines

"""tfg-drake ros2, as a user calls it."""

import json
import os
import signal
import subprocess
import sys

import pytest

TOPICS = """\
/odom         nav_msgs/msg/Odometry
/scan         sensor_msgs/msg/LaserScan
/detections   sensor_msgs/msg/PointCloud2
/cmd_vel      geometry_msgs/msg/TwistStamped
"""


def test_emulate_prints_its_topics_and_the_truth_at_its_end():
    pytest.importorskip("rclpy", reason="rclpy is not installed")
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "ros2", "emulate", "corridor", "--seed", "3"]
    own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(command, **pipes, text=True, env=os.environ | own)
    try:
        lines = ""
        while not lines.endswith(TOPICS.splitlines(keepends=True)[-1]):
            lines += process.stdout.readline() or pytest.fail(process.stderr.read())
        # /tf comes first where ROS has its type.
        assert lines.endswith(TOPICS)
        process.stdin.write("report\n")
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["distance"] == 0.0
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
        truth = json.loads(out.splitlines()[-1])
        assert (process.returncode, err) == (0, "")
        assert (truth["contacts"], truth["distance"]) == (0, 0.0)
        assert len(truth["pose"]) == 3
        assert truth["stamp"] > 0.0
    finally:
        process.kill()
        process.wait()


def test_an_unknown_scenario(call):
    code, out, err = call("ros2", "emulate", "nowhere")
    assert (code, out) == (2, "")
    assert err.startswith("tfg-drake: nowhere: no such file or scenario; name a YAML file or one of corridor,")


def test_without_ros(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    code, out, err = call("ros2", "emulate", "corridor")
    assert (code, out) == (2, "")
    assert err.startswith("tfg-drake: ros2: rclpy cannot be imported by ")


def test_help(call):
    code, out, _ = call("ros2", "emulate", "--help")
    assert code == 0
    assert "Usage: tfg-drake ros2 emulate" in out

"""What both transports do with what they receive."""

import itertools
import math

import pytest

from tfg_drake.hardware.remarks import alarms
from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.messages import LaserScan


def odometry(stamp, frame="odom", x=0.0, theta=0.0):
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * theta), "w": math.cos(0.5 * theta)}
    pose = {"position": {"x": x, "y": 0.0}, "orientation": orientation}
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
        [5.19] + [5.20 + 0.01 * i for i in range(20)], abs=1e-9
    )


@pytest.mark.parametrize(("turn", "jumps"), [(math.pi / 2, True), (-0.7, True), (3.1, True), (0.3, False)])
def test_a_heading_that_jumps_is_not_believed(turn, jumps):
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("odometry", preset.topics.odometry)])
    turning = [2.0 + 0.02 * i + turn * (i >= 90) for i in range(120)]  # past where angles wrap
    for i, theta in enumerate(turning):
        message = odometry(100.0 + 0.02 * i, theta=theta)
        intake.receive("odometry", preset.topics.odometry, message, 5.0 + 0.02 * i)
    assert (intake.fault() is not None) == jumps
    told = [one.X_OB[2] for one in intake.take()]
    steps = [abs(math.remainder(b - a, 2.0 * math.pi)) for a, b in itertools.pairwise(told)]
    assert max(steps) == pytest.approx(0.02 if jumps else turn + 0.02, abs=1e-9)


def battery(percentage, status=2, voltage=12.0):
    """sensor_msgs/BatteryState; status 1 is charging, 2 discharging."""
    return {"voltage": voltage, "percentage": percentage, "power_supply_status": status}


@pytest.mark.parametrize(
    ("message", "level", "alarm"),
    [
        (battery(0.8), "good", None),
        (battery(0.15), "low", None),
        (battery(12.0), "low", None),  # percent
        (battery(0.05), "dangerous", "the battery is down to 5 %: charge it, then enable the base"),
        (battery(3.0), "dangerous", "the battery is down to 3 %: charge it, then enable the base"),
        (battery(104.0), "good", None),
        (battery(0.03, status=1), "good", "the base is charging: take it off its dock or its cable, then enable it"),
        (battery(math.nan), "good", None),
        (battery(None), "good", None),
        (battery(0.0, 0, 0.0), "good", None),  # a base that has not looked yet
        (battery(0.03, 2, None), "dangerous", "the battery is down to 3 %: charge it, then enable the base"),
    ],
)
def test_a_battery_is_judged_by_its_percentage(message, level, alarm):
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("odometry", preset.topics.odometry), ("battery", preset.topics.battery)])
    intake.receive("battery", preset.topics.battery, message, 5.0)
    (state,) = intake.take()
    assert (state.stamp, state.battery_level) == (5.0, level)
    assert list(alarms(state).values()) == ([] if alarm is None else [alarm])
    assert intake.fault() is None


def said(frame="map", variances=(0.25, 0.25, 0.0685), yaw=0.5):
    """As RViz's 2D Pose Estimate says it, by default with its covariance."""
    covariance = [0.0] * 36
    covariance[0], covariance[7], covariance[35] = variances
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)}
    pose = {"position": {"x": 3.0, "y": -2.0, "z": 0.0}, "orientation": orientation}
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
    return {"header": header, "pose": {"pose": pose, "covariance": covariance}}


@pytest.mark.parametrize(
    ("message", "sigma"),
    [
        (said(), [0.5, 0.2617]),
        (said("/map", (0.01, 0.04, 0.0)), [0.2, 0.05]),
        (said(variances=(-1.0, 0.0, -1.0)), [0.05, 0.05]),
    ],
)
def test_where_somebody_says_that_the_robot_is(message, sigma):
    preset = load_preset("turtlebot4")
    topic = preset.topics.initial_pose
    intake = Intake(preset, [("initial_pose", topic)])
    intake.receive("initial_pose", topic, message, 5.0)
    (one,) = intake.take()
    assert (topic.name, one.stamp) == ("/initialpose", 5.0)
    assert pytest.approx([3.0, -2.0, 0.5]) == one.X_WB
    assert one.sigma == pytest.approx(sigma, abs=1e-4)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (said("odom"), "it is said in the frame odom, the map is map: set RViz's fixed frame"),
        (said(variances=(math.nan, 0.0, 0.0)), "pose.covariance is nan, no number up to 100000"),
        (
            said() | {"pose": said()["pose"] | {"covariance": [0.0]}},
            "cannot reshape array of size 1 into shape (6,6)",
        ),
    ],
)
def test_what_says_nothing_of_where_the_robot_is_is_refused(message, why):
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("initial_pose", preset.topics.initial_pose)])
    intake.receive("initial_pose", preset.topics.initial_pose, message, 5.0)
    assert intake.take() == []
    assert intake.remarks() == [f"/initialpose: messages are not used: {why}"]


def test_a_battery_that_makes_no_sense_is_refused_and_told_once():
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("odometry", preset.topics.odometry), ("battery", preset.topics.battery)])
    for _ in range(5):
        intake.receive("battery", preset.topics.battery, battery("much"), 5.0)
    assert intake.take() == []
    assert len(intake.remarks()) == 1


def test_an_alarm_without_a_stamp_is_not_lost_while_the_clock_is_learned():
    preset = load_preset("turtlebot3")
    topic = next(one for one in preset.topics.hazards if one.type == "turtlebot3_msgs/msg/SensorState")
    intake = Intake(preset, [("odometry", preset.topics.odometry), ("hazards", topic)])
    fields = {"bumper": 1, "cliff": 0.0, "sonar": 0.0, "illumination": 0.0, "led": 0, "button": 0, "torque": True}
    intake.receive("hazards", topic, fields | {"left_encoder": 0, "right_encoder": 0, "battery": 12.0}, 5.0)
    assert [one.bumper != 0 for one in intake.take()] == [True]


class Raises:
    """A message that raises whatever is asked of it."""

    def __init__(self, error):
        self._error = error

    def __getattr__(self, name):
        raise self._error


@pytest.mark.parametrize(
    "error", [OverflowError("too large"), RecursionError("deep"), ZeroDivisionError(), MemoryError()]
)
def test_whatever_a_message_raises_it_is_refused_and_told_once(error):
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("scan", preset.topics.scan), ("clock", preset.topics.odometry)])
    for i in range(3):
        intake.receive("scan", preset.topics.scan, Raises(error), 5.0 + i)
    assert intake.remarks() == [f"/scan: messages are not used: {error}".strip()]
    assert intake.remarks() == []
    assert intake.refusals.counts.total() == 3


def test_the_odometry_tells_sensors_the_clock_and_is_not_theirs_to_say():
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("scan", preset.topics.scan), ("clock", preset.topics.odometry)])
    scan = {"ranges": [1.0, 2.0], "angle_min": 0.0, "angle_increment": 0.1, "time_increment": 0.0}
    scan |= {"range_min": 0.1, "range_max": 12.0}
    for i in range(20):
        intake.receive("clock", preset.topics.odometry, odometry(100.0 + 0.1 * i), 5.0 + 0.1 * i)
        late = {"header": odometry(100.0 + 0.1 * i)["header"]} | scan
        intake.receive("scan", preset.topics.scan, late, 5.0 + 0.1 * i + 0.06)
    taken = intake.take()
    assert {type(one) for one in taken} == {LaserScan}
    assert taken[-1].stamp == pytest.approx(5.0 + 0.1 * 19, abs=1e-6)


def test_a_sensors_clock_that_jumps_stops_no_base_but_is_told():
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("scan", preset.topics.scan), ("clock", preset.topics.odometry)])
    for i in range(20):
        jump = 5.0 if i == 15 else 0.0
        intake.receive("clock", preset.topics.odometry, odometry(100.0 + jump + 0.1 * i), 5.0 + 0.1 * i)
    assert intake.fault() is None
    assert intake.remarks() == ["/odom: the clock of /odom has jumped; the clock is learned anew"]


def test_tags_of_two_families_are_told_once():
    preset = load_preset("turtlebot4")
    intake = Intake(preset, [("detections", preset.topics.detections), ("camera_info", preset.topics.camera_info)])
    P = [600.0, 0.0, 320.0, 0.0, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    corners = [296.0, 216.0, 344.0, 218.0, 345.0, 264.0, 296.0, 263.0]
    for i, family in enumerate(8 * ["tag36h11"] + 8 * ["tag16h5"]):
        stamp = 100.0 + 0.1 * i
        header = {"stamp": {"sec": int(stamp), "nanosec": int(1e9 * (stamp % 1.0))}}
        tags = {"header": header, "detections": [{"family": family, "id": 5, "corners": corners}]}
        intake.receive("camera_info", preset.topics.camera_info, {"header": header, "p": P}, 5.0 + 0.1 * i)
        intake.receive("detections", preset.topics.detections, tags, 5.0 + 0.1 * i)
    assert intake.remarks() == [
        f"{preset.topics.detections.name}: tags are of tag16h5 and tag36h11: one id of both would be one tag; print all"
        " of one"
    ]
    assert len(intake.take()) > 10

"""ROS messages to ours, exactly: as dictionaries and as objects."""

import base64
import math
from types import SimpleNamespace

import numpy as np
import pytest

from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import Camera, Scanner
from tfg_drake.messages import Hazards

STILL = np.zeros(2)
NO_HAZARDS = Hazards(0.0, 0, 0, 0)


def objects(value):
    """A message of dictionaries as one of objects."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: objects(item) for key, item in value.items()})
    return [objects(item) for item in value] if isinstance(value, list) else value


transports = pytest.mark.parametrize("as_sent", [dict, objects], ids=["rosbridge", "rclpy"])


def odometry_message(x=1.0, y=2.0, yaw=2.5, v=0.1, w=-0.3):
    return {
        "header": {"stamp": {"sec": 12, "nanosec": 250_000_000}, "frame_id": "odom"},
        "child_frame_id": "base_link",
        "pose": {
            "pose": {
                "position": {"x": x, "y": y, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
            }
        },
        "twist": {"twist": {"linear": {"x": v}, "angular": {"z": w}}},
    }


@transports
def test_odometry(as_sent):
    odometry = conversions.odometry(as_sent(odometry_message()), 7.0)
    assert odometry.stamp == 7.0
    np.testing.assert_allclose(odometry.X_OB, [1.0, 2.0, 2.5], atol=1e-15)
    assert odometry.V_B.tolist() == [0.1, -0.3]
    assert not odometry.at_rest


def test_a_robot_rests_when_neither_place_nor_velocity_says_otherwise():
    still = odometry_message(v=0.0, w=0.0)
    before = conversions.odometry(still, 1.0)
    assert conversions.odometry(still, 2.0, before).at_rest
    assert not conversions.odometry(odometry_message(x=1.01, v=0.0, w=0.0), 2.0, before).at_rest
    assert not conversions.odometry(odometry_message(v=0.0, w=0.1), 2.0, before).at_rest


def test_a_turn_in_place_is_motion_whatever_the_twist_says():
    before = conversions.odometry(odometry_message(yaw=3.1, v=0.0, w=0.0), 1.0)
    turned = conversions.odometry(odometry_message(yaw=3.2, v=0.0, w=0.0), 1.1, before)
    assert not turned.at_rest
    np.testing.assert_allclose(turned.V_B, [0.0, 1.0], atol=1e-9)
    # The gyro's angle wanders on while the robot stands.
    assert conversions.odometry(odometry_message(yaw=3.1 + 2e-5, v=0.0, w=0.0), 1.1, before).at_rest


@pytest.mark.parametrize("nothing", [0.0, math.nan, None])
def test_where_the_twist_says_nothing_the_poses_tell_the_velocity(nothing):
    before = conversions.odometry(odometry_message(x=0.0, y=0.0, yaw=0.0, v=nothing, w=nothing), 1.0)
    assert before.V_B.tolist() == [0.0, 0.0]
    # On an arc of 0.5 m/s and 0.8 rad/s, backwards.
    x, y = -0.5 / 0.8 * math.sin(0.08), 0.5 / 0.8 * (1.0 - math.cos(0.08))
    arc = odometry_message(x=x, y=y, yaw=-0.08, v=nothing, w=nothing)
    np.testing.assert_allclose(conversions.odometry(arc, 1.1, before).V_B, [-0.5, -0.8], rtol=1e-3)
    # It did not drive there, and two messages at one time tell no velocity.
    leap = odometry_message(x=4.0, y=0.0, yaw=0.0, v=nothing, w=nothing)
    for stamp in (1.1, 1.0, 0.9):
        assert conversions.odometry(leap, stamp, before).V_B.tolist() == [0.0, 0.0]
    assert conversions.odometry(odometry_message(x=x, y=y, yaw=-0.08), 1.1, before).V_B.tolist() == [0.1, -0.3]


def test_a_quaternion_that_was_rounded_is_normalised_another_refused():
    message = odometry_message(yaw=0.5)
    orientation = message["pose"]["pose"]["orientation"]
    for scale in (0.97, 1.03):
        orientation.update(z=scale * math.sin(0.25), w=scale * math.cos(0.25))
        assert conversions.odometry(message, 0.0).X_OB[2] == pytest.approx(0.5)
    for z, w in ((0.0, 0.0), (1.0, 1.0), (0.2, 0.3)):
        orientation.update(z=z, w=w)
        with pytest.raises(ValueError, match=f"^orientation 0 0 {z:g} {w:g} is no unit quaternion$"):
            conversions.odometry(message, 0.0)


@transports
def test_the_stamp_of_a_header(as_sent):
    assert conversions.ros_stamp(as_sent(odometry_message())) == 12.25
    assert conversions.ros_stamp(as_sent({"state": 1})) is None


def test_the_stamp_of_ros_1():
    assert conversions.ros_stamp({"header": {"stamp": {"secs": 3, "nsecs": 500_000_000}}}) == 3.5


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"x": math.nan}, "pose.pose.position.x is nan, no number up to 100000"),
        ({"x": 1e200}, "pose.pose.position.x is 1e+200, no number up to 100000"),
        ({"x": 10**400}, f"pose.pose.position.x is 1{'0' * 17}...{'0' * 19}, no number up to 100000"),
        ({"v": math.inf}, "twist.twist.linear.x is inf, no number up to 1e+09"),
        ({"v": "fast"}, "twist.twist.linear.x is 'fast', no number up to 1e+09"),
        ({"yaw": math.nan}, "pose.pose.orientation.z is nan, no number up to 1e+09"),
    ],
)
def test_odometry_that_is_refused(change, line):
    with pytest.raises(ValueError, match="no number") as error:
        conversions.odometry(odometry_message(**change), 0.0)
    assert str(error.value) == line


def test_a_missing_field_is_named():
    with pytest.raises(ValueError, match=r"^no field pose\.pose\.orientation\.x$"):
        conversions.odometry({"pose": {"pose": {}}}, 0.0)


def scan_message(ranges, first, step, **fields):
    limits = {"range_min": 0.15, "range_max": 12.0, "time_increment": 0.0}
    return {"angle_min": first, "angle_increment": step, "ranges": ranges, **limits, **fields}


@transports
def test_a_scan_keeps_its_rays(as_sent):
    scan = conversions.laser_scan(as_sent(scan_message([1.0, 2.0, 3.0], -0.5, 0.5)), 4.0, Scanner(sigma=0.02), STILL)
    np.testing.assert_allclose(scan.angles, [-0.5, 0.0, 0.5], atol=1e-15)
    np.testing.assert_allclose(scan.ranges, [1.0, 2.0, 3.0], atol=1e-15)
    assert (scan.stamp, scan.range_max, scan.sigma) == (4.0, 12.0, 0.02)


def test_angles_increase_about_straight_ahead():
    upside_down = scan_message([1.0, 2.0, 3.0], 0.5, -0.5)
    assert conversions.laser_scan(upside_down, 0.0, Scanner(), STILL).ranges.tolist() == pytest.approx([3.0, 2.0, 1.0])
    # A full circle from 0 to 2 pi, the last ray the first again.
    circle = scan_message([1.0, 2.0, 3.0, 4.0, 1.0], 0.0, 0.5 * math.pi)
    scan = conversions.laser_scan(circle, 0.0, Scanner(), STILL)
    assert scan.angles.tolist() == pytest.approx([-0.5 * math.pi, 0.0, 0.5 * math.pi, math.pi])
    assert scan.ranges.tolist() == pytest.approx([4.0, 1.0, 2.0, 3.0])


def test_what_ranges_say():
    nothing = [math.inf, 12.5, -math.inf, math.nan, None, 0.0, 0.1]
    scan = conversions.laser_scan(scan_message(nothing, 0.0, 0.1), 0.0, Scanner(), STILL)
    np.testing.assert_allclose(scan.ranges, [math.inf, math.inf, 0.15, *[math.nan] * 4])
    free = conversions.laser_scan(scan_message(nothing, 0.0, 0.1), 0.0, Scanner(unanswered="free"), STILL)
    np.testing.assert_allclose(free.ranges, [math.inf, math.inf, 0.15, *[math.inf] * 3, math.nan])


def test_the_greatest_range_is_no_return():
    ranges = [12.0, float(np.float32(12.0)) - 5e-4, 11.99, 12.001]
    scan = conversions.laser_scan(scan_message(ranges, 0.0, 0.1), 0.0, Scanner(), STILL)
    np.testing.assert_allclose(scan.ranges, [math.inf, math.inf, 11.99, math.inf])


def test_what_is_said_of_a_scanner_wins():
    message = scan_message([1.0, 2.0, 3.0], 0.3, 0.0)
    for clockwise, flip, expected in (
        (False, False, [1.0, 2.0, 3.0]),
        (True, False, [3.0, 2.0, 1.0]),
        (False, True, [3.0, 2.0, 1.0]),
        (True, True, [1.0, 2.0, 3.0]),
    ):
        scanner = Scanner(field_of_view=2.0, clockwise=clockwise, flip=flip, clock_offset=0.25)
        scan = conversions.laser_scan(message, 7.0, scanner, STILL)
        assert scan.stamp == 6.75
        np.testing.assert_allclose(scan.angles, [-1.0, 0.0, 1.0])
        assert scan.ranges.tolist() == expected


def test_a_scan_is_straightened_by_no_velocity_that_no_base_has():
    message = scan_message([2.0] * 3, -0.1, 0.1, time_increment=0.01)
    wild, fastest = (conversions.laser_scan(message, 0.0, Scanner(), np.array([1e9, v])) for v in (-1e9, -20.0))
    assert np.isfinite(wild.angles).all()
    np.testing.assert_allclose(wild.ranges, fastest.ranges)


def test_a_scan_is_seen_from_the_body():
    # Mounted 4 cm behind the centre, a quarter turn to the left: its x axis is the body's y axis.
    scanner = Scanner(x=-0.04, yaw=0.5 * math.pi)
    message = scan_message([1.04, 3.0, math.inf], -0.5 * math.pi, 0.5 * math.pi)
    scan = conversions.laser_scan(message, 0.0, scanner, STILL)
    ahead, left, behind = [1.0, 0.0], [-0.04, 3.0], [-12.04, 0.0]
    np.testing.assert_allclose(scan.ranges, [1.0, math.hypot(*left), math.inf])
    angles = [math.atan2(y, x) for x, y in (ahead, left, behind)]
    np.testing.assert_allclose(scan.angles, angles, atol=1e-12)


def test_a_scanner_upside_down_has_its_left_on_the_robots_right():
    scanner = Scanner(yaw=0.25 * math.pi, flip=True)
    scan = conversions.laser_scan(scan_message([1.0, 2.0, 3.0], -0.5, 0.5), 0.0, scanner, STILL)
    assert scan.angles.tolist() == pytest.approx((0.25 * math.pi + np.array([-0.5, 0.0, 0.5])).tolist())
    assert scan.ranges.tolist() == pytest.approx([3.0, 2.0, 1.0])


def test_a_sweep_is_told_as_of_its_middle():
    # The robot turns at 1 rad/s and drives at 0.2 m/s; a wall point 2 m ahead of the middle pose, met 0.05 s before
    # and after by rays that point elsewhere then.
    V_B, point = np.array([0.2, 1.0]), np.array([2.0, 0.3])
    rays = []
    for t in (-0.05, 0.0, 0.05):
        dx, dy = point - [0.2 * t, 0.0]
        rays.append((math.hypot(dx, dy), math.atan2(dy, dx) - t))
    step = -0.05
    ranges = [r for r, _ in rays]
    message = scan_message(ranges, rays[0][1], step, time_increment=0.05)
    scan = conversions.laser_scan(message, 10.0, Scanner(), V_B)
    assert scan.stamp == pytest.approx(10.05)
    points = scan.ranges[:, None] * np.stack([np.cos(scan.angles), np.sin(scan.angles)], axis=1)
    assert np.abs(points - point).max() < 0.01  # the rays' spacing is not quite even
    still = conversions.laser_scan(message, 10.0, Scanner(), STILL)
    assert np.abs(still.angles - np.arctan2(0.3, 2.0)).max() > 0.04


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"angle_increment": 0.0}, "scan of angles 0.0 + i * 0.0 and ranges from 0.15 to 12.0"),
        ({"range_min": 13.0}, "scan of angles 0.0 + i * 0.1 and ranges from 13.0 to 12.0"),
        ({"range_max": math.nan}, "range_max is nan, no number up to 1000"),
        ({"range_max": 1e300}, "range_max is 1e+300, no number up to 1000"),
        ({"time_increment": math.inf}, "time_increment is inf, no number up to 1"),
        ({"ranges": 3.0}, "ranges is no list"),
        ({"ranges": [[1.0]]}, "ranges is no list of numbers"),
        ({"ranges": range(10**9)}, "ranges has 1000000000 entries; 50000 are the most that is plausible"),
    ],
)
def test_a_scan_without_sense_is_refused(change, line):
    with pytest.raises(ValueError, match=r".") as error:
        conversions.laser_scan(scan_message([1.0], 0.0, 0.1) | change, 0.0, Scanner(), STILL)
    assert str(error.value) == line


def test_a_stamp_without_sense_is_refused():
    for stamp in ({"sec": math.inf, "nanosec": 0}, {"sec": 1, "nanosec": -5}, {"sec": 2**40, "nanosec": 0}):
        with pytest.raises(ValueError, match="number"):
            conversions.ros_stamp({"header": {"stamp": stamp}})


CAMERA = Camera(x=0.1, y=0.02, yaw=0.3, pitch=-0.2, tag_size=0.2, corner_sigma=0.5)
INFO = {"p": [600.0, 0.0, 320.0, 0.0, 0.0, 590.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]}
CALIBRATED = conversions.calibration(INFO)


def seen(p_BT, height, facing):
    """Corners, in pixels, of an upright tag at p_BT (in the floor's plane) and a height above the camera."""
    c, s = math.cos(CAMERA.yaw), math.sin(CAMERA.yaw)
    cp, sp = math.cos(CAMERA.pitch), math.sin(CAMERA.pitch)
    R_yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    R_pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    across = np.array([-math.sin(facing), math.cos(facing), 0.0])
    half = 0.5 * CAMERA.tag_size
    center = np.array([*p_BT, height]) - [CAMERA.x, CAMERA.y, 0.0]
    corners = []
    for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        x, y, z = (R_yaw @ R_pitch).T @ (center + half * (a * across + [0, 0, b]))
        corners += [600.0 * -y / x + 320.0, 590.0 * -z / x + 240.0]
    return corners


@transports
def test_tags_from_their_corners(as_sent):
    places = np.array([[2.0, 1.0], [1.5, 0.4]])
    detections = [
        {"id": 7, "corners": seen(places[0], 0.3, 3.4)},
        {"id": 3, "corners": seen(places[1], 0.2, 3.0)},
    ]
    calibrated = conversions.calibration(as_sent(INFO))
    found = conversions.apriltag_detections(as_sent({"detections": detections}), calibrated, 5.0, CAMERA)
    assert found.ids.tolist() == [7, 3]
    np.testing.assert_allclose(found.range, np.hypot(*places.T), atol=1e-8)
    np.testing.assert_allclose(found.bearing, np.arctan2(places[:, 1], places[:, 0]), atol=1e-8)
    assert (found.sigma_range > 0.001).all()
    assert (found.sigma_range < 0.05).all()
    assert (found.sigma_bearing < 0.003).all()


def test_the_sigmas_of_tags_are_those_of_their_corners():
    random = np.random.default_rng(0)
    exact = np.array(seen([2.0, 1.0], 0.3, 3.4))
    draws = [{"id": 0, "corners": (exact + 0.5 * random.normal(size=8)).tolist()} for _ in range(2000)]
    found = conversions.apriltag_detections({"detections": draws}, CALIBRATED, 0.0, CAMERA)
    assert found.range.std() == pytest.approx(found.sigma_range[0], rel=0.2)
    assert found.bearing.std() == pytest.approx(found.sigma_bearing[0], rel=0.2)


def test_no_tags():
    assert len(conversions.apriltag_detections({"detections": []}, CALIBRATED, 0.0, CAMERA).ids) == 0


@pytest.mark.parametrize("bad", [math.inf, -math.inf, math.nan, 1e200, None, "x"])
def test_a_corner_that_is_none_costs_one_sighting(bad):
    good = seen([2.0, 1.0], 0.3, 3.4)
    detections = [
        {"id": 1, "corners": [bad, *good[1:]]},
        {"id": 2, "corners": good},
        {"id": 3, "corners": good[:2] * 4},
    ]
    found = conversions.apriltag_detections({"detections": detections}, CALIBRATED, 0.0, CAMERA)
    assert 2 in found.ids
    assert 1 not in found.ids


def test_a_camera_without_calibration_is_refused():
    with pytest.raises(ValueError, match="camera_info holds no calibration"):
        conversions.calibration({"p": [0.0] * 12})
    with pytest.raises(ValueError, match="camera_info's P is inf, no number up to 100000"):
        conversions.calibration({"P": [math.inf] * 12})
    with pytest.raises(ValueError, match="does not have twelve numbers"):
        conversions.calibration({"p": [1.0] * 3})


def cloud(rows, order="<"):
    layout = np.dtype([("id", f"{order}u4")] + [(name, f"{order}f8") for name in conversions.COLUMNS[1:]])
    data = np.array(rows, dtype=layout)
    fields = [
        {"name": name, "offset": layout.fields[name][1], "datatype": 6 if name == "id" else 8, "count": 1}
        for name in conversions.COLUMNS
    ]
    size = {"height": 1, "width": len(rows), "point_step": layout.itemsize, "is_bigendian": order == ">"}
    return {"fields": fields, **size, "data": data.tobytes()}


ROWS = [(12, 2.5, 0.3, 0.02, 0.01), (4, 1.25, -0.4, 0.03, 0.01)]


@transports
@pytest.mark.parametrize("order", "<>")
def test_plain_detections(as_sent, order):
    found = conversions.plain_detections(as_sent(cloud(ROWS, order)), 3.0)
    rows = zip(found.ids, found.range, found.bearing, found.sigma_range, found.sigma_bearing, strict=True)
    np.testing.assert_allclose(np.array(list(rows)), ROWS, atol=1e-15)
    assert found.stamp == 3.0


def test_plain_detections_over_rosbridge():
    message = cloud(ROWS)
    message["data"] = base64.b64encode(message["data"]).decode()
    assert conversions.plain_detections(message, 0.0).ids.tolist() == [12, 4]


def test_plain_detections_that_are_refused():
    for change, line in (
        ({"width": -1}, "width is -1, no whole number from 0 to 2000"),
        ({"width": math.inf}, "width is inf, no number up to 2000"),
        ({"width": 1000, "height": 1000}, "1000000 points; 2000 are the most that is plausible"),
        ({"point_step": 10**9}, "point_step is 1000000000, no number up to 4096"),
        ({"data": 10**12}, "data is no list"),
    ):
        with pytest.raises(ValueError, match=r".") as error:
            conversions.plain_detections(cloud(ROWS) | change, 0.0)
        assert str(error.value) == line
    with pytest.raises(ValueError, match="without the field id; they need id, range"):
        conversions.plain_detections(cloud([]) | {"fields": []}, 0.0)


def bits(hazards):
    return hazards.bumper, hazards.cliff, hazards.wheel_drop


@transports
def test_kobuki_events(as_sent):
    package = "kobuki_ros_interfaces/msg"
    hazards = NO_HAZARDS
    for kind, message, expected in [
        ("BumperEvent", {"bumper": 0, "state": 1}, (4, 0, 0)),
        ("BumperEvent", {"bumper": 1, "state": 1}, (6, 0, 0)),
        ("BumperEvent", {"bumper": 0, "state": 0}, (2, 0, 0)),
        ("CliffEvent", {"sensor": 2, "state": 1, "bottom": 9}, (2, 1, 0)),
        ("WheelDropEvent", {"wheel": 0, "state": 1}, (2, 1, 4)),
        ("WheelDropEvent", {"wheel": 1, "state": 1}, (2, 1, 5)),
        ("WheelDropEvent", {"wheel": 0, "state": 0}, (2, 1, 1)),
    ]:
        hazards = conversions.hazards(f"{package}/{kind}", as_sent(message), 3.0, hazards)
        assert bits(hazards) == expected
        assert hazards.stamp == 3.0


@transports
def test_turtlebot3_sensor_state(as_sent):
    kind = "turtlebot3_msgs/msg/SensorState"
    assert bits(conversions.hazards(kind, as_sent({"bumper": 5, "cliff": 2}), 1.0, NO_HAZARDS)) == (5, 2, 0)


@transports
def test_create3_hazards(as_sent):
    kind = "irobot_create_msgs/msg/HazardDetectionVector"
    found = [
        (0, "base_link"),  # the backup limit is no hazard of ours
        (1, "bump_front_left"),
        (1, "bump_front_center"),
        (2, "cliff_side_right"),
        (4, "wheel_drop_left"),
        (5, "base_link"),
    ]
    message = {"detections": [{"type": t, "header": {"frame_id": frame}} for t, frame in found]}
    hazards = conversions.hazards(kind, as_sent(message), 1.0, NO_HAZARDS)
    assert bits(hazards) == (6, 1, 4)
    assert bits(conversions.hazards(kind, as_sent({"detections": []}), 2.0, hazards)) == (0, 0, 0)


def test_commands():
    twist = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": -0.5}}
    assert conversions.velocity("geometry_msgs/msg/Twist", 0.2, -0.5, 3.5) == twist
    header = {"stamp": {"sec": 3, "nanosec": 500_000_000}, "frame_id": "base_link"}
    stamped = conversions.velocity("geometry_msgs/msg/TwistStamped", 0.2, -0.5, 3.5)
    assert stamped == {"header": header, "twist": twist}

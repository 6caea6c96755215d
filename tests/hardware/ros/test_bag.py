"""ROS bags as recordings: written here by other packages than the reader's own."""

import math
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.hardware.ros.bag import load_bag
from tfg_drake.slam.shared import SCANNER_X

writer = pytest.importorskip("mcap_ros2.writer")
rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "recordings"
SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"

_LINE = "=" * 80 + "\n"
_HEADER = """MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_TIME = """MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_VECTOR = """MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
_QUATERNION = """MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
DEFINITIONS = {
    SCAN: [
        """std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
""",
        _HEADER,
        _TIME,
    ],
    ODOMETRY: [
        """std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
""",
        _HEADER,
        _TIME,
        "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n",
        "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n",
        "MSG: geometry_msgs/Pose\ngeometry_msgs/Vector3 position\ngeometry_msgs/Quaternion orientation\n",
        "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
        _VECTOR,
        _QUATERNION,
    ],
    TRANSFORMS: [
        "geometry_msgs/TransformStamped[] transforms\n",
        """MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
""",
        "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        _HEADER,
        _TIME,
        _VECTOR,
        _QUATERNION,
    ],
}


def header(stamp, frame):
    return {"stamp": {"sec": int(stamp), "nanosec": round(1e9 * (stamp % 1.0))}, "frame_id": frame}


def about_z(yaw):
    return {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)}


def vector(x=0.0, y=0.0, z=0.0):
    return {"x": x, "y": y, "z": z}


def scan(stamp, ranges=(1.0, 2.0, math.inf)):
    of_rays = {"angle_min": -0.5, "angle_max": 0.5, "angle_increment": 0.5, "time_increment": 0.0, "scan_time": 0.1}
    within = {"range_min": 0.1, "range_max": 8.0, "ranges": list(ranges), "intensities": []}
    return {"header": header(stamp, "laser"), **of_rays, **within}


def odometry(stamp, x, yaw=0.0):
    pose = {"pose": {"position": vector(x), "orientation": about_z(yaw)}, "covariance": [0.0] * 36}
    twist = {"twist": {"linear": vector(0.5), "angular": vector()}, "covariance": [0.0] * 36}
    return {"header": header(stamp, "odom"), "child_frame_id": "base", "pose": pose, "twist": twist}


def transform(parent, child, x, yaw):
    placed = {"translation": vector(x), "rotation": about_z(yaw)}
    one = {"header": header(0.0, parent), "child_frame_id": child, "transform": placed}
    return {"transforms": [one]}


def bag(path, messages):
    """Writes messages (topic, type, message) in this order."""
    with path.open("wb") as file:
        to = writer.Writer(file)
        schemas = {name: to.register_msgdef(name, _LINE.join(parts)) for name, parts in DEFINITIONS.items()}
        for number, (topic, kind, message) in enumerate(messages):
            to.write_message(topic, schemas[kind], message, log_time=number)
        to.finish()
    return path


def way(stamps=(100.0, 101.0, 102.0)):
    return [("/odom", ODOMETRY, odometry(stamp, 0.5 * k)) for k, stamp in enumerate(stamps)]


def looks(stamps=(100.5, 101.5)):
    return [("/scan", SCAN, scan(stamp)) for stamp in stamps]


def test_scans_and_odometry_by_their_stamps(tmp_path):
    # As they came in, not in order.
    log = load_bag(bag(tmp_path / "b.mcap", [*looks()[::-1], *way()]))
    assert log.name == "b"
    assert [one.stamp for one in log.odometry] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(log.odometry[2].X_OB, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(log.odometry[2].V_B, [0.5, 0.0])
    assert [one.stamp for one in log.scans] == [0.5, 1.5]
    np.testing.assert_allclose(log.scans[0].ranges, [1.0, 2.0, math.inf])
    assert log.scans[0].range_max == 8.0
    assert "Where the scanner sits is not told" in log.notes[0]
    assert math.sqrt(log.prior.covariance[SCANNER_X, SCANNER_X]) == pytest.approx(0.2)


def test_the_scanner_sits_where_fixed_transforms_say(tmp_path):
    placed = [
        ("/tf_static", TRANSFORMS, transform("base", "mast", 0.1, math.pi)),
        ("/tf_static", TRANSFORMS, transform("mast", "laser", 0.3, 0.0)),
    ]
    log = load_bag(bag(tmp_path / "b.mcap", [*placed, *way(), *looks()]))
    # It looks back, 0.2 m behind the origin: what is 2 m before it is 2.2 m behind the robot.
    ahead = np.argmin(np.abs(np.abs(log.scans[0].angles) - math.pi))
    assert log.scans[0].ranges[ahead] == pytest.approx(2.2)
    assert log.notes == ()


def test_a_scanner_upside_down_is_refused(tmp_path):
    placed = transform("base", "laser", 0.1, 0.0)
    placed["transforms"][0]["transform"]["rotation"] = {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    messages = [("/tf_static", TRANSFORMS, placed), *way(), *looks()]
    with pytest.raises(DatasetError, match=r"/tf_static has laser tilted or upside down; a scanner must be upright"):
        load_bag(bag(tmp_path / "b.mcap", messages))


def test_scans_without_odometry_round_them_are_left_out(tmp_path):
    log = load_bag(bag(tmp_path / "b.mcap", [*way(), *looks((99.0, 100.5, 101.5, 103.0))]))
    assert [one.stamp for one in log.scans] == [1.5, 2.5]
    with pytest.raises(DatasetError, match="fewer than two scans while there is odometry; record both at once"):
        load_bag(bag(tmp_path / "b.mcap", [*way(), *looks((103.0, 104.0))]))


def test_of_two_topics_the_fuller_is_read(tmp_path):
    more = [("/other", SCAN, scan(101.0))]
    log = load_bag(bag(tmp_path / "b.mcap", [*way(), *looks(), *more]))
    assert len(log.scans) == 2
    assert log.notes[0] == f"Of {SCAN} /scan is read, not /other."


@pytest.mark.parametrize(
    ("messages", "complaint"),
    [
        (way(), f"no {SCAN} in it; record scans and odometry of ROS 2"),
        (looks(), f"no {ODOMETRY} in it; record scans and odometry of ROS 2"),
        ([*way()[:1], *looks()], "2 scans and 1 messages of odometry in it; record more"),
    ],
)
def test_what_is_missing_is_told(tmp_path, messages, complaint):
    with pytest.raises(DatasetError) as error:
        load_bag(bag(tmp_path / "b.mcap", messages))
    assert str(error.value) == f"{tmp_path}/b.mcap: {complaint}"


def test_no_bag_and_half_of_one(tmp_path):
    with pytest.raises(DatasetError, match=r"none.mcap: no such file or folder; name a data set"):
        load_bag(tmp_path / "none.mcap")
    whole = bag(tmp_path / "b.mcap", [*way(), *looks()]).read_bytes()
    for part in (b"", b"no bag at all", whole[: len(whole) // 2]):
        (tmp_path / "b.mcap").write_bytes(part)
        with pytest.raises(DatasetError, match=r"b.mcap: not a whole ROS 2 bag .*; copy it again"):
            load_bag(tmp_path / "b.mcap")

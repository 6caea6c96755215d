"""ROS bags as recordings: written here by other packages than the reader's own."""

import contextlib
import math
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard

from tests.mutations import assert_refused_or_read, mutations
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.hardware.ros.bag import load_bag
from tfg_drake.hardware.ros.bag_files import LEAST_UNPACKED, is_bag

mcap_writer = pytest.importorskip("mcap.writer")
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


def bag(path, messages, **how):
    """Writes messages (topic, type, message) in this order."""
    with path.open("wb") as file:
        to = writer.Writer(file, **how)
        schemas = {name: to.register_msgdef(name, _LINE.join(parts)) for name, parts in DEFINITIONS.items()}
        for number, (topic, kind, message) in enumerate(messages):
            to.write_message(topic, schemas[kind], message, log_time=number)
        to.finish()
    return path


def way(stamps=(100.0, 101.0, 102.0)):
    return [("/odom", ODOMETRY, odometry(stamp, 0.5 * k)) for k, stamp in enumerate(stamps)]


def looks(stamps=(100.5, 101.5)):
    return [("/scan", SCAN, scan(stamp)) for stamp in stamps]


def typed(store, kind, value):
    """The message of a type store that a dictionary describes; what that leaves out is 0."""
    made = {}
    for name, (node, of) in store.fielddefs[kind][1]:
        if node == typesys.base.Nodetype.NAME:
            made[name] = typed(store, of, value[name])
        elif node == typesys.base.Nodetype.BASE:
            made[name] = value.get(name, 0)
        else:
            (inner, what), _ = of
            items = value[name]
            is_message = inner == typesys.base.Nodetype.NAME
            made[name] = [typed(store, what, one) for one in items] if is_message else np.array(items, what[0])
    return store.types[kind](**made)


def rosbag2_folder(folder, messages, plugin, compression=None, split=1):
    """As `ros2 bag record` leaves it, in so many files: rosbags writes one, so it is made of several."""
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    folder.mkdir()
    names = []
    for part in range(split):
        written = folder / f"part{part}"
        bag_writer = rosbag2.Writer(written, version=9, storage_plugin=plugin)
        if compression is not None:
            bag_writer.set_compression(compression, rosbag2.CompressionFormat.ZSTD)
        with bag_writer:
            topics = {}
            for number, (topic, kind, message) in enumerate(messages):
                if number * split // len(messages) == part:
                    topics[topic] = topics.get(topic) or bag_writer.add_connection(topic, kind, typestore=store)
                    data = store.serialize_cdr(typed(store, kind, message), kind)
                    bag_writer.write(topics[topic], number * 10**9, data)
        (file,) = [one for one in written.iterdir() if one.suffix != ".yaml"]
        (written / "metadata.yaml").unlink()
        # So that neither the alphabet nor the order in the folder is that of the recording.
        names.append(f"run_{part + 9}{''.join(file.suffixes)}")
        file.rename(folder / names[-1])
        written.rmdir()
    lines = "".join(f"  - {name.removesuffix('.zstd')}\n" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{lines}"
    )
    return folder


def ros1_bag(path, messages, compression=None):
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    store.register(typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
    bag_writer = rosbag1.Writer(path)
    if compression is not None:
        bag_writer.set_compression(compression)
    with bag_writer:
        topics = {}
        for number, (topic, kind, message) in enumerate(messages):
            topics[topic] = topics.get(topic) or bag_writer.add_connection(topic, kind, typestore=store)
            data = store.serialize_ros1(typed(store, kind, message), kind)
            bag_writer.write(topics[topic], number * 10**9, data)
    return path


def assert_same(log, other):
    for name in ("odometry", "scans"):
        first, second = getattr(log, name), getattr(other, name)
        assert [one.stamp for one in first] == [one.stamp for one in second]
    np.testing.assert_array_equal([one.X_OB for one in log.odometry], [one.X_OB for one in other.odometry])
    np.testing.assert_array_equal([one.ranges for one in log.scans], [one.ranges for one in other.scans])
    assert [note.text for note in log.notes] == [note.text for note in other.notes]


def long_drive(count=40):
    """Messages of a drive, each second an odometry and then a scan."""
    messages = [("/tf_static", TRANSFORMS, transform("base", "laser", 0.1, 0.2))]
    for k in range(count):
        messages += [("/odom", ODOMETRY, odometry(100.0 + k, 0.5 * k)), *looks([100.5 + k])]
    return messages


def test_messages_come_as_they_were_recorded_by_their_own_stamps(tmp_path):
    log = load_bag(bag(tmp_path / "b.mcap", [*looks()[::-1], *way()]))
    assert log.name == "b"
    assert [one.stamp for one in log.odometry] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(log.odometry[2].X_OB, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(log.odometry[2].V_B, [0.5, 0.0])
    assert [one.stamp for one in log.scans] == [1.5, 0.5]
    np.testing.assert_allclose(np.diff(log.scan_arrivals), 1e-9, atol=3e-8)
    np.testing.assert_allclose(log.odometry_arrivals[0] - log.scan_arrivals[0], 2e-9, atol=3e-8)
    np.testing.assert_allclose(log.scans[0].ranges, [1.0, 2.0, math.inf])
    assert log.scans[0].range_max == 8.0
    assert (log.notes[0].kind, log.notes[0].time_s) == ("mount", None)
    assert log.notes[0].text == (
        "No transform says where the scanner sits: it is taken to look ahead from the body's origin. "
        "Say otherwise by --set hardware.scanner.KEY=VALUE, with x, y, yaw."
    )
    assert not log.mount_known
    assert log.scanner.mount_deviation == pytest.approx(0.2)


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
    assert log.mount_known


def test_of_moving_transforms_those_that_stay_count_and_the_body_may_be_a_branch(tmp_path):
    # As ROS 1 has them: all in /tf, names with slashes. The body hangs on the frame that the scanner hangs on.
    moving = [("/tf", TRANSFORMS, transform("/trunk", "/head", 0.1 * k, 0.0)) for k in range(3)]
    fixed = [("/tf", TRANSFORMS, transform("/trunk", "laser", 0.3, 0.0))] * 3
    body = [("/tf", TRANSFORMS, transform("trunk", "base", 0.1, 0.0))]
    log = load_bag(bag(tmp_path / "b.mcap", [*moving, *fixed, *body, *way(), *looks()]))
    assert log.mount_known
    ahead = np.argmin(np.abs(log.scans[0].angles))
    assert log.scans[0].ranges[ahead] == pytest.approx(2.2)
    # One that swings says nothing.
    swings = [("/tf", TRANSFORMS, transform("base", "laser", 0.3, 0.1 * k)) for k in range(3)]
    assert not load_bag(bag(tmp_path / "b.mcap", [*swings, *way(), *looks()])).mount_known


@pytest.mark.parametrize(("axis", "ahead"), [("x", 0.0), ("y", math.pi)])
def test_a_scanner_upside_down_is_mirrored(tmp_path, axis, ahead):
    placed = transform("base", "laser", 0.0, 0.0)
    placed["transforms"][0]["transform"]["rotation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0, axis: 1.0}
    log = load_bag(bag(tmp_path / "b.mcap", [("/tf_static", TRANSFORMS, placed), *way(), *looks()]))
    assert log.mount_known
    # Rays at -0.5, 0, 0.5 rad: rolled, what was on the right is on the left; pitched, they look back as well.
    scan = log.scans[0]
    np.testing.assert_allclose(scan.ranges[np.isclose(scan.angles, math.remainder(ahead + 0.5, 2 * math.pi))], 1.0)
    np.testing.assert_allclose(scan.ranges[np.isclose(np.abs(scan.angles), ahead)], 2.0)


def test_a_tilted_scanner_is_refused_unless_somebody_says_otherwise(tmp_path):
    placed = transform("base", "laser", 0.1, 0.0)
    placed["transforms"][0]["transform"]["rotation"] = {"x": math.sin(0.5), "y": 0.0, "z": 0.0, "w": math.cos(0.5)}
    path = bag(tmp_path / "b.mcap", [("/tf_static", TRANSFORMS, placed), *way(), *looks()])
    with pytest.raises(DatasetError, match=r"laser tilted by 57 degrees, a scanner must be level; if it is, say so by"):
        load_bag(path)
    assert load_bag(path, {"yaw": 0.0, "flip": False}).mount_known


def test_what_is_said_wins(tmp_path):
    placed = [("/tf_static", TRANSFORMS, transform("base", "laser", 0.3, 0.4))]
    path = bag(tmp_path / "b.mcap", [*placed, *way(), *looks()])
    said = {"x": 0.0, "yaw": 0.0, "clockwise": True, "field_of_view": 2.0, "clock_offset": 0.25}
    log = load_bag(path, said)
    np.testing.assert_allclose(log.scans[0].angles, [-1.0, 0.0, 1.0])
    np.testing.assert_allclose(log.scans[0].ranges, [math.inf, 2.0, 1.0])
    assert [one.stamp for one in log.scans] == [0.25, 1.25]
    # Upside down and clockwise it counts as if it were neither.
    np.testing.assert_allclose(load_bag(path, {**said, "flip": True}).scans[0].ranges, [1.0, 2.0, math.inf])


def test_a_direction_that_is_said_is_known_a_place_is_not(tmp_path):
    log = load_bag(bag(tmp_path / "b.mcap", [*way(), *looks()]), {"yaw": 1.0})
    assert log.mount_known
    assert log.notes == ()
    assert (log.scanner.mount_deviation, log.scanner.yaw_deviation) == (pytest.approx(0.2), pytest.approx(0.02))


def test_of_two_topics_the_fuller_is_read(tmp_path):
    more = [("/other", SCAN, scan(101.0))]
    log = load_bag(bag(tmp_path / "b.mcap", [*way(), *looks(), *more]))
    assert len(log.scans) == 2
    assert log.notes[0].text == "Of sensor_msgs/LaserScan /scan is read, not /other."


@pytest.mark.parametrize(
    ("messages", "complaint"),
    [
        (way(), "no sensor_msgs/LaserScan in it, but nav_msgs/Odometry; record scans and odometry"),
        (looks(), "no nav_msgs/Odometry in it, but sensor_msgs/LaserScan; record scans and odometry"),
        ([], "no sensor_msgs/LaserScan and no nav_msgs/Odometry in it; record scans and odometry"),
        ([*way()[:1], *looks()], "1 of 1 messages of /odom can be used; record more"),
        (
            [*way(), *[(topic, kind, {**one, "angle_increment": 0.0}) for topic, kind, one in looks()]],
            "0 of 2 messages of /scan can be used: scan of angles -0.5 + i * 0.0 and ranges from 0.10000000149011612 "
            "to 8.0; record more",
        ),
    ],
)
def test_what_is_missing_is_told(tmp_path, messages, complaint):
    with pytest.raises(DatasetError) as error:
        load_bag(bag(tmp_path / "b.mcap", messages))
    assert str(error.value) == f"{tmp_path}/b.mcap: {complaint}"


def test_bad_messages_are_left_out_and_counted(tmp_path):
    messages = [*way(range(100, 110)), *looks(range(101, 108))]
    for at, number in ((0, 0.0), (3, math.nan)):
        messages[at][2]["pose"]["pose"]["orientation"] = {"x": number, "y": 0.0, "z": 0.0, "w": 0.0}
    messages[-1][2]["ranges"] = [1.0] * 60_000
    log = load_bag(bag(tmp_path / "b.mcap", messages))
    assert (len(log.odometry), len(log.scans)) == (8, 6)
    assert len(log.odometry_arrivals) == 8
    assert len(log.scan_arrivals) == 6
    assert [note.text for note in log.notes[1:]] == [
        "2 of 10 messages of /odom are not used: orientation 0 0 0 0 is no unit quaternion",
        "1 of 7 messages of /scan are not used: ranges has 60000 entries; 50000 are the most that is plausible",
    ]


@pytest.mark.parametrize("cut", [lambda stamp: 0.0, lambda stamp: 7.0, lambda stamp: float(int(0.1 * stamp))])
def test_where_headers_are_not_stamped_the_recorders_stamps_serve(tmp_path, cut):
    messages = long_drive()
    for _, _, one in messages[1:]:
        stamp = one["header"]["stamp"]
        one["header"]["stamp"] = {"sec": int(cut(stamp["sec"])), "nanosec": 0}
    path = rosbag2_folder(tmp_path / "b", messages, rosbag2.StoragePlugin.MCAP)
    log = load_bag(path)
    np.testing.assert_allclose([one.stamp for one in log.odometry], 2.0 * np.arange(40))
    np.testing.assert_allclose([one.stamp for one in log.scans], 2.0 * np.arange(40) + 1.0)
    told = "the headers of /odom and /scan are not stamped: the recorder's stamps are used"
    assert [(one.kind, one.time_s, one.text) for one in log.notes] == [("stamps", None, told)]


PLUGINS = rosbag2.StoragePlugin
MODES = rosbag2.CompressionMode


@pytest.mark.parametrize("split", [1, 3])
@pytest.mark.parametrize("plugin", [PLUGINS.MCAP, PLUGINS.SQLITE3])
@pytest.mark.parametrize("mode", [None, MODES.FILE, MODES.MESSAGE, MODES.STORAGE])
def test_bags_of_ros_2_of_every_kind(tmp_path, split, plugin, mode):
    if (plugin, mode) == (PLUGINS.SQLITE3, MODES.STORAGE):
        pytest.skip("SQLite packs nothing by itself")
    good = load_bag(bag(tmp_path / "good.mcap", long_drive()))
    folder = rosbag2_folder(tmp_path / "b", long_drive(), plugin, mode, split)
    assert is_bag(folder)
    log = load_bag(folder)
    assert_same(log, good)
    np.testing.assert_allclose(log.scan_arrivals - log.odometry_arrivals, 1.0)
    # A recorder that was killed has written no metadata.
    (folder / "metadata.yaml").unlink()
    assert is_bag(folder)
    log = load_bag(folder)
    assert log.notes[0].text == (
        "no whole metadata.yaml in it: all files of a bag are read, in the order of their numbers"
    )
    assert [one.stamp for one in log.odometry] == [one.stamp for one in good.odometry]
    if split == 1:
        (file,) = folder.iterdir()
        assert is_bag(file)
        assert_same(load_bag(file), good)


def test_a_file_of_the_bag_that_is_gone_is_told(tmp_path):
    folder = rosbag2_folder(tmp_path / "b", long_drive(), PLUGINS.MCAP, split=3)
    (folder / "run_10.mcap").unlink()
    log = load_bag(folder)
    assert log.notes[0].text == "run_10.mcap of metadata.yaml not there, the others are read"
    assert len(log.odometry) < 40
    for file in folder.glob("*.mcap"):
        file.unlink()
    with pytest.raises(DatasetError, match="b: no file of its bag is there; copy the whole folder"):
        load_bag(folder)


@pytest.mark.parametrize("packing", [None, *rosbag1.Writer.CompressionFormat])
def test_bags_of_ros_1(tmp_path, packing):
    good = load_bag(bag(tmp_path / "good.mcap", long_drive()))
    path = ros1_bag(tmp_path / "b.bag", long_drive(), packing)
    assert is_bag(path)
    assert_same(load_bag(path), good)


def mcap_without_chunks(path, messages):
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        to = mcap_writer.Writer(file, use_chunking=False, use_statistics=False, index_types=mcap_writer.IndexType.NONE)
        to.start("ros2")
        topics = {}
        for number, (topic, kind, message) in enumerate(messages):
            if topic not in topics:
                topics[topic] = to.register_channel(topic, "cdr", to.register_schema(kind, "ros2msg", b""))
            data = bytes(store.serialize_cdr(typed(store, kind, message), kind))
            to.add_message(topics[topic], number * 10**9, data, number * 10**9)
        to.finish()
    return path


WRITERS = {
    "chunks of zstd": lambda path: bag(path, long_drive(120), chunk_size=10_000),
    "no chunks": lambda path: mcap_without_chunks(path, long_drive()),
    "ROS 1": lambda path: ros1_bag(path, long_drive()),
    "ROS 1 in lz4": lambda path: ros1_bag(path, long_drive(300), rosbag1.Writer.CompressionFormat.LZ4),
}


@pytest.mark.parametrize("how", WRITERS)
def test_what_a_recorder_wrote_before_it_was_killed_is_read(tmp_path, how):
    path = WRITERS[how](tmp_path / "b")
    whole = path.read_bytes()
    counts = []
    for share in (0.4, 0.6):
        path.write_bytes(whole[: int(share * len(whole))])
        log = load_bag(path)
        counts.append(len(log.odometry))
        assert any(" is cut off, as by a recorder that was killed: the " in note.text for note in log.notes)
    path.write_bytes(whole)
    assert 5 < counts[0] < counts[1] < len(load_bag(path).odometry)


def test_an_mcap_without_chunks_and_index(tmp_path):
    good = load_bag(bag(tmp_path / "good.mcap", long_drive()))
    assert_same(load_bag(mcap_without_chunks(tmp_path / "b.mcap", long_drive())), good)


def test_what_is_no_bag_is_told(tmp_path):
    with pytest.raises(DatasetError, match=r"none.mcap: no such file or directory; name a data set"):
        load_bag(tmp_path / "none.mcap")
    for part in (b"", b"no bag at all"):
        (tmp_path / "b.mcap").write_bytes(part)
        with pytest.raises(DatasetError, match=r"b.mcap: not a file of a ROS bag \(.mcap, .db3, .bag\); is it what"):
            load_bag(tmp_path / "b.mcap")
    (tmp_path / "b.mcap").unlink()
    assert not is_bag(tmp_path)
    assert not is_bag(tmp_path / "a.log")


def test_little_that_stands_for_much_is_refused(tmp_path):
    zeros = zstandard.compress(bytes(LEAST_UNPACKED + 1))
    text = struct.pack("<I", 4) + b"zstd"
    chunk = struct.pack("<QQQI", 0, 0, len(zeros), 0) + text + struct.pack("<Q", len(zeros)) + zeros
    record = struct.pack("<BQ", 6, len(chunk)) + chunk
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n" + record)
    with pytest.raises(DatasetError, match=r"b.mcap: it unpacks to more than 64 MiB; record it again, unpacked"):
        load_bag(tmp_path / "b.mcap")


@pytest.mark.parametrize("how", WRITERS)
def test_mutated_bags_are_read_or_refused(tmp_path, how):
    path = WRITERS[how](tmp_path / "b")
    assert_refused_or_read(path, lambda: load_bag(path), DatasetError, count=60)


@pytest.mark.parametrize("name", ["metadata.yaml", "run_9.db3"])
def test_a_mutated_folder_is_read_or_refused(tmp_path, name):
    folder = rosbag2_folder(tmp_path / "b", long_drive(20), PLUGINS.SQLITE3)
    file, good = folder / name, (folder / name).read_bytes()
    for data in (*mutations(good, 60, 1), good + b"  - " + b"x" * 300 + b".db3\n"):
        file.write_bytes(data)
        with contextlib.suppress(DatasetError):
            assert len(load_bag(folder).scans) >= 2


@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not at hand")
@pytest.mark.parametrize(
    "name",
    [
        "A-twist-zero/twist_zero.mcap",
        "F-no-index/no_index.mcap",
        "F-no-index/cut_off.mcap",
        "G-bag-folder/drive",
        "H-upside-down/upside_down.mcap",
        "S-zero-stamps/stamp_zero.mcap",
        "S-zero-stamps/zero_quat.mcap",
    ],
)
def test_recordings_with_one_thing_wrong_are_read_as_the_good_one(name):
    good, log = load_bag(DATA / "0-good" / "good.mcap"), load_bag(DATA / name)
    assert log.mount_known
    # One drive, drawn anew for each: those that are whole are as long, and all go the same way.
    stamps, expected = (np.array([one.stamp for one in run.odometry]) for run in (log, good))
    begin = int(np.searchsorted(expected, stamps[0] - 0.05))
    count = len(stamps)
    assert count == len(good.odometry) - (begin if count > 1000 else len(good.odometry) - count)
    for one, other in zip(log.odometry[::50], good.odometry[begin::50], strict=False):
        np.testing.assert_allclose(one.X_OB[:2], other.X_OB[:2], atol=0.5)
        np.testing.assert_allclose(one.V_B, other.V_B, atol=0.2)
        assert one.at_rest == other.at_rest or one is log.odometry[0]
    for one, other in zip(log.scans[::50], good.scans[::50], strict=False):
        near = np.interp(one.angles, other.angles, np.nan_to_num(other.ranges, posinf=12.0))
        assert np.median(np.abs(np.nan_to_num(one.ranges, posinf=12.0) - near)) < 0.1

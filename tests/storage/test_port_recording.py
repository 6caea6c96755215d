import dataclasses
import errno
import math
import os
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import CompressionType, Writer

from tests.mutations import assert_refused_or_read
from tfg_drake.io import files
from tfg_drake.io.files import most_unpacked
from tfg_drake.messages import Hazards, LaserScan, Odometry, SaidPose, TagDetections
from tfg_drake.planning.requested_goal import RequestedGoal
from tfg_drake.storage import port_recording
from tfg_drake.storage.port_recording import (
    COMMAND,
    ENABLED,
    GOAL,
    MESSAGES,
    PORTS,
    SAID,
    Enabled,
    PortWriter,
    RecordingError,
    Velocity,
    read_recording,
)

NONE = np.zeros(0)
AWKWARD = np.array([math.pi, -0.0, 5e-324, math.inf, 1.0 / 3.0, -1e300])


def scan(stamp, ranges=AWKWARD):
    return LaserScan(stamp, np.linspace(-1.0, 1.0, len(ranges)), ranges, 10.0, 0.015)


def messages(stamp):
    """One message a port."""
    return {
        "base.odometry": Odometry(stamp, np.array([1.0, -0.0, stamp]), np.array([0.1, -0.2]), at_rest=True),
        "base.hazards": Hazards(stamp, 5, 0, 2),
        "tags.detections": TagDetections(stamp, np.array([7, -(2**40)]), *np.arange(8.0).reshape(4, 2) / 3.0),
        "scan.ranges": scan(stamp),
        COMMAND: Velocity(0.5, -stamp),
        ENABLED: Enabled(stamp),
        GOAL: RequestedGoal(int(stamp), np.array([stamp, -0.0])),
        SAID: SaidPose(stamp, 2, np.array([1.0, -0.0, stamp]), np.array([0.5, 0.25])),
    }


def record(path, times, robot="sim"):
    with PortWriter(path, robot) as writer:
        for time in times:
            for port, message in messages(time).items():
                writer.write(port, time, message)


def same(one, other):
    """Whether two messages are the same to the bit."""
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(one))
    return type(one) is type(other) and all(
        a.tobytes() == b.tobytes() and a.dtype == b.dtype
        if isinstance(a, np.ndarray)
        else type(a) is type(b) and repr(a) == repr(b)
        for a, b in pairs
    )


def test_every_message_comes_back_to_the_bit(tmp_path):
    times = [0.0, 0.0625, 1.0 / 3.0, 100.0, 36000.0625]
    record(tmp_path / "ports.mcap", times)
    recording = read_recording(tmp_path)
    assert (recording.robot, recording.end_time, recording.whole) == ("sim", 36000.0625, True)
    for port, kind in PORTS.items():
        assert [type(message) for message in recording.messages[port]] == [kind] * len(times)
        for time, message in zip(times, recording.messages[port], strict=True):
            assert same(message, messages(time)[port])
            assert same(recording.at(port, time), message)


def test_before_their_first_message_sensors_show_none(tmp_path):
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port, message in messages(0.0).items():
            writer.write(port, 0.0, message)
        writer.write("scan.ranges", 1.0, LaserScan(-math.inf, NONE, NONE, 10.0, 0.015))
        writer.write("tags.detections", 1.0, TagDetections(-math.inf, NONE.astype(int), NONE, NONE, NONE, NONE))
    recording = read_recording(tmp_path)
    assert recording.at("scan.ranges", 1.0).stamp == -math.inf
    assert recording.at("tags.detections", 1.0).ids.dtype == np.int64
    assert recording.at("tags.detections", 1.0).ids.shape == recording.at("scan.ranges", 1.0).ranges.shape == (0,)


def test_a_message_is_recorded_once_and_counts_from_when_it_came(tmp_path):
    first, second = messages(0.0), messages(0.5)
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for time, now in ((0.0, first), (0.25, first), (0.75, second), (1.0, messages(0.5))):
            for port, message in now.items():
                writer.write(port, time, message)
    recording = read_recording(tmp_path)
    for port in PORTS:
        assert recording.log_times[port].tolist() == [0, 750_000_000]
        for time, expected in ((0.0, first), (0.7499, first), (0.75, second), (9.0, second)):
            assert same(recording.at(port, time), expected[port])


def test_where_nobody_has_been_sent_yet_nobody_is(tmp_path):
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for time in (1.0, 2.0):
            for port in (*MESSAGES, *([GOAL] if time > 1.0 else [])):
                writer.write(port, time, messages(time)[port])
    recording = read_recording(tmp_path)
    assert [recording.at(GOAL, time).count for time in (0.0, 1.9, 2.0, 9.0)] == [0, 0, 2, 2]


def test_a_command_is_recorded_where_it_changes(tmp_path):
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port in MESSAGES:
            writer.write(port, 0.0, messages(0.0)[port])
        for time, v in ((0.0, 0.0), (1.0, 0.0), (2.0, 0.3), (3.0, 0.3), (4.0, 0.0)):
            writer.write(COMMAND, time, Velocity(v, 0.0))
    recording = read_recording(tmp_path)
    assert recording.log_times[COMMAND].tolist() == [0, 2_000_000_000, 4_000_000_000]
    assert [one.v for one in recording.messages[COMMAND]] == [0.0, 0.3, 0.0]


def test_whether_it_may_move_is_recorded_where_it_changes(tmp_path):
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port in MESSAGES:
            writer.write(port, 0.0, messages(0.0)[port])
        for time, enabled in ((0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (3.0, 1.0)):
            writer.write(ENABLED, time, Enabled(enabled))
    recording = read_recording(tmp_path)
    assert recording.log_times[ENABLED].tolist() == [0, 2_000_000_000]
    assert [recording.enabled(time) for time in (0.0, 1.9, 2.0, 9.0)] == [0.0, 0.0, 1.0, 1.0]


def test_angles_that_stay_are_kept_once(tmp_path):
    record(tmp_path / "ports.mcap", [0.0, 1.0])
    one, two = read_recording(tmp_path).messages["scan.ranges"]
    assert np.shares_memory(one.angles, two.angles)


def test_other_programs_can_read_it(tmp_path):
    """With the library's own reader and the schema in the file, as Foxglove does."""
    record(tmp_path / "ports.mcap", [2.5])
    with (tmp_path / "ports.mcap").open("rb") as file:
        found = {channel.topic: (schema, channel, one) for schema, channel, one in make_reader(file).iter_messages()}
    assert list(found) == list(PORTS)
    schema, channel, one = found["scan.ranges"]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("foxglove.LaserScan", "protobuf", "protobuf")
    assert one.log_time == one.publish_time == 2_500_000_000
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    proto = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(one.data)
    assert list(proto.ranges) == AWKWARD.tolist()
    assert (proto.stamp, proto.range_max, proto.sigma) == (2.5, 10.0, 0.015)
    # What Foxglove's 3D panel goes by.
    assert (proto.frame_id, proto.start_angle, proto.end_angle) == ("base", -1.0, 1.0)
    assert (proto.timestamp.seconds, proto.timestamp.nanos) == (2, 500_000_000)


def test_long_arrays_have_long_lengths(tmp_path):
    ranges = np.random.default_rng(0).uniform(0.0, 10.0, 40_000)
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port, message in (messages(0.0) | {"scan.ranges": scan(0.0, ranges)}).items():
            writer.write(port, 0.0, message)
    np.testing.assert_array_equal(read_recording(tmp_path).messages["scan.ranges"][0].ranges, ranges)


def test_of_a_killed_program_all_is_there_but_the_last_second(tmp_path):
    program = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from test_port_recording import PortWriter, messages
writer = PortWriter(Path(sys.argv[1]), "sim")
for k in range(200):
    for port, message in messages(k / 10).items():
        writer.write(port, k / 10, message)
os.kill(os.getpid(), signal.SIGKILL)
"""
    path = tmp_path / "ports.mcap"
    command = [sys.executable, "-c", program, str(path), os.path.dirname(__file__)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    recording = read_recording(path)
    assert not recording.whole
    assert 18.9 <= recording.end_time <= 19.9
    assert same(recording.at("scan.ranges", 15.0), messages(15.0)["scan.ranges"])


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_wherever_it_is_cut_off_the_beginning_can_be_read(share, tmp_path, caplog):
    path = tmp_path / "ports.mcap"
    record(path, np.arange(200) / 10)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    recording = read_recording(path)
    assert not recording.whole
    assert 4.0 <= recording.end_time <= 19.9
    expected = f"{path}: was not closed; what its program had not written yet when it was killed is missing"
    assert caplog.messages == [expected]


def test_what_is_no_recording_is_one_line(tmp_path):
    path = tmp_path / "ports.mcap"

    def complaint():
        with pytest.raises(RecordingError) as caught:
            read_recording(tmp_path)
        return str(caught.value)

    assert complaint() == f"{path}: no such file; name the folder of a run that was recorded"
    path.write_bytes(b"")
    assert complaint() == f"{path}: is empty; name the recording of a run that had begun"
    path.write_bytes(b"something else altogether")
    assert complaint() == f"{path}: is not an MCAP file; name the folder of a run that was recorded"
    PortWriter(path, "sim").close()
    assert complaint() == f"{path}: holds no base.odometry; name the recording of a run that had begun"
    record(path, np.arange(200) / 10)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    assert complaint() == f"{path}: is damaged; copy it again from where it was recorded"


def test_a_recording_of_other_messages_says_so(tmp_path, monkeypatch):
    @dataclasses.dataclass
    class Other:
        stamp: float
        novelty: float

    monkeypatch.setattr("tfg_drake.storage.port_recording.PORTS", PORTS | {"base.hazards": Other})
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port, message in (messages(0.0) | {"base.hazards": Other(0.0, 1.0)}).items():
            writer.write(port, 0.0, message)
    monkeypatch.undo()
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path)
    expected = "base.hazards has stamp, novelty and not stamp, bumper, cliff, wheel_drop; record the run again"
    assert str(caught.value) == f"{tmp_path / 'ports.mcap'}: is of another version: {expected}"


def test_a_full_disk_ends_the_recording_and_not_the_run(caplog):
    with PortWriter(Path("/dev/full"), "sim") as writer:
        for port, message in messages(0.0).items():
            writer.write(port, 0.0, message)
        writer.write("base.hazards", 9.0, messages(9.0)["base.hazards"])
    reason = os.strerror(errno.ENOSPC)
    assert caplog.messages == [f"/dev/full: cannot be written: {reason}; the run is not recorded any further"]


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("told", [2**30, 1000, None])
def test_a_chunk_of_zeros_is_not_unpacked_without_end(tmp_path, monkeypatch, compression, told):
    """One that says how much it stands for, one that says less, and many of which each is small enough."""
    monkeypatch.setattr(files, "_LEAST_UNPACKED", 2**20)
    unpack, unpacked = port_recording._unpacked, []
    monkeypatch.setattr(port_recording, "_unpacked", lambda chunk: unpacked.append(unpack(chunk)) or unpacked[-1])
    size = 2**26 if told else 2**19
    pack = lz4.frame.compress if compression == "lz4" else zstandard.compress
    chunk = Chunk(compression, pack(bytes(size)), 0, 0, 0, told or size)
    path = tmp_path / "ports.mcap"
    record(path, np.arange(20) / 10)
    whole, builder = path.read_bytes(), RecordBuilder()
    for _ in range(1 if told else 200):
        chunk.write(builder)
    # Before all others, behind the header.
    start = MAGIC_SIZE + 9 + int.from_bytes(whole[MAGIC_SIZE + 1 : MAGIC_SIZE + 9], "little")
    path.write_bytes(whole[:start] + builder.end() + whole[start:])
    tracemalloc.start()
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    tracemalloc.stop()
    assert sum(len(chunk.data) for chunk in unpacked) <= most_unpacked(path)
    assert str(caught.value) == f"{path}: is damaged; copy it again from where it was recorded"


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_what_another_program_has_packed_otherwise_is_read(tmp_path, compression):
    path, other = tmp_path / "ports.mcap", tmp_path / "other.mcap"
    record(path, np.arange(200) / 10)
    with path.open("rb") as file, other.open("wb") as copy:
        writer = Writer(copy, compression=compression, enable_data_crcs=True)
        writer.start()
        ids = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic not in ids:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    expected, read = read_recording(path), read_recording(other)
    assert same(read.at("scan.ranges", 15.0), expected.at("scan.ranges", 15.0))
    assert read.end_time == expected.end_time


def test_a_mutated_recording_is_refused_or_read(tmp_path):
    path = tmp_path / "ports.mcap"
    record(path, np.arange(50) / 10)
    assert_refused_or_read(path, lambda: read_recording(path), RecordingError, count=100)


def test_a_recording_that_goes_on_has_at_once_what_a_checkpoint_counts_on(tmp_path):
    path = tmp_path / port_recording.FILE_NAME
    # Neither is closed: their program was killed.
    first = PortWriter(path, "sim")
    for k in range(40):
        first.write("base.odometry", k / 16.0, Odometry(k / 16.0, np.full(3, float(k)), np.zeros(2)))
    standing = first.standing()
    assert standing.count == 40
    first.write("base.odometry", 3.0, Odometry(3.0, np.full(3, 3.0), np.zeros(2)))
    writers = [PortWriter(path, "sim", standing) for _ in range(2)]
    assert [writer.standing().count for writer in writers] == [40, 40]


def test_what_could_not_be_written_does_not_count(tmp_path, monkeypatch):
    writer = PortWriter(tmp_path / port_recording.FILE_NAME, "sim")
    writer.write("base.odometry", 0.0, Odometry(0.0, np.zeros(3), np.zeros(2)))
    assert writer.standing().count == 1
    monkeypatch.setattr(writer._writer, "flush", lambda: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    writer.write("base.odometry", 2.0, Odometry(2.0, np.ones(3), np.zeros(2)))
    assert writer.standing().count == 1
    assert writer.failure is not None

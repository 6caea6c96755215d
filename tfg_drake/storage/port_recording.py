"""Recording of a station's ports in a run: an MCAP file that Foxglove and the MCAP tools read.

A channel a port, named like it, of protobuf messages: the fields of the messages in `tfg_drake.messages` by their
names, float64 to the bit, with their schema in the file. log_time is when the port carried the message first (ns since
the run began), publish_time the message's own stamp. The metadata "run" names the robot. A scan is one of Foxglove's,
too, and beside the ports stands what its 3D panel shows of the explorer (`tfg_drake.storage.foxglove`).

The file grows by compressed chunks: of a program that is killed all is there but the last second.
"""

from __future__ import annotations

import dataclasses
import io
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.exceptions import InvalidMagic
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from tfg_drake.io.files import FileError, most_unpacked, of_run, open_inside, reading
from tfg_drake.mapfile.message_arrays import entry_type, hints_of
from tfg_drake.messages import (
    Hazards,
    IntArray,
    LaserScan,
    MapEstimate,
    Odometry,
    SaidPose,
    TagDetections,
    TfgMap,
    message,
)
from tfg_drake.planning.requested_goal import RequestedGoal
from tfg_drake.storage import foxglove
from tfg_drake.table import dtype_of

FILE_NAME = "ports.mcap"
# Greatest time that is lost if the program is killed, s.
FLUSH_PERIOD = 1.0
# Greatest size of displayed maps, as a share of the ports' messages, before compression.
MAP_SHARE = 0.1

_NS = 1e9
_Field = descriptor_pb2.FieldDescriptorProto
# Integers of fixed size, for older files.
_TYPES: Mapping[Any, Any] = {
    np.dtype(np.float64): _Field.TYPE_DOUBLE,
    np.dtype(np.int64): _Field.TYPE_SFIXED64,
    np.dtype(np.bool_): _Field.TYPE_BOOL,
}
_log = logging.getLogger("tfg_drake.storage.port_recording")


@message
class Velocity:
    """A velocity that the base was told: v forward, m/s, and w, the turn rate, rad/s."""

    v: float
    w: float


@message
class Enabled:
    """enabled: 1.0 while the base may move, else 0.0."""

    enabled: float


@message
class Standing:
    """A file's messages, how many it has, and the stage of the newest map that was shown or might have been."""

    count: int
    stage: int


# Recorded ports of a station: a run cannot be replayed without MESSAGES, but without commands.
MESSAGES: Mapping[str, type] = {
    "base.odometry": Odometry,
    "base.hazards": Hazards,
    "tags.detections": TagDetections,
    "scan.ranges": LaserScan,
}
COMMAND = "base.velocity_commanded"
ENABLED = "base.enabled"
GOAL, SAID = "operator.goal", "operator.pose"
PORTS: Mapping[str, type] = {**MESSAGES, COMMAND: Velocity, ENABLED: Enabled, GOAL: RequestedGoal, SAID: SaidPose}
# Requests of an operator by the explorer's input that takes them.
REQUESTS: Mapping[str, str] = {"requested_goal": GOAL, "said_pose": SAID}


class RecordingError(FileError):
    """A recording that cannot be played; the message is one line: which, why and how to mend it."""


def nanoseconds(time: float) -> int:
    """A time, s, as whole nanoseconds: what is recorded and looked up by it has been rounded alike."""
    return round(time * _NS)


class PortWriter:
    """A recording being written, a context manager: closing it makes the file whole.

    What cannot be written after the beginning, as to a full disk, ends the recording with a line in the log, and not
    the run; failure: what ended it, None where nothing did.
    """

    def __init__(self, path: Path, robot: str, standing: Standing | None = None) -> None:
        """robot: what was driven. standing: what `standing` said of a file that is written further. Raises OSError
        where it cannot be, RecordingError where it is not what it was."""
        self._path = path
        self.failure: OSError | None = None
        # The new file is in the place of the old one when it has all that stands there.
        beside = path if standing is None else path.with_name(f".{path.name}")
        self._file = open_inside(beside, "wb")
        self._writer = Writer(self._file, compression=CompressionType.LZ4, enable_data_crcs=True)
        self._writer.start(library="tfg_drake")
        self._writer.add_metadata("run", {"robot": robot})
        self._channels: dict[str, int] = {}
        for port, kind in PORTS.items():
            self._register(port, *_schema(kind))
        for topic, (shown, _) in foxglove.TOPICS.items():
            self._register(topic, shown.DESCRIPTOR.full_name, foxglove.file_set(shown))
        self._encoders: dict[str, Callable[[Any], bytes]] = {port: _encoder(kind) for port, kind in PORTS.items()}
        # Bytes of the map that was shown last, and of the ports since then; stage of the newest that might have been.
        self._map_bytes, self._bytes, self._stage = 0, 0, 0
        self._newest: dict[str, object] = {}
        self._last_data: dict[str, bytes] = {}
        self._waiting: list[tuple[str, float, Any]] = []
        # Messages that were added, and of these what the operating system has.
        self._flushed, self._count, self._whole = -math.inf, 0, 0
        if standing is not None:
            self._copy(path, standing.count)
            self._stage = standing.stage
            self._flush()
            beside.replace(path)

    def standing(self) -> Standing:
        """Puts all on the disk, and says what stands there."""
        self._write_waiting()
        return Standing(self._whole, self._stage)

    def _copy(self, path: Path, count: int) -> None:
        """Takes the first messages of another recording."""
        topics: dict[int, str] = {}
        with reading(path, RecordingError):
            for record in _records(path):
                if self._count >= count:
                    break
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    self._add(topics[record.channel_id], record.log_time, record.data, record.publish_time)
        if self._count < count:
            raise RecordingError(f"{path}: has {self._count} of {count} messages; copy it again from where it was made")

    def _register(self, topic: str, name: str, files: Any) -> None:
        schema = self._writer.register_schema(name, "protobuf", files.SerializeToString())
        self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)

    def __enter__(self) -> PortWriter:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def write(self, port: str, time: float, value: object) -> None:
        """Records what a port carries at a time, s, one of PORTS' messages, or the pose or path to be shown: each once,
        and not one that is no other than that before."""
        if value is self._newest.get(port):
            return
        self._newest[port] = value
        # Many at a time take half as long as one by one.
        self._waiting.append((port, time, value))
        if time >= self._flushed + FLUSH_PERIOD:
            self._flushed = time
            self._write_waiting()

    def wants_map(self, stage: int) -> bool:
        """True if a stage's map would be a new one."""
        return stage > self._stage

    def write_map(self, time: float, estimate: MapEstimate, tfg: TfgMap, walls: MapEstimate | None) -> None:
        """Records the map at a time, s, to be shown, unless the last one takes too much of the file. walls: an estimate
        with those that are landmarks."""
        self.write(foxglove.SURFACES, time, (estimate, tfg, walls))
        self._stage = tfg.stage

    def close(self) -> None:
        """Writes what is left, and the index. What was told is let go: Drake keeps the systems that hold the writer."""
        self._write_waiting()
        self._newest.clear()
        self._last_data.clear()
        if self._file.closed:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
        except OSError as error:
            self._give_up(error)

    def _write_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        if self._file.closed:
            return
        try:
            for port, time, value in waiting:
                if port == foxglove.SURFACES and self._map_bytes > MAP_SHARE * self._bytes:
                    continue
                data = self._encoders[port](value) if port in PORTS else foxglove.TOPICS[port][1](time, value)
                if data == self._last_data.get(port):
                    continue
                now, stamp = nanoseconds(time), getattr(value, "stamp", time)
                published = nanoseconds(stamp) if 0.0 <= stamp < math.inf else now
                self._add(port, now, data, published)
            self._flush()
        except OSError as error:
            self._give_up(error)

    def _add(self, topic: str, log_time: int, data: bytes, publish_time: int) -> None:
        self._last_data[topic] = data
        if topic == foxglove.SURFACES:
            self._map_bytes, self._bytes = len(data), 0
        elif topic in PORTS:
            self._bytes += len(data)
        self._writer.add_message(self._channels[topic], log_time, data, publish_time)
        self._count += 1

    def _flush(self) -> None:
        """Leaves all that was added to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._whole = self._count

    def _give_up(self, error: OSError) -> None:
        _log.error("%s: cannot be written: %s; the run is not recorded any further", self._path, error.strerror)
        self.failure = error
        try:
            self._file.close()
        except OSError:
            self._file.raw.close()  # What waits to be written is lost.


@dataclasses.dataclass(frozen=True)
class PortRecording:
    """A recording that was read.

    path. robot: what was driven. log_times: of each of PORTS (n,) ns, increasing, when its messages came; messages: n
    of the port's kind. end_time: s, when the last of them came. whole: it was closed, by a program that was not killed.
    """

    path: Path
    robot: str
    log_times: Mapping[str, IntArray]
    messages: Mapping[str, Sequence[Any]]
    end_time: float
    whole: bool

    def at(self, port: str, time: float) -> Any:
        """A port's message at a time, s; before the first one, that one, but of a request that there is none."""
        row = int(np.searchsorted(self.log_times[port], nanoseconds(time), side="right")) - 1
        if row < 0 and port in REQUESTS.values():
            return PORTS[port]()
        return self.messages[port][max(row, 0)]

    def enabled(self, time: float) -> float:
        """1.0 while the base might move, at a time, s, else 0.0; 1.0 where that was not recorded."""
        return float(self.at(ENABLED, time).enabled) if self.messages[ENABLED] else 1.0


def read_recording(path: Path) -> PortRecording:
    """Read a recording, also one that ends where its program was killed.

    Args:
        path: the file, or the run's folder with it.

    Raises:
        RecordingError: it is not there, not a recording, or damaged.
    """
    path = of_run(path, FILE_NAME)
    times: dict[str, list[int]] = {port: [] for port in PORTS}
    messages: dict[str, list[Any]] = {port: [] for port in PORTS}
    robot, whole = "", False
    schemas: dict[int, Schema] = {}
    decoders: dict[int, tuple[str, Any]] = {}
    with reading(path, RecordingError):
        if path.stat().st_size == 0:
            raise RecordingError(f"{path}: is empty; name the recording of a run that had begun")
        for record in _records(path):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in decoders and record.topic in PORTS:
                decoders[record.id] = record.topic, _decoder(path, record.topic, schemas[record.schema_id])
            elif isinstance(record, Message) and record.channel_id in decoders:
                port, decoder = decoders[record.channel_id]
                before = messages[port][-1] if messages[port] else None
                messages[port].append(_read_message(PORTS[port], decoder.FromString(record.data), before))
                times[port].append(record.log_time)
            elif isinstance(record, Metadata) and record.name == "run":
                robot = record.metadata.get("robot", "")
            elif isinstance(record, Footer):
                whole = True
    if not whole:
        _log.warning("%s: was not closed; what its program had not written yet when it was killed is missing", path)
    silent = [port for port in MESSAGES if not messages[port]]
    if silent:
        raise RecordingError(f"{path}: holds no {silent[0]}; name the recording of a run that had begun")
    end = max(stamps[-1] for stamps in times.values() if stamps)
    log_times = {port: np.array(stamps, dtype=np.int64) for port, stamps in times.items()}
    return PortRecording(path, robot, log_times, messages, end / _NS, whole)


def recorded_robot(folder: Path) -> str:
    """The robot whose run a folder holds the recording of; "" where there is none that can be read."""
    try:
        found = (record for record in _records(folder / FILE_NAME) if isinstance(record, Metadata))
        return str(next(found).metadata.get("robot", ""))
    except Exception:  # Anything may come of bytes that are not what they should be.
        return ""


def _records(path: Path) -> Iterator[Any]:
    """The records of an MCAP file up to where it ends, or ends too early."""
    size, most = path.stat().st_size, most_unpacked(path)
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                most -= record.uncompressed_size
                if most < 0:
                    raise ValueError("it stands for too many bytes")
                yield from breakup_chunk(_unpacked(record), validate_crc=True)
        except Exception as error:
            # Its program was killed while it wrote the last record, or before it wrote another.
            if file.tell() >= size > MAGIC_SIZE:
                return
            if isinstance(error, InvalidMagic):
                mend = "name the folder of a run that was recorded"
                raise RecordingError(f"{path}: is not an MCAP file; {mend}") from error
            raise


def _unpacked(chunk: Chunk) -> Chunk:
    """A chunk without compression: no more of it than it says that it has, which the library does not look at."""
    unpack = {"lz4": lz4.frame.open, "zstd": zstandard.open}.get(chunk.compression)
    if unpack is None:
        return chunk
    data = unpack(io.BytesIO(chunk.data)).read(chunk.uncompressed_size)
    if len(data) < chunk.uncompressed_size:
        raise ValueError("the chunk is not whole")
    return dataclasses.replace(chunk, compression="", data=data)


def _encoder(kind: type) -> Callable[[Any], bytes]:
    """Encoder of a kind of message to protobuf's wire format."""
    make, names = _proto_class(*_schema(kind)), list(hints_of(kind))

    def encode(value: Any) -> bytes:
        fields = {name: np.asarray(getattr(value, name)).tolist() for name in names}
        if kind is LaserScan:
            fields |= foxglove.scan_fields(value)
        return bytes(make(**fields).SerializeToString())

    return encode


def _proto_class(name: str, files: Any) -> Any:
    """The protobuf class of a message by its declaration's name and the files with it."""
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def _decoder(path: Path, port: str, schema: Schema) -> Any:
    """The protobuf class of a channel's messages. Raises RecordingError where they are not as this version's are."""
    decoder = _proto_class(schema.name, descriptor_pb2.FileDescriptorSet.FromString(schema.data))
    there = [field.name for field in decoder.DESCRIPTOR.fields if field.name not in foxglove.ONLY_ITS]
    wanted = [field.name for field in dataclasses.fields(PORTS[port])]
    if sorted(there) != sorted(wanted):
        different = f"{port} has {', '.join(there)} and not {', '.join(wanted)}"
        raise RecordingError(f"{path}: is of another version: {different}; record the run again")
    return decoder


def _read_message(kind: type, proto: Any, before: Any) -> Any:
    """A message of a kind; an array that is that of the message before is shared with it, as a scan's angles are."""
    fields: dict[str, Any] = {}
    for name, hint in hints_of(kind).items():
        value, dtype = getattr(proto, name), dtype_of(hint)
        if dtype is None:
            fields[name] = hint(value)
            continue
        array, old = np.array(value, dtype=dtype), getattr(before, name, None)
        fields[name] = old if old is not None and array.tobytes() == old.tobytes() else array
    return kind(**fields)


def _schema(kind: type) -> tuple[str, Any]:
    """The name of a message's declaration and the files with it: a dataclass of numbers, truth values and arrays (n,)
    of them. A scan's fields but for its ranges stand in Foxglove's declaration."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{kind.__name__}.proto", package="tfg_drake", syntax="proto3")
    declared = file.message_type.add(name=kind.__name__)
    first = foxglove.FIRST_OWN + 1 if kind is LaserScan else 1
    for number, (name, hint) in enumerate(hints_of(kind).items(), start=first):
        label = _Field.LABEL_OPTIONAL if dtype_of(hint) is None else _Field.LABEL_REPEATED
        declared.field.add(name=name, number=number, label=label, type=_TYPES[entry_type(hint)])
    if kind is LaserScan:
        return foxglove.scan_files([field for field in declared.field if field.name != "ranges"])
    return f"{file.package}.{kind.__name__}", descriptor_pb2.FileDescriptorSet(file=[file])

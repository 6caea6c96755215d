"""The messages in the files of a ROS bag: MCAP and SQLite of ROS 2, and those of ROS 1, packed or not, whole or cut.

Every file is read from its beginning to its end, without its index: so what a recorder wrote before it was killed is
there, and the messages of a topic come in the order in which they were recorded. What is unpacked is bounded.
"""

from __future__ import annotations

import bz2
import contextlib
import enum
import io
import re
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.io.yaml_text import parse_yaml

# First bytes of the file formats.
_MCAP, _SQLITE, _ROS1, _ZSTD = b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V2.0\n", b"\x28\xb5\x2f\xfd"
# Suffixes of files of a bag; a recorder that compresses whole files adds one of _PACKED.
SUFFIXES = (".mcap", ".db3", ".bag", ".active")
_PACKED = (".zstd", ".zst")
METADATA = "metadata.yaml"
# Greatest unpacked size, the larger one: bytes, or times the packed size, as scans without returns shrink much.
LEAST_UNPACKED, MOST_SHRUNK = 64 * 2**20, 100
# Greatest size of a record or message, bytes; images are skipped.
_LARGEST = 256 * 2**20


class _Ros1(enum.IntEnum):
    """Opcodes of the records of ROS 1 that are read."""

    MESSAGE = 2
    CHUNK = 5
    CONNECTION = 7


class Logged(NamedTuple):
    """A message in a bag. kind: its type, "sensor_msgs/LaserScan". time_ns: time of recording by the recorder's clock.
    ros1: data is serialised as in ROS 1."""

    topic: str
    kind: str
    time_ns: int
    data: bytes
    ros1: bool = False


def is_bag(path: Path) -> bool:
    """Return True if a file is named like a bag's, or a folder contains such files or metadata.yaml."""
    if path.is_dir():
        return (path / METADATA).is_file() or bool(_in_folder(path))
    return _is_named(path)


def bag_files(path: Path) -> tuple[list[Path], list[str]]:
    """Return the files of a bag in the order of recording, and remarks on that: by metadata.yaml, or, if the recorder
    was killed before it wrote that, by the numbers in their names.

    Raises:
        DatasetError: there are none.
    """
    if not path.is_dir():
        return [path], []
    told, found = [], _in_folder(path)
    try:
        tree: Any = parse_yaml((path / METADATA).read_text(encoding="utf-8"))
        named = [path / Path(name).name for name in tree["rosbag2_bagfile_information"]["relative_file_paths"]]
        there = [_there(one) for one in named]
    except (OSError, ValueError, KeyError, TypeError):
        told.append(f"no whole {METADATA} in it: all files of a bag are read, in the order of their numbers")
    else:
        if missing := [one.name for one, file in zip(named, there, strict=True) if file is None]:
            told.append(f"{', '.join(missing)[:200]} of {METADATA} not there, the others are read")
        found = [file for file in there if file is not None]
    if not found:
        raise DatasetError(f"{path}: no file of its bag is there; copy the whole folder")
    return found, told


def read_messages(files: Collection[Path], kinds: Collection[str], tell: Callable[[str], None]) -> Iterator[Logged]:
    """Yield the messages of these kinds, file by file, in the order of each file. tell: called with a remark on the
    part of a file that is not read.

    Raises:
        DatasetError: a file cannot be opened or is no file of a bag, or would be too large unpacked.
    """
    try:
        unpacked = _Unpacked(max(LEAST_UNPACKED, MOST_SHRUNK * sum(file.stat().st_size for file in files)))
        for file in files:
            with file.open("rb") as stream:
                yield from _of_file(file, stream, kinds, unpacked, tell)
    except OSError as error:
        raise DatasetError(f"{error.filename}: {(error.strerror or str(error)).lower()}; name a data set") from None


class _Unpacked:
    """Unpacks chunks of a bag up to a total size, bytes."""

    def __init__(self, room: int) -> None:
        self._room, self._most = room, room

    def __call__(self, packing: str, data: bytes) -> bytes:
        """Return the unpacked data. Raises DatasetError if they are too large, any exception if they are damaged."""
        if packing == "zstd":
            result = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(self._room + 1)
        elif packing == "lz4":
            result = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=self._room + 1)
        elif packing == "bz2":
            result = bz2.BZ2Decompressor().decompress(data, self._room + 1)
        else:
            return data
        self._room -= len(result)
        if self._room < 0:
            raise DatasetError(f"it unpacks to more than {self._most // 2**20} MiB; record it again, unpacked")
        return result


def _of_file(
    file: Path, stream: IO[bytes], kinds: Collection[str], unpacked: _Unpacked, tell: Callable[[str], None]
) -> Iterator[Logged]:
    start = stream.read(16)
    stream.seek(0)
    if start.startswith(_ZSTD):
        with tempfile.NamedTemporaryFile() as whole:
            whole.write(unpacked("zstd", stream.read()))
            whole.seek(0)
            yield from _of_file(file, whole.file, kinds, unpacked, tell)
        return
    readers = {_MCAP: _of_mcap, _ROS1: _of_ros1, _SQLITE: _of_sqlite}
    reader = next((one for begin, one in readers.items() if start.startswith(begin)), None)
    if reader is None:
        raise DatasetError(f"{file}: not a file of a ROS bag (.mcap, .db3, .bag); is it what its name says?")
    count = 0
    try:
        for one in reader(stream, kinds, unpacked):
            # ROS 2 may compress each message by itself.
            yield one._replace(data=unpacked("zstd", one.data)) if one.data.startswith(_ZSTD) else one
            count += 1
    except DatasetError as error:
        raise DatasetError(f"{file}: {error}") from None
    except EOFError:
        tell(f"{file.name} is cut off, as by a recorder that was killed: the {count} messages before that are read")
    except Exception as error:  # damaged bytes may raise any exception
        why = " ".join(str(error).split())[:100] or type(error).__name__
        tell(f"{file.name} is damaged ({why}): the {count} messages before that are read")


def _of_mcap(stream: IO[bytes], kinds: Collection[str], unpacked: _Unpacked) -> Iterator[Logged]:
    """Yield the messages of an MCAP file, see https://mcap.dev/spec."""
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str, bool]] = {}
    stream.seek(len(_MCAP))
    for opcode, content in _unchunked(stream, unpacked):
        if opcode == Opcode.SCHEMA:
            schemas[_number("<H", content)] = _text(content, 2)[0].replace("/msg/", "/")
        elif opcode == Opcode.CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, after = _text(content, 4)
            channels[number] = topic, schemas.get(schema, ""), _text(content, after)[0] == "ros1"
        elif opcode == Opcode.MESSAGE:
            number, _, logged = struct.unpack_from("<HIQ", content)
            topic, kind, ros1 = channels.get(number, ("", "", False))
            if kind in kinds:
                yield Logged(topic, kind, logged, content[22:], ros1)


def _unchunked(stream: IO[bytes], unpacked: _Unpacked) -> Iterator[tuple[int, bytes]]:
    """Yield opcodes and contents of the records of an MCAP's data section, also those in chunks. Raises EOFError where
    the file is cut off, after the records that are there, also of a cut chunk."""
    while len(head := stream.read(9)) == 9:
        if head.startswith(_MCAP):  # Python's mcap writes it again if it makes no chunks
            stream.seek(-1, io.SEEK_CUR)
            continue
        opcode, length = struct.unpack("<BQ", head)
        if opcode == 0:
            raise ValueError("a record of no kind")
        content = _read(stream, length)
        whole = len(content) == length
        if opcode == Opcode.CHUNK:
            packing, at = _text(content, 28)
            with contextlib.suppress(EOFError):
                yield from _unchunked(io.BytesIO(unpacked(packing, content[at + 8 :])), unpacked)
        elif opcode == Opcode.DATA_END:
            return
        elif whole:
            yield opcode, content
        if not whole:
            break
    raise EOFError


def _of_ros1(stream: IO[bytes], kinds: Collection[str], unpacked: _Unpacked) -> Iterator[Logged]:
    """Yield the messages of a bag of format 2.0, see http://wiki.ros.org/Bags/Format/2.0."""
    topics: dict[int, tuple[str, str]] = {}

    def records(part: IO[bytes]) -> Iterator[Logged]:
        while len(head := part.read(4)) == 4:
            of_record = _ros1_fields(_whole(part, _number("<I", head)))
            length = _number("<I", _whole(part, 4))
            data = _read(part, length)
            opcode = of_record[b"op"][0]
            if opcode == _Ros1.CHUNK:
                yield from records(io.BytesIO(unpacked(of_record[b"compression"].decode(), data)))
            if len(data) < length:
                raise EOFError
            if opcode == _Ros1.CONNECTION:
                kind = _ros1_fields(data)[b"type"].decode()
                topics[_number("<I", of_record[b"conn"])] = of_record[b"topic"].decode(), kind
            elif opcode == _Ros1.MESSAGE:
                topic, kind = topics.get(_number("<I", of_record[b"conn"]), ("", ""))
                seconds, nanoseconds = struct.unpack("<II", of_record[b"time"])
                if kind in kinds:
                    yield Logged(topic, kind, 10**9 * seconds + nanoseconds, data, ros1=True)

    stream.seek(len(_ROS1))
    yield from records(stream)


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a record's header; each is stored as length, name, "=" and value."""
    fields, at = {}, 0
    while at < len(header):
        end = at + 4 + _number("<I", header, at)
        name, _, value = header[at + 4 : end].partition(b"=")
        fields[name], at = value, end
    return fields


def _of_sqlite(stream: IO[bytes], kinds: Collection[str], _: _Unpacked) -> Iterator[Logged]:
    """Yield the messages of rosbag2's tables topics (id, name, type, ..), messages (id, topic_id, timestamp, data)."""
    path = Path(stream.name).absolute()
    # A killed recorder may have left messages in its write-ahead log.
    how = "mode=ro" if Path(f"{path}-wal").is_file() else "immutable=1"
    with contextlib.closing(sqlite3.connect(f"{path.as_uri()}?{how}", uri=True)) as tables:
        tables.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST)
        rows = tables.execute("SELECT id, name, type FROM topics")
        topics = {key: (str(name), str(kind).replace("/msg/", "/")) for key, name, kind in rows}
        for key, time_ns, data in tables.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            topic, kind = topics.get(key, ("", ""))
            if kind in kinds:
                yield Logged(topic, kind, int(time_ns), bytes(data))


def _read(stream: IO[bytes], length: int) -> bytes:
    """Return `length` bytes, fewer at the end. Raises ValueError if no record is that long."""
    if length > _LARGEST:
        raise ValueError(f"a record of {length} bytes")
    return stream.read(length)


def _whole(stream: IO[bytes], length: int) -> bytes:
    """Return `length` bytes. Raises EOFError if there are fewer."""
    data = _read(stream, length)
    if len(data) < length:
        raise EOFError
    return data


def _number(layout: str, data: bytes, at: int = 0) -> int:
    return int(struct.unpack_from(layout, data, at)[0])


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the text stored with its length at an offset, and the offset of its end."""
    end = at + 4 + _number("<I", data, at)
    return data[at + 4 : end].decode(), end


def _in_folder(folder: Path) -> list[Path]:
    """Return the files of a bag in a folder, in the order of the numbers in their names."""
    found = [one for one in folder.iterdir() if one.is_file() and _is_named(one)]
    parts = {one: re.split(r"([0-9]+)", one.name) for one in found}  # every second part is a number
    return sorted(found, key=lambda one: [int(part) if k % 2 else part for k, part in enumerate(parts[one])])


def _is_named(path: Path) -> bool:
    name = path.with_suffix("") if path.suffix in _PACKED else path
    return name.suffix in SUFFIXES


def _there(path: Path) -> Path | None:
    """Return a file or its compressed form, None if neither exists."""
    return next((one for one in (path, *(Path(f"{path}{end}") for end in _PACKED)) if one.is_file()), None)

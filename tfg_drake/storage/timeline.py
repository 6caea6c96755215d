"""A mission's picture over time, as a file that grows while it runs: what the page of `tfg_drake.cockpit` shows.

The file is MAGIC and then blocks: the length of a block (uint32), and so many bytes by zlib. A block holds whole
records. A record is the length of its header (uint32), the header (JSON, filled up with spaces), and its arrays one
behind the other; all lengths are multiples of 4, all numbers little-endian. The header has "t", the simulated time, s,
"layer", the record's name, "arrays", a list of [name, type, shape], and whatever else is told. An array's type is "f4"
(float32), "i4" (int32), "u2" (uint16), "u1" (uint8) or, of what is metres to whoever reads it, "mm" (int32),
millimetres, "c2" (int16) or "c4" (int32), column by column, by how many centimetres each row differs from the last.

A record says what a layer is like from its time on, until there is another one of that layer; those of the layer "free"
name the star polygons that have changed. Where a record has an array "gone", the layer is a table, and the record says
how it has changed: the other arrays are rows that are added, gone are the numbers of rows that are no longer there. All
rows of a layer are numbered in the order in which they were written. Of a program that is killed all is there but the
last second.
"""

from __future__ import annotations

import dataclasses
import io
import json
import logging
import math
import struct
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tfg_drake.config import RobotConfig
from tfg_drake.io.files import FileError, open_inside
from tfg_drake.pictures import scene, tables
from tfg_drake.pictures.rows import StandingRows, Table

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap

FILE_NAME = "timeline.tfg"
MAGIC = b"tfg_drake timeline 2\n\n\n\n"
# Wall time between two blocks, s, which is lost at most if the program ends; shorter while a page is open.
FLUSH_PERIOD, WATCHED_PERIOD = 1.0, 0.08
# Greatest mean rate of a layer, bytes per simulated second; one that changes more is written less often.
LAYER_RATE = 8e3
# Greatest mean rate at which tables are compared, bytes per simulated second; a large map is written less often.
COMPARED_RATE = 400e3
# Layers of many points for which centimetres suffice.
COARSE = ("scan", "free", "path")
# Level of zlib, the fastest; the next one takes twice the time and saves a twentieth.
COMPRESSION = 1

NUMBERS = {"mm": "<i4", "c2": "<i2", "c4": "<i4", "f4": "<f4", "i4": "<i4", "u2": "<u2", "u1": "u1"}
_told = json.JSONEncoder(separators=(",", ":")).encode
LENGTH = struct.Struct("<I")
_log = logging.getLogger("tfg_drake.storage.timeline")


class TimelineError(FileError):
    """A timeline that cannot be shown; the message is one line: which, why and how to mend it."""


def encoded(layer: str, time: float, arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any]) -> bytes:
    """A record. Arrays of float64 are positions, m; those of float32, integers and truth values stay what they are."""
    entries, data = [], []
    for name, array in arrays.items():
        kind, packed = _packed(array, layer in COARSE)
        raw = packed.tobytes()
        entries.append([name, kind, list(array.shape)])
        data.append(raw + bytes(-len(raw) % 4))
    header = _told({"t": round(time, 4), "layer": layer, "arrays": entries, **told}).encode()
    header += b" " * (-len(header) % 4)
    return b"".join([LENGTH.pack(len(header)), header, *data])


def _packed(array: NDArray[Any], coarse: bool) -> tuple[str, NDArray[Any]]:
    if array.dtype == np.float64 and coarse:
        steps = np.diff(np.rint(100.0 * array), axis=0, prepend=0.0).T
        kind = "c2" if np.abs(steps).max(initial=0.0) < 2**15 else "c4"
        return kind, steps.astype(NUMBERS[kind])
    if array.dtype == np.float64:
        return "mm", np.rint(1000.0 * array).astype("<i4")
    if array.dtype == np.float32:
        return "f4", array.astype("<f4", copy=False)
    if array.dtype == np.bool_ or array.dtype == np.uint8:
        return "u1", array.astype(np.uint8)
    if array.size and array.min() >= 0 and array.max() < 2**16:
        return "u2", array.astype("<u2")
    return "i4", array.astype("<i4")


@dataclasses.dataclass(frozen=True)
class Standing:
    """A file's size, bytes; when each layer may be written again, s; and the rows of the tables in it."""

    size: int
    due: dict[str, float]
    rows: dict[str, StandingRows]


class TimelineWriter:
    """A timeline being written, a context manager.

    What cannot be written after the beginning, as to a full disk, ends it with a line in the log, and not the mission;
    failure: what ended it, None where nothing did. watched: whether somebody looks on, to whom it is to be told soon.
    """

    def __init__(
        self, path: Path, watched: Callable[[], bool] = lambda: False, standing: Standing | None = None
    ) -> None:
        """standing: what `standing` said of a file that is written further. Raises OSError where it cannot be,
        TimelineError where it is not what it was."""
        self._path, self.watched = path, watched
        self.failure: OSError | None = None
        self._file: BinaryIO = open_inside(path, "wb" if standing is None else "r+b", buffering=0)
        self._records: list[bytes] = []
        self._due: dict[str, float] = {}
        self._rows: dict[str, StandingRows] = {}
        self._flushed = time.monotonic()
        self._size = len(MAGIC)  # of what is whole
        if standing is None:
            self._file.write(MAGIC)
        else:
            self._size, size = standing.size, self._file.seek(0, io.SEEK_END)
            if not len(MAGIC) <= standing.size <= size:
                self._file.close()
                mend = "copy it again from where it was made"
                raise TimelineError(f"{path}: has {size} of {standing.size} bytes; {mend}")
            self._file.truncate(standing.size)
            self._file.seek(0, io.SEEK_END)
            self._due, self._rows = standing.due, standing.rows

    def standing(self) -> Standing:
        """Puts all on the disk, and says what stands there."""
        self.flush()
        return Standing(self._size, self._due, self._rows)

    def __enter__(self) -> TimelineWriter:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def is_due(self, layer: str, time: float) -> bool:
        """True if a layer may be written at a time, s: not if written too much lately."""
        return time >= self._due.get(layer, -math.inf)

    def write(self, layer: str, time: float, arrays: Mapping[str, NDArray[Any]], **told: Any) -> None:
        """Adds a record; see `encoded`."""
        if self._file.closed:
            return
        record = encoded(layer, time, arrays, told)
        due = max(time, self._due.get(layer, time))
        self._due[layer] = due + len(record) / LAYER_RATE
        self._records.append(record)

    def write_rows(self, layer: str, time: float, table: Table, **told: Any) -> None:
        """Adds a record of how a table has changed."""
        added, gone = self._rows.setdefault(layer, StandingRows()).change(table)
        rows = {name: array[added] for name, array in table.arrays.items()}
        self.write(layer, time, {**rows, "gone": gone}, **told)
        size = sum(array.nbytes for array in table.arrays.values())
        self._due[layer] = max(self._due.get(layer, time), time + size / COMPARED_RATE)

    def flush(self, *, all_of_it: bool = True) -> None:
        """Put on the disk what there is, all of it or only when it is time to."""
        now = time.monotonic()
        if self._file.closed or not self._records:
            return
        if not all_of_it and now < self._flushed + (WATCHED_PERIOD if self.watched() else FLUSH_PERIOD):
            return
        self._flushed = now
        block = zlib.compress(b"".join(self._records), COMPRESSION)
        self._records = []
        data = LENGTH.pack(len(block)) + block
        try:
            while data:
                data = data[self._file.write(data) :]
            self._size += LENGTH.size + len(block)
        except OSError as error:
            self._end(error)

    def close(self) -> None:
        """Write the rest, and let go of it: Drake keeps the systems that hold the writer."""
        self.flush()
        self._rows = {}
        self._file.close()

    def _end(self, error: OSError) -> None:
        self.failure = error
        self._file.close()
        _log.error("%s: cannot be written: %s; the mission goes on", self._path, error.strerror or error)


def write_map_timeline(saved: SavedMap, path: Path, title: str) -> None:
    """Write the timeline of a map. title: stands above it. Raises OSError where the file cannot be written."""
    with TimelineWriter(path) as writer:
        now, tfg, stars = saved.stamp, saved.tfg, scene.free_space(saved.tfg)
        writer.write("world", now, {}, title=title, radius=RobotConfig.radius, rule="", simulated=False)
        writer.write("frame", now, {"pose": saved.X_WM.astype(np.float32)})
        table, views = tables.landmarks(saved), len(saved.X_MA)
        writer.write_rows("map", now, table, stage=saved.stage, entropy=saved.entropy, views=views)
        writer.write_rows("wall_landmarks", now, tables.wall_landmarks(saved.graph))
        writer.write_rows("tfg", now, tables.surfaces(tfg))
        writer.write_rows("frontiers", now, tables.frontiers(tfg))
        writer.write("free", now, scene.packed_stars(stars, np.arange(len(stars))))

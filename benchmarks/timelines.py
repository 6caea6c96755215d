"""Reads a run's timeline.tfg, whose format is in tfg_drake/storage/timeline.py, as arrays."""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.io.files import most_unpacked, of_run, reading
from tfg_drake.storage.timeline import FILE_NAME, LENGTH, MAGIC, NUMBERS, TimelineError

# Greatest size of a timeline's records, each with its whole table, bytes: an hour in a large building has 0.2 GB.
_LARGEST = 2 * 2**30


@dataclasses.dataclass(frozen=True)
class Record:
    """A layer from a time on, s; of a table all rows. told: what else the header has. Positions in m."""

    time: float
    layer: str
    arrays: Mapping[str, NDArray[Any]]
    told: Mapping[str, Any]


def read_timeline(path: Path, *, whole: bool = True) -> list[Record]:
    """The records of a timeline, also of one that is being written or was when its program was killed.

    Args:
        path: the file, or the run's folder with it.
        whole: of a table all rows that are there; else, as written, those that came and the numbers of those gone.

    Raises:
        TimelineError: it is not there, no timeline, or damaged.
    """
    path = of_run(path, FILE_NAME)
    with reading(path, TimelineError):
        data, most = path.read_bytes(), most_unpacked(path)
        if not data.startswith(MAGIC):
            raise TimelineError(f"{path}: is no timeline of this version; name the folder of a run that was recorded")
        records = (record for block in _blocks(data, most) for record in _records(block))
        return list(_whole(records) if whole else records)


def _blocks(data: bytes, most: int) -> Iterator[bytes]:
    """The blocks, unpacked: `most` bytes in all, ValueError for more."""
    start = len(MAGIC)
    while start + 4 <= len(data):
        (length,) = LENGTH.unpack_from(data, start)
        block = data[start + 4 : start + 4 + length]
        if len(block) < length:
            return
        unpacked = zlib.decompressobj().decompress(block, most + 1)
        most -= len(unpacked)
        if most < 0:
            raise ValueError("it stands for too many bytes")
        yield unpacked
        start += 4 + length


def _records(block: bytes) -> Iterator[Record]:
    start = 0
    while start < len(block):
        (length,) = LENGTH.unpack_from(block, start)
        header = json.loads(block[start + 4 : start + 4 + length])
        start += 4 + length
        arrays = {}
        for name, kind, shape in header["arrays"]:
            array = np.frombuffer(block, np.dtype(NUMBERS[kind]), math.prod(shape), start)
            start += array.nbytes + -array.nbytes % 4
            if kind in ("c2", "c4"):
                arrays[name] = 1e-2 * np.cumsum(array.reshape(shape[::-1]), axis=1, dtype=np.int64).T
            else:
                arrays[name] = (1e-3 * array if kind == "mm" else array).reshape(shape)
        told = {key: value for key, value in header.items() if key not in ("t", "layer", "arrays")}
        yield Record(header["t"], header["layer"], arrays, told)


def _whole(records: Iterator[Record]) -> Iterator[Record]:
    """The records, those of tables with all rows that are there, in the order in which they were written."""
    tables: dict[str, tuple[NDArray[np.int64], int, Mapping[str, NDArray[Any]]]] = {}
    size = 0
    for record in records:
        if "gone" not in record.arrays:
            yield record
            continue
        added = {name: array for name, array in record.arrays.items() if name != "gone"}
        numbers, count, before = tables.get(record.layer, (np.zeros(0, dtype=np.int64), 0, {}))
        stays = ~np.isin(numbers, record.arrays["gone"])
        arrays = {name: np.concatenate([before[name][stays], new]) if before else new for name, new in added.items()}
        size += sum(array.nbytes for array in arrays.values())
        if size > _LARGEST:
            raise ValueError("it stands for too many bytes")
        end = count + len(next(iter(added.values())))
        tables[record.layer] = (np.append(numbers[stays], np.arange(count, end)), end, arrays)
        yield dataclasses.replace(record, arrays=arrays)

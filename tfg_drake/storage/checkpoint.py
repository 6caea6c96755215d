"""Checkpoint of a mission under way, a file to go on from: written anew every few seconds, whole or not at all.

The file is MAGIC, a checksum (uint32) of the rest, and two blocks (`tfg_drake.storage.serialization`): what is told of
the mission, and its state, which is read by the version that wrote it.
"""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tfg_drake import __version__
from tfg_drake.io.files import FileError, of_run, reading, write_atomic
from tfg_drake.messages import FloatArray
from tfg_drake.storage.serialization import Packed, pack

FILE_NAME = "checkpoint.bin"
MAGIC = b"tfg_drake checkpoint 3\n"
# The header: names of scenario, world, robot and method; own: whether the method is a file or has parts of one's own;
# scenario_digest: of the mission's definition; stamps (n,) s and X_WB (n, 3): the estimated poses.
TOLD: Mapping[str, Any] = {
    "version": str,
    "scenario": str,
    "world": str,
    "seed": int,
    "robot": str,
    "method": str,
    "own": bool,
    "scenario_digest": str,
    "sim_time_s": float,
    "stamps": FloatArray,
    "X_WB": FloatArray,
    "contacts": int | None,
}
# Greatest size of a file, bytes; that of an hour in a large building has 40 MB.
LARGEST = 256 * 2**20
_CHECKSUM = struct.Struct("<I")
_MEND = "copy it again from where it was written, or begin a mission with the run's map: --map"


class CheckpointError(FileError):
    """A mission that cannot be gone on with; the message is one line: which, why and how to mend it."""


def write_checkpoint(path: Path, told: Mapping[str, Any], state: Mapping[str, tuple[Any, Any]]) -> None:
    """Write a mission.

    Args:
        path: the file.
        told: values of TOLD but for the version.
        state: annotation and value of each of its parts.

    Raises:
        TypeError: a part has no place in it, or is not what its annotation says; the message names it.
        OSError: it cannot be written.
    """
    known = {"version": __version__, **told}
    pieces = [*pack({name: (hint, known[name]) for name, hint in TOLD.items()}), *pack(state)]
    checksum = 0
    for piece in pieces:
        checksum = zlib.crc32(piece, checksum)
    write_atomic(path, b"".join([MAGIC, _CHECKSUM.pack(checksum), *pieces]), durable=False)


def read_checkpoint(path: Path) -> tuple[dict[str, Any], Packed]:
    """Reads a mission's header and its state. path: the file, or the run's folder with it.

    Raises:
        CheckpointError: there is none, it is damaged, or another version wrote it. So does the state's `take`.
    """
    told, state = _opened(path)
    if told["version"] != __version__:
        mend = f"go on with that version, or begin a mission with its map: --map {path}"
        raise CheckpointError(f"{path}: was written by version {told['version']}, this is {__version__}; {mend}")
    return told, state


def read_told(path: Path) -> dict[str, Any]:
    """Reads the header of a mission cut short, whichever version wrote it. Raises CheckpointError."""
    return _opened(path)[0]


def _opened(path: Path) -> tuple[dict[str, Any], Packed]:
    path = of_run(path, FILE_NAME)
    if not path.is_file():
        run = path.parent
        if (run / "summary.json").is_file():
            raise CheckpointError(f"{run}: that mission has ended; begin another one with its map: --map {run}")
        raise CheckpointError(f"{run}: holds no mission to go on with; name the folder of one that was cut short")
    with reading(path, CheckpointError):
        if path.stat().st_size > LARGEST:
            raise CheckpointError(f"{path}: has more than {LARGEST // 2**20} MiB; {_MEND}")
        data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise CheckpointError(f"{path}: is no checkpoint of this version; {_MEND}")
    damaged = functools.partial(_damaged, path)
    try:
        start = len(MAGIC) + _CHECKSUM.size
        if zlib.crc32(memoryview(data)[start:]) != _CHECKSUM.unpack_from(data, len(MAGIC))[0]:
            raise ValueError("its checksum is wrong")
        block = Packed(data, start, damaged)
        told = {name: block.take(name, hint) for name, hint in TOLD.items()}
        if any(isinstance(value, str) and not value.isprintable() for value in told.values()):
            raise ValueError("it tells of what is no line of text")
        if told["X_WB"].shape != (*told["stamps"].shape, 3):
            raise ValueError("stamps do not fit the poses")
        return told, Packed(data, block.end, damaged)
    except CheckpointError:
        raise
    except Exception as error:  # Anything may come of bytes that are not what they should be.
        raise damaged(error) from error


def _damaged(path: Path, error: BaseException) -> CheckpointError:
    first_line = next(iter(str(error).splitlines()), type(error).__name__)
    return CheckpointError(f"{path}: is damaged ({first_line}); {_MEND}")

"""Files that are either whole or not there, and read no further than they should be."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tfg_drake.bad_input import BadInput

# Greatest size of a run's text file, bytes: a trajectory of two days.
LARGEST_TEXT = 256 * 2**20
# Greatest size of a file's arrays, bytes; a map of 274 landmarks and 138 views has 0.8 MB.
_LARGEST_ARRAYS = 64 * 2**20
# Greatest unpacked size, bytes, or as a multiple of the packed size: a run's arrays shrink to a tenth at best, zeros to
# a thousandth.
_LEAST_UNPACKED, _MOST_SHRUNK = 64 * 2**20, 32
# The function that unpacks a file, by its suffix.
_UNPACKED: dict[str, Any] = {".gz": gzip.open, ".bz2": bz2.open}


class FileError(BadInput, ValueError):
    """A file of a run that cannot be used; the message is one line: which, what is wrong, how to mend it."""


def of_run(path: Path, name: str) -> Path:
    """A file of a run, which the path is, or which has this name in the run's folder, which the path is."""
    return path / name if path.is_dir() else path


@contextlib.contextmanager
def reading(path: Path, problem: type[FileError] = FileError) -> Iterator[None]:
    """While a file of a run is read: whatever is raised then, as by bytes that are not what they should be, comes as
    `problem`."""
    try:
        yield
    except FileError as error:
        raise error if isinstance(error, problem) else problem(str(error)) from None
    except FileNotFoundError:
        raise problem(f"{path}: no such file; name the folder of a run that was recorded") from None
    except OSError as error:
        raise problem(f"{path}: cannot be read: {error.strerror or error}; name a file that can be") from None
    except Exception as error:
        raise problem(f"{path}: is damaged; copy it again from where it was recorded") from error


def read_text(path: Path) -> str:
    """A text file of a run. Raises OSError; UnicodeDecodeError where it is no UTF-8; FileError where it is too long."""
    data = read_bytes(path, LARGEST_TEXT + 1)
    if len(data) > LARGEST_TEXT:
        raise FileError(f"{path}: has more than {LARGEST_TEXT // 2**20} MiB; name a file of a run")
    return data.decode()


def read_object(path: Path) -> dict[str, Any]:
    """The JSON object of a run's file, such as summary.json. Raises FileError."""
    with reading(path):
        return {**json.loads(read_text(path))}  # of anything but an object a TypeError


def read_arrays(path: Path) -> dict[str, Any]:
    """The arrays of an .npz file. Raises FileError where they are too large, anything where it is no such file."""
    import numpy as np  # Who asks for help does not wait for it.

    with zipfile.ZipFile(path) as archive:  # which unpacks no more of an array than it says here
        size = sum(info.file_size for info in archive.infolist())
    if size > _LARGEST_ARRAYS:
        raise FileError(f"{path} holds {size / 2**20:.0f} MiB, at most {_LARGEST_ARRAYS / 2**20:.0f} are read")
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def most_unpacked(path: Path) -> int:
    """How many bytes what a file holds packed may stand for. Raises OSError."""
    return max(_LEAST_UNPACKED, _MOST_SHRUNK * path.stat().st_size)


def read_bytes(path: Path, most: int) -> bytes:
    """The first `most` bytes of a file, all where it has fewer, unpacked where its name ends in .gz or .bz2.

    No more than these are unpacked: a file of zeros shrinks to a thousandth.

    Raises:
        OSError: the file cannot be read; one without errno, such as gzip.BadGzipFile, where it is no packed file or not
            a whole one.
    """
    try:
        with path.open("rb") as plain, _UNPACKED.get(path.suffix, contextlib.nullcontext)(plain) as file:
            return bytes(file.read(most))
    except (EOFError, zlib.error) as error:
        raise gzip.BadGzipFile(str(error)) from None


def open_inside(path: Path, mode: str, buffering: int = -1, encoding: str | None = None) -> Any:
    """Opens a run's file to write it, as `open` does, where the file is one of its folder: a link out of it is not
    followed, and nobody waits at a pipe. Raises OSError."""
    odd = os.O_NOFOLLOW | os.O_NONBLOCK
    return open(path, mode, buffering, encoding, opener=lambda name, flags: os.open(name, flags | odd, 0o666))


def write_atomic(path: Path, data: bytes | str, *, durable: bool = True) -> None:
    """Write a file by way of a temporary neighbour and a rename, so that no reader ever meets half of it.

    Args:
        path: the file; its folder must exist.
        data: the contents, text as UTF-8.
        durable: they are on the disk, not only on their way there, when this returns. Without it the file outlives the
            program all the same, and nobody waits for a disk; a power cut may cost it.

    Raises:
        OSError: the file cannot be written; what was there before is untouched.
    """
    contents = data.encode() if isinstance(data, str) else data
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(contents)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)  # mkstemp makes it private
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise

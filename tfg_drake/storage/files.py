"""Files that are either whole or not there, and read no further than they should be."""

from __future__ import annotations

import gzip
import os
import tempfile
import zlib
from pathlib import Path


def read_bytes(path: Path, most: int) -> bytes:
    """The first `most` bytes of a file, all where it has fewer, unzipped where its name ends in .gz.

    No more than these are unzipped: a file of zeros shrinks to a thousandth.

    Raises:
        OSError: the file cannot be read; gzip.BadGzipFile, which is one, where it is no gzip file or not a whole one.
    """
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            return file.read(most)
    except (EOFError, zlib.error) as error:
        raise gzip.BadGzipFile(str(error)) from None


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

"""Text files, plain or gzipped, and numbers in them, with complaints that name file and line."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.io.files import read_bytes

# The longest text that is read, bytes; a log of 300 000 scans of 180 rays has 300 MB.
_LONGEST = 512 * 2**20
# gzip makes tables of numbers some ten times shorter; what it made a hundred times shorter is none. Below a MB it
# does not matter.
_ZIPPED = 100
_ANY = 2**20
# No number that was measured is greater, nor the ns since 1970; what is computed from it stays finite.
GREATEST = 1e19


def found_file(folder: Path, name: str) -> Path | None:
    """The file of this name in a folder, or its gzipped version; None where there is neither."""
    return next((path for path in (folder / name, folder / f"{name}.gz") if path.is_file()), None)


def find_file(folder: Path, name: str) -> Path:
    """The same where it must be there.

    Raises:
        DatasetError: there is neither.
    """
    if (path := found_file(folder, name)) is None:
        raise DatasetError(f"{folder / name}: no such file, nor with .gz; put it there")
    return path


def read_text(path: Path) -> str:
    """The text of a file, unpacked where its name ends in .gz or .bz2.

    Raises:
        DatasetError: the file cannot be read, or is too long.
    """
    try:
        most = min(_LONGEST, max(_ANY, _ZIPPED * path.stat().st_size))
        data = _unpacked(path, most + 1) if path.suffix == ".bz2" else read_bytes(path, most + 1)
        if len(data) > most:
            raise DatasetError(f"{path}: more than {most / 2**20:.0f} MiB of text; is it what its name says?")
        return data.decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file; is it what its name says?") from error
    except gzip.BadGzipFile as error:
        raise DatasetError(f"{path}: not a whole gzip file; copy it again") from error
    except OSError as error:
        raise DatasetError(f"{path}: {(error.strerror or str(error)).lower()}") from error


def _unpacked(path: Path, most: int) -> bytes:
    """The first `most` bytes of what a .bz2 holds. Raises OSError; DatasetError where it is no whole one."""
    with path.open("rb") as packed, bz2.open(packed) as file:
        try:
            return file.read(most)
        except (EOFError, OSError) as error:
            raise DatasetError(f"{path}: not a whole bzip2 file; copy it again") from error


def parse_numbers(path: Path, line: int, words: list[str]) -> list[float]:
    """The words of a line of a file as numbers.

    Raises:
        DatasetError: one of them is not a finite number below GREATEST.
    """
    try:
        numbers = [float(word) for word in words]
        if all(-GREATEST < number < GREATEST for number in numbers):
            return numbers
    except ValueError:
        pass  # which it is, is found below
    wrong = next(word for word in words if not _is_measured(word))
    raise DatasetError(f"{path}, line {line}: {wrong[:40]!r} is not a finite number below {GREATEST:g}; mend the line")


def _is_measured(word: str) -> bool:
    try:
        return abs(float(word)) < GREATEST
    except ValueError:
        return False

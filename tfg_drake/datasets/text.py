"""Tables of numbers in text files, plain or gzipped, with complaints that name file and line."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.files import read_bytes
from tfg_drake.messages import FloatArray

# The longest text that is read, bytes; the longest public log that we know of has 10 MB.
_LONGEST = 64 * 2**20
# gzip makes tables of numbers some ten times shorter; what it made a hundred times shorter is none. Below a MB it
# does not matter.
_ZIPPED = 100
_ANY = 2**20
# No number that was measured is greater, whatever its unit; what is computed from it stays finite.
GREATEST = 1e18


def find_file(folder: Path, name: str) -> Path:
    """The file of this name in a folder, or its gzipped version.

    Raises:
        DatasetError: there is neither.
    """
    for path in (folder / name, folder / f"{name}.gz"):
        if path.is_file():
            return path
    raise DatasetError(f"{folder / name}: no such file, nor with .gz; put it there")


def read_text(path: Path) -> str:
    """The text of a file, unzipped where its name ends in .gz.

    Raises:
        DatasetError: the file cannot be read, or is too long.
    """
    try:
        most = min(_LONGEST, max(_ANY, _ZIPPED * path.stat().st_size))
        data = read_bytes(path, most + 1)
        if len(data) > most:
            raise DatasetError(f"{path}: more than {most / 2**20:.0f} MiB of text; is it what its name says?")
        return data.decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file; is it what its name says?") from error
    except gzip.BadGzipFile as error:
        raise DatasetError(f"{path}: not a whole gzip file; copy it again") from error
    except OSError as error:
        raise DatasetError(f"{path}: {(error.strerror or str(error)).lower()}") from error


def read_table(path: Path, columns: tuple[str, ...]) -> FloatArray:
    """Finite numbers (n, len(columns)) separated by white space; lines that are empty or begin with '#' are skipped.

    Raises:
        DatasetError: the file cannot be read, or a line of it is broken.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != len(columns):
            raise DatasetError(
                f"{path}, line {number}: {len(columns)} numbers expected ({', '.join(columns)}), {len(words)} found;"
                " mend the line"
            )
        rows.append(parse_numbers(path, number, words))
    return np.array(rows).reshape(-1, len(columns))


def parse_numbers(path: Path, line: int, words: list[str]) -> list[float]:
    """The words of a line of a file as numbers.

    Raises:
        DatasetError: one of them is not a finite number below GREATEST.
    """
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not abs(number) < GREATEST:
            raise DatasetError(
                f"{path}, line {line}: {word[:40]!r} is not a finite number below {GREATEST:g}; mend the line"
            )
        numbers.append(number)
    return numbers

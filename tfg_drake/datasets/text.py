"""Tables of numbers in text files, plain or gzipped, with complaints that name file and line."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.messages import FloatArray


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
        DatasetError: the file cannot be read.
    """
    try:
        data = path.read_bytes()
        return (gzip.decompress(data) if path.suffix == ".gz" else data).decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file; is it what its name says?") from error
    except (gzip.BadGzipFile, EOFError) as error:
        raise DatasetError(f"{path}: not a whole gzip file; copy it again") from error
    except OSError as error:
        raise DatasetError(f"{path}: {(error.strerror or str(error)).lower()}") from error


def read_table(path: Path, columns: tuple[str, ...]) -> FloatArray:
    """Finite numbers (n, len(columns)) separated by white space; lines that are empty or begin with '#' are skipped.

    Raises:
        DatasetError: the file cannot be read, or a line of it is broken.
    """
    rows = [
        (number, line.split())
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    for number, words in rows:
        if len(words) != len(columns):
            raise DatasetError(
                f"{path}, line {number}: {len(columns)} numbers expected ({', '.join(columns)}), {len(words)} found;"
                " mend the line"
            )
    try:
        table = np.array([words for _, words in rows], dtype=float).reshape(-1, len(columns))
    except ValueError:
        table = None
    if table is None or not np.isfinite(table).all():
        number, word = next((n, word) for n, words in rows for word in words if not is_finite_number(word))
        raise DatasetError(f"{path}, line {number}: {word!r} is not a finite number; mend the line")
    return table


def is_finite_number(word: str) -> bool:
    """Whether a word is a finite number."""
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False

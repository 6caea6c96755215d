"""Text files, plain or packed, and their rows as they come, mended where what is meant is plain; what was mended is
counted and told. Complaints name file and line.

Read as they are: other line ends, blank lines, a heading with or without '#', columns in the order that it names, words
parted by white space, commas or semicolons, rows out of order, rows that are there twice, and a last row that was cut
off. A row that is wrong in any other way is refused by its reader.
"""

from __future__ import annotations

import bisect
import re
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.io.files import read_bytes
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.notes import Note

# Greatest length of a text, bytes; a log of 300 000 scans of 180 rays has 300 MB.
_LONGEST = 512 * 2**20
# Greatest compression: gzip shrinks tables of numbers by ten, so a text shrunk by more than _ZIPPED is none, unless it
# has less than _ANY bytes.
_ZIPPED = 100
_ANY = 2**20
# Greatest number: no measurement exceeds it, nor the ns since 1970, and results stay finite.
GREATEST = 1e19
# Greatest number of lines of a heading without '#'.
HEADING = 4
# Number of last rows that show a file's decimals.
DECIMALS_OF = 20
# Other names of columns.
_NAMES = {
    "time": ("timestamp", "stamp", "t", "stamp_s", "time_s", "sec", "seconds"),
    "heading": ("yaw", "theta", "orientation"),
    **{axis: (f"t{axis}", f"p{axis}", f"p_{axis}", f"{axis}_m", f"pos_{axis}") for axis in "xyz"},
    **{f"q{axis}": (f"q_{axis}", f"quat_{axis}") for axis in "xyzw"},
}
_NAMED = {other: name for name, others in _NAMES.items() for other in others}
# Units that a heading may give; an angle in degrees has none of these.
_UNIT = re.compile(r"[\[(](s|sec|ms|us|ns|m|rad|-|)[\])]")
# What is left of a number that was cut off, and no number.
_CUT_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d*)?([eE][+-]?)?")

Row = TypeVar("Row")


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
        data = read_bytes(path, most + 1)
        if len(data) > most:
            raise DatasetError(f"{path}: more than {most / 2**20:.0f} MiB of text; is it what its name says?")
        return data.decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file; is it what its name says?") from error
    except OSError as error:
        packed = "bzip2" if path.suffix == ".bz2" else "gzip"  # says no number of an error
        told = f"not a whole {packed} file; copy it again" if error.errno is None else str(error.strerror).lower()
        raise DatasetError(f"{path}: {told}") from error


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
    wrong = next(word for word in words if not (_is_number(word) and abs(float(word)) < GREATEST))
    raise DatasetError(f"{path}, line {line}: {wrong[:40]!r} is not a finite number below {GREATEST:g}; mend the line")


class ShortRowError(DatasetError):
    """A row that ends too early: as the last of a file it was cut off."""


class Rows:
    """The rows of one file: `read`, then perhaps `in_order` and `once`, then `notes`."""

    def __init__(self, path: Path) -> None:
        """path: plain, or gzipped with a name in .gz.

        Raises:
            DatasetError: the file cannot be read.
        """
        self.path, self._comma = path, False
        self._separator: str | None = None  # between the words of a row; None: white space
        text = read_text(path).removeprefix("\ufeff")
        self._ended = text.endswith(("\n", "\r"))
        self._lines = text.splitlines()
        self._mended: list[str] = []
        both = text.count("\r\n")
        kinds = {"CRLF": both, "CR": text.count("\r") - both, "LF": text.count("\n") - both}
        found = [kind for kind, count in kinds.items() if count]
        if found and found != ["LF"]:
            self._mended.append(f"line ends {' and '.join(found)}, read as such")
        while self._lines and not self._lines[-1].strip():
            self._lines.pop()
        if blank := sum(not line.strip() for line in self._lines):
            self._mended.append(f"{_count(blank, 'blank line')} skipped")

    def first(self) -> tuple[int, list[str]]:
        """The number (from 1) and the words of the first line that is not blank; 0 and none of an empty file."""
        return next(self._split(), (0, []))

    def sniff(self) -> None:
        """Take the separator that the middle line has; decimal commas are read as points beside any other."""
        lines = [line for line in self._lines if line.strip()]
        line = lines[len(lines) // 2] if lines else ""
        self._comma = re.search(r"\d,\d", line) is not None and (";" in line or "\t" in line)
        self._separator = ";" if ";" in line else "," if "," in line and not self._comma else None
        if self._comma:
            self._mended.append("decimal commas read as points")

    def columns(self, *layouts: tuple[str, ...]) -> tuple[tuple[str, ...], list[int], int, int]:
        """The rows' layout, the index in a row of each of its columns, the number of words in a row, and
        the number of the last line of the heading, 0 without any.

        A heading tells if it names as many columns as the first row has; else the number of words does, or the first
        layout is taken.

        Raises:
            DatasetError: a heading names some columns of a layout and not all.
        """
        row: list[str] = []
        plain: list[int] = []
        named: list[tuple[int, list[str]]] = []
        for number, row in self._split():
            is_comment = row[0].startswith("#")
            if not is_comment and (len(plain) == HEADING or not is_heading(row, [len(one) for one in layouts])):
                break
            plain += [] if is_comment else [number]
            names = [name.lower() for name in self._words(_UNIT.sub("", self._lines[number - 1].lstrip("\t #")))]
            named.append((number, [_NAMED.get(name, name) for name in names]))
        told = f"{_count(len(plain), 'line')} of a heading without '#', skipped" if plain else ""
        layout = next((layout for layout in layouts if len(layout) == len(row)), layouts[0])
        at, width = list(range(len(layout))), len(layout)
        for number, names in named:
            nearest = min(layouts, key=lambda layout: len(set(layout) - set(names)))
            missing = [column for column in nearest if column not in names]
            if len(names) != len(row) or (missing and (number not in plain or len(missing) > len(nearest) - 2)):
                continue
            if missing:
                found = f"{', '.join(missing)} not among the columns {', '.join(names)}"
                raise DatasetError(f"{self.path}, line {number}: {found}; name them there")
            layout, at, width = nearest, [names.index(column) for column in nearest], len(row)
            told = f"columns read as {', '.join(names)}" if at != list(range(len(at))) else ""
        self._mended += [told] if told else []
        return layout, at, width, max(plain, default=0)

    def read(self, parse: Callable[[int, list[str]], Row | None], after: int = 0) -> list[Row]:
        """Results of parse on the number (from 1) and the words of every line; lines for which it is None are no row.

        parse: raises DatasetError where a row is broken, and ShortRowError where words are missing at its end. after:
        lines up to this number are left out. Blank lines and lines that begin with '#' are left out, too; so is the
        last row where it was cut off, unless it is the only one.

        Raises:
            DatasetError: by parse, of any other row.
        """
        rows: list[Row] = []
        ends: deque[str] = deque(maxlen=DECIMALS_OF)
        for number, words in self._split():
            if number <= after or words[0].startswith("#"):
                continue
            last = number == len(self._lines)
            try:
                row = parse(number, words)
            except DatasetError as error:
                if not rows or not last or not self._cut_off(error, words):
                    raise
                self._mended.append("the last row cut off, left out")
                break
            if row is None:
                continue
            if last and not self._ended and _lacks_decimals(words[-1], ends):
                self._mended.append("the last row cut off, left out")
                break
            rows.append(row)
            ends.append(words[-1])
        return rows

    def expect(self, number: int, words: list[str], width: int, expected: str, mend: str = "mend the line") -> None:
        """Raises DatasetError where a line has another number of words, ShortRowError where it has fewer."""
        if len(words) != width:
            kind = ShortRowError if len(words) < width else DatasetError
            raise kind(f"{self.path}, line {number}: {expected}, {len(words)} found; {mend}")

    def once(self, rows: Sequence[Row], key: Callable[[Row], object] = lambda row: row) -> list[Row]:
        """The rows without those that are, by their keys (hashable), there already."""
        found: dict[object, Row] = {}
        for row in rows:
            found.setdefault(key(row), row)
        kept = list(found.values())
        if twice := len(rows) - len(kept):
            self._mended.append(f"{_count(twice, 'row')} twice, left out")
        return kept

    def in_order(self, stamps: FloatArray) -> IntArray:
        """(n,) what puts stamps (n,) in order; those that are equal stay as they are."""
        if (np.diff(stamps) >= 0.0).all():
            return np.arange(len(stamps))
        self._mended.append(f"{_count(_out_of_order(stamps), 'row')} out of order, sorted")
        return np.argsort(stamps, kind="stable")

    @property
    def notes(self) -> tuple[Note, ...]:
        """A note of what was mended in the file, or none."""
        return (Note("file", None, f"{self.path.name}: {'; '.join(self._mended)}"),) if self._mended else ()

    def _split(self) -> Iterator[tuple[int, list[str]]]:
        for number, line in enumerate(self._lines, start=1):
            if line.strip():
                yield number, self._words(line)

    def _words(self, line: str) -> list[str]:
        line = line.replace(",", ".") if self._comma else line
        return [word.strip() for word in line.strip().split(self._separator)]

    def _cut_off(self, error: DatasetError, words: list[str]) -> bool:
        if isinstance(error, ShortRowError):
            return True
        return not self._ended and _CUT_NUMBER.fullmatch(words[-1]) is not None and not _is_number(words[-1])


def read_table(
    path: Path, *layouts: tuple[str, ...], timed: bool = True, names: Mapping[str, Mapping[str, int]] | None = None
) -> tuple[FloatArray, tuple[Note, ...]]:
    """Finite numbers (n, columns of a layout) and what was mended, a note or none.

    layouts: names of columns, of which the file has one set, see `Rows.columns`. timed: the first column is time, by
    whatever unit, and sorts the rows. names: by column, numbers for the words that stand in it.

    Raises:
        DatasetError: the file cannot be read, or a line of it is broken.
    """
    rows = Rows(path)
    rows.sniff()
    columns, at, width, after = rows.columns(*layouts)

    def parse(number: int, words: list[str]) -> tuple[float, ...]:
        rows.expect(number, words, width, f"{width} numbers expected ({', '.join(columns)})")
        for column, known in (names or {}).items():
            i = at[columns.index(column)]
            if words[i] not in known:
                complaint = f"{column} {words[i]!r} is not known, only {', '.join(known)}; mend the line"
                raise DatasetError(f"{path}, line {number}: {complaint}")
            words[i] = str(known[words[i]])
        return tuple(parse_numbers(path, number, [words[i] for i in at]))

    found = rows.read(parse, after)
    table = np.array(rows.once(found)).reshape(-1, len(columns))
    return (table[rows.in_order(table[:, 0])] if timed else table), rows.notes


def is_heading(words: list[str], columns: Collection[int]) -> bool:
    """True if the words of a line are names where numbers should be, as many as one of these."""
    numbers = [_is_number(word) for word in words]
    return not any(numbers) or (not numbers[0] and len(words) not in columns)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _lacks_decimals(word: str, others: Collection[str]) -> bool:
    """True if a file's last word has fewer decimals than the words that end the rows before, which all have as many."""
    decimals = {len(one.partition(".")[2]) for one in others}
    return len(others) > 2 and len(decimals) == 1 and len(word.partition(".")[2]) < decimals.pop()


def _out_of_order(stamps: FloatArray) -> int:
    """How few stamps of (n,) have to be moved until the others are in order."""
    ends: list[float] = []  # Of the runs in order of every length, the least last stamp.
    for stamp in stamps.tolist():
        at = bisect.bisect_right(ends, stamp)
        ends[at : at + 1] = [stamp]
    return len(stamps) - len(ends)

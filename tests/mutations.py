"""Bad files for parsers: a good one with bytes flipped, cut out, doubled, and numbers made extreme."""

import random
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

EXTREME = (
    b"0",
    b"-1",
    b"nan",
    b"-inf",
    b".inf",
    b"1e-300",
    b"1e300",
    b"1e17",
    b"99999",
    b"9" * 20,
    b"9" * 5000,
    b"0x" + b"f" * 5000,
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def mutations(good: bytes, count: int, seed: int) -> Iterator[bytes]:
    """So many bad versions of a file's contents, one to three changes each, the same for the same seed."""
    draw = random.Random(seed)
    for _ in range(count):
        data = good
        for _ in range(draw.randint(1, 3)):
            data = draw.choice((_flip, _cut, _double, _number, _number))(data, draw)
        yield data


def _flip(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    return data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]


def _cut(data: bytes, draw: random.Random) -> bytes:
    first = draw.randrange(len(data) + 1)
    return data[:first] + data[first + draw.choice((1, 10, len(data))) :]


def _double(data: bytes, draw: random.Random) -> bytes:
    first = draw.randrange(len(data) + 1)
    last = first + draw.choice((1, 10, 100))
    return data[:last] + data[first:last] * draw.choice((1, 1, 100)) + data[last:]


def _number(data: bytes, draw: random.Random) -> bytes:
    numbers = list(_NUMBER.finditer(data))
    if not numbers:
        return data
    one = draw.choice(numbers)
    return data[: one.start()] + draw.choice(EXTREME) + data[one.end() :]


def assert_refused_or_read(
    file: Path, load: Callable[[], object], error: type[Exception], count: int = 200, seed: int = 0
) -> None:
    """Every mutation of a good file is loaded, or refused by one line of the loader's own error.

    The file is good again after this.
    """
    good = file.read_bytes()
    load()
    complaints = []
    for data in mutations(good, count, seed):
        file.write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                load()
        except error as complaint:
            complaints.append(str(complaint))
        except Exception as other:
            pytest.fail(f"{file.name}: {other!r} of {data[:2000]!r}")
    file.write_bytes(good)
    assert len(complaints) > count // 20
    assert not [complaint for complaint in complaints if "\n" in complaint]

"""Folder of a command's results and log: one command at a time, and what cannot be written ends no mission."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import sys
import tempfile
import time
import typing
from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path

from tfg_drake.io.files import open_inside

# What a run leaves in its folder; sweep.json and what belongs to it is a comparison's, which goes on where it ended.
RESULTS: tuple[str, ...] = (
    "log.txt",
    "stages.jsonl",
    "ports.mcap",
    "timeline.tfg",
    "mission.html",
    "map.npz",
    "grid.npz",
    "summary.json",
    "figure.png",
    "solved.g2o",
    "checkpoint.bin",
    "known_map.npz",
)
RESULTS += ("trajectory.tum", "truth.tum", "online.tum")
# Kept free for the last map and the summary of a disk that is full, bytes: the files that a run writes at its end take
# 2 MB after ten minutes, 10 MB after an hour.
RESERVE = 16 * 2**20

_log = logging.getLogger("tfg_drake.run_folder")


def make_run_folder(out: Path | None, name: str) -> Path:
    """The folder `out`, made if missing; by default runs/<time>-<name>, numbered where that is taken.

    Raises OSError where it cannot be made.
    """
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        return out
    stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    for suffix in ("", *(f"-{i}" for i in range(2, 1000))):
        folder = Path("runs") / (stem + suffix)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
    raise FileExistsError(f"runs/{stem}: name another folder")


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Meanwhile nobody else writes a run into the folder; the kernel ends that with the program, however it ends.

    Raises BlockingIOError where somebody does.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = "another run is at work in it; wait for its end, or name another folder"
            raise BlockingIOError(errno.EWOULDBLOCK, problem, str(folder)) from None
        except OSError as error:  # Not every network's files know locks.
            _log.info("%s: cannot be locked: %s", folder, error.strerror)
        yield
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def open_run_folder(out: Path | None, name: str, *, goes_on: bool = False) -> Iterator[RunFolder]:
    """The folder of one run, see `make_run_folder`, for nobody else: without the results of an earlier run, or with
    those of the one that goes on.

    Raises:
        BlockingIOError: another run is at work in it.
        OSError: it cannot be written.
    """
    path = make_run_folder(out, name)
    with claimed(path):
        if not goes_on:
            if (path / "stages.jsonl").exists():  # Elsewhere it may be what somebody wrote.
                (path / "scenario.yaml").unlink(missing_ok=True)
            for file in RESULTS:
                (path / file).unlink(missing_ok=True)
        folder = RunFolder(path)
        try:
            yield folder
        finally:
            folder.give_up_reserve()


class RunFolder:
    """The folder of a run under way; see `open_run_folder`.

    path. unwritten: file names, and why they could not be written; what could be at last is not among them.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.unwritten: dict[str, str] = {}
        self._told: set[str] = set()
        self._waiting: dict[str, bytes] = {}
        self._reserve: int | None = None

    def keep_reserve(self) -> None:
        """Take RESERVE bytes of the disk, in a file that has no name and so is gone with the program."""
        try:
            self._reserve, name = tempfile.mkstemp(dir=self.path, prefix=".reserve.")
            os.unlink(name)
            os.posix_fallocate(self._reserve, 0, RESERVE)
        except OSError as error:
            self.give_up_reserve()
            _log.warning("%s: no room for a reserve: %s; the map may not fit at the end", self.path, error.strerror)

    def give_up_reserve(self) -> None:
        """Leave it to what is written from now on."""
        if self._reserve is not None:
            os.close(self._reserve)
            self._reserve = None

    def attempt(self, name: str, write: Callable[[Path], object]) -> None:
        """Calls `write` with the path of one of the files; where it cannot be written that is told once."""
        try:
            write(self.path / name)
        except OSError as error:
            self.lost(name, error)
        else:
            self.unwritten.pop(name, None)

    def append(self, name: str, text: str) -> None:
        """Puts a text at the end of a file, or keeps it for the next time where it cannot be written."""
        waiting = self._waiting[name] = self._waiting.get(name, b"") + text.encode()
        self.attempt(name, lambda path: _append(path, waiting))
        if name not in self.unwritten:
            self._waiting[name] = b""

    def lost(self, name: str, error: OSError) -> None:
        """Take note of a file that cannot be written."""
        self.unwritten[name] = error.strerror or str(error)
        if name not in self._told:
            self._told.add(name)
            _log.error("%s: cannot be written: %s; the mission goes on", self.path / name, self.unwritten[name])

    @contextlib.contextmanager
    def logging(self) -> Iterator[None]:
        """Logs the program's remarks to log.txt meanwhile. Raises OSError if it cannot be opened."""
        handler = _LogFile(self)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logger = logging.getLogger("tfg_drake")
        level = logger.level
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        try:
            yield
        finally:
            logger.setLevel(level)
            logger.removeHandler(handler)
            handler.close()


class _LogFile(logging.FileHandler):
    """A log that may be cut short, as by a full disk."""

    def __init__(self, folder: RunFolder) -> None:
        super().__init__(folder.path / "log.txt", mode="a", encoding="utf-8")
        self._folder = folder

    def _open(self) -> TextIOWrapper:
        return typing.cast(TextIOWrapper, open_inside(Path(self.baseFilename), "a", encoding="utf-8"))

    def handleError(self, record: logging.LogRecord) -> None:
        error = sys.exc_info()[1]
        if isinstance(error, OSError):
            self._folder.lost("log.txt", error)
        else:
            super().handleError(record)

    def close(self) -> None:
        try:
            super().close()
        except OSError as error:
            self._folder.lost("log.txt", error)


def _append(path: Path, data: bytes) -> None:
    """All of it or nothing, so that a file of lines has no half one."""
    with open_inside(path, "ab", buffering=0) as file:
        size = file.tell()
        try:
            while data:
                data = data[file.write(data) :]
        except OSError:
            file.truncate(size)
            raise

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
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tfg_drake.bad_input import BadInput
from tfg_drake.config import ROBOTS
from tfg_drake.io.files import open_inside

# Files that a run leaves in its folder; task.json is that of a comparison, which continues where it ended.
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
# Disk space reserved for the last map and the summary, bytes; the files written at a run's end take 2 MB after ten
# minutes, 10 MB after an hour.
RESERVE = 16 * 2**20

# Loggers whose remarks are shown to the operator at once.
REMARKING = (
    "hardware",
    "notes",
    "operator",
    "pace",
    "storage",
    "run_folder",
    "slam.sensors",
    "visualizer",
    "world",
)

_log = logging.getLogger("tfg_drake.run_folder")


def run_name(scenario: str, world: Path | None, robot: str = "sim") -> str:
    """Name of a run: its robot, its world or its scenario."""
    if robot != "sim":
        return robot.partition(":")[0]
    return Path(scenario).stem if world is None else world.stem.removesuffix(".vectormap")


def check_kept(out: Path, replayed: Path | None = None, inputs: Sequence[Path] = ()) -> None:
    """Raises BadInput where a run in the folder would be lost that nothing brings back, or what somebody wrote: one of
    the files that are read has the name of the scenario that a run leaves, and is none."""
    from tfg_drake.storage.port_recording import recorded_robot

    for file in inputs:
        if file.resolve() == (out / "scenario.yaml").resolve() and not (out / "stages.jsonl").exists():
            raise BadInput(f"--out {out}: its scenario.yaml, which is read, would be written over; name another folder")
    if replayed is not None and out.resolve() == replayed.resolve():
        raise BadInput(f"--out {out}: holds the run that is replayed; name another folder")
    robot = recorded_robot(out)
    if robot in ROBOTS:
        raise BadInput(f"--out {out}: holds the run of a real robot ({robot}), which nothing brings back; name another")


def remarks_on_screen(screen: typing.TextIO | None = None) -> contextlib.AbstractContextManager[None]:
    """Shows the remarks of base, operator, Meshcat's picture and the run's files on a screen, by default standard
    output, meanwhile."""
    names = (f"tfg_drake.{name}" for name in REMARKING)
    return _heard(logging.StreamHandler(screen or sys.stdout), "%(message)s", *names)


@contextlib.contextmanager
def _heard(handler: logging.Handler, form: str, *names: str) -> Iterator[None]:
    """Meanwhile what the loggers of these names say goes to a handler, too."""
    handler.setFormatter(logging.Formatter(form))
    loggers = [logging.getLogger(name) for name in names]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


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
        except OSError as error:  # Some network file systems have no locks.
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
            if (path / "stages.jsonl").exists():  # Otherwise scenario.yaml may be a user's own.
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
        _append(self.path / "log.txt", b"")
        logger = logging.getLogger("tfg_drake")
        level = logger.level
        with _heard(_LogFile(self), "%(asctime)s %(levelname)s %(name)s: %(message)s", logger.name):
            logger.setLevel(logging.INFO)
            try:
                yield
            finally:
                logger.setLevel(level)


class _LogFile(logging.Handler):
    """Appends to log.txt, which may be cut short, as by a full disk."""

    def __init__(self, folder: RunFolder) -> None:
        super().__init__()
        self._folder = folder

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._folder.append("log.txt", f"{self.format(record)}\n")
        except Exception:
            self.handleError(record)


def _append(path: Path, data: bytes) -> None:
    """All of it or nothing, so that a file of lines has no half one."""
    with open_inside(path, "ab", buffering=0) as file:
        size = file.tell()
        try:
            while data:
                data = data[file.write(data) :]
        except OSError:
            with contextlib.suppress(OSError):
                file.truncate(size)
            raise

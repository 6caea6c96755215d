"""The compiled kernels, made ready before anything waits for them.

numba compiles a kernel where it is first called, and keeps it in a cache. All of them take most of a minute and several
hundred megabytes. So processes of their own do it, in the installation or beside a program that starts without them:

    python -m tfg_drake.kernels       compile what is missing

kernels.txt names every kernel and the types that it is called with; tests/test_kernels.py fails where it lacks one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import fcntl
import functools
import hashlib
import importlib
import json
import math
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

from tfg_drake.io.files import write_atomic

PACKAGE = Path(__file__).parent
TABLE = PACKAGE / "kernels.txt"
# What needs a kernel: the first look of a mission, the rest of a mission in a shipped scenario, or something else only.
LOOK, MISSION, OTHER = range(3)
_NEEDS = ("look", "mission", "other")
# A process keeps what it has compiled for good. Beside a program that does something else it is replaced when it holds
# so much, MB; likewise, later, where the program only waits.
BESIDE, ALONE = 230.0, 400.0
# What the table's kernels are to the processes that compile, a byte each.
_WAITING, _TAKEN, _DONE = b".", b"o", b"x"
# What is known of a cache: what compiled it, of what sources, for what need, and its files.
_RECEIPT = "tfg_drake-kernels.json"
_LOCK = "tfg_drake-kernels.lock"
_NOTHING: dict[str, Any] = {"environment": None, "sources": {}, "compiled": -1, "cached": []}
_IMPORT = re.compile(r"^from (tfg_drake[\w.]*) import (\([^)]*\)|.*)$", re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A kernel, the types of its arguments as `spelled` has them, and what needs it first: LOOK, MISSION or OTHER."""

    module: str
    name: str
    types: str
    need: int

    def compile(self) -> None:
        """Compile it into numba's cache, unless it is there. Raises what importing it or numba raises."""
        module = importlib.import_module(self.module)
        getattr(module, self.name).compile(_types(self.types, module))


def read_table(need: int = OTHER) -> list[Kernel]:
    """All kernels that something needs, those that are needed first before the others."""
    kernels = []
    for line in TABLE.read_text().splitlines():
        word, path, types = line.split(maxsplit=2)
        module, _, name = path.rpartition(".")
        kernels.append(Kernel(module, name, types, _NEEDS.index(word)))
    # Of each need those with the most to them before the others, so that nobody begins with a large one at the end.
    return sorted((one for one in kernels if one.need <= need), key=lambda kernel: (kernel.need, -len(kernel.types)))


def write_table(kernels: Iterable[Kernel]) -> None:
    """Make these the table. Raises OSError."""
    lines = (f"{_NEEDS[one.need]} {one.module}.{one.name} {one.types}\n" for one in kernels)
    write_atomic(TABLE, "".join(sorted(lines)))


def spelled(kind: Any) -> str:
    """A numba type in a form that Python reads: float64[:, ::1], readonly(int64[::1]), omitted(0.5), Name(float64)."""
    types = importlib.import_module("numba").types
    if isinstance(kind, types.Array):
        axes = [":"] * kind.ndim
        if kind.layout in "CF":
            axes[-1 if kind.layout == "C" else 0] = "::1"
        array = f"{spelled(kind.dtype)}[{', '.join(axes)}]"
        return array if kind.mutable else f"readonly({array})"
    if isinstance(kind, types.Omitted):
        return f"omitted({kind.value!r})"
    if isinstance(kind, types.BaseTuple):
        of = getattr(kind, "instance_class", tuple)
        return f"{'tuple_' if of is tuple else of.__name__}({', '.join(map(spelled, kind))})"
    return "boolean" if kind == types.boolean else str(kind)


def _types(text: str, module: Any) -> tuple[Any, ...]:
    """What `spelled` has spelled; named tuples are those that a module knows."""
    types = importlib.import_module("numba").types
    made = types.BaseTuple.from_types
    tuples = {
        name: lambda *kinds, of=value: made(kinds, of)
        for name, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, tuple)
    }
    words = {
        "readonly": lambda array: array.copy(readonly=True),
        "omitted": types.Omitted,
        "tuple_": lambda *kinds: made(kinds),
    }
    return tuple(eval(f"({text},)", {**vars(types), **tuples, **words}))


# What is compiled


def choose_folder() -> None:
    """Where this package's folder cannot be written, the user's cache or a temporary folder keeps what is compiled: to
    be called before numba is imported.

    Raises:
        OSError: no folder can be written.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if not given and os.access(PACKAGE, os.W_OK):
        return
    # Without a home this is no absolute path, and one of a folder that happens to be here would be a surprise.
    cache = Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache")) / "tfg_drake"
    own = Path(tempfile.gettempdir()) / f"tfg_drake-{os.getuid()}"
    for tried in [Path(given)] if given else [cache, own] if cache.is_absolute() else [own]:
        with contextlib.suppress(OSError):
            tried.mkdir(mode=0o700, parents=True, exist_ok=True)
            # What is in it is run: in a folder for everybody's files it must be nobody else's.
            if tried == own and tried.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=tried):
                os.environ["NUMBA_CACHE_DIR"] = str(tried)
                return
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), given or str(own))


def folder() -> Path:
    """Where what is compiled is kept; of numba's many folders the uppermost."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    return Path(given) if given else PACKAGE / "__pycache__"


def are_compiled(need: int = OTHER) -> bool:
    """Whether the kernels are in the cache, of the sources and for the machine that there are now. Imports nothing."""
    there = _receipt()
    return (
        there["compiled"] >= need
        and there["environment"] == _environment()
        and there["sources"] == {name: _stamp(path) for name, path in _all_sources().items()}
        and set(there["cached"]) <= {str(path) for module in _modules() for path in _cached(module)}
    )


def drop_stale() -> None:
    """Forget what was compiled of sources that have changed since, and take note of those that there are now.

    numba looks at the file that a kernel is in, and not at those of the kernels that it calls, which are part of it.
    """
    before, environment = _receipt(), _environment()
    now = {name: _stamp(path) for name, path in _all_sources().items()}
    for module in _modules():
        known = before["environment"] == environment
        if not known or any(before["sources"].get(name) != now[name] for name in _sources(module)):
            for path in _cached(module):
                path.unlink(missing_ok=True)
    _write_receipt({**_NOTHING, "environment": environment, "sources": now})


def _receipt() -> dict[str, Any]:
    try:
        read: dict[str, Any] = json.loads((folder() / _RECEIPT).read_text())
    except (OSError, ValueError):
        return _NOTHING
    return read


def _write_receipt(receipt: dict[str, Any]) -> None:
    folder().mkdir(parents=True, exist_ok=True)
    write_atomic(folder() / _RECEIPT, json.dumps(receipt), durable=False)


def _environment() -> str:
    """What compiles, and for what processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.machine()]
    processor = sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}) or lines
    words = [sys.version, *(version(name) for name in ("numba", "llvmlite", "numpy")), *processor]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _stamp(path: Path) -> list[int]:
    status = path.stat()
    return [status.st_mtime_ns, status.st_size]


@functools.cache
def _modules() -> tuple[str, ...]:
    return tuple(sorted({kernel.module for kernel in read_table()}))


def _all_sources() -> dict[str, Path]:
    """The files that the kernels are made of, by module."""
    return {name: _path(name) for module in _modules() for name in _sources(module)}


@functools.cache
def _sources(module: str) -> frozenset[str]:
    """The modules that what is compiled of one is made of: itself, those that it imports and, where these have kernels
    too, theirs."""
    found, left = {module}, [module]
    while left:
        text = _path(left.pop()).read_text(encoding="utf-8")
        if "njit" not in text:
            continue
        for package, names in _IMPORT.findall(text):
            for name in (package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))):
                if name not in found and _path(name).is_file():
                    found.add(name)
                    left.append(name)
    return frozenset(found)


def _path(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


def _cached(module: str) -> list[Path]:
    """What numba has kept of a module."""
    source = _path(module)
    name = f"{source.stem}.*.nb[ic]"
    if folder() == PACKAGE / "__pycache__":
        return sorted((source.parent / "__pycache__").glob(name))
    return sorted(folder().glob(f"{source.parent.name}_*/{name}"))


# Who compiles


class Compilation:
    """Processes that compile what is missing while this one does something else; to be closed."""

    def __init__(self, need: int = OTHER, most: float | None = None) -> None:
        """need: what the kernels are for. most: MB that a process may hold; then there are two until the kernels of the
        first look are there, one afterwards. Without it there are two to the end.

        Raises:
            ChildProcessError: no process can be started.
            OSError: the cache cannot be written.
        """
        drop_stale()
        self._need, self._since = need, time.monotonic()
        self.of, self._look = len(read_table(need)), len(read_table(LOOK))
        self._folder = tempfile.TemporaryDirectory(prefix="tfg_drake-")
        self._board = Path(self._folder.name) / "board"
        self._board.write_bytes(_WAITING * self.of)
        rows = [self.of, self.of if most is None else self._look]
        self._processes = [_start(self._board, last, most or math.inf) for last in rows]

    @property
    def done(self) -> int:
        """How many kernels are there."""
        return self._board.read_bytes().count(_DONE)

    @property
    def word(self) -> str:
        """What is done, in words; "" where nothing is any more."""
        return "" if self.ended else f"compiling kernels, {self.done} of {self.of}"

    @property
    def left(self) -> float:
        """How long it will take at the speed so far, s; inf where nothing is known of that."""
        done = self.done
        return (time.monotonic() - self._since) * (self.of - done) / done if done else math.inf

    @property
    def ready(self) -> bool:
        """Whether all are there that the first look of a mission needs, or nobody compiles them any more."""
        return self._board.read_bytes()[: self._look].count(_DONE) == self._look or self.ended

    @property
    def ended(self) -> bool:
        """Whether all are there, or nobody compiles the others any more."""
        return all(process.poll() is not None for process in self._processes)

    def close(self) -> None:
        """Ends what is still at work; takes note that all kernels are there, if they are."""
        for process in self._processes:
            process.terminate()
            process.wait()
        if self.done == self.of:
            cached = [str(path) for module in _modules() for path in _cached(module)]
            with contextlib.suppress(OSError):
                _write_receipt({**_receipt(), "compiled": self._need, "cached": cached})
        self._folder.cleanup()


def _start(board: Path, last: int, most: float) -> subprocess.Popen[bytes]:
    """A process that compiles those of the table's first `last` kernels that nobody else does. Ctrl-C passes it by.

    Raises ChildProcessError where it cannot be started.
    """
    nothing, command = subprocess.DEVNULL, _command(board, last, most)
    try:
        return subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, process_group=0)
    except OSError as error:
        raise ChildProcessError(error.errno, error.strerror, command[0]) from error


def _command(board: Path, last: int, most: float) -> list[str]:
    return [sys.executable, "-m", "tfg_drake.kernels", str(board), str(last), str(most)]


def _work(path: Path, last: int, most: float) -> None:
    """What such a process does, until the one that started it is gone."""
    parent = os.getppid()
    kernels = read_table()
    with path.open("r+b", buffering=0) as board:
        take_turns()
        while os.getppid() == parent:
            with _alone(board):
                row = os.pread(board.fileno(), last, 0).find(_WAITING)
                if row < 0:
                    return
                os.pwrite(board.fileno(), _TAKEN, row)
            with contextlib.suppress(Exception):  # Whoever calls it will hear of it.
                kernels[row].compile()
            os.pwrite(board.fileno(), _DONE, row)
            if _memory() > most:
                command = _command(path, last, most)
                os.execv(command[0], command)


@contextlib.contextmanager
def _alone(file: BinaryIO) -> Iterator[None]:
    """No other process is within such a block for the same file at the same time."""
    fcntl.lockf(file, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.lockf(file, fcntl.LOCK_UN)


def take_turns() -> None:
    """From now on this process changes the cache only while no other one does that has called this.

    numba reads, changes and writes the list of what is kept of a kernel as if it were alone.
    """
    folder().mkdir(parents=True, exist_ok=True)
    lock = (folder() / _LOCK).open("ab")
    file: Any = importlib.import_module("numba.core.caching").IndexDataCacheFile
    save = file.save

    def save_alone(self: Any, key: Any, data: Any) -> None:
        with _alone(lock):
            save(self, key, data)

    file.save = save_alone


def _memory() -> float:
    """What this process holds, MB; 0 where that cannot be known."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(arguments: Sequence[str]) -> None:
    """Compile what is missing, with a line every other second."""
    if arguments:
        _work(Path(arguments[0]), int(arguments[1]), float(arguments[2]))
        return
    choose_folder()
    if are_compiled():
        return
    with contextlib.closing(Compilation()) as compilation:
        while not compilation.ended:
            print(compilation.word, flush=True)
            time.sleep(2.0)


if __name__ == "__main__":
    main(sys.argv[1:])

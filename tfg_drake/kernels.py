"""Cache of numba's compiled kernels, and the sources of each.

numba's own locators look at the time of the file that a kernel is in, and not at the files of the kernels and constants
that it takes from elsewhere. `KernelLocator` stands in front of them (NUMBA_CACHE_LOCATOR_CLASSES): a kernel's stamp is
the contents of its file and of all that this one imports of the package. So numba itself compiles after an edit what
the edit concerns, and nothing else. Nothing is locked: of two processes that keep a kernel at the same instant one may
lose its entry, which is then compiled once more.

This module imports neither numba nor anything else that takes long.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import importlib
import os
import platform
import re
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tfg_drake.io.files import write_atomic

PACKAGE = Path(__file__).parent
_LOCATORS = "NUMBA_CACHE_LOCATOR_CLASSES"
_NUMBAS = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
# Of LLVM: at 3 they take a fifth longer to compile, and missions as long.
LEVEL = 1
_version = functools.cache(version)
_IMPORT = re.compile(r"^from (tfg_drake[\w.]*) import (\([^)]*\)|.*)$", re.MULTILINE)


class KernelLocator:
    """Tells numba of a kernel of this package where it is kept and what it is compiled of."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file, self._line = py_file, py_func.__code__.co_firstlineno
        self._path = folder() / Path(py_file).parent.name

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> KernelLocator | None:
        """The locator of a function; None, and numba asks the next, if it is not of this package."""
        if not Path(py_file).is_relative_to(PACKAGE):
            return None
        _let_modules_go()
        _set_level()
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._path)

    def ensure_cache_path(self) -> None:
        """Makes the folder."""
        self._path.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Digest that a compiled kernel must match to be used."""
        return stamp([Path(self._py_file)])

    def get_disambiguator(self) -> str:
        """Tells functions of one name in a file apart."""
        return str(self._line)


@functools.cache
def _let_modules_go() -> None:
    """From now on numba closes the LLVM module of each kernel that it has loaded, 0.6 MB, and parses it again only
    where one is compiled that calls it. A numba whose private names are others keeps them all."""
    import llvmlite.binding as llvm
    from numba.core import codegen

    library: Any = getattr(codegen, "CPUCodeLibrary", None)
    load, module_of = getattr(library, "_unserialize", None), getattr(library, "_get_module_for_linking", None)
    if load is None or module_of is None:
        return

    def unserialize(_library: Any, target: Any, state: Any) -> Any:
        loaded = load(target, state)
        module = getattr(loaded, "_shared_module", None)
        if module is not None and state[1] == "object":
            module.close()
            loaded._shared_module, loaded.bitcode = None, state[2][1]
        return loaded

    def get_module_for_linking(loaded: Any) -> Any:
        if bitcode := loaded.__dict__.pop("bitcode", None):
            loaded._shared_module = llvm.parse_bitcode(bitcode)
        return module_of(loaded)

    library._unserialize, library._get_module_for_linking = classmethod(unserialize), get_module_for_linking


@functools.cache
def _set_level() -> None:
    """From now on LLVM optimises the kernels of this package at LEVEL, and others as it did."""
    config: Any = importlib.import_module("numba.core.config")
    event: Any = importlib.import_module("numba.core.event")
    outside: list[Any] = []

    class Level(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            outside.append(config.OPT)
            if event.data["dispatcher"].py_func.__module__.startswith(f"{__package__}."):
                config.OPT = type(config.OPT)(LEVEL)

        def on_end(self, event: Any) -> None:
            config.OPT = outside.pop()

    event.register("numba:compile", Level())


def use_locator() -> None:
    """From now on numba asks `KernelLocator` first, in this process and those that it starts."""
    given = os.environ.get(_LOCATORS) or _NUMBAS
    own = f"{__name__}.{KernelLocator.__name__}"
    os.environ[_LOCATORS] = given if own in given else f"{own},{given}"
    if "numba" in sys.modules:  # It has read its environment already.
        sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ[_LOCATORS]


def folder() -> Path:
    """Folder of compiled kernels: NUMBA_CACHE_DIR, else in the package, where that cannot be written in the
    user's cache or a temporary folder.

    Raises:
        PermissionError: no folder can be written.
    """
    return _folder(os.environ.get("NUMBA_CACHE_DIR", ""))


@functools.cache
def _folder(given: str) -> Path:
    if not given and os.access(PACKAGE, os.W_OK):
        return PACKAGE / "__pycache__" / "kernels"
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
                # Of this installation; another one's kernels are of other sources.
                return tried / f"kernels-{_digest(str(PACKAGE))[:8]}"
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), given or str(own))


def kernel_files() -> list[Path]:
    """The files with kernels."""
    return [path for path in sorted(PACKAGE.glob("*/*.py")) if "\n@njit" in path.read_text(encoding="utf-8")]


def sources(path: Path) -> set[Path]:
    """A file of the package and all files of the package that it imports, at any remove."""
    found, left = {path}, [path]
    while left:
        new = _read(left.pop())[1] - found
        found |= new
        left += new
    return found


def stamp(paths: list[Path]) -> str:
    """Digest of some files, what they import, and numpy's version."""
    files = sorted(set().union(*map(sources, paths)))
    contents = (f"{path.relative_to(PACKAGE)} {_read(path)[0]}" for path in files)
    return _digest("\n".join([_version("numpy"), str(LEVEL), *contents]))


@functools.cache
def _read(path: Path) -> tuple[str, frozenset[Path]]:
    """A file's digest and the files of the package that it imports."""
    text = path.read_text(encoding="utf-8")
    modules = [
        module
        for package, names in _IMPORT.findall(text)
        for module in (package, *(f"{package}.{name}" for name in re.findall(r"\w+", names)))
    ]
    files = (PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py") for module in modules)
    return _digest(text), frozenset(filter(Path.is_file, files))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def are_compiled() -> bool:
    """True if a mission's kernels have been compiled here, of these sources and for this machine."""
    with contextlib.suppress(OSError):
        return (folder() / "compiled").read_text() == _whole()
    return False


def note_compiled() -> None:
    """That they have been. Raises OSError."""
    folder().mkdir(parents=True, exist_ok=True)
    write_atomic(folder() / "compiled", _whole(), durable=False)


def _whole() -> str:
    """All sources, what compiles them, and for what processor."""
    lines = [platform.machine()]
    with contextlib.suppress(OSError):
        lines += Path("/proc/cpuinfo").read_text().splitlines()
    processor = {line for line in lines if line.startswith(("model name", "flags", "Features"))} or lines[:1]
    words = [sys.version, _version("numba"), _version("llvmlite"), stamp(kernel_files()), *sorted(processor)]
    return _digest("\n".join(words))

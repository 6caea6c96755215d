"""Cache of numba's compiled kernels, and the sources of each.

numba's own locators look at the time of the file that a kernel is in, and not at the kernels and constants that it
takes from elsewhere. `KernelLocator` stands in front of them (NUMBA_CACHE_LOCATOR_CLASSES): a kernel's stamp is its
text and that of every statement of the package whose name stands in it, or in one of these. So numba itself compiles
after an edit what the edit concerns, and nothing else. Nothing is locked: of two processes that keep a kernel at the
same instant one may lose its entry, which is then compiled once more.

This module imports neither numba nor anything else that takes long.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
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
_version = functools.cache(version)
_IMPORT = re.compile(r"^ *from (tfg_drake[\w.]*) import (\([^)]*\)|.*)$", re.MULTILINE)
# Where the statements of a module begin, and decorators; the names that one defines; docstrings and comments.
_STATEMENT = re.compile(r"^(?=[^\s)\]}])", re.MULTILINE)
_NAMES = re.compile(r"^(?:(?:def|class) (\w+)|(\w+(?:, \w+)*)(?:: .+)? = )", re.MULTILINE)
_SILENT = re.compile(r'"""(?s:.*?)"""|#.*')
# A name in a file.
Place = tuple[Path, str]


class KernelLocator:
    """Tells numba of a kernel of this package where it is kept and what it is compiled of."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._place = Path(py_file), py_func.__name__
        self._path = folder() / Path(py_file).parent.name

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> KernelLocator | None:
        """The locator of a function; None, and numba asks the next, if it is not of this package."""
        if not Path(py_file).is_relative_to(PACKAGE):
            return None
        _let_modules_go()
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._path)

    def ensure_cache_path(self) -> None:
        """Makes the folder."""
        self._path.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Digest that a compiled kernel must match to be used."""
        return stamp([self._place])

    def get_disambiguator(self) -> str:
        """Tells functions of one name in a file apart: there are none."""
        return ""


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
            # Its files are executed, so in a shared folder it must belong to this user.
            if tried == own and tried.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=tried):
                # Kernels of this installation only, as another one has other sources.
                return tried / f"kernels-{_digest(str(PACKAGE))[:8]}"
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), given or str(own))


def all_kernels() -> list[Place]:
    """The kernels of the package."""
    files = [path for path in sorted(PACKAGE.glob("*/*.py")) if "\n@njit" in path.read_text(encoding="utf-8")]
    return [(path, name) for path in files for name, text in _read(path)[0].items() if "@njit" in text]


def sources(places: list[Place]) -> dict[Place, str]:
    """The statements of these names, and those of all names of the package that stand in them, at any remove."""
    found: dict[Place, str] = {}
    left, seen = list(places), set(places)
    while left:
        place = left.pop()
        text, asked = _statement(place)
        if text is not None:
            found[place] = text
        left += asked - seen
        seen |= asked
    return found


@functools.cache
def _statement(place: Place) -> tuple[str | None, set[Place]]:
    """The statement of a name, none where another file has it, and the names of the package that stand in it."""
    path, name = place
    named, imported = _read(path)
    if name in imported:
        return None, {imported[name]}
    words = set(re.findall(r"\w+", named.get(name, "")))
    modules = [imported[word][0] for word in words if word in imported and not imported[word][1]]
    asked = {(file, word) for file in (path, *modules) for word in words if any(word in one for one in _read(file))}
    return named.get(name, ""), asked


def stamp(places: list[Place]) -> str:
    """Digest of what some kernels are made of, and numpy's version."""
    texts = sorted(f"{path.relative_to(PACKAGE)} {name} {text}" for (path, name), text in sources(places).items())
    return _digest("\n".join([_version("numpy"), *texts]))


@functools.cache
def _read(path: Path) -> tuple[dict[str, str], dict[str, Place]]:
    """The statements of a file by the names that they define, without comments, and where in the package its other
    names are from; that of a module is "" there."""
    lines = _SILENT.sub("", path.read_text(encoding="utf-8")).splitlines()
    text = "\n".join(line.rstrip() for line in lines if line.strip())
    named: dict[str, str] = {}
    imported: dict[str, Place] = {}
    decorators = ""
    for statement in _STATEMENT.split(text):
        decorators += statement
        if statement.startswith("@"):
            continue
        if found := _NAMES.search(decorators):
            named |= {name: named.get(name, "") + decorators for name in (found[1] or found[2]).split(", ")}
        decorators = ""
    for module, names in _IMPORT.findall(text):
        folder = PACKAGE.joinpath(*module.split(".")[1:])
        for name, other in re.findall(r"(\w+)(?: as (\w+))?", names):
            for place in ((folder / f"{name}.py", ""), (folder.with_suffix(".py"), name)):
                if place[0].is_file():
                    imported.setdefault(other or name, place)
    return named, imported


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
    words = [sys.version, _version("numba"), _version("llvmlite"), stamp(all_kernels()), *sorted(processor)]
    return _digest("\n".join(words))

"""Compiled kernels are kept where they can be, are never those of old sources, and are there when a mission begins."""

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tfg_drake import kernels
from tfg_drake.diagrams.compile_kernels import MODULE, listed, resolved

PACKAGE = Path(kernels.__file__).parent


def make_package(parent):
    """Another package of kernels: `caller` calls that of `called`, which takes a number of `number`."""
    folder = parent / "tfg_drake"
    for name in ("kernels.py", "bad_input.py", "io/files.py"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGE / name, folder / name)
    (folder / "__init__.py").write_text("from tfg_drake.kernels import use_locator\nuse_locator()\n")
    (folder / "part").mkdir()
    for name, text in (
        ("caller", "from tfg_drake.part.called import (\n    f,\n)\n@njit(cache=True)\ndef g(x):\n    return f(x)\n"),
        ("called", "from tfg_drake.part import number\nY = number.Y\n@njit(cache=True)\ndef f(x):\n    return x + Y\n"),
        ("number", "Y = 1\nZ = 3\n"),
        ("other", "@njit(cache=True)\ndef h(x):\n    return x\n"),
    ):
        (folder / "part" / f"{name}.py").write_text(f"from numba import njit\n{text}")
    return folder


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Such a package, as if it were ours."""
    folder = make_package(tmp_path)
    monkeypatch.setattr(kernels, "PACKAGE", folder)
    kernels._read.cache_clear()
    kernels._statement.cache_clear()
    yield folder
    kernels._read.cache_clear()
    kernels._statement.cache_clear()


def change(path, old, new):
    path.write_text(path.read_text().replace(old, new, 1))
    kernels._read.cache_clear()
    kernels._statement.cache_clear()


def called(package, first="", **environment):
    """What g(1) is in a process of its own, and how often it was compiled there."""
    program = f"{first}\nfrom tfg_drake.part.caller import g; print(g(1), sum(g.stats.cache_misses.values()))"
    # Python itself would keep the bytecode of a file that is as old and as long as before.
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    for name in ("NUMBA_CACHE_LOCATOR_CLASSES", *({"NUMBA_CACHE_DIR"} - environment.keys())):
        environment.pop(name, None)
    command = [sys.executable, "-c", program]
    said = subprocess.run(command, env=environment, cwd=package.parent, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    return tuple(map(int, said.stdout.split()))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Such a package, compiled: whoever has edited it leaves it compiled again."""
    folder = make_package(tmp_path_factory.mktemp("kept"))
    assert called(folder) == (2, 1)
    return folder


def test_a_kernel_is_compiled_anew_after_an_edit_of_what_it_calls(kept):
    # Of the same length, and as old.
    number = kept / "part" / "number.py"
    before = number.stat()
    change(number, "Y = 1", "Y = 5")
    os.utime(number, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert called(kept) == (6, 1)


LINKED = """
from tfg_drake.part.caller import g
kept = lambda: [o.library._shared_module is not None for o in g.overloads.values()]
g(1)
before = kept()
from numba import njit
assert njit(lambda x: g(x) + 1)(1) == g(1) + 1
assert (before, kept(), sum(g.stats.cache_misses.values())) == ([False], [True], 0)
"""


def test_a_loaded_kernel_is_parsed_again_where_another_calls_it(kept):
    called(kept, first=LINKED)


def test_another_numba_keeps_its_modules(kept):
    first = "import numba.core.codegen as c; c.CPUCodeLibrary, c.JITCodeLibrary.x = None, 1"
    assert called(kept, first=first)[1] == 0


def test_kernels_are_kept_where_numba_is_told(package):
    cache = package.parent / "cache"
    assert called(package, NUMBA_CACHE_DIR=str(cache)) == (2, 1)
    assert {path.name.split(".")[0] for path in cache.rglob("*.nbi")} == {"caller", "called"}


@pytest.mark.parametrize(
    ("changed", "old", "new", "stale"),
    [
        ("other", "return x", "return -x", {"h"}),
        ("caller", "return f(x)", "return f(-x)", {"g"}),
        ("called", "x + Y", "x - Y", {"f", "g"}),
        ("called", "Y = number.Y", "Y = number.Z", {"f", "g"}),
        ("number", "Y = 1", "Y = 2", {"f", "g"}),
        ("number", "Z = 3", "Z = 4", set()),
        ("called", "from numba", "import math\n\nTWO = 2\nfrom numba", set()),
        ("called", "return x", "# Of Z.\n    return x", set()),
        ("caller", "    f,\n", "    f,\n    Y,\n", set()),
    ],
)
def test_an_edit_concerns_the_kernels_that_are_made_of_it(package, changed, old, new, stale):
    places = {name: (path, name) for path, name in kernels.all_kernels()}
    assert places.keys() == {"f", "g", "h"}
    before = {name: kernels.stamp([place]) for name, place in places.items()}
    change(package / "part" / f"{changed}.py", old, new)
    assert {name for name, place in places.items() if kernels.stamp([place]) != before[name]} == stale


def test_whatever_a_kernel_names_is_among_its_sources():
    """Against the names that Python itself has compiled: else a kernel of old sources would be used."""
    for one in listed():
        function = resolved(one)[0].py_func
        sources = {name for _, name in kernels.sources([(Path(function.__code__.co_filename), function.__name__)])}
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            is_ours = getattr(value, "__module__", "").startswith("tfg_drake.") or isinstance(value, (int, float))
            if name in function.__globals__ and is_ours:
                assert name in sources, (one.module, one.name, name)


def test_a_kernel_that_has_moved_in_its_file_is_not_compiled_again(kept):
    change(kept / "part" / "called.py", "from numba", "\n\nfrom numba")
    assert called(kept, first="import numba")[1] == 0


def test_what_was_compiled_of_other_sources_is_not_all(package, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert not kernels.are_compiled()
    kernels.note_compiled()
    assert kernels.are_compiled()
    change(package / "part" / "number.py", "Y = 1", "Y = 2")
    assert not kernels.are_compiled()


@pytest.fixture
def no_folder(tmp_path, monkeypatch):
    """The package cannot be written, and no folder has been chosen yet."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)
    kernels._folder.cache_clear()
    yield
    kernels._folder.cache_clear()


def test_where_the_package_cannot_be_written_the_users_cache_is_used(tmp_path, no_folder):
    assert kernels.folder().parent == tmp_path / "cache" / "tfg_drake"


@pytest.mark.parametrize("lost", [{"HOME"}, {"HOME", "XDG_CACHE_HOME"}])
def test_without_a_home_a_temporary_folder_is_used(tmp_path, monkeypatch, no_folder, lost):
    """As for a user id that no file of passwords knows: os.path.expanduser leaves the ~ where it is."""
    for name in lost:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", {}.__getitem__)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    own = tmp_path / f"tfg_drake-{os.getuid()}"
    assert kernels.folder().parent == (own if "XDG_CACHE_HOME" in lost else tmp_path / "cache" / "tfg_drake")
    assert not (tmp_path / "~").exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.raises(OSError, match="Permission denied") as caught:
        kernels.folder()
    assert caught.value.filename == str(tmp_path / "file" / "cache")


COUNTED = """
from numba.core import event
compiled = []
event.register("numba:compile", type("", (event.Listener,), {
    "on_start": lambda self, e: compiled.append(e.data["dispatcher"].py_func.__module__), "on_end": lambda *_: None})())
import tfg_drake
print(tfg_drake.explore("house").outcome)
print(*{module for module in compiled if module.startswith("tfg_drake")})
"""


@pytest.mark.slow
def test_after_the_warm_up_a_mission_compiles_next_to_nothing(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", MODULE], env=environment, check=True, stdout=subprocess.DEVNULL)
    command = [sys.executable, "-c", COUNTED]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == "", "the warm-up was not complete"
    outcome, modules = done.stdout.split("\n")[:2]
    assert outcome == "complete"
    assert len(modules.split()) <= 3, modules

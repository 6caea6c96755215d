"""The table of kernels has what is called, and what is kept of old sources is not used."""

import contextlib
import importlib.util
import os
import pwd
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import types
from numba.core.dispatcher import Dispatcher

from tfg_drake import kernels
from tfg_drake.planning import exact_gain

REHEARSAL = Path(__file__).with_name("rehearsal.py")
MEND = "run `make kernels`"


@pytest.fixture(scope="module")
def dispatchers():
    specification = importlib.util.spec_from_file_location("rehearsal", REHEARSAL)
    rehearsal = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(rehearsal)
    return rehearsal.dispatchers()


def test_every_kernel_is_in_the_table_or_part_of_one_that_is(dispatchers):
    table = [(kernel.module, kernel.name) for kernel in kernels.read_table()]
    assert set(table) <= dispatchers.keys(), f"the table has kernels that there are not; {MEND}"
    left, covered = [dispatchers[name] for name in table], set()
    while left:
        kernel = left.pop()
        if kernel not in covered:
            covered.add(kernel)
            words = (kernel.py_func.__globals__.get(name) for name in kernel.py_func.__code__.co_names)
            left += [word for word in words if isinstance(word, Dispatcher)]
    missing = [name for name, kernel in dispatchers.items() if kernel not in covered]
    assert not missing, f"the table lacks these; {MEND}"


@pytest.mark.slow
def test_the_commands_call_nothing_that_the_table_lacks(compiled):
    done = subprocess.run([sys.executable, str(REHEARSAL)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), f"{done.stderr[-2000:]}\n{MEND}"


def test_who_compiles_imports_neither_drake_nor_gtsam():
    modules = sorted({kernel.module for kernel in kernels.read_table()})
    program = f"import sys, {', '.join(modules)}; print([m for m in ('pydrake', 'gtsam') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_types_are_read_as_they_were_spelled():
    array = types.Array(types.float64, 2, "C")
    known = types.NamedTuple(
        (types.Array(types.int64, 1, "C"),) * 2 + (array, array.copy(readonly=True)), exact_gain.Known
    )
    for kind in (
        array,
        array.copy(readonly=True),
        types.Array(types.float64, 2, "A"),
        types.Array(types.boolean, 3, "F"),
        numba.typeof(np.zeros(3, dtype=np.int8)),
        types.Omitted(0.5),
        types.boolean,
        types.int64,
        types.Tuple((types.float64, array)),
        known,
    ):
        assert kernels._types(kernels.spelled(kind), exact_gain) == (kind,)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Four modules: `caller` calls a kernel of `called`, which takes a number from `number`; `other` is on its own."""
    folder, cache = tmp_path / "tfg_drake", tmp_path / "cache"
    (cache / "tfg_drake_0").mkdir(parents=True)
    folder.mkdir()
    for name, text in (
        ("caller", "from tfg_drake.called import (\n    f,\n)\n@njit\n"),
        ("called", "from tfg_drake import number\n@njit\n"),
        ("number", "x = 1\n"),
        ("other", "@njit\n"),
    ):
        (folder / f"{name}.py").write_text(text)
        for suffix in ("nbi", "1.nbc"):
            (cache / "tfg_drake_0" / f"{name}.f-1.py311.{suffix}").touch()
    (folder / "kernels.txt").write_text(
        "".join(f"look tfg_drake.{name}.f int64\n" for name in ("caller", "called", "other"))
    )
    monkeypatch.setattr(kernels, "PACKAGE", folder)
    monkeypatch.setattr(kernels, "TABLE", folder / "kernels.txt")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    for cached in (kernels._modules, kernels._sources):
        cached.cache_clear()
    yield folder
    for cached in (kernels._modules, kernels._sources):
        cached.cache_clear()


def kept():
    return {path.name.split(".")[0] for path in kernels.folder().glob("*/*.nb?")}


def compiled_now():
    for name in ("caller", "called", "other"):
        (kernels.folder() / "tfg_drake_0" / f"{name}.f-1.py311.nbi").touch()
    cached = [str(path) for module in kernels._modules() for path in kernels._cached(module)]
    kernels._write_receipt({**kernels._receipt(), "compiled": kernels.OTHER, "cached": cached})


def change(path):
    path.write_text(path.read_text() + "# changed\n")


def test_what_nobody_knows_the_sources_of_is_forgotten(package):
    assert not kernels.are_compiled()
    kernels.drop_stale()
    assert kept() == {"number"}


@pytest.mark.parametrize(
    ("changed", "left"),
    [("other", {"caller", "called"}), ("caller", {"called", "other"}), ("called", {"other"}), ("number", {"other"})],
)
def test_a_kernel_is_forgotten_with_any_source_that_it_is_made_of(package, changed, left):
    kernels.drop_stale()
    compiled_now()
    assert kernels.are_compiled()
    change(package / f"{changed}.py")
    assert not kernels.are_compiled()
    kernels.drop_stale()
    assert kept() - {"number"} == left
    # What an interrupted compilation has left is not forgotten.
    compiled_now()
    kernels.drop_stale()
    assert kept() - {"number"} == {"caller", "called", "other"}


def test_a_cache_that_lacks_a_file_is_not_whole(package):
    kernels.drop_stale()
    compiled_now()
    next(kernels.folder().glob("*/other.*")).unlink()
    assert not kernels.are_compiled()


def test_where_the_package_cannot_be_written_the_users_cache_is_used(tmp_path, monkeypatch):
    # Set first, so that it is put back as it was: choose_folder sets it.
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    kernels.choose_folder()
    assert "NUMBA_CACHE_DIR" not in os.environ
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)
    kernels.choose_folder()
    assert kernels.folder() == tmp_path / "cache" / "tfg_drake"


@pytest.mark.parametrize("lost", [{"HOME"}, {"HOME", "XDG_CACHE_HOME"}])
def test_without_a_home_a_temporary_folder_is_used(tmp_path, monkeypatch, lost):
    """As for a user id that no file of passwords knows: os.path.expanduser leaves the ~ where it is."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name in lost:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", {}.__getitem__)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)
    kernels.choose_folder()
    own = tmp_path / f"tfg_drake-{os.getuid()}"
    assert kernels.folder() == (own if "XDG_CACHE_HOME" in lost else tmp_path / "cache" / "tfg_drake")
    assert not (tmp_path / "~").exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.raises(OSError, match="Permission denied") as caught:
        kernels.choose_folder()
    assert caught.value.filename == str(tmp_path / "file" / "cache")


def test_all_is_compiled_when_a_compilation_has_ended(compiled):
    with contextlib.closing(kernels.Compilation()) as compilation:
        for process in compilation._processes:
            process.wait()
        assert compilation.ready
        assert compilation.ended
        assert compilation.done == compilation.of == len(kernels.read_table())
        assert (compilation.left, compilation.word) == (0.0, "")
    assert kernels.are_compiled()

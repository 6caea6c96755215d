"""The kernels that are compiled before the first mission are those that missions call."""

import subprocess
import sys
import time

import pytest

from benchmarks.mission_kernels import called_by, spelled
from tfg_drake.diagrams import compile_kernels

CALLED = r"""
import tfg_drake
from benchmarks.mission_kernels import called
tfg_drake.explore("house", seed=1, until=25.0)
print(*map("\t".join, called()), sep="\n")
"""


def test_each_is_there_with_such_types_and_after_what_it_calls():
    listed = compile_kernels.listed()
    assert len(set(listed)) == len(listed)
    found = [compile_kernels.resolved(one) for one in listed]
    assert [one.types for one in listed] == [f"({''.join(f'{spelled(one)}, ' for one in types)})" for _, types in found]
    names = [kernel for kernel, _ in found]
    for row, kernel in enumerate(names):
        later = set(names[row + 1 :])
        assert not later & set(called_by(kernel)) - {kernel}, kernel


@pytest.mark.slow
def test_it_has_what_another_mission_calls():
    done = subprocess.run([sys.executable, "-c", CALLED], capture_output=True, text=True, check=True)
    called = {tuple(line.split("\t")) for line in done.stdout.splitlines()}
    assert len(called) > 50
    assert called - {(one.module, one.name, one.types) for one in compile_kernels.listed()} == set(), "make kernels"


@pytest.fixture
def few(monkeypatch):
    """Another list: a kernel that is there, one that another compiles, one that has gone, and one of other types."""
    types = "(float64, float64, float64, float64, float64, float64, )"
    rows = [
        ("geometry.distance", "side_of", 4.0, types),
        ("geometry.distance", "segments_cross", 6.0, types),
        ("geometry.distance", "gone", 2.0, types),
        ("geometry.distance", "point_segment_distance", 8.0, "(boolean, )"),
    ]
    monkeypatch.setattr(compile_kernels, "listed", lambda: [compile_kernels.Listed(*row) for row in rows])


def test_a_process_leaves_what_another_has_begun_and_what_is_of_another_version(few, tmp_path):
    (tmp_path / "1").touch()
    compile_kernels._compile(tmp_path)
    assert {path.stem for path in tmp_path.iterdir() if path.suffix} == {"0", "2", "3"}
    assert (tmp_path / "1").exists()


def test_the_time_left_goes_by_what_each_costs(few, tmp_path):
    compiling = object.__new__(compile_kernels.WarmUp)
    compiling._folder = type("", (), {"name": str(tmp_path)})
    compiling._since, compiling._processes = time.monotonic() - 100.0, [type("", (), {"poll": lambda _self: None})()]
    assert compiling.left == float("inf")
    (tmp_path / "0.kept").touch()
    assert compiling.left == float("inf")
    (tmp_path / "3.made").touch()
    assert compiling.left == pytest.approx(100.0, abs=1.0)  # 8 of 16 s that were not there.
    (tmp_path / "1.made").touch()
    (tmp_path / "2").touch()
    assert compiling.left == pytest.approx(100.0 * 2.0 / 14.0, abs=1.0)


def test_they_are_compiled_for_the_package_that_this_program_imports(tmp_path, monkeypatch):
    """Though there is another where it was started, as in a clone whose package is installed besides."""
    (tmp_path / "tfg_drake").mkdir()
    (tmp_path / "tfg_drake" / "__init__.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compile_kernels, "MODULE", "tfg_drake.notes")
    assert compile_kernels._start(tmp_path).wait(60) == 0

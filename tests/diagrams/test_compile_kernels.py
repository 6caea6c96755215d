"""The kernels that are compiled before the first mission are those that missions call."""

import os
import subprocess
import sys

import pytest

from benchmarks.mission_kernels import called_by, spelled
from tfg_drake.diagrams import compile_kernels

CALLED = r"""
import tfg_drake
from benchmarks.mission_kernels import called
tfg_drake.explore("house", seed=1, until=25.0)
tfg_drake.explore("house", seed=1, method="grid-nearest", until=25.0)
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
        ("geometry.distance", "side_of", types),
        ("geometry.distance", "segments_cross", types),
        ("geometry.distance", "gone", types),
        ("geometry.distance", "point_segment_distance", "(boolean, )"),
    ]
    monkeypatch.setattr(compile_kernels, "listed", lambda: [compile_kernels.Listed(*row) for row in rows])


def test_each_process_takes_what_no_other_has_and_leaves_what_is_of_another_version(few, monkeypatch):
    def compiled(rows):
        (numbers, queue), (told, done) = os.pipe(), os.pipe()
        os.write(queue, b"".join(row.to_bytes(2) for row in rows))
        os.close(queue)
        with monkeypatch.context() as patched:
            patched.setattr(os, "read", lambda _, size, read=os.read: read(numbers, size))
            patched.setattr(os, "write", lambda _, data, write=os.write: write(done, data))
            compile_kernels._compile()
        os.close(done)
        return os.read(told, 99)

    assert compiled([0, 2, 3]) == b"..."
    assert compiled([]) == b""


def test_progress_is_told_as_the_share_that_is_done(monkeypatch):
    monkeypatch.setattr(compile_kernels, "_start", lambda _rows, done: Process(os.dup(done)))

    class Process:
        def __init__(self, done):
            self.done, self.code = done, None

        def poll(self):
            return self.code

        def terminate(self):
            os.close(self.done)

        wait = poll

    compiling = compile_kernels.WarmUp()
    first = compiling._processes[0]
    said = "compiling kernels, once per installation, "
    assert compiling.word == said + "0 % done"
    os.write(first.done, b"." * (len(compile_kernels.listed()) // 2 + 1))
    assert compiling.word == said + "50 % done"
    for process in compiling._processes:
        process.code = 1
    assert (compiling.word, compiling.ended) == ("", True)
    compiling.close()


def test_they_are_compiled_for_the_package_that_this_program_imports(tmp_path, monkeypatch):
    """Though there is another where it was started, as in a clone whose package is installed besides."""
    (tmp_path / "tfg_drake").mkdir()
    (tmp_path / "tfg_drake" / "__init__.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compile_kernels, "MODULE", "tfg_drake.notes")
    with open(os.devnull, "r+b") as nothing:
        assert compile_kernels._start(nothing.fileno(), nothing.fileno()).wait(60) == 0

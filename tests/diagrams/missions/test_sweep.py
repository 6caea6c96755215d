import dataclasses
import errno
import importlib.util
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.diagrams.rooms import lasting
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.interruption import NAMES
from tfg_drake.diagrams.methods import METHODS, FindMethod
from tfg_drake.diagrams.missions import ray_sweep
from tfg_drake.diagrams.missions.mission import MissionRequest
from tfg_drake.diagrams.missions.sweep import (
    SweepError,
    _receipt,
    folder_of,
    open_sweep,
    parse_methods,
    run_local,
    run_one,
)
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario
from tfg_drake.io.extras import pip_install
from tfg_drake.io.files import write_atomic

ROOM = """
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
"""


def tasks(seeds=2, methods=("tfg",), **changes):
    scenario = ApplyWorldFile(LoadScenario(data=ROOM), tag_spacing=1.0)
    found = []
    for seed in range(seeds):
        scenario.seed = seed
        basis = {"name": "room", "world_name": "room", "max_time": 3.0} | changes
        of_seed = LoadScenario(data=ROOM, defaults=scenario)
        found += [MissionRequest(of_seed, METHODS[method], **basis) for method in methods]
    return found


def replaced(task, seed):
    return dataclasses.replace(task, scenario=dataclasses.replace(task.scenario, seed=seed))


def all_lasting(runs):
    return {seed: lasting(run.summary) for seed, run in runs.items()}


def by_seed(runs):
    return {run.seed: run for run in runs}


@pytest.fixture(scope="module")
def one_job(tmp_path_factory):
    """Two runs, one after the other in this process, and their folder."""
    out = tmp_path_factory.mktemp("sweep")
    assert open_sweep(tasks(), out) == []
    for task in tasks():
        run_one(task, folder_of(task, out))
    return by_seed(open_sweep(tasks(), out)), out


def test_a_run_leaves_its_folder_and_receipt(one_job):
    runs, out = one_job
    assert [run.outcome for run in runs.values()] == ["time_limit", "time_limit"]
    assert runs[0].folder == out / "runs" / "tfg" / "seed-0"
    assert {"summary.json", "task.json", "truth.tum", "trajectory.tum"} < set(os.listdir(runs[0].folder))
    receipt = json.loads((runs[0].folder / "task.json").read_text())
    assert (receipt["method"], receipt["seed"], receipt["max_time_s"]) == ("tfg", 0, 3.0)


def signalled_runs(some, out):
    """Runs all at a time, each of which is sent every signal at once."""
    over, signalled = threading.Event(), set()

    def signal_all():
        while len(signalled) < len(some) and not over.is_set():
            for process in multiprocessing.active_children():
                if process.pid not in signalled:
                    signalled.add(process.pid)
                    for number in NAMES:
                        os.kill(process.pid, number)
            time.sleep(0.01)

    sender = threading.Thread(target=signal_all)
    sender.start()
    runs = by_seed(run_local(some, out, len(some), threading.Event()))
    over.set()
    sender.join()
    assert len(signalled) == len(some)
    return runs


@pytest.mark.slow
def test_two_at_a_time_make_the_same_bits(one_job, tmp_path):
    runs = signalled_runs(tasks(), tmp_path)
    assert all_lasting(runs) == all_lasting(one_job[0])
    same = [(run.folder / "truth.tum").read_bytes() for run in (runs[0], one_job[0][0])]
    assert same[0] == same[1]


def test_finished_runs_are_not_run_again(one_job, tmp_path):
    out = one_job[1]
    assert [run.summary for run in open_sweep(tasks(), out)] == [run.summary for run in one_job[0].values()]
    # Other seeds and methods may be asked for.
    assert len(open_sweep(tasks(3, ("tfg", "tfg-nearest")), out)) == 2
    assert [run.seed for run in open_sweep(tasks(3)[1:], out)] == [1]
    assert open_sweep(tasks(methods=("tfg-nearest",)), out) == []


def test_runs_of_other_seeds_may_be_copied_from_another_folder(one_job, tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    for task, out in zip(tasks(), (first, second), strict=True):
        out.mkdir()
        assert open_sweep([task], out) == []
        shutil.copytree(folder_of(task, one_job[1]), folder_of(task, out))
    shutil.copytree(second / "runs", first / "runs", dirs_exist_ok=True)
    assert [run.seed for run in open_sweep(tasks(), first)] == [0, 1]


def test_after_an_edit_of_its_file_a_method_is_run_again(one_job, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("MakeExplorer = print\n")
    mine = dataclasses.replace(tasks(1)[0], method=FindMethod(str(file)))
    out = tmp_path / "out"
    shutil.copytree(one_job[0][0].folder, folder_of(mine, out))
    write_atomic(folder_of(mine, out) / "task.json", json.dumps(_receipt(mine)))
    assert len(open_sweep([mine], out)) == 1
    file.write_text("MakeExplorer = input\n")
    assert open_sweep([mine], out) == []


@pytest.mark.parametrize("name", ["task.json", "summary.json"])
def test_a_run_that_is_not_whole_is_run_again(one_job, name):
    runs, out = one_job
    file = runs[1].folder / name
    contents = file.read_text()
    for broken in ("", contents.replace('"seed": 1', '"seed": 7') if name == "task.json" else contents[:50]):
        file.write_text(broken)
        assert [run.seed for run in open_sweep(tasks(), out)] == [0]
    file.write_text(contents)


def test_another_sweeps_folder_is_refused(one_job):
    out = one_job[1]
    mend = "name another folder with --out"
    with pytest.raises(SweepError) as caught:
        open_sweep(tasks(max_time=10.0), out)
    assert str(caught.value) == f"{out}: holds another comparison (max_time_s differ); {mend}"
    other = tasks()
    for task in other:
        task.scenario.robot.max_speed = 0.2
    with pytest.raises(SweepError) as caught:
        open_sweep(other, out)
    assert str(caught.value) == f"{out}: holds another comparison (scenario's values differ); {mend}"
    with pytest.raises(SweepError, match="scenario's values differ"):  # None of its seeds is there.
        open_sweep([replaced(other[0], 7)], out)
    other = tasks()
    other[0].scenario.world.start = [1.0, 1.0, 0.0]
    with pytest.raises(SweepError, match="scenario's values differ"):
        open_sweep(other, out)
    assert open_sweep([replaced(other[0], 7)], out) == []  # Seeds may begin at places of their own.


@pytest.mark.slow
def test_a_killed_or_failed_run_stops_no_other(tmp_path):
    some = tasks(3)
    folder_of(some[2], tmp_path).parent.mkdir(parents=True)
    folder_of(some[2], tmp_path).write_text("in the way")
    killer = threading.Thread(target=kill_first)
    killer.start()
    runs = by_seed(run_local(some, tmp_path, 1, threading.Event()))
    killer.join()
    assert [runs[seed].outcome for seed in range(3)] == ["failed", "time_limit", "failed"]
    assert runs[0].reason == "killed by SIGKILL"
    assert runs[2].reason.startswith("NotADirectoryError: ")
    assert [run.seed for run in open_sweep(some, tmp_path)] == [1]


def test_a_signal_to_the_whole_group_ends_no_run(tmp_path):
    """As `timeout` and clusters send it: whoever started the runs looks after it."""
    assert signalled_runs(tasks(1), tmp_path)[0].outcome == "time_limit"


def test_a_run_that_cannot_be_started_is_one_line(tmp_path, monkeypatch):
    def refuse(_self):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(multiprocessing.get_context("spawn").Process, "start", refuse)
    with pytest.raises(SweepError) as caught:
        list(run_local(tasks(1), tmp_path, 1, threading.Event()))
    assert str(caught.value) == f"{sys.executable}: cannot be started: Permission denied; try fewer --jobs"


def kill_first():
    while not multiprocessing.active_children():
        time.sleep(0.01)
    multiprocessing.active_children()[0].kill()


def test_an_interrupt_ends_all_at_once(tmp_path):
    interrupted = threading.Event()
    threading.Timer(1.0, interrupted.set).start()
    begun = time.monotonic()
    assert list(run_local(tasks(), tmp_path, 1, interrupted)) == []
    assert time.monotonic() - begun < 30.0
    assert not multiprocessing.active_children()


def test_methods_are_named():
    both = [METHODS["tfg"], METHODS["grid-nearest"]]
    assert parse_methods("tfg, grid-nearest", LoadScenario(data=ROOM)) == both
    # The grid method fixes that: it counts for the other one.
    assert parse_methods("tfg, grid-nearest", LoadScenario(data=ROOM), ["explorer.first_look=2"]) == both
    example = Path(__file__).parents[3] / "examples" / "goal_selector.py"
    (own,) = parse_methods(f"{example}", LoadScenario(data=ROOM))
    assert (own.name, own.source) == ("goal_selector", str(example))
    again = pickle.loads(pickle.dumps(MissionRequest(LoadScenario(data=ROOM), own)))  # as it is sent to a process
    assert (again.method.name, again.method.source) == (own.name, own.source)
    with pytest.raises(SweepError, match="--methods tfg,tfg: names tfg twice; name each once"):
        parse_methods("tfg,tfg", LoadScenario(data=ROOM))
    with pytest.raises(BadInput, match=r"^--methods scripted: the scenario has no drive; give it one, a list of"):
        parse_methods("tfg,scripted", LoadScenario(data=ROOM))


needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")


@needs_ray
@pytest.mark.slow
def test_a_cluster_makes_the_same_bits_though_a_worker_dies(one_job, tmp_path):
    killed = []
    killer = threading.Thread(target=lambda: killed.append(kill_worker()))
    killer.start()
    runs = by_seed(ray_sweep.run_on_ray(tasks(), tmp_path, "local", threading.Event()))
    killer.join()
    assert killed[0]
    assert all_lasting(runs) == all_lasting(one_job[0])
    for seed, run in one_job[0].items():
        assert sorted(os.listdir(runs[seed].folder)) == sorted(os.listdir(run.folder))
        assert (runs[seed].folder / "truth.tum").read_bytes() == (run.folder / "truth.tum").read_bytes()
    assert len(open_sweep(tasks(), tmp_path)) == 2


def kill_worker():
    """Kill a worker of this process's own cluster that is at a mission; False if none came up within a minute."""
    for _ in range(1200):
        for process in Path("/proc").glob("[0-9]*"):
            try:
                at_work = b"ray::_mission" in (process / "cmdline").read_bytes()
                if at_work and os.getpid() in ancestors(process):
                    os.kill(int(process.name), signal.SIGKILL)
                    return True
            except OSError:
                continue  # It has ended meanwhile.
        time.sleep(0.05)
    return False


def ancestors(process):
    while process.name != "0":
        process = Path("/proc") / (process / "stat").read_text().rpartition(")")[2].split()[1]
        yield int(process.name)


@needs_ray
@pytest.mark.parametrize("address", ["localhost:1", "nowhere.invalid:6379", "head:port"])
def test_a_cluster_that_is_not_there_is_refused(tmp_path, address):
    with pytest.raises(SweepError) as caught:
        next(ray_sweep.run_on_ray(tasks(), tmp_path, address, threading.Event()))
    assert str(caught.value).startswith(f"--ray {address}: no cluster there (")
    assert str(caught.value).endswith("); start one with ray start --head")


def test_without_ray_there_is_a_mend(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(SweepError) as caught:
        next(ray_sweep.run_on_ray(tasks(), tmp_path, "local", threading.Event()))
    assert str(caught.value) == f"--ray: Ray is not installed; {pip_install('ray')}"

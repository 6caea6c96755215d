import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tfg_drake.comparison.runs import Run
from tfg_drake.diagrams.commands.compare import _seeds
from tfg_drake.diagrams.interruption import NAMES
from tfg_drake.diagrams.missions import comparison_report, sweep
from tfg_drake.diagrams.missions.comparison_report import closing_lines, of_commits


def test_seeds_are_a_number_or_a_range():
    assert (_seeds("3"), _seeds("40:42")) == (range(3), range(40, 42))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("--seeds 0", "--seeds 0: must be 1 or more"),
        ("--seeds 5:5", "--seeds 5:5: must be 1 or more"),
        ("--seeds few", "--seeds few: must be a number of seeds, or A:B for A to B - 1"),
        ("--jobs 0", "--jobs 0: must be 1 or more"),
        ("--max-time 0", "--max-time 0: must be greater than 0 s"),
        ("--tag-spacing -1", "--tag-spacing -1: must be greater than 0 m"),
        ("--jobs 2 --ray local", "--jobs and --ray exclude each other; a cluster knows how many missions it can run"),
        ("--methods tfg,tfg", "--methods tfg,tfg: names tfg twice; name each once"),
        (
            "house --methods random,tfg-nearest --set explorer.goal=argmax",
            "--methods random: fixes explorer.goal=random; leave explorer.goal=argmax out, or take another method: tfg",
        ),
        ("--out /dev/null", "--out /dev/null: is a file; name a folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(call, arguments, complaint):
    assert call("compare", "--seeds", "1", *arguments.split()) == (2, "", f"tfg-drake: {complaint}\n")


def test_an_unknown_method_is_told_the_names(call):
    code, out, err = call("compare", "--methods", "tfg,gird-nearest")
    # On a busy machine it says that it is loading.
    assert (code, re.sub(r"loading \(\d+ s\)\n", "", out)) == (2, "")
    assert re.fullmatch(r"tfg-drake: --methods gird-nearest: no such method; name a .py file or one of tfg, .*\n", err)


def test_a_report_names_the_commits_of_its_runs():
    runs = [Run("a", i, Path(), {"commit": one}) for i, one in enumerate(["5e8d", None, "5e8d", "77ab-dirty"])]
    assert of_commits([*runs, Run("a", 9, Path(), None)]) == " of commit 5e8d (runs: 2), 77ab-dirty (runs: 1)"
    assert (of_commits(runs[:3]), of_commits(runs[1:2])) == (" of commit 5e8d", "")


def test_the_closing_lines_have_time_and_error_where_there_is_one():
    ended = {"outcome": "complete", "sim_time_s": 90.0}
    # Of the seed that both have.
    runs = [Run("a", seed, Path(), ended | {"position_error_moving_m": {"mean": 0.01 * seed}}) for seed in (1, 2)]
    stood = Run("b", 1, Path(), ended | {"position_error_moving_m": {"mean": None}})
    assert closing_lines([*runs, stood], ["a", "b", "c"]) == [
        "a             2 complete; time 90 s, position error 0.010 m from the first drive on",
        "b             1 complete; time 90 s",
        "c             no run",
    ]


def in_this_process(tasks, out, _jobs, _interrupted):
    """`run_local` without processes of its own, which test_sweep.py looks at."""
    for task in tasks:
        yield sweep.run_of(task, out, *sweep.attempt(task, sweep.folder_of(task, out)))


def test_a_comparison_from_the_command_line_and_again(call, room, tmp_path, monkeypatch):
    monkeypatch.setattr(sweep, "run_local", in_this_process)
    out = tmp_path / "comparison"
    arguments = ["compare", room, "--tag-spacing", "1", "--methods", "tfg,tfg-nearest"]
    arguments += ["--seeds", "1", "--max-time", "9", "--out", str(out)]
    code, printed, err = call(*arguments)
    assert (code, err) == (0, "")
    # In between it may say how far it is.
    expected = [
        r"tfg, seed 0: complete; 1 of 2 runs, about .*",
        r"tfg-nearest, seed 0: complete; 2 of 2 runs",
        r"tfg           1 complete; time 8 s",
        re.escape(f"report: {out / 'report.html'}"),
    ]
    assert re.fullmatch(r"(?:.*\n)*" + r"\n(?:.*\n)*".join(expected) + r"\n", printed), printed
    for name in ("errors", "coverage", "maps", "costs"):
        assert (out / f"{name}.png").stat().st_size > 5000
        assert (out / f"{name}.pdf").stat().st_size > 2000
    rows = list(csv.DictReader((out / "runs.csv").open()))
    assert [(row["method"], row["seed"], row["outcome"]) for row in rows] == [
        ("tfg", "0", "complete"),
        ("tfg-nearest", "0", "complete"),
    ]
    page = (out / "report.html").read_text()
    assert not re.search(r"https?:|file:|(src|href)=\"(?!data:)", page)
    assert page.count("data:image/png;base64,") == 4
    command = f"tfg-drake compare {room} --tag-spacing 1.0 --methods tfg,tfg-nearest --seeds 1 --max-time 9"
    assert command in page
    assert f"    {command}\n" in (out / "report.md").read_text()

    monkeypatch.setattr(comparison_report, "write_comparison", lambda *_: None)
    code, printed, err = call(*arguments)
    assert (code, err, printed.splitlines()[0]) == (0, "", "2 of 2 runs are there already")

    older = out / "runs" / "tfg" / "seed-0" / "summary.json"
    older.write_text(json.dumps({**json.loads(older.read_text()), "commit": "0a1b2c3"}))
    assert call(*arguments)[1].splitlines()[0] == "2 of 2 runs are there already, 1 of another commit"

    code, printed, err = call(*arguments, "--set", "robot.max_speed=0.2")
    assert (code, printed) == (2, "")
    complaint = "holds another comparison (scenario's values differ); name another folder with --out"
    assert err == f"tfg-drake: {out}: {complaint}\n"


def test_each_seed_may_have_a_world_of_its_own(call, tmp_path, monkeypatch):
    for seed in (3, 4):
        walls = [[0, 0, seed, 0], [seed, 0, seed, 4], [seed, 4, 0, 4], [0, 4, 0, 0]]
        (tmp_path / f"{seed}.yaml").write_text(json.dumps({"base": "house", "world": {"walls": walls, "tags": []}}))
    asked = []
    monkeypatch.setattr(sweep, "run_local", lambda tasks, *_: asked.extend(tasks) or [])
    arguments = ["--methods", "tfg", "--seeds", "3:5", "--start", "1,1,0", "--out", str(tmp_path / "out")]
    assert call("compare", "house", "--world", str(tmp_path / "{seed}.yaml"), *arguments)[0] == 0
    assert [task.scenario.world.walls[0][2] for task in asked] == [3.0, 4.0]
    assert len({task.world_name for task in asked}) == 1
    assert {task.name for task in asked} == {"house"}
    assert (tmp_path / "out" / "report.md").read_text().startswith("# tfg in a world of each seed\n")


def blocked_in_missions(pid):
    """The masks of blocked signals of a comparison's processes that run a mission, at least one."""
    masks = []
    while not masks:
        time.sleep(0.02)
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                status = Path(f"/proc/{child}/status").read_text()
                masks.append(int(re.search(r"SigBlk:\s*(\w+)", status)[1], 16))
    return masks


@pytest.mark.slow
def test_a_signal_to_all_of_its_processes_leaves_a_partial_report(call, room, tmp_path, monkeypatch):
    """SIGTERM, as `timeout` sends it; a mission's process hears none of those that end a program."""
    out = tmp_path / "comparison"
    arguments = ["compare", room, "--jobs", "1", "--max-time", "1", "--methods", "tfg", "--out", str(out), "--seeds"]
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_local", in_this_process)
        patch.setattr(comparison_report, "write_comparison", lambda *_: None)
        assert call(*arguments, 1)[0] == 0
    process = subprocess.Popen(
        [sys.executable, "-m", "tfg_drake.diagrams.cli", *arguments, "20"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    masks = blocked_in_missions(process.pid)
    assert all(mask >> (number - 1) & 1 for mask in masks for number in NAMES)
    os.killpg(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    stopping = "\ntfg-drake: stopping; SIGTERM again leaves at once\n"
    assert (process.returncode, err) == (128 + signal.SIGTERM, stopping)
    assert re.search(r"This report is partial: [1-9]\d* of 20 runs are done.", (out / "report.md").read_text())

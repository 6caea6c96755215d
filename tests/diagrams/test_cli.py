import dataclasses
import errno
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
import typer

from tests.diagrams.rooms import ROOM, ROOMS
from tfg_drake import __version__, kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams import cli, compile_kernels
from tfg_drake.diagrams.commands.command import EXIT_CODES
from tfg_drake.diagrams.interruption import TOGETHER
from tfg_drake.diagrams.missions.mission_runner import Progress
from tfg_drake.io.files import FileError
from tfg_drake.mapfile.landmark_table import landmark_csv
from tfg_drake.mapfile.saved_map import load_map, save_map
from tfg_drake.slam import estimator


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("explore --max-time 0", "--max-time 0: must be greater than 0 s"),
        ("explore --max-time nan", "--max-time nan: must be greater than 0 s"),
        ("explore --realtime-rate -1", "--realtime-rate -1: must be 0 (no limit) or more"),
        (
            "explore --tag-spacing x",
            "invalid value for '--tag-spacing': 'x' is neither a distance in metres nor none; "
            "see tfg-drake explore --help",
        ),
        ("explore --tag-spacing 0", "--tag-spacing 0: must be greater than 0 m"),
        ("explore --tag-spacing 1e-4", "--tag-spacing 0.0001: must be 0.05 m at least; tags are no smaller"),
        ("compare --set seed=5", "--set seed=5: the seeds are those of --seeds; leave it out"),
        ("explore --seed -1", "--seed -1: must be between 0 and 2147483647"),
        ("explore --page-port 70000", "port 70000: must be between 1 and 65535"),
        ("explore --start 1,2", "--start 1,2: must be X,Y,YAW in metres and radians, such as 1.5,2,0"),
        ("explore --start a,b,c", "--start a,b,c: must be X,Y,YAW in metres and radians, such as 1.5,2,0"),
        ("explore --start 1,2,inf", "--start 1,2,inf: must be finite"),
        ("explore --set a", "--set a: expected KEY=VALUE, such as explorer.stop_gain=5"),
        ("explore --out /dev/null", "--out /dev/null: is a file; name a folder"),
        ("explore --out /dev/null/x", "--out /dev/null/x: not a directory; name a folder that can be written"),
        ("explore a b", "got unexpected extra argument(s) (b); see tfg-drake explore --help"),
        ("fly", "no such command 'fly'; see tfg-drake --help"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(call, arguments, complaint):
    assert call(*arguments.split()) == (2, "", f"tfg-drake: {complaint}\n")


def test_the_version(call):
    assert call("--version") == (0, f"tfg-drake {__version__}\n", "")


def test_help_is_printed_if_asked_for_and_if_no_command_is_given(call):
    code, text, err = call("-h")
    assert (code, err) == (0, "")
    assert text.startswith("Usage: tfg-drake [OPTIONS] COMMAND [ARGS]...\n")
    assert "Explore a building and map it" in text
    assert call("--help") == (0, text, "")
    assert call() == (2, "", text)
    assert call("map", "export", "-h") == call("map", "export", "--help")


def test_a_shell_completes_commands(call, monkeypatch):
    monkeypatch.setenv("_TFG_DRAKE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "tfg-drake ex")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert call() == (0, "explore\nexport\n", "")


@pytest.mark.parametrize(
    ("arguments", "beginning"),
    [
        # The parser and the loader have their own words for the rest.
        ("explore --sed 3", "no such option: --sed"),
        ("explore --seed", "option '--seed' requires an argument"),
        ("explore --seed three", "invalid value for '--seed': "),
        ("explore nowhere", "nowhere: no such file or scenario; "),
        ("explore --world nowhere.vectormap.txt", "nowhere.vectormap.txt: "),
        ("explore --set explorer.stop_gian=1", "--set explorer.stop_gian=1: "),
    ],
)
def test_other_bad_input_too(call, arguments, beginning):
    code, out, err = call(*arguments.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"tfg-drake: {beginning}")
    assert err.count("\n") == 1


def test_what_is_read_is_not_written_over(call, tmp_path):
    own = tmp_path / "scenario.yaml"
    own.write_text(ROOM)
    problem = "its scenario.yaml, which is read, would be written over; name another folder"
    assert call("explore", str(own), "--out", str(tmp_path)) == (2, "", f"tfg-drake: --out {tmp_path}: {problem}\n")
    assert own.read_text() == ROOM


def test_bad_input_leaves_no_folder_behind(call, tmp_path):
    call("explore", "nowhere", "--out", str(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_help_is_quick_and_names_every_option():
    code = "import sys; from tfg_drake.diagrams import cli; cli.main(['explore', '--help'])"
    heavy = "\nfinally: print([m for m in ('pydrake', 'numpy', 'gtsam', 'numba', 'matplotlib') if m in sys.modules])"
    program = "import sys\ntry: exec(" + repr(code) + ")" + heavy
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    options = "world tag-spacing start seed headless realtime-rate max-time set out json"
    for option in options.split(" "):
        assert f"--{option} " in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_has_groups_and_an_example(call):
    code, text, _ = call("explore", "--help")
    assert code == 0
    groups = re.split(r"\n\n(?=\S)", text)
    heads = ["Arguments:", "The mission:", "A simulated world:", "A real robot, or a run:", "To look at it:"]
    assert [group.splitlines()[0] for group in groups[1:]] == heads
    for option, head in (("--seed", 1), ("--start", 2), ("--preset", 3), ("--page-port", 4)):
        assert f"  {option} " in groups[1 + head]
    of_explore = typer.main.get_command(cli.app).commands["explore"]
    for option in [name for one in of_explore.params for name in one.opts if name.startswith("--")]:
        assert f"{option} " in text
    example = text.splitlines()[-1].removeprefix("  Example: tfg-drake ").split()
    cli.app(["explore", *example[1:], "--help"], standalone_mode=False)


@pytest.mark.parametrize(
    ("arguments", "rate"),
    [(["--method", "manual"], 1.0), (["--method", "manual", "--realtime-rate", "0.5"], 0.5), ([], 0.0)],
)
def test_whoever_drives_by_hand_has_a_page_in_real_time(call, room, tmp_path, monkeypatch, arguments, rate):
    def open_page(*_, **given):
        raise BadInput(f"rate {given['rate']}")

    monkeypatch.setattr("tfg_drake.diagrams.missions.page.open_page", open_page)
    assert call("explore", room, *arguments, "--out", tmp_path / "run")[2] == f"tfg-drake: rate {rate}\n"


def test_a_mission_from_the_command_line(call, room, tmp_path):
    arguments = ["explore", room, "--tag-spacing", "1", "--headless", "--json", "--out", str(tmp_path / "run")]
    code, out, err = call(*arguments, "--set", "explorer.samples=100", "--seed", "5", "--max-time", "200")
    assert (code, err) == (0, "")
    summary = json.loads(out.splitlines()[-1])
    assert summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["outcome"], summary["seed"], summary["scenario"]) == ("complete", 5, "room")
    # Before the table, on a slow machine, come lines of progress.
    names = [line[:12].strip() for line in out.splitlines()[:-1]]
    names = [name for name in names[names.index("outcome") :] if name]
    before, after = ["outcome", "time", "driven", "tags", "walls", "map"], ["coverage", "safety"]
    assert names == [*before, "pose error", *after, "left open", "unseen room", "files", "page"]
    mapped, reachable = summary["landmarks_mapped"], summary["landmarks_reachable"]
    assert f"\ntags        {mapped} mapped of {reachable} reachable, map error 0.0" in out
    assert "\nsafety      contacts: 0 by the robot, 0 by others; least clearance " in out


def test_a_mission_has_a_page_and_prints_its_address_first(call, room, tmp_path):
    code, out, err = call("explore", room, "--max-time", "1", "--page-port", "17432", "--out", str(tmp_path / "run"))
    assert (code, err) == (0, "")
    lines = [line for line in out.splitlines() if not line.startswith("loading")]
    assert any(re.fullmatch(r"page: http://localhost:17432/#token=[\w-]{20,}", line) for line in lines[:2])
    assert lines[-2] == f"go on       tfg-drake explore --resume {tmp_path / 'run'}"
    assert lines[-1] == f"page        {tmp_path / 'run' / 'mission.html'}"


def test_a_port_that_somebody_else_has(call, room, tmp_path):
    with socket.create_server(("127.0.0.1", 17433)):
        code, out, err = call("explore", room, "--page-port", "17433", "--out", str(tmp_path / "run"))
    assert (code, out) == (2, "")
    complaint = "localhost, port 17433: the page cannot be served there: address already in use; name another"
    assert err == f"tfg-drake: {complaint}\n"


def test_a_run_in_another_world_has_the_name_of_its_file(call, tmp_path):
    world = tmp_path / "room-0.10.yaml"
    world.write_text(ROOM)
    arguments = ["explore", "--world", str(world), "--headless", "--json", "--max-time", "1"]
    _, out, _ = call(*arguments, "--out", str(tmp_path / "run"))
    assert json.loads(out.splitlines()[-1])["scenario"] == "room-0.10"


@pytest.mark.parametrize(
    ("outcome", "code"),
    [
        ("complete", 0),
        ("budget", 0),
        ("battery", 0),
        ("time_limit", 0),
        ("stuck", 1),
        ("fault", 3),
        ("interrupted", 130),
    ],
)
def test_exit_codes(outcome, code):
    assert EXIT_CODES[outcome] == code


STOPPING = "\ntfg-drake: stopping; Ctrl-C again leaves at once\n"
SIGNALS = [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP")]
# A process that takes an instant of its own to be interrupted at, by what it is about to import or has written.
INTERRUPTED = """
import os, pathlib, signal, sys
from tfg_drake.diagrams import cli

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
cli.main(sys.argv[2:])
"""


def start(program, *arguments):
    return subprocess.Popen(
        [sys.executable, *program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def wait_for(process, path):
    while not path.exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


@pytest.mark.parametrize("module", ["yaml", pytest.param("tfg_drake.diagrams.station", marks=pytest.mark.slow)])
def test_ctrl_c_before_the_mission_begins_leaves_a_summary(room, tmp_path, module):
    arguments = ["explore", room, "--headless", "--json", "--out", str(tmp_path / "run")]
    out, err = (process := start(["-c", INTERRUPTED], module, *arguments)).communicate(timeout=120)
    assert (process.returncode, err) == (130, STOPPING)
    summary = json.loads(out.splitlines()[-1])
    assert summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["outcome"], summary["reason"]) == ("interrupted", "interrupted by Ctrl-C at 0 s")


def test_a_signal_while_driving_leaves_map_and_summary(tmp_path):
    (tmp_path / "rooms.yaml").write_text(ROOMS)
    arguments = ["explore", str(tmp_path / "rooms.yaml"), "--tag-spacing", "1", "--headless", "--json"]
    arguments += ["--realtime-rate", "4", "--out", str(tmp_path / "run")]
    process = start(["-m", "tfg_drake.diagrams.cli"], *arguments)
    stages = tmp_path / "run" / "stages.jsonl"
    wait_for(process, stages)
    while not stages.read_text():
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    # As `timeout` sends it: to the program, and to its group.
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + signal.SIGTERM, STOPPING.replace("Ctrl-C", "SIGTERM"))
    summary = json.loads(out.splitlines()[-1])
    assert summary["outcome"] == "interrupted"
    assert summary["reason"].startswith("interrupted by SIGTERM at ")
    assert summary["stages"] >= 1
    assert summary["map_bytes"] == (tmp_path / "run" / "map.npz").stat().st_size
    assert {"mission.html", "trajectory.tum", "figure.png"} <= {path.name for path in (tmp_path / "run").iterdir()}


@pytest.mark.parametrize(("number", "name"), SIGNALS)
def test_every_signal_ends_a_mission_with_a_code_of_its_own(call, room, tmp_path, monkeypatch, number, name):
    def interrupt(progress):
        if not progress.outcome:
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), number)
        return ""

    told = []
    monkeypatch.setattr(Progress, "line", property(interrupt))
    monkeypatch.setattr(cli, "_tell_at_once", told.append)
    code, out, err = call("explore", room, "--headless", "--json", "--out", tmp_path / "run")
    assert (code, err) == (128 + number, "")
    assert told == [f"stopping; {name} again leaves at once"]
    summary = json.loads(out.splitlines()[-1])
    assert summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["outcome"], summary["reason"]) == ("interrupted", f"interrupted by {name} at 1 s")


@pytest.mark.slow
def test_a_second_signal_leaves_at_once(room, tmp_path):
    process = start(["-m", "tfg_drake.diagrams.cli"], "explore", room, "--headless", "--out", str(tmp_path / "run"))
    wait_for(process, tmp_path / "run")
    process.send_signal(signal.SIGTERM)
    assert process.stderr.readline() + process.stderr.readline() == STOPPING.replace("Ctrl-C", "SIGTERM")
    time.sleep(TOGETHER)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out.count("Traceback")) == (128 + signal.SIGTERM, 0)
    assert err == "\ntfg-drake: interrupted; nothing more is written\n"


def test_a_fault_ends_with_one_line_and_exit_code_3(call, room, tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("def MakeExplorer(scenario):\n    raise ValueError('no way\\nmore')\n")
    only_tags = ("--set", "explorer.landmarks=tags")
    code, out, err = call("explore", room, "--method", str(broken), "--headless", "--out", str(tmp_path), *only_tags)
    remark, outcome = out.splitlines()[:2]
    assert remark == "There is no tag in this world, so no landmark to map; --tag-spacing places some"
    assert (code, outcome) == (3, "outcome     fault: ValueError at 0.00 s: no way")
    assert err == f"tfg-drake: ValueError at 0.00 s: no way; the traceback is in {tmp_path}/log.txt\n"


def test_an_estimate_that_is_lost_ends_with_one_line_and_the_map_before(call, room, tmp_path, monkeypatch):
    def fail(_graph):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(estimator, "known_jointly", fail)
    code, out, err = call("explore", room, "--headless", "--out", str(tmp_path), "--tag-spacing", "1")
    assert code == 1
    assert err.startswith("tfg-drake: the estimate is no longer finite at ")
    assert err.endswith(
        "(Singular matrix); the map is kept as it was at stage 1; look at odometry and scans about then\n"
    )
    assert err.count("\n") == 1
    assert "Traceback" not in out
    assert (tmp_path / "map.npz").exists()


def test_a_method_that_makes_no_diagram_is_told_so(call, tmp_path):
    three = tmp_path / "three.py"
    three.write_text("def MakeExplorer(scenario):\n    return 3\n")
    code, out, _ = call("explore", "house", "--method", str(three), "--headless", "--out", str(tmp_path / "run"))
    reason = "TypeError at 0.00 s: MakeExplorer must return the explorer's Diagram, not int"
    assert (code, out.splitlines()[0]) == (3, f"outcome     fault: {reason}")


def test_a_method_that_there_is_not_or_that_lacks_something_is_refused(call, room):
    code, _, err = call("explore", room, "--method", "tgf")
    assert (code, err.startswith("tfg-drake: --method tgf: no such method; name a .py file or one of tfg, ")) == (
        2,
        True,
    )
    code, _, err = call("explore", room, "--method", "scripted")
    complaint = "scripted: the scenario has no drive; give it one, a list of [x, y] under `drive:`"
    assert (code, err) == (2, f"tfg-drake: --method {complaint}\n")
    code, _, err = call("explore", "house", "--method", "paper", "--set", "explorer.goal=random")
    complaint = "paper: fixes explorer.goal=argmax; leave explorer.goal=random out, or take another method: tfg"
    assert (code, err) == (2, f"tfg-drake: --method {complaint}\n")


def test_a_mistake_outside_the_simulation_is_one_line_too(call, monkeypatch, room, tmp_path):
    def fail(*_arguments):
        raise ValueError("no way\nmore")

    monkeypatch.setattr("tfg_drake.diagrams.missions.run.write_report", fail)
    code, _, err = call("explore", room, "--headless", "--max-time", "1", "--out", str(tmp_path))
    assert code == 3
    assert err.startswith("tfg-drake: internal error: ValueError: no way more (test_cli.py, line ")
    assert err.count("\n") == 1


def test_the_progress_line():
    progress = Progress(
        time=120.0, wall_time=4.0, phase="follow", stage=7, landmarks="63 tags", area=412.4, position_error=0.0213
    )
    expected = " 120.0 s  stage   7 follow    63 tags   412 m2  error   2.1 cm  30.0 x real time"
    assert progress.line == expected
    untold = dataclasses.replace(progress, position_error=math.nan).line
    assert untold == " 120.0 s  stage   7 follow    63 tags   412 m2  30.0 x real time"
    over = dataclasses.replace(progress, outcome="complete").line
    assert over == " 120.0 s  complete: solving the whole map, writing the run's files"


@pytest.mark.parametrize(("number", "name"), SIGNALS)
def test_a_command_that_keeps_nothing_ends_at_once(call, monkeypatch, tmp_path, number, name):
    monkeypatch.setattr("tfg_drake.diagrams.interruption.TOGETHER", 0.0)
    monkeypatch.setattr("tfg_drake.diagrams.commands.view._timeline", lambda *_: os.kill(os.getpid(), number))
    code, out, err = call("export", str(tmp_path), str(tmp_path / "a.mp4"))
    assert (code, out, err.strip()) == (128 + number, "", "")


def run_in(folder, *arguments, before="", **given):
    """A command in a process and a folder of its own, something done before by the shell: its code and output."""
    line = f'{before} exec "$@"'
    command = ["sh", "-c", line, "sh", sys.executable, "-m", "tfg_drake.diagrams.cli", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False, **given)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_a_mission_without_standard_streams_is_as_any(room, tmp_path):
    arguments = ["explore", room, "--headless", "--max-time", "1", "--out", "run"]
    code, _, err = run_in(tmp_path, *arguments, before="exec <&- >&- 2>&-;")
    assert (code, err) == (0, "")
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["outcome"] == "time_limit"


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", "<&-", "2>&-"])
def test_closed_streams_change_nothing(small_map, tmp_path, closed):
    save_map(tmp_path / "map.npz", small_map)
    code, _, err = run_in(tmp_path, "map", "export", "map.npz", "a.csv", before=f"exec {closed};")
    assert (code, err) == (0, "")
    assert (tmp_path / "a.csv").read_text() == landmark_csv(load_map(tmp_path / "map.npz"))


@pytest.mark.slow
def test_names_that_the_terminal_cannot_show_are_spelled_out(small_map, tmp_path):
    save_map(tmp_path / "map.npz", small_map)
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    code, out, err = run_in(tmp_path, "map", "export", "map.npz", "a-\xfc.csv", env=environment)
    assert (code, err) == (0, "")
    assert out.startswith(r"a-\xfc.csv: ")
    assert (tmp_path / "a-\xfc.csv").exists()


@pytest.mark.slow
def test_a_mission_in_a_locale_without_utf_8_is_drawn_in_meshcat_and_spells_out_names(room, tmp_path):
    """In a process of its own: Drake's log is set up once."""
    environment = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    arguments = ["explore", room, "--headless", "--meshcat", "--max-time", "1", "--out", "run-\xfc"]
    code, out, err = run_in(tmp_path, *arguments, env=os.environ | environment)
    assert (code, err) == (0, "")
    assert re.search(r"^Meshcat: http://localhost:\d+$", out, re.MULTILINE)
    assert re.search(r"^files +run-(\\xfc|\\udcc3\\udcbc)$", out, re.MULTILINE)
    assert (tmp_path / "run-\xfc" / "summary.json").exists()


@pytest.mark.parametrize("arguments", [["explore", "house"], ["map", "info", "/"]])
def test_a_working_directory_that_is_gone_is_one_line(tmp_path, arguments):
    (tmp_path / "gone").mkdir()
    said = run_in(tmp_path / "gone", *arguments, before='rmdir "$PWD";')
    complaint = "the working directory: no such file or directory; change to another"
    assert said == (2, "", f"tfg-drake: {complaint}\n")


@pytest.mark.parametrize("kilobytes", [400_000, 1_000_000])
def test_too_little_address_space_is_one_line(tmp_path, kilobytes):
    said = run_in(tmp_path, "explore", "house", "--out", "run", before=f"ulimit -v {kilobytes};")
    complaint = f"ulimit -v: {kilobytes * 1.024e-3:.0f} MB of address space; raise it to 1074 or more"
    assert said == (2, "", f"tfg-drake: {complaint}\n")


@pytest.mark.parametrize(
    ("error", "complaint"),
    [
        (MemoryError(), "no memory or thread is left; end other programs, or raise the limits (ulimit -v, -u)"),
        (
            RuntimeError("can't start new thread"),
            "no memory or thread is left; end other programs, or raise the limits (ulimit -v, -u)",
        ),
        (PermissionError(errno.EACCES, "Permission denied", "/usr/bin/python"), "/usr/bin/python: permission denied"),
        (OSError(errno.ENOSPC, "No space left on device"), "no space left on device"),
        (FileError("summary.json: is damaged"), "summary.json: is damaged"),
    ],
)
def test_what_the_machine_refuses_is_one_line(call, monkeypatch, tmp_path, error, complaint):
    def fail(*_arguments):
        raise error

    monkeypatch.setattr("tfg_drake.diagrams.commands.view._timeline", fail)
    assert call("export", str(tmp_path), str(tmp_path / "a.mp4")) == (2, "", f"tfg-drake: {complaint}\n")


@pytest.mark.slow
def test_a_full_disk_behind_the_output_is_one_line(room, tmp_path):
    arguments = ["explore", room, "--tag-spacing", "1", "--headless", "--max-time", "1", "--out", "run"]
    said = run_in(tmp_path, *arguments, before="exec >/dev/full;")
    assert said == (2, "", "tfg-drake: no space left on device\n")
    assert (tmp_path / "run" / "summary.json").exists()


@pytest.mark.parametrize("error", [errno.EACCES, errno.EAGAIN])
def test_a_process_that_cannot_be_started_to_compile_is_named(call, monkeypatch, room, error):
    def refuse(*_arguments, **_given):
        raise OSError(error, os.strerror(error), sys.executable)

    monkeypatch.setattr(kernels, "are_compiled", lambda: False)
    monkeypatch.setattr(compile_kernels.subprocess, "Popen", refuse)
    code, _, err = call("explore", room, "--headless")
    complaint = f"cannot be started to compile kernels: {os.strerror(error).lower()}"
    assert (code, err) == (2, f"tfg-drake: {sys.executable}: {complaint}\n")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            "--method tgf",
            "--method tgf: no such method; name a .py file or one of tfg, tfg-argmax, paper, tfg-nearest, "
            "grid-nearest, weighted, random, scripted, manual",
        ),
        (
            "house --method grid-nearest --set explorer.return_home=true",
            "--method grid-nearest: does not mind explorer.return_home; leave it out, or take another method: tfg",
        ),
        (
            "--robot ros2 --preset turtlebot9",
            "turtlebot9: no such file or preset; name a YAML file or one of emulated, turtlebot2, turtlebot3, "
            "turtlebot4",
        ),
        (
            "--robot rosbridge --bridge robot",
            "rosbridge: robot is no HOST:PORT; name the server such as localhost:9090",
        ),
        (
            "--robot kobuki --scan rplidar:/dev/null --port /dev/none",
            "/dev/none: no such device; plug the base in and switch it on, or name the port it has under "
            "/dev/serial/by-id",
        ),
        (
            "--robot ros2 --method manual",
            "--method manual: is for a simulated robot; leave --robot out",
        ),
        (
            "house --start 2,3,1",
            "world.start: (2, 3) is too near to the wall from (2.6, 3.1) to (1.6, 3.1): 0.100 m, the robot's radius is "
            "0.18 m; start at (1.3, 3), the nearest free place",
        ),
        ("house --page-port 70000", "port 70000: must be between 1 and 65535"),
    ],
)
def test_arguments_are_judged_before_anything_is_compiled_or_said(call, monkeypatch, arguments, complaint):
    monkeypatch.setattr(kernels, "are_compiled", lambda: False)
    monkeypatch.setattr("tfg_drake.diagrams.compile_kernels.WarmUp", None)
    assert call("explore", *arguments.split()) == (2, "", f"tfg-drake: {complaint}\n")


def test_who_interrupts_the_compiling_does_not_wait_for_it(call, monkeypatch):
    class Compiling:
        word, ended = "compiling kernels", False

        def close(self):
            pass

    def interrupt(_seconds):
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(kernels, "are_compiled", lambda: False)
    monkeypatch.setattr("tfg_drake.diagrams.compile_kernels.WarmUp", Compiling)
    monkeypatch.setattr("tfg_drake.diagrams.compile_kernels.time.sleep", interrupt)
    code, out, _ = call("explore", "house", "--headless")
    assert (code, "outcome" in out) == (128 + signal.SIGINT, False)

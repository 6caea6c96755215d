"""`tfg-drake explore --resume` and `--map`."""

import json
import shutil

import pytest

from tests.storage.test_checkpoint import TOLD
from tfg_drake.diagrams.missions.resume import scenario_digest
from tfg_drake.storage.checkpoint import write_checkpoint


@pytest.fixture
def cut(tmp_path):
    """The folder of a mission that was cut short, as far as it is looked at before anything is driven."""
    folder = tmp_path / "cut"
    folder.mkdir()
    tell(folder)
    return folder


def tell(folder, **told):
    write_checkpoint(folder / "checkpoint.bin", {**TOLD, "scenario_digest": scenario_digest(folder), **told}, {})


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["house"], "scenario: is that of the run which is resumed; leave it out"),
        (["--seed", "3"], "--seed: is that of the run which is resumed; leave it out"),
        (["--set", "seed=3"], "--set: is that of the run which is resumed; leave it out"),
        (["--start", "1,2,0"], "--start: is that of the run which is resumed; leave it out"),
        (["--map", "x"], "--map: is that of the run which is resumed; leave it out"),
        (["--method", "paper"], "--method paper: the run that is resumed has tfg; leave it out"),
        (["--robot", "kobuki"], "--robot kobuki: the run that is resumed drove sim; leave it out"),
    ],
)
def test_what_a_run_has_already_is_refused(call, cut, arguments, line):
    assert call("explore", "--resume", cut, "--headless", *arguments) == (2, "", f"tfg-drake: {line}\n")


def test_a_run_does_not_say_what_code_is_run(call, cut, tmp_path):
    mine = tmp_path / "mine.py"
    mine.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    tell(cut, method="mine", own=True)
    line = f"--resume {cut}: its method, mine, is somebody's own; give it again: --method FILE"
    for given in ([], ["--method", "paper"]):
        assert call("explore", "--resume", cut, "--headless", *given) == (2, "", f"tfg-drake: {line}\n")
    tell(cut, method=str(mine))
    code, _, complaint = call("explore", "--resume", cut, "--headless")
    assert (code, complaint.count("\n")) == (2, 1)
    assert f"no method is called {mine}" in complaint
    assert not (tmp_path / "ran").exists()


def test_a_run_does_not_say_that_a_real_robot_is_driven(call, cut):
    tell(cut, robot="kobuki")
    line = f"--resume {cut}: that run drove a real robot; give it again: --robot kobuki"
    assert call("explore", "--resume", cut, "--headless") == (2, "", f"tfg-drake: {line}\n")


def test_another_scenario_is_noticed(call, cut):
    for name in ("scenario.yaml", "known_map.npz"):
        (cut / name).write_text("base: house\n")
        code, _, complaint = call("explore", "--resume", cut, "--headless")
        assert (code, complaint.count("\n")) == (2, 1)
        assert f"{cut / 'scenario.yaml'}: it, or the map begun with, is not that of the run" in complaint
        (cut / name).unlink()


@pytest.mark.parametrize("name", ["log.txt", "timeline.tfg", "ports.mcap", "scenario.yaml"])
def test_links_out_of_the_folder_are_not_followed(call, cut, tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine\n")
    (cut / name).symlink_to(elsewhere)
    code, _, complaint = call("explore", "--resume", cut, "--headless")
    assert (code, complaint) == (2, f"tfg-drake: {cut / name}: is a link; put the file itself there\n")
    assert elsewhere.read_text() == "mine\n"


def test_a_terminal_takes_no_orders_from_a_complaint(call, tmp_path):
    code, _, complaint = call("explore", tmp_path / "\x1b[2J\u202e.yaml", "--headless")
    assert code == 2
    assert "\\x1b[2J\\u202e.yaml" in complaint


def test_what_is_no_run_is_told(call, tmp_path):
    code, _, complaint = call("explore", "--resume", tmp_path, "--headless")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "holds no mission to go on with" in complaint
    code, _, complaint = call("explore", "house", "--map", tmp_path / "x.npz", "--headless")
    assert (code, complaint) == (
        2,
        f"tfg-drake: {tmp_path / 'x.npz'}: no such file; name the folder of a run that was recorded\n",
    )


def test_the_checkpoint_stands_for_its_folder(call, cut):
    said = call("explore", "--resume", cut, "--headless")
    assert said[0] == 2
    assert f"{cut / 'scenario.yaml'}: no such file" in said[2]
    assert call("explore", "--resume", cut / "checkpoint.bin", "--headless") == said


@pytest.mark.slow
def test_a_mission_goes_on_and_the_next_one_begins_with_its_map(call, room, tmp_path):
    half, whole = tmp_path / "half", tmp_path / "whole"
    arguments = ["--headless", "--json"]
    quick = ["--set", "explorer.first_look=2", "--set", "explorer.first_turns=1"]
    assert call("explore", room, *quick, "--tag-spacing", 1, "--max-time", 6, "--out", half, *arguments)[0] == 0
    code, out, err = call("explore", "--resume", half, "--out", whole, *arguments)
    assert err == ""
    summary = json.loads(out.splitlines()[-1])
    assert (code, summary["resumed_at_s"], summary["outcome"]) == (0, [6.0], "complete")
    shutil.rmtree(half)
    code, _, complaint = call("explore", "--resume", whole)
    mend = f"that mission has ended; begin another one with its map: --map {whole}"
    assert (code, complaint) == (2, f"tfg-drake: {whole}: {mend}\n")
    known = ["--map", whole, "--max-time", 15, "--out", tmp_path / "next", *quick]
    code, out, _ = call("explore", room, "--tag-spacing", 1, *known, *arguments)
    assert code == 0
    assert json.loads(out.splitlines()[-1])["changes"]["tags_moved"] == []
    assert any(line.startswith("known map   the robot found itself at") for line in out.splitlines())

"""`tfg-drake explore --resume` and `--map`."""

import json
import shutil

import pytest

from tfg_drake.storage.checkpoint import write_checkpoint

TOLD = {"scenario": "room", "world": "room", "seed": 0, "robot": "sim", "method": "tfg", "source": "tfg"}


@pytest.fixture
def cut(tmp_path):
    """The folder of a mission that was cut short, as far as it is looked at before anything is driven."""
    folder = tmp_path / "cut"
    folder.mkdir()
    write_checkpoint(folder / "checkpoint.bin", TOLD, {})
    return folder


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


def test_what_is_no_run_is_told(call, tmp_path):
    code, _, complaint = call("explore", "--resume", tmp_path, "--headless")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "holds no mission to go on with" in complaint
    code, _, complaint = call("explore", "house", "--map", tmp_path / "x.npz", "--headless")
    assert (code, complaint) == (2, f"tfg-drake: no such map: {tmp_path / 'x.npz'}\n")


def test_the_checkpoint_stands_for_its_folder(call, cut):
    said = call("explore", "--resume", cut, "--headless")
    assert said[0] == 2
    assert f"{cut / 'scenario.yaml'}: no such file" in said[2]
    assert call("explore", "--resume", cut / "checkpoint.bin", "--headless") == said


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

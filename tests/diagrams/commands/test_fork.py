"""tfg-drake fork: the other future of a run."""

import json

import pytest

from tests.diagrams.rooms import DIVIDED, QUICK_LOOK, tagged
from tfg_drake.comparison.differences import _ROWS
from tfg_drake.comparison.measures import MEASURES
from tfg_drake.diagrams.missions import run


@pytest.fixture(scope="module")
def original(tmp_path_factory, compiled):
    return run.run_mission(
        tagged(DIVIDED + QUICK_LOOK), name="room", out_dir=tmp_path_factory.mktemp("original"), max_time=15.0
    )


@pytest.mark.slow
def test_nothing_changed_is_no_difference(call, original, tmp_path):
    out = tmp_path / "fork"
    code, said, _ = call("fork", original.folder, "--stage", 2, "--out", out)
    assert code == 0
    for name in ("stages.jsonl", "trajectory.tum", "map.npz"):
        assert (out / name).read_bytes() == (original.folder / name).read_bytes(), name
    table = said.partition("\n\n")[2].splitlines()[2:-1]
    assert len(table) == 11
    assert all(line.endswith("=") for line in table)


@pytest.mark.slow
def test_another_goal_makes_another_run(call, original, tmp_path):
    out = tmp_path / "fork"
    code, said, _ = call("fork", original.folder, "--stage", 2, "--goal", "1,3", "--out", out, "--json")
    summary = json.loads(said.splitlines()[-1])
    assert summary["scenario"] == "room-fork"
    assert code in (0, 1)
    assert "candidate   x m" in said
    assert "chosen" in said
    assert (out / "stages.jsonl").read_bytes() != (original.folder / "stages.jsonl").read_bytes()
    difference = summary["distance_m"] - original.summary["distance_m"]
    assert f"{difference:+.1f} m" in next(line for line in said.splitlines() if line.startswith("driven"))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["RUN", "--stage", "2", "--goal", "1,3", "--candidate", "1"], "--goal and --candidate exclude each other"),
        (["RUN", "--stage", "2", "--goal", "1"], "--goal 1: must be X,Y in metres, such as 1.5,2"),
        (["RUN", "--stage", "0"], "stage 0: "),
        (["RUN", "--stage", "2", "--candidate", "9999"], "candidate 9999: stage 2 has 1 to "),
        (["RUN", "--stage", "2", "--out", "RUN"], "holds the run that is forked; name another folder"),
        (["nowhere", "--stage", "2"], "nowhere: holds no run"),
    ],
)
def test_bad_input_is_one_line(call, original, tmp_path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(tmp_path)
    code, _, said = call("fork", *(original.folder if word == "RUN" else word for word in arguments))
    assert code == 2
    assert complaint in said
    assert said.count("\n") == 1
    assert not list(tmp_path.glob("runs/*"))


def test_a_fork_names_things_as_the_report_of_a_comparison_does():
    named = {name for name, _, _ in _ROWS} & {measure.name for measure in MEASURES}
    assert named == {"time", "driven", "stages", "tags mapped", "walls mapped", "surface within 5 cm", "area seen"}

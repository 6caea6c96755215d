"""tfg-drake tags advise: a world to explore, a table, and one line for what cannot be used."""

import pytest

from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.mapfile.saved_map import save_map

ROOM = """
world:
  start: [1, 1, 0]
  walls: [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]]
  tags: [{id: 1, position: [2, 0.01], facing: 1.5708}]
"""


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    return path


def test_the_advised_world_can_be_explored(call, room, tmp_path):
    out = tmp_path / "advised.yaml"
    code, said, _ = call("tags", "advise", "--world", room, "--count", 3, "--out", out)
    assert code == 0
    assert f"explore --world {out}" in said
    world = MakeWorld(LoadScenario(out).world)
    assert world.tag_ids.tolist() == [1, 0, 2, 3]  # what hangs, then the numbers that are free
    assert world.walls.shape == (4, 4)
    rows = [line.split() for line in said.splitlines() if line.split()[0] in ("0", "2", "3")]
    assert [float(row[1]) for row in rows] == pytest.approx(world.p_WT[1:, 0], abs=0.006)
    worst = [float(row[-1]) for row in rows]
    assert worst == sorted(worst, reverse=True)


def test_fresh_forgets_the_tags_that_hang(call, room, tmp_path):
    out = tmp_path / "advised.yaml"
    assert call("tags", "advise", "--world", room, "--fresh", "--count", 2, "--out", out)[0] == 0
    assert MakeWorld(LoadScenario(out).world).tag_ids.tolist() == [0, 1]


def test_a_mission_gets_tags_beside_those_that_it_mapped(call, room, tmp_path, small_map):
    run, out = tmp_path / "run", tmp_path / "more.yaml"
    run.mkdir()
    (run / "scenario.yaml").write_text(ROOM)
    save_map(run / "map.npz", small_map)
    code, _, said = call("tags", "advise", run, "--count", 1, "--out", out)
    assert code == 0, said
    world = MakeWorld(LoadScenario(out).world)
    assert world.tag_ids.tolist() == [*small_map.ids.tolist(), 0]
    assert world.start == pytest.approx(small_map.X_WM)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "tags advise: name either the folder of a mission or --world FILE"),
        (["run", "--world", "room"], "tags advise: name either the folder of a mission or --world FILE"),
        (["run", "--fresh"], "--fresh: goes with --world; of a mission both are known"),
        (["--world", "ROOM", "--count", "0"], "--count 0: must be 1 or more"),
        (["--world", "ROOM", "--start", "1,2"], "--start 1,2: must be X,Y,YAW in metres and radians"),
        (["--world", "ROOM", "--start", "a,b,c"], "--start a,b,c: must be X,Y,YAW in metres and radians"),
        (["--world", "ROOM", "--out", "ROOM"], "is the world that is read; name another file"),
        (["nowhere"], "nowhere/scenario.yaml: no such file or scenario"),
    ],
)
def test_bad_input_is_one_line(call, room, arguments, complaint):
    code, _, said = call("tags", "advise", *(str(room) if word == "ROOM" else word for word in arguments))
    assert code == 2
    assert complaint in said
    assert said.count("\n") == 1

"""A mission that somebody drives by hand."""

import numpy as np
import pytest

from benchmarks.timelines import read_timeline
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.config import RobotConfig
from tfg_drake.diagrams.methods import FindMethod, MethodError
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.sweep import SweepError, parse_methods
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario
from tfg_drake.mission import manual_drive
from tfg_drake.mission.manual_drive import Pressed, drive_csv, read_drive, steered

ROOM = """
seed: 3
world:
  start: [1, 2, 0]
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
explorer: {first_look: 1, first_turns: 1}
"""
# Forward at 0.3 m/s, a look round, on in a curve to the left, and the end.
DRIVE = (
    *(Pressed(7.0, "forward"),) * 3,
    Pressed(13.0, "look"),
    *(Pressed(18.0, "forward"),) * 2,
    Pressed(19.0, "stick 0.60 0.30"),
    Pressed(23.0, "halt"),
    Pressed(25.0, "end"),
)


def room(seed=3):
    scenario = ApplyWorldFile(LoadScenario(data=ROOM), tag_spacing=1.0)
    scenario.seed = seed
    return scenario


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    (folder / "drive.csv").write_text(drive_csv(DRIVE))
    method = FindMethod(str(folder / "drive.csv"))
    return run.run_mission(room(), method=method, out_dir=folder / "run", max_time=120.0)


def test_the_robot_goes_where_it_is_driven_and_the_map_grows(driven):
    assert driven.summary["reason"].startswith("The drive is over")
    goals = np.array([stage["goal"] for stage in driven.stages])
    # 6 s at 0.3 m/s from (1, 2), straight ahead, give or take its getting up to speed.
    straight = np.array([stage["time_s"] for stage in driven.stages]) < 13.0
    assert np.abs(goals[straight, 1] - 2.0).max() < 0.2
    assert goals[:, 0].max() > 2.6
    assert abs(goals[-1, 1] - 2.0) > 0.2  # in a curve
    assert driven.summary["landmarks_mapped"] > 0.8 * driven.summary["landmarks_reachable"]
    assert driven.summary["position_error_m"]["max"] < 0.1
    assert driven.summary["method"] == "manual"


@pytest.mark.slow
def test_the_keys_are_kept_and_drive_once_more_to_the_bit(driven, tmp_path):
    keys = driven.folder / "keys.csv"
    assert [one.key for one in read_drive(keys)] == [one.key for one in DRIVE]
    again = run.run_mission(room(), method=FindMethod(str(keys)), out_dir=tmp_path / "again", max_time=120.0)
    for name in ("stages.jsonl", "trajectory.tum", "map.npz", "keys.csv"):
        assert (again.folder / name).read_bytes() == (driven.folder / name).read_bytes(), name


@pytest.mark.slow
def test_a_driver_may_take_all_the_time_there_is(tmp_path):
    """Nobody turns the robot, or ends the mission, while it stands."""
    result = run.run_mission(room(), method=FindMethod("manual"), out_dir=tmp_path, max_time=400.0)
    assert (result.summary["outcome"], result.summary["stages"]) == ("time_limit", 1)


def test_keys_change_the_velocity_within_the_robots_limits():
    robot = RobotConfig(max_speed=0.25, max_turn_rate=0.5)
    velocity = (0.0, 0.0)
    for key, expected in (
        ("forward", (0.1, 0.0)),
        ("left", (0.1, 0.3)),
        ("left", (0.1, 0.5)),
        ("back", (0.0, 0.5)),
        *((key, None) for key in ["back"] * 5),
        ("right", (-0.25, 0.2)),
        ("halt", (0.0, 0.0)),
    ):
        velocity = steered(velocity, key, robot)
        assert expected is None or velocity == pytest.approx(expected)


def test_a_stick_is_a_share_of_the_robots_most():
    robot = RobotConfig(max_speed=0.25, max_turn_rate=0.5)
    assert steered((0.1, 0.3), manual_drive.stick(0.5, -1.5), robot) == (0.125, -0.5)
    assert steered((0.1, 0.3), manual_drive.stick(0.0, 0.0), robot) == (0.0, 0.0)


@pytest.mark.slow
def test_the_robot_drives_by_itself_where_its_driver_sends_it(tmp_path, monkeypatch):
    asked = iter([()] * 120 + [[(3.0, 1.0)]])
    monkeypatch.setattr(Cockpit, "requests", lambda _: next(asked, ()))
    with Cockpit("", "room", rate=0.0) as cockpit:
        result = run.run_mission(room(), method=FindMethod("manual"), out_dir=tmp_path, max_time=24.0, cockpit=cockpit)
    # It has looked round there, on the planner's path, and then waits for its driver.
    x, y, _ = result.stages[-1]["goal"]
    assert np.hypot(x - 4.0, y - 3.0) < 0.6
    assert result.summary["distance_m"] > 2.0
    assert [one.told["reason"] for one in read_timeline(tmp_path) if one.layer == "goal"][-1] == "Somebody drives."

    # Where it was sent is kept with the keys, and so it goes there once more.
    keys = tmp_path / "keys.csv"
    assert [one.key for one in read_drive(keys)] == ["send 3.0 1.0"]
    again = run.run_mission(room(), method=FindMethod(str(keys)), out_dir=tmp_path / "again", max_time=24.0)
    assert (again.folder / "trajectory.tum").read_bytes() == (tmp_path / "trajectory.tum").read_bytes()


def test_a_comparison_wants_keys_that_were_pressed(driven):
    keys = driven.folder / "keys.csv"
    named = [(method.name, method.source) for method in parse_methods(f"tfg,{keys}", room())]
    assert named == [("tfg", ""), ("manual", str(keys))]
    with pytest.raises(SweepError, match=r"--methods manual: nobody is at the keys; name the keys\.csv of a run"):
        parse_methods("tfg,manual", room())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x,y\n1,2\n", "holds no drive; name the keys.csv of a run with --method manual"),
        ("time_s,key\n1.0,stick 0.5 1.5\n", "line 2: expected a time, not before the last, and a key; mend the line"),
        ("time_s,key\n1.0,send 1.0 nan\n", "line 2: expected a time, not before the last, and a key; mend the line"),
        ("time_s,key\n1.0,jump\n", "line 2: expected a time, not before the last, and a key; mend the line"),
        ("time_s,key\n2.0,look\n1.0,look\n", "line 3: expected a time"),
    ],
)
def test_what_is_no_drive_is_told(tmp_path, text, complaint):
    (tmp_path / "keys.csv").write_text(text)
    with pytest.raises(MethodError) as caught:
        FindMethod(str(tmp_path / "keys.csv"))
    assert complaint in str(caught.value)


def test_arrows_and_letters_are_keys():
    assert set(manual_drive.KEYS.values()) == {"forward", "back", "left", "right", "halt", "look", "end"}

"""A mission that begins with the map of an earlier one."""

import dataclasses
import json

import numpy as np
import pytest

import tfg_drake
from tests.diagrams.rooms import ROOMS
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.methods import METHODS, MethodError
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.errors import driven
from tfg_drake.diagrams.missions.resume import cut_short
from tfg_drake.diagrams.recorded_station import ReplayRobot
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario
from tfg_drake.mapfile.saved_map import MapFileError
from tfg_drake.messages import SaidPose
from tfg_drake.storage.port_recording import SAID, read_recording


def rooms():
    return ApplyWorldFile(LoadScenario(data=ROOMS), tag_spacing=1.0)


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    return run.run_mission(rooms(), name="rooms", out_dir=tmp_path_factory.mktemp("first"))


@pytest.fixture(scope="module")
def second(first, tmp_path_factory):
    """Elsewhere in the same rooms, where a tag hangs elsewhere and a post stands."""
    scenario = rooms()
    scenario.seed, scenario.world.start = 4, [7.5, 3.0, 2.0]
    scenario.world.walls += [[4, 1, 4.4, 1], [4.4, 1, 4.4, 1.4], [4.4, 1.4, 4, 1.4], [4, 1.4, 4, 1]]
    moved = scenario.world.tags[0]
    scenario.world.tags[0] = dataclasses.replace(moved, position=[moved.position[0] + 0.35, moved.position[1]])
    scenario.explorer.known_map = str(first.folder)
    return run.run_mission(scenario, name="rooms", out_dir=tmp_path_factory.mktemp("second")), moved.id


def test_it_finds_itself_and_tells_what_has_changed(first, second):
    result, moved = second
    summary, changes = result.summary, result.summary["changes"]
    assert first.summary["changes"] is None
    assert summary["outcome"] == "complete"
    assert 0.0 <= changes["found_at_s"] < 5.0
    assert (changes["tags_moved"], changes["tags_gone"], changes["tags_new"]) == ([moved], [], [])
    middle = np.array(changes["surfaces_new"]).reshape(-1, 2, 2).mean(axis=1)
    assert len(middle)
    assert np.all(np.abs(middle - [4.2, 1.2]) < 0.35)
    assert changes["surfaces_gone"] == []
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"]
    assert summary["landmark_rmse_m"] < 0.02
    # The errors before it has found itself do not count: it began 6 m from where the map does.
    assert summary["position_error_m"]["max"] < 0.2
    # The way before counts as driven, the jump to the place that it has found does not.
    assert driven(*result.mission.estimated_poses(lost=True)) == pytest.approx(summary["distance_m"], rel=0.02)
    assert summary["map_bytes"] < 2.0 * first.summary["map_bytes"]


@pytest.mark.slow
def test_in_another_building_it_maps_apart_and_says_so(first, tmp_path):
    scenario = rooms()
    scenario.world.walls = [[0, 0, 5, 0], [5, 0, 5, 3], [5, 3, 2, 3], [2, 3, 2, 4], [2, 4, 0, 4], [0, 4, 0, 0]]
    scenario.world.tags, scenario.world.start = [], [1.0, 1.0, 0.3]
    scenario.explorer.known_map = str(first.folder)
    before = (first.folder / "map.npz").read_bytes()
    summary = run.run_mission(scenario, name="room", out_dir=tmp_path / "run").summary
    assert summary["outcome"] == "apart"
    assert summary["reason"].startswith("It has not found itself in the map that it began with: ")
    assert summary["changes"]["found_at_s"] is None
    # In a frame of its own, which in simulation is known.
    assert summary["position_error_m"]["max"] < 0.1
    assert summary["surface_phantom_m"] < 0.1
    assert summary["walls_mapped"] < 9
    assert (first.folder / "map.npz").read_bytes() == before


def test_the_folder_has_the_map_that_it_began_with(first, second, tmp_path):
    result, _ = second
    assert (result.folder / "known_map.npz").read_bytes() == (first.folder / "map.npz").read_bytes()
    moved = tmp_path / "moved"
    result.folder.rename(moved)
    assert LoadScenario(moved / "scenario.yaml").explorer.known_map == str(moved / "known_map.npz")
    moved.rename(result.folder)


@pytest.mark.slow
def test_from_python_it_goes_on_when_it_was_cut(first, tmp_path):
    scenario = rooms()
    half = tfg_drake.explore(scenario, map=first.folder, until=8.0, out=tmp_path / "half")
    assert half.summary["changes"]["found_at_s"] < 5.0
    # It has seen little of the rooms, all of which the first session has seen.
    assert half.summary["undiscovered"][0]["probability"] < first.summary["undiscovered"][0]["probability"] + 0.1
    before = cut_short(half.folder, tmp_path / "after")
    assert before.request.scenario.explorer.known_map == str(tmp_path / "after" / "known_map.npz")
    after = tfg_drake.explore(resume=half.folder, out=tmp_path / "after", until=9.0)
    assert (after.folder / "known_map.npz").exists()
    assert json.loads((after.folder / "summary.json").read_text())["resumed_at_s"] == [8.0]


def without_tags(folder):
    """Elsewhere in the rooms of a map, with nothing but walls to be found by."""
    scenario = rooms()
    scenario.seed, scenario.world.start, scenario.world.tags = 4, [7.5, 3.0, 2.0], []
    scenario.explorer.known_map, scenario.explorer.first_look = str(folder), 0.0
    return scenario


@pytest.mark.slow
def test_what_is_said_of_its_place_is_recorded_and_replays_to_the_bit(first, tmp_path, monkeypatch):
    scenario, said = without_tags(first.folder), SaidPose(X_WB=np.array([7.4, 3.1, 1.9]))

    def driven(out, end, before=None, asked=()):
        asked = iter(asked)
        monkeypatch.setattr(Cockpit, "requests", lambda _: next(asked, ()))
        state = None if before is None else before.request.before
        with Cockpit("", "rooms", rate=0.0) as cockpit:
            return run.run_mission(scenario, name="rooms", max_time=end, out_dir=out, cockpit=cockpit, before=state)

    whole = driven(tmp_path / "whole", 6.0, asked=[()] * 8 + [[said]])
    half = driven(tmp_path / "half", 3.0, asked=[()] * 8 + [[said]])
    after = driven(tmp_path / "after", 6.0, before=cut_short(half.folder, tmp_path / "after"))
    robot = ReplayRobot(read_recording(after.folder))
    again = run.run_mission(scenario, name="rooms", max_time=6.0, out_dir=tmp_path / "again", robot=robot)
    for one in (whole, after, again):
        (heard,) = read_recording(one.folder).messages[SAID]
        assert (heard.stamp, heard.count, heard.X_WB.tolist()) == (0.5625, 1, said.X_WB.tolist())
        assert one.summary["changes"]["places"] == 1  # of two, had nobody said it
        assert (one.folder / "map.npz").read_bytes() == (whole.folder / "map.npz").read_bytes()
        assert len(one.stages) == 1
        assert (one.folder / "stages.jsonl").read_bytes() == (whole.folder / "stages.jsonl").read_bytes()


def test_what_is_no_map_is_told(tmp_path):
    scenario = rooms()
    scenario.explorer.known_map = str(tmp_path / "nothing.npz")
    with pytest.raises(MapFileError, match="no such file"):
        tfg_drake.explore(scenario, until=0.0)
    with pytest.raises(MethodError, match="cannot begin with a map"):
        METHODS["grid-nearest"].Check(scenario)

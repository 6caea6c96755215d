"""Areas that the robot must not enter: a mission ends without them, and what is none is told in one line."""

import json

import numpy as np
import pytest
import shapely

from tests.diagrams.rooms import QUICK_LOOK
from tfg_drake.diagrams.scenario import (
    AreasOutside,
    CheckScenario,
    DumpScenario,
    LoadScenario,
    MakeKeepOut,
    PrepareScenario,
    Scenario,
    ScenarioError,
)

# A corridor of 12 x 2 m, barred half-way; or a room round a shaft.
CORRIDOR = "[[0, 0, 12, 0], [12, 0, 12, 2], [12, 2, 0, 2], [0, 2, 0, 0]]"
HALL = "[[0, 0, 8, 0], [8, 0, 8, 6], [8, 6, 0, 6], [0, 6, 0, 0], [4, 4.5, 4, 6]]"
BAR, SHAFT = [[5, -0.2], [6, -0.2], [6, 2.2], [5, 2.2]], [[3, 2], [5, 1.8], [5.2, 3.5], [3.5, 3.8]]


@pytest.fixture
def explore(call, tmp_path):
    def run(walls, keep_out, *options, start="[1.5, 1, 0.3]"):
        scenario, out = tmp_path / "barred.yaml", tmp_path / "run"
        scenario.write_text(f"seed: 3\n{QUICK_LOOK}world: {{start: {start}, walls: {walls}}}\n")
        setting = f"explorer.keep_out={json.dumps(keep_out)}".replace("NaN", ".nan")
        arguments = [scenario, "--tag-spacing", 1, "--set", setting, *options, "--headless", "--out", out]
        code, _, err = call("explore", *arguments)
        if not (out / "truth.tum").exists():
            return code, err, None, None
        way = np.loadtxt(out / "truth.tum")[:, 1:3]
        return code, err, json.loads((out / "summary.json").read_text()), way

    return run


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tfg", "grid-nearest"])
def test_what_lies_behind_a_barred_corridor_keeps_no_mission_from_its_end(explore, method):
    code, err, summary, way = explore(CORRIDOR, [BAR], "--method", method, "--max-time", 400)
    assert (code, err, summary["outcome"]) == (0, "", "complete")
    assert way[:, 0].max() < 5 - 0.18
    assert summary["area_coverage"] > 0.99


def test_the_robot_drives_round_an_area(explore):
    code, err, summary, way = explore(HALL, [SHAFT], "--max-time", 600)
    assert (code, err, summary["outcome"]) == (0, "", "complete")
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"]
    assert shapely.distance(shapely.LineString(way), shapely.Polygon(SHAFT)) > 0.18


@pytest.mark.parametrize(
    ("keep_out", "complaint"),
    [
        (
            [[[1, 0], [2, 0], [2, 2], [1, 2]]],
            "explorer.keep_out: the robot starts in it, at (1.5, 1), or nearer to it ",
        ),
        (
            [[[1.6, 0], [2, 0], [2, 2], [1.6, 2]]],
            "explorer.keep_out: the robot starts in it, at (1.5, 1), or nearer to",
        ),
        (
            [BAR, [[0, 0], [1, 0]]],
            "explorer.keep_out[1]: has 2 corners; give the three or more corners [x, y] of a poly",
        ),
        (
            [[[3, 0], [4, 1], [4, 0], [3, 1]]],
            "explorer.keep_out[0]: crosses or touches itself between corners 0 and 1; ",
        ),
        (
            [BAR, [[3, 0], [4, 1], [3, 0]]],
            "explorer.keep_out[1]: has 2 corners; give the three or more corners [x, y] of a poly",
        ),
        (
            [[[50, 0], [50, 1e300], [60, 0]]],
            "explorer.keep_out[0]: has a corner more than 1e+08 m from the origin; give the three",
        ),
        (
            [BAR, [[50, 0], [20000, 20000], [60, 0]]],
            "explorer.keep_out[1]: its corner (20000, 20000) is more than 1000 m from where the map begins; check",
        ),
        ([[[3, 0], [4, float("nan")], [4, 0]]], "explorer.keep_out[0][1][1]: must be finite, is nan"),
        ([[[3, 0], [4, 1, 2], [4, 0]]], "explorer.keep_out[0][1]: expected 2 numbers [x, y], found 3"),
        ([[3, 0], [4, 1], [4, 0]], "explorer.keep_out[0][0]: expected a list, found int (3)"),
    ],
)
def test_what_is_no_area_or_holds_the_start_is_one_clear_line(explore, keep_out, complaint):
    code, err, summary, _ = explore(CORRIDOR, keep_out)
    assert (code, summary, err.count("\n")) == (2, None, 1)
    assert complaint in err


def test_a_ring_that_ends_where_it_begins_is_the_same_area():
    scenario, ring = Scenario(), Scenario()
    scenario.explorer.keep_out, ring.explorer.keep_out = [SHAFT], [[*SHAFT, SHAFT[0]]]
    CheckScenario(ring)
    np.testing.assert_array_equal(MakeKeepOut(ring), MakeKeepOut(scenario))


def test_an_area_outside_the_building_is_told():
    scenario = LoadScenario("house")
    beyond, across = [[20, 0], [21, 0], [21, 1]], [[-5, -5], [20, -5], [20, 20], [-5, 20]]
    scenario.explorer.keep_out = [SHAFT, beyond, across, [[0, -9], [1, -9], [1, -8]]]
    told = "explorer.keep_out[{}]: lies outside the building, so it bars nothing; is this meant?"
    assert AreasOutside(scenario) == [told.format(1), told.format(3)]
    scenario.world.walls = []
    assert AreasOutside(scenario) == []


def test_the_areas_of_the_run_whose_map_is_begun_with_hold_again(tmp_path, caplog):
    before, own = Scenario(), Scenario()
    before.explorer.keep_out, own.explorer.keep_out = [SHAFT], [BAR]
    (tmp_path / "scenario.yaml").write_text(DumpScenario(before))
    for known in (tmp_path, tmp_path / "map.npz"):
        caplog.clear()
        assert PrepareScenario("house", known_map=known).explorer.keep_out == [SHAFT]
        told = f"1 of {tmp_path / 'scenario.yaml'} hold once the robot knows its place"
        assert caplog.messages == [f"keep-out areas: {told}; --set explorer.keep_out=[] for none"]
    caplog.clear()
    assert PrepareScenario(own, known_map=tmp_path).explorer.keep_out == [BAR]
    assert PrepareScenario("house", ["explorer.keep_out=[]"], known_map=tmp_path).explorer.keep_out == []
    gone = f"keep-out areas: 1 of {tmp_path / 'scenario.yaml'} hold no longer, as others are given"
    assert caplog.messages == [gone] * 2
    caplog.clear()
    own.explorer.keep_out.append(SHAFT)
    assert PrepareScenario(own, known_map=tmp_path).explorer.keep_out == [BAR, SHAFT]
    # A map of another name may lie in another frame.
    assert PrepareScenario("house", known_map=tmp_path / "aligned.npz").explorer.keep_out == []
    assert caplog.messages == []
    (tmp_path / "scenario.yaml").write_text("explorer: {keep_out: [[[0, 0], [1, 0]]]}\n")
    with pytest.raises(ScenarioError, match=r"scenario\.yaml: explorer\.keep_out\[0\]: has 2 corners"):
        PrepareScenario("house", known_map=tmp_path)


def test_areas_taken_over_are_told_on_the_screen(call, tmp_path):
    before = Scenario()
    before.explorer.keep_out = [SHAFT]
    (tmp_path / "scenario.yaml").write_text(DumpScenario(before))
    _, out, err = call("explore", "house", "--map", tmp_path, "--headless", "--out", tmp_path / "next")
    assert f"keep-out areas: 1 of {tmp_path / 'scenario.yaml'} hold once the robot knows its place" in out
    assert "no such file" in err  # the map

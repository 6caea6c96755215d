"""Areas that the robot must not enter: a mission ends without them, and what is none is told in one line."""

import json

import numpy as np
import pytest
import shapely

from tests.diagrams.rooms import QUICK_LOOK

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
        ([[[3, 0], [4, float("nan")], [4, 0]]], "explorer.keep_out[0][1][1]: must be finite, is nan"),
        ([[[3, 0], [4, 1, 2], [4, 0]]], "explorer.keep_out[0][1]: expected 2 numbers [x, y], found 3"),
        ([[3, 0], [4, 1], [4, 0]], "explorer.keep_out[0][0]: expected a list, found int (3)"),
    ],
)
def test_what_is_no_area_or_holds_the_start_is_one_clear_line(explore, keep_out, complaint):
    code, err, summary, _ = explore(CORRIDOR, keep_out)
    assert (code, summary, err.count("\n")) == (2, None, 1)
    assert complaint in err

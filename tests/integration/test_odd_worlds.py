"""Worlds that leave little or nothing to do, and worlds that cannot be used: a clear end or one clear line."""

import gzip
import json
import re

import pytest

from tests.diagrams.rooms import QUICK_LOOK

BOX = "[[-0.5, -0.5, 0.5, -0.5], [0.5, -0.5, 0.5, 0.5], [0.5, 0.5, -0.5, 0.5], [-0.5, 0.5, -0.5, -0.5]]"
WIDE = [[-4, -4, 8, -4], [8, -4, 8, 4], [8, 4, -4, 4], [-4, 4, -4, -4]]
TAG, FAR = "{id: 1, position: [2, 3.99], facing: -1.57}", "{id: 2, position: [7.99, -3], facing: 3.14}"
ROOM = "[[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]"


@pytest.fixture
def tool(call, tmp_path):
    """Runs `tfg-drake explore` headless: exit code, standard output, standard error, the summary or None."""

    def run(*arguments):
        ended = call("explore", *arguments, "--headless", "--out", tmp_path / "run")
        summary = tmp_path / "run" / "summary.json"
        return *ended, json.loads(summary.read_text()) if summary.exists() else None

    return run


@pytest.fixture
def scenario(tmp_path):
    """Writes a scenario and says where it is."""

    def write(world, rest=""):
        path = tmp_path / "odd.yaml"
        path.write_text(f"seed: 1\n{QUICK_LOOK}{rest}\nworld: {{{world}}}\n")
        return path

    return write


@pytest.mark.parametrize("spacing", [None, 0.5])
def test_a_closet_round_the_robot_is_explored(tool, scenario, spacing):
    tags = ["--tag-spacing", spacing] if spacing else []
    code, out, err, summary = tool(scenario(f"start: [0, 0, 0], walls: {BOX}"), *tags)
    assert (code, err, summary["outcome"]) == (0, "", "complete")
    assert summary["reason"] == "No place promises more than 20 nats."
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"] == (8 if spacing else 0)
    assert summary["contacts"] == 0
    assert "outcome     complete: No place promises" in out


def test_a_robot_among_posts_that_it_does_not_fit_between_says_so(tool, scenario):
    posts = [(x, y) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5) if (x, y) != (0.0, 0.0)]
    walls = [[x - 0.05, y, x + 0.05, y] for x, y in posts] + [[x, y - 0.05, x, y + 0.05] for x, y in posts]
    code, _, err, summary = tool(scenario(f"start: [0, 0, 0], walls: {walls + WIDE}, tags: [{TAG}]"))
    assert (code, err, summary["outcome"]) == (1, "", "stuck")
    assert summary["reason"].startswith("The robot cannot reach any other place, and frontier is left.")


@pytest.mark.parametrize(("time", "outcome"), [(9.0, "stuck"), pytest.param(80.0, "complete", marks=pytest.mark.slow)])
def test_what_lies_behind_a_door_that_shut_is_named(tool, scenario, time, outcome):
    """While the robot has only looked through it, or when all is mapped."""
    change = f"reality: {{changes: [{{time: {time}, walls: [[4, 1.5, 4, 2.7]]}}]}}\n"
    walls = [*WIDE, [4, -4, 4, 1.5], [4, 2.7, 4, 4]]
    code, _, err, summary = tool(scenario(f"start: [2, 2, 0], walls: {walls}, tags: [{TAG}, {FAR}]", change))
    assert (code, err, summary["outcome"]) == (1 if outcome == "stuck" else 0, "", outcome)
    assert ("behind a door that shut" in summary["reason"]) == (outcome == "stuck")
    told = " The robot cannot reach any place that shows these tags: 2."
    assert summary["reason"].endswith(told) == (outcome == "stuck")


def test_tags_that_hang_oddly_or_behind_a_wall_are_named(tool, scenario):
    """One in mid-room, one turned to its wall, two in the half of the building that is walled off."""
    walls = [*WIDE, [4, -4, 4, 4]]
    tags = [TAG, "{id: 5, position: [3, 2], facing: 0}", "{id: 6, position: [0, 3.99], facing: 1.57}", FAR]
    tags += ["{id: 9, position: [7.99, 3], facing: 3.14}"]
    code, out, err, summary = tool(scenario(f"start: [2, 0, 0], walls: {walls}, tags: [{', '.join(tags)}]"))
    assert (code, err, summary["outcome"]) == (0, "", "complete")
    assert "tags that hang on no wall: 5; is this meant?" in out
    assert "tags that face into their wall, where nobody sees them: 6; is this meant?" in out
    assert summary["reason"].endswith(" The robot cannot reach any place that shows these tags: 6, 2, 9.")


def test_where_there_is_no_room_for_people_it_is_said(tool, scenario):
    cell = BOX.replace("0.5", "0.28")
    code, _, err, summary = tool(scenario(f"start: [0, 0, 0], walls: {cell}"), "--set", "reality.people=1")
    assert (code, summary) == (2, None)
    assert "reality.people: nowhere in this world is there room for people; set it to 0" in err


def test_walls_without_tags_are_a_map_too(tool, scenario):
    code, _, err, summary = tool(scenario(f"start: [2, 1.5, 0.3], walls: {ROOM}"))
    assert (code, err, summary["outcome"]) == (0, "", "complete")
    assert summary["landmarks_mapped"] == summary["landmarks_present"] == 0
    assert summary["landmark_rmse_m"] is summary["landmark_anees"] is None
    assert summary["surface_coverage"] > 0.99


@pytest.mark.slow
def test_where_there_is_nothing_the_mission_ends(tool, scenario):
    code, _, err, summary = tool(
        scenario("start: [0, 0, 0], walls: []"), "--max-time", 300, "--set", "robot.max_speed=2"
    )
    assert (code, err, summary["outcome"]) == (1, "", "stuck")
    assert re.fullmatch(
        r"Neither a landmark nor a surface was seen on 5\d m of way: there is nothing to map.", summary["reason"]
    )


@pytest.mark.parametrize(
    ("world", "rest", "complaint"),
    [
        (f"start: [0, 0.1, 0], walls: {ROOM}", "", "world.start: (0, 0.1) is too near to the wall from (0, 4) to "),
        (f"start: [2, 2, 0], walls: {ROOM}, doors: []", "", "world.doors: unknown key; "),
        (f"start: [2, 2, 0], walls: {ROOM}", "robot: {radius: wide}", "robot.radius: expected a number, found text"),
        (f"start: [2, 2, 0], walls: {ROOM}", "robot: {radius: [0.2]}", "robot.radius: expected a number, found a list"),
        (f"start: [2, 2, 0], walls: {ROOM}", "robot: {radius: .nan}", "robot.radius: must be finite, is nan"),
        (f"start: [2, .nan, 0], walls: {ROOM}", "", "world.start[1]: must be finite, is nan"),
        (f"start: [2, 2], walls: {ROOM}", "", "world.start: expected 3 numbers "),
        ("start: [2, 2, 0], walls: [[0, 0, 6, 0], [1, 1, 1, 1]]", "", "world.walls[1]: "),
        (
            f"start: [2, 2, 0], walls: {ROOM}, tags: [{{id: 4, position: [1, 0.01], facing: 1.57}},"
            " {id: 4, position: [2, 0.01], facing: 1.57}]",
            "",
            "world.tags[1]",
        ),
        ("start: [2, 2, 0], walls: [[0, 0", "", "line "),
    ],
)
def test_a_malformed_scenario_is_one_line(tool, scenario, world, rest, complaint):
    path = scenario(world, rest)
    code, out, err, summary = tool(path)
    assert (code, out, summary) == (2, "", None)
    assert err.startswith(f"tfg-drake: {path}: {complaint}")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "content",
    [b"", b"P5\n4 4\n255\n123", b"P5\nfour 4\n255\n", b"nonsense", gzip.compress(b"P5\n4 4\n255\n", mtime=0)[:-9]],
)
@pytest.mark.parametrize("name", ["map.pgm", "map.pgm.gz", "map.png"])
def test_a_broken_image_is_one_line(tool, tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    world = tmp_path / "map.yaml"
    world.write_text(f"image: {name}\nresolution: 0.05\norigin: [0, 0, 0]\n")
    code, out, err, summary = tool("--world", world)
    assert (code, out, summary) == (2, "", None)
    assert err.startswith("tfg-drake: ")
    assert name in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("name", ["nowhere.yaml", "nowhere.vectormap.txt", "nowhere.pgm"])
def test_a_missing_file_is_one_line(tool, tmp_path, name):
    for arguments in ([tmp_path / name], ["--world", tmp_path / name]):
        code, out, err, summary = tool(*arguments)
        assert (code, out, summary) == (2, "", None)
        assert str(tmp_path / name) in err
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("explorer.stop_gian=1", "explorer.stop_gian: unknown key; did you mean stop_gain?"),
        ("explorer.stop_gain=much", "expected a number, found text ('much')"),
        ("explorer.gain=best", "explorer.gain"),
        ("robot.max_speed=-1", "robot.max_speed: must be greater than 0, is -1"),
        ("tags.range=.nan", "tags.range: must be finite, is nan"),
        ("explorer=5", "explorer"),
        ("=5", "expected KEY=VALUE"),
    ],
)
def test_a_wrong_setting_is_one_line(tool, setting, complaint):
    code, out, err, summary = tool("house", "--set", setting)
    assert (code, out, summary) == (2, "", None)
    assert err.startswith(f"tfg-drake: --set {setting}: ")
    assert complaint in err
    assert err.count("\n") == 1

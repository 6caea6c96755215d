"""Scenarios: what the shipped ones hold, how files and settings merge, and every complaint word for word."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.config import DisturbanceConfig, as_it_is
from tfg_drake.diagrams.scenario import (
    ApplySettings,
    ApplyWorldFile,
    FindScenario,
    LoadScenario,
    MakeWorld,
    MakeWorldConfig,
    Scenario,
    ScenarioError,
)
from tfg_drake.io.yaml_text import dump_yaml
from tfg_drake.world.reachability import make_grid, reachable_cells, reachable_tags
from tfg_drake.world.world import odd_tags

SHIPPED = (
    "corridor",
    "corridor_bare",
    "corridor_push",
    "corridor_slip",
    "house",
    "house_real",
    "office",
    "paper",
    "paper_real",
    "paper_white",
)
FACTS = """
seed: 4
world:
  start: [1, 1, 0]
  walls: [[0, 0, 3, 0], [3, 0, 3, 2]]
  tags: [{id: 5, position: [1, 0.01], facing: 1.5708}]
robot: {max_speed: 0.4}
"""


def complaint(call, *arguments, **keywords) -> str:
    with pytest.raises(ScenarioError) as error:
        call(*arguments, **keywords)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("name", "text", "given"),
    [
        ("lab.vectormap.txt", "0,0,6,0", "it"),
        ("lab.yaml", "image: lab.pgm\nresolution: 0.05", "it"),
        ("lab.pgm", "P2", "the map_server .yaml that names it"),
    ],
)
def test_a_floor_plan_in_the_place_of_a_scenario_is_told_its_option(tmp_path, name, text, given):
    (tmp_path / name).write_text(text)
    told = f"{tmp_path / name}: is a floor plan, not a scenario; give {given} by --world"
    assert complaint(LoadScenario, tmp_path / name) == told


@pytest.mark.parametrize("name", SHIPPED)
def test_every_tag_of_a_shipped_world_is_reachable(name):
    scenario = LoadScenario(name)
    world = MakeWorld(scenario.world)
    grid = make_grid(world)
    reachable = reachable_cells(grid, world, scenario.robot.radius)
    seen = reachable_tags(world, grid, reachable, scenario.tags.range, scenario.tags.max_incidence)
    assert seen.all()


def test_shipped_scenarios_are_the_files_in_the_folder():
    assert tuple(sorted(file.stem for file in FindScenario("paper").parent.glob("*.yaml"))) == SHIPPED


def test_paper_has_the_size_and_the_number_of_tags_of_the_papers_simulation():
    world = MakeWorld(LoadScenario("paper").world)
    corners = world.walls.reshape(-1, 2)
    np.testing.assert_array_equal([corners.min(axis=0), corners.max(axis=0)], [[0, 0], [46, 22]])
    np.testing.assert_array_equal(world.tag_ids, np.arange(274))


def test_the_parameters_of_paper_are_the_defaults():
    paper, defaults = LoadScenario("paper"), Scenario()
    for section in ("robot", "odometry", "tags", "scan", "safety", "explorer"):
        assert getattr(paper, section) == getattr(defaults, section)


def test_a_base_is_merged_key_by_key():
    white, paper = LoadScenario("paper_white"), LoadScenario("paper")
    assert white.world == paper.world
    assert (white.odometry.distance_scale, white.odometry.gyro_bias, white.odometry.gyro_scale) == (0, 0, 0)
    assert white.odometry.gyro_noise == paper.odometry.gyro_noise


def test_of_several_bases_each_is_merged_into_those_before():
    scenario, house, real = LoadScenario("house_real"), LoadScenario("house"), LoadScenario("paper_real")
    assert (scenario.world, scenario.drive) == (house.world, house.drive)
    assert scenario.reality == dataclasses.replace(real.reality, people=2)
    assert complaint(LoadScenario, data="base: [house, paper_real]").endswith("give one of them")


def test_a_base_is_a_shipped_name_or_a_file_beside(tmp_path):
    (tmp_path / "plain.yaml").write_text(FACTS)
    (tmp_path / "fast.yaml").write_text("base: plain.yaml\nrobot: {max_speed: 0.7}\n")
    fast = LoadScenario(tmp_path / "fast.yaml")
    assert (fast.robot.max_speed, fast.seed, len(fast.world.tags)) == (0.7, 4, 1)


def test_data_names_and_defaults():
    scenario = LoadScenario(data=FACTS)
    assert (scenario.seed, scenario.robot.max_speed, scenario.robot.radius) == (4, 0.4, 0.18)
    assert LoadScenario(data="a: {seed: 1}\nb: {seed: 2}", scenario_name="b").seed == 2
    merged = LoadScenario(data="seed: 9", defaults=scenario)
    assert (merged.seed, merged.robot.max_speed) == (9, 0.4)
    assert LoadScenario(data="robot: {radius: 1e-1}").robot.radius == 0.1


def test_world_and_config_are_inverse():
    config = LoadScenario(data=FACTS).world
    assert MakeWorldConfig(MakeWorld(config)) == config
    empty = MakeWorld(Scenario().world)
    assert empty.walls.shape == (0, 4)
    assert empty.p_WT.shape == (0, 2)


ONE = "{id: 1, position: [0, 1], facing: 0}"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("robot: {radios: 1}", "robot.radios: unknown key; did you mean radius?"),
        (
            "wheels: {}",
            "wheels: unknown key; the sections are seed, world, robot, odometry, tags, scan, station, camera, reality,"
            " safety, disturbances, explorer, planner, drive, grid, hardware",
        ),
        ("disturbances: [{duration: 0}]", "disturbances[0].duration: must be greater than 0, is 0"),
        ("drive: [[1, 2, 3]]", "drive[0]: expected 2 numbers [x, y], found 3"),
        ("robot: {radius: a}", "robot.radius: expected a number, found text ('a')"),
        ("robot: {radius: 1" + 400 * "0" + "}", "robot.radius: must be finite, is too large"),
        ("tags: {rate: 1e9}", "tags.rate: must be at most 1000, is 1e+09"),
        ("grid: {resolution: 5e-4}", "grid.resolution: must be at least 0.01, is 0.0005"),
        ("robot: {radius: 2001-13-45}", "broken YAML: month must be in 1..12"),
        ("robot: {radius: yes}", "robot.radius: expected a number, found a yes/no value (True)"),
        ("robot: {radius: .nan}", "robot.radius: must be finite, is nan"),
        ("robot: {radius: -.inf}", "robot.radius: must be finite, is -inf"),
        ("robot: {radius: 0}", "robot.radius: must be greater than 0, is 0"),
        ("robot: 3", "robot: expected a section of keys, found int (3)"),
        ("tags: {rate: -2}", "tags.rate: must be greater than 0, is -2"),
        ("tags: {bearing_noise: -0.1}", "tags.bearing_noise: must be greater than 0, is -0.1"),
        ("tags: {detection_probability: 1.5}", "tags.detection_probability: must be at most 1, is 1.5"),
        ("explorer: {samples: 0}", "explorer.samples: must be at least 1, is 0"),
        ("seed: 1.5", "seed: expected a whole number, found float (1.5)"),
        ("seed: -1", "seed: must be between 0 and 2147483647, is -1"),
        ("seed: 99999999999999999999999", "seed: must be between 0 and 2147483647, is 99999999999999999999999"),
        ("scan: {rate: 0.05}", "scan.rate: must be at least 1, is 0.05"),
        (
            "world: {walls: [[0, 0, 1e5, 0], [0, 0, 0, 30]], start: [5, 5, 0]}",
            "the walls extend over 100000 x 30 m, the farthest to (100000, 0); check their unit or resolution, or that"
            " number",
        ),
        ("world: {tags: [{id: -1}]}", "world.tags[0].id: must be between 0 and 2147483647, is -1"),
        ("world: {walls: 3}", "world.walls: expected a list, found int (3)"),
        ("world: {walls: [[0, 0, 1]]}", "world.walls[0]: expected 4 numbers [x0, y0, x1, y1], found 3"),
        ("world: {walls: [[0, 0, 1, b]]}", "world.walls[0][3]: expected a number, found text ('b')"),
        ("world: {walls: [[1, 2, 1, 2]]}", "world.walls[0]: zero length at (1, 2); remove the wall"),
        ("world: {start: [0, 0]}", "world.start: expected 3 numbers [x, y, yaw], found 2"),
        ("world: {tags: [{id: x}]}", "world.tags[0].id: expected a whole number, found text ('x')"),
        (
            "world: {tags: [{ID: 3}]}",
            "world.tags[0].ID: unknown key; the keys of world.tags[0] are id, position, facing",
        ),
        ("world: {tags: [{position: [1]}]}", "world.tags[0].position: expected 2 numbers [x, y], found 1"),
        (
            "world: {tags: [{id: 1, position: [0, 1]}]}",
            "world.tags[0].facing: missing; write a tag as {id: 7, position: [x, y], facing: 0.0}, m and rad",
        ),
        (
            "reality: {changes: [{tags: [{id: 1, facing: 0}]}]}",
            "reality.changes[0].tags[0].position: missing; write a tag as {id: 7, position: [x, y], facing: 0.0}, m and"
            " rad",
        ),
        (f"world: {{tags: [{ONE}, {ONE}]}}", "world.tags[1].id: 1 is taken by world.tags[0]; give each tag an id"),
        ("- 1", "expected keys and values such as `seed: 0`, found a list"),
        ("", "expected keys and values such as `seed: 0`, found nothing"),
        ("seed: [1", "line 2, column 1: broken YAML: did not find expected ',' or ']'"),
        ("seed: " + "[" * 900, "line 1, column 106: broken YAML: more than 100 levels deep"),
        ("base: 3", "base: expected a scenario's name or file, found int (3)"),
        ("base: []", "base: expected a scenario's name or file, found a list"),
        (
            "reality: {changes: [{walls: [[1, 2, 3]]}]}",
            "reality.changes[0].walls[0]: expected 4 numbers [x0, y0, x1, y1], found 3",
        ),
        ("reality: {changes: [{time: -1}]}", "reality.changes[0].time: must not be negative, is -1"),
        (
            "reality: {changes: [{fallen: [7]}]}",
            "reality.changes[0]: there is no tag 7 in the world then; name one of its tags",
        ),
        (
            "reality: {changes: [{door: 1}]}",
            "reality.changes[0].door: unknown key;"
            " the keys of reality.changes[0] are time, walls, opened, tags, fallen",
        ),
        ("reality: {scan: {sweep_time: -0.1}}", "reality.scan.sweep_time: must not be negative, is -0.1"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line(tmp_path, data, message):
    file = tmp_path / "bad.yaml"
    file.write_text(data)
    assert complaint(LoadScenario, file) == f"{file}: {message}"


def test_missing_files_and_names(tmp_path):
    names = ", ".join(SHIPPED)
    assert complaint(LoadScenario, "papr") == f"papr: no such file or scenario; name a YAML file or one of {names}"
    file = tmp_path / "a.yaml"
    file.write_text("base: papr")
    assert complaint(LoadScenario, file) == (
        f"{file}: base: papr: no such file or scenario; name a YAML file or one of {names}"
    )
    file.write_text("base: a.yaml")
    assert complaint(LoadScenario, file) == f"{file}: base: a.yaml leads back to this file; break the circle"
    file.write_bytes(b"\xff\xfe\xfa")
    assert complaint(LoadScenario, file) == f"{file}: cannot be read: not UTF-8 text"
    assert complaint(LoadScenario, data="a: {}", scenario_name="b") == "scenario: no scenario b; the file has a"
    assert complaint(LoadScenario) == "LoadScenario: give filename or data, or both"


def test_settings_are_applied_in_order_to_a_copy():
    scenario = Scenario()
    changed = ApplySettings(scenario, ["explorer.stop_gain=5", "tags.range_scale=1.01", "seed=3", "seed=4"])
    assert (changed.explorer.stop_gain, changed.tags.range_scale, changed.seed) == (5.0, 1.01, 4)
    assert isinstance(changed.explorer.stop_gain, float)
    assert scenario == Scenario()
    pushed = ApplySettings(scenario, ["disturbances=[{time: 3, ahead: 0.5}]"])
    assert pushed.disturbances == [DisturbanceConfig(time=3.0, ahead=0.5)]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("explorer.gain=best", "explorer.gain: must be one of exact, limit, paper, authors, is best"),
        (
            "explorer.goal=far",
            "explorer.goal: must be one of gain_per_time, argmax, tour, nearest_frontier, random, is far",
        ),
        ("explorer.solver=ceres", "explorer.solver: must be one of dissection, gtsam, is ceres"),
        ("planner.risk=none", "planner.risk: must be one of point, path, is none"),
        ("explorer.stop_gian=5", "explorer.stop_gian: unknown key; did you mean stop_gain?"),
        ("robot.x=5", None),
        ("seed.x=5", "seed.x: unknown key; seed is a value, not a section"),
        ("explorer.stop_gain", "expected KEY=VALUE, such as explorer.stop_gain=5"),
        ("explorer.stop_gain=", "expected KEY=VALUE, such as explorer.stop_gain=5"),
        ("explorer.stop_gain=fast", "explorer.stop_gain: expected a number, found text ('fast')"),
        ("tags.rate=0", "tags.rate: must be greater than 0, is 0"),
        ("tags.mount_deviation=-0.005", "tags.mount_deviation: must not be negative, is -0.005"),
        ("tags.range_scale_deviation=2", "tags.range_scale_deviation: must be at most 1, is 2"),
        ("seed=1.5", "seed: expected a whole number, found float (1.5)"),
        ("robot={radius: 1}", "robot is a section; set one of its keys, or write a scenario file"),
        ("tags.rate=[", "line 2, column 1: broken YAML: did not find expected node content"),
    ],
)
def test_bad_settings_are_refused_in_one_line(setting, message):
    found = complaint(ApplySettings, Scenario(), [setting])
    if message is None:
        message = (
            "robot.x: unknown key; the keys of robot are radius, max_speed, max_turn_rate, max_acceleration,"
            " max_turn_acceleration"
        )
    assert found == f"--set {setting}: {message}"


def test_a_setting_may_put_the_start_inside_a_wall():
    scenario = LoadScenario(data=FACTS)
    assert complaint(ApplySettings, scenario, ["robot.radius=1.5"]).startswith(
        "--set: world.start: (1, 1) is too near to the wall from (0, 0) to (3, 0)"
    )


def write_room(folder: Path) -> Path:
    file = folder / "room.vectormap.txt"
    file.write_text("0,0,4,0\n4,0,4,3\n4,3,0,3\n0,3,0,0\n")
    return file


def test_a_world_file_replaces_walls_tags_and_start(tmp_path):
    paper = LoadScenario("paper")
    room = ApplyWorldFile(paper, write_room(tmp_path), tag_spacing=1.0, start=(2.0, 1.0, 0.5))
    assert (len(room.world.walls), len(room.world.tags), room.world.start) == (8, 14, [2.0, 1.0, 0.5])
    assert room.robot == paper.robot
    drawn = [ApplyWorldFile(ApplySettings(paper, [f"seed={s}"]), write_room(tmp_path)).world.start for s in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_a_world_file_may_be_a_scenario_or_a_shipped_name(tmp_path):
    file = tmp_path / "facts.yaml"
    file.write_text(FACTS)
    assert ApplyWorldFile(Scenario(), file).world == LoadScenario(file).world
    assert ApplyWorldFile(Scenario(), "house").world == LoadScenario("house").world
    moved = ApplyWorldFile(LoadScenario("house"), start=(4.0, 3.6, 0.0))
    assert moved.world.start == [4.0, 3.6, 0.0]
    assert moved.world.tags == LoadScenario("house").world.tags


def test_bad_world_files_are_refused_in_one_line(tmp_path):
    file = write_room(tmp_path)
    assert complaint(ApplyWorldFile, Scenario(), file, None, (0.1, 1.0, 0.0)) == (
        f"{file}: world.start: (0.1, 1) is too near to the wall from (0, 3) to (0, 0): 0.100 m, the robot's radius is"
        " 0.18 m; start at (0.3, 1), the nearest free place"
    )
    assert complaint(ApplyWorldFile, Scenario(), file, -1.0) == (
        f"{file}: tag spacing: must be a positive number of metres, is -1"
    )
    missing = tmp_path / "none.vectormap.txt"
    assert complaint(ApplyWorldFile, Scenario(), missing) == f"{missing}: no such file"
    unknown = tmp_path / "plan.dxf"
    unknown.write_text("")
    assert complaint(ApplyWorldFile, Scenario(), unknown) == (
        f"{unknown}: unknown kind of map; give a scenario or map_server .yaml or a *.vectormap.txt"
    )
    grid = tmp_path / "map.yaml"
    grid.write_text("image: map.pgm\nresolution: 0.1\n")
    assert complaint(ApplyWorldFile, Scenario(), grid) == f"{grid}: image: {tmp_path / 'map.pgm'} does not exist"


def test_what_reality_leaves_out_is_as_the_data_sheet_says():
    scenario = LoadScenario(data="reality: {tags: {range_noise: 0, yaw: -0.01}, scan: {noise: null}}")
    assert (scenario.reality.tags.range_noise, scenario.reality.tags.yaw, scenario.reality.scan.noise) == (
        0,
        -0.01,
        None,
    )
    sensor = as_it_is(scenario.tags, scenario.reality.tags)
    assert sensor == dataclasses.replace(scenario.tags, range_noise=0.0)
    changed = ApplySettings(scenario, ["reality.tags.range_noise=null", "reality.odometry.gyro_bias=0.01"])
    assert changed.reality.tags.range_noise is None
    assert as_it_is(changed.odometry, changed.reality.odometry).gyro_bias == 0.01
    off = ["reality.scan.left=-0.02", "reality.tags.detection_range=8", "reality.odometry.slip_per_turn_rate=0.01"]
    assert ApplySettings(scenario, off).reality.scan.left == -0.02
    assert complaint(ApplySettings, scenario, ["reality.scan.dropout_probability=1.5"]) == (
        "--set reality.scan.dropout_probability=1.5: reality.scan.dropout_probability: must be at most 1, is 1.5"
    )


def test_numbers_with_an_exponent_and_a_dumped_document():
    text = "base: paper\nrobot: {radius: 2e-1}\nworld: {start: [1e0, 15e-1, 0e0]}\n---\n"
    read = LoadScenario(data=text)
    assert (read.robot.radius, read.world.start) == (0.2, [1.0, 1.5, 0.0])
    assert ApplySettings(read, ["robot.radius=1e-1"]).robot.radius == 0.1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("world: {start: [1, 1, 90]}", "world.start: 90 rad is more than a turn; write radians, not degrees"),
        (
            "world: {tags: [{id: 3, position: [1, 1], facing: -180}]}",
            "world.tags[0].facing: -180 rad is more than a turn; write radians, not degrees",
        ),
        ("robot: {max_speed: 30}", "robot.max_speed: must be at most 5, is 30"),
        ("robot: {max_turn_rate: 90}", "robot.max_turn_rate: must be at most 15, is 90"),
        ("hardware: {max_speed: 30}", "hardware.max_speed: must be at most 5, is 30"),
        ("explorer: {turn_rate: 70}", "explorer.turn_rate: must be at most 15, is 70"),
        ("tags: {bearing_noise: 2}", "tags.bearing_noise: must be at most 1, is 2"),
        ("grid: {update_angle: 30}", "grid.update_angle: must be at most 6.28319, is 30"),
        *(
            (f"{before}{key}: -90{after}", f"{place}.{key}: -90 rad is more than a turn; write radians, not degrees")
            for before, key, after, place in (
                ("reality: {tags: {", "yaw", "}}", "reality.tags"),
                ("reality: {scan: {", "yaw", "}}", "reality.scan"),
                ("hardware: {camera: {", "pitch", "}}", "hardware.camera"),
                ("hardware: {more_cameras: [{", "roll", "}]}", "hardware.more_cameras[0]"),
                ("hardware: {scanner: {", "yaw", "}}", "hardware.scanner"),
                ("disturbances: [{", "turn", "}]", "disturbances[0]"),
                ("world: {tags: [{id: 1, position: [0, 1], ", "facing", "}]}", "world.tags[0]"),
            )
        ),
    ],
)
def test_degrees_and_what_no_robot_does(text, told):
    assert complaint(LoadScenario, data=text) == f"scenario: {told}"


@pytest.mark.slow
def test_a_mutated_scenario_is_refused_or_read(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(dump_yaml(dataclasses.asdict(LoadScenario(data=FACTS))))
    assert_refused_or_read(file, lambda: LoadScenario(file), ScenarioError, count=1000)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_tags_hang_on_their_walls(name):
    assert odd_tags(MakeWorld(LoadScenario(name).world)) == ()


def test_the_comments_of_its_fields_are_in_its_docstring():
    """But not of the sections that have docstrings of their own."""
    assert str(Scenario.__doc__).startswith("Everything that defines a run.\n\nseed: Every random number")
    assert "\n\nreality: Deviations of a simulated world" in str(Scenario.__doc__)

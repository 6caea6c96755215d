"""Presets: those shipped are whole, and every mistake in one is one line."""

import pytest
import yaml

from tests.mutations import assert_refused_or_read
from tfg_drake.hardware.ros import conversions, preset
from tfg_drake.hardware.ros.preset import PRESETS, PresetError, Topic, Topics, load_preset

NAMES = sorted(path.stem for path in PRESETS.glob("*.yaml"))


def test_what_is_shipped():
    assert NAMES == ["emulated", "turtlebot2", "turtlebot3", "turtlebot4"]


@pytest.mark.parametrize("name", NAMES)
def test_shipped_presets(name):
    robot = load_preset(name)
    assert 0.0 < robot.limits.speed <= 0.3
    assert robot.topics.odometry == Topic("/odom", "nav_msgs/msg/Odometry")
    assert robot.topics.hazards or name == "emulated"
    assert robot.topics.detections is not None


def test_commands_of_the_robots():
    commands = {name: load_preset(name).topics.command for name in NAMES}
    types = [commands[name].type.split("/")[-1] for name in NAMES]
    assert types == ["TwistStamped", "Twist", "TwistStamped", "TwistStamped"]
    assert commands["turtlebot2"].name == "/commands/velocity"


def test_every_type_of_hazards_has_a_conversion():
    assert set(preset.TYPES["hazards"]) == set(conversions.HAZARDS)


def changed(tmp_path, *keys, value=None, drop=False):
    tree = yaml.safe_load((PRESETS / "turtlebot4.yaml").read_text(encoding="utf-8"))
    place = tree
    for key in keys[:-1]:
        place = place[key]
    if drop:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def test_a_file_of_ones_own(tmp_path):
    path = changed(tmp_path, "topics", "odometry", "name", value="/robot7/odom")
    assert load_preset(path).topics.odometry.name == "/robot7/odom"
    assert load_preset(changed(tmp_path, "topics", "hazards", drop=True)).topics.hazards == []


@pytest.mark.parametrize(
    ("keys", "value", "line"),
    [
        (
            ("speeed",),
            1,
            "speeed: unknown key; the keys of preset are topics, limits, scanner, camera, frames, publish, discovery",
        ),
        (("publish",), {"map": 3}, "publish.map: expected text, found int (3)"),
        (("frames",), {"base": ""}, "frames.base: must not be empty"),
        (("limits", "speed"), "fast", "limits.speed: expected a number, found text ('fast')"),
        (("limits", "speed"), -0.1, "limits.speed: must be greater than 0, is -0.1"),
        (("scanner", "unanswered"), "far", "scanner.unanswered: must be one of unknown, free, is far"),
        (("scanner", "flip"), 1, "scanner.flip: expected true or false, found int (1)"),
        (("scanner", "clockwise"), "yes", "scanner.clockwise: expected true or false, found text ('yes')"),
        (("scanner", "field_of_view"), -2.0, "scanner.field_of_view: must not be negative, is -2"),
        (
            ("scanner", "field_of_view"),
            270,
            "scanner.field_of_view: 270 rad is more than a turn; write radians, not degrees",
        ),
        (("scanner", "least_range"), -0.1, "scanner.least_range: must not be negative, is -0.1"),
        (("limits", "speed"), 30, "limits.speed: must be at most 5, is 30"),
        (("limits", "turn_rate"), 90.0, "limits.turn_rate: must be at most 20, is 90"),
        (("scanner", "yaw"), 180, "scanner.yaw: 180 rad is more than a turn; write radians, not degrees"),
        (("camera", "pitch"), -15, "camera.pitch: -15 rad is more than a turn; write radians, not degrees"),
        (("camera", "x"), 10**400, "camera.x: must be finite, is too large"),
        (("scanner", "yaw"), float("nan"), "scanner.yaw: must be finite, is nan"),
        (("limits",), 3, "limits: expected a section of keys, found int (3)"),
        (("topics", "odometry", "name"), 4, "topics.odometry.name: expected text, found int (4)"),
        (("topics", "hazards"), "none", "topics.hazards: expected a list, found text ('none')"),
        (("discovery",), "lan", "discovery: must be one of subnet, localhost, is lan"),
        (("topics", "scan", "qos"), "best", "topics.scan.qos: must be one of sensor_data, reliable, is best"),
        (
            ("topics", "command", "type"),
            "geometry_msgs/Twist",
            "topics.command.type: must be one of geometry_msgs/msg/Twist, geometry_msgs/msg/TwistStamped, "
            "is geometry_msgs/Twist",
        ),
    ],
)
def test_mistakes_are_named(tmp_path, keys, value, line):
    path = changed(tmp_path, *keys, value=value)
    with pytest.raises(PresetError) as error:
        load_preset(path)
    assert str(error.value) == f"{path}: {line}"


def test_numbers_with_an_exponent(tmp_path):
    path = changed(tmp_path, "limits", "speed", value="FAST")
    path.write_text(path.read_text().replace("FAST", "2e-1"))
    assert load_preset(path).limits.speed == 0.2


def test_what_is_missing_is_named(tmp_path):
    for keys, line in [
        (("topics", "scan"), f"topics.scan: missing; write {Topics.example}"),
        (("topics", "scan", "type"), f"topics.scan.type: missing; write {Topic.example}"),
        (("topics",), f"topics: missing; write {Topics.example}"),
        (("topics", "camera_info"), "topics.camera_info: missing; corners of tags say nothing without it"),
    ]:
        path = changed(tmp_path, *keys, drop=True)
        with pytest.raises(PresetError) as error:
            load_preset(path)
        assert str(error.value) == f"{path}: {line}"


def test_no_such_preset():
    with pytest.raises(PresetError) as error:
        load_preset("turtlebot5")
    names = "emulated, turtlebot2, turtlebot3, turtlebot4"
    assert str(error.value) == f"turtlebot5: no such file or preset; name a YAML file or one of {names}"


def test_broken_yaml(tmp_path):
    path = tmp_path / "broken.yaml"
    path.write_text("topics: [", encoding="utf-8")
    with pytest.raises(PresetError, match=r"broken\.yaml: cannot be read: line \d+, column \d+: broken YAML: "):
        load_preset(path)


@pytest.mark.parametrize(
    "text", ["[" * 200_000, "{a: " * 200_000, "topics: &all [*all]", "camera: {x: 0x" + "f" * 5000]
)
def test_what_is_short_on_paper_and_endless_in_memory_is_one_line(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PresetError, match=r"cannot be read") as error:
        load_preset(path)
    assert "\n" not in str(error.value)


def test_a_mutated_preset_is_refused_or_read(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes((PRESETS / "turtlebot4.yaml").read_bytes())
    assert_refused_or_read(path, lambda: load_preset(path), PresetError)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_many_mutated_presets_are_refused_or_read(tmp_path, name):
    path = tmp_path / "mine.yaml"
    path.write_bytes((PRESETS / f"{name}.yaml").read_bytes())
    assert_refused_or_read(path, lambda: load_preset(path), PresetError, count=1000, seed=1)


def test_what_the_scanners_see():
    scanners = {name: load_preset(name).scanner for name in NAMES}
    assert {name: scanner.unanswered for name, scanner in scanners.items()} == {
        "emulated": "unknown",
        "turtlebot2": "unknown",
        "turtlebot3": "free",
        "turtlebot4": "free",
    }
    assert scanners["turtlebot2"].least_range == 0.45

"""A station that sees with a rendered camera: the ports and the messages of the ideal one, made of pixels."""

import math
import sys

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")

from tfg_drake.config import ChangeConfig, TagConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.rendered_eyes import MakeRenderedEyes
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario, MakeWorld, Scenario, ScenarioError, WorldConfig
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.geometry.se2 import between
from tfg_drake.io.extras import pip_install
from tfg_drake.messages import replace
from tfg_drake.simulation.people import RADIUS, nobody

WORLD = WorldConfig(
    walls=[[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]],
    tags=[TagConfig(id=5, position=[1.99, 0.5], facing=np.pi), TagConfig(id=3, position=[1.99, -0.6], facing=np.pi)],
    start=[0.0, 0.0, 0.0],
)


def seeing(*settings):
    return ApplySettings(Scenario(world=WORLD), ["station.eyes=camera", *settings])


def started(scenario, command=(0.0, 0.0), seed=0):
    station = MakeTurtlebotStation(scenario)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetRandomContext(context, RandomGenerator(seed))
    station.GetInputPort("base.velocity_commanded").FixValue(context, list(command))
    simulator.Initialize()
    return station, simulator


def newest(station, simulator):
    context = simulator.get_context()
    return [station.GetOutputPort(name).Eval(context) for name in ("tags.detections", "scan.ranges", "truth.pose")]


@pytest.fixture(scope="module")
def still():
    """Of a station that stands: the station, and tags, scan and pose after a few frames."""
    station, simulator = started(seeing())
    simulator.AdvanceTo(0.25)
    return station, *newest(station, simulator)


def test_the_ports_are_those_of_the_ideal_station(still):
    ideal = MakeTurtlebotStation(Scenario(world=WORLD))
    for station in (still[0], ideal):
        assert station.get_name() == "station"
    names = [
        [station.get_output_port(i).get_name() for i in range(station.num_output_ports())]
        for station in (still[0], ideal)
    ]
    assert names[0] == names[1]


def test_rendered_tags_are_where_they_are(still):
    _, tags, _, _ = still
    assert tags.stamp == pytest.approx(0.2)
    assert tags.ids.tolist() == [3, 5]
    p_WT = np.array([[1.99, -0.6], [1.99, 0.5]])
    error = tags.range - np.hypot(*p_WT.T)
    np.testing.assert_allclose(error, 0.0, atol=0.02)
    assert (np.abs(error) < 3.0 * tags.sigma_range).all()
    np.testing.assert_allclose(tags.bearing, np.arctan2(p_WT[:, 1], p_WT[:, 0]), atol=0.005)


def test_the_scan_is_that_of_the_walls(still):
    _, _, scan, _ = still
    assert scan.stamp == pytest.approx(0.2)
    assert scan.range_max == 5.0
    assert np.ptp(scan.angles) == pytest.approx(math.radians(65.0), abs=0.01)
    # The tags hang 1 cm before it.
    np.testing.assert_allclose(scan.ranges * np.cos(scan.angles), 2.0, atol=0.0115)


def test_one_seed_is_one_run():
    runs = []
    for _ in range(2):
        station, simulator = started(seeing("reality.camera.exposure_time=0.01"), command=(0.2, 0.8), seed=4)
        simulator.AdvanceTo(0.35)
        tags, scan, pose = newest(station, simulator)
        runs.append(np.concatenate([tags.range, tags.bearing, scan.ranges, pose]))
    np.testing.assert_array_equal(*runs)


def test_a_robot_that_turns_fast_blurs_its_image():
    turned = {}
    for exposure in (0.0, 0.03):
        station, simulator = started(seeing(f"reality.camera.exposure_time={exposure}"), command=(0.0, 1.5))
        simulator.AdvanceTo(0.65)
        tags, _, pose = newest(station, simulator)
        turned[exposure] = tags
    sharp = turned[0.0]
    assert len(sharp.ids)
    p_BT = between(pose[:3], np.array([[1.99, -0.6, 0.0], [1.99, 0.5, 0.0]]))
    assert len(sharp.ids) <= np.count_nonzero(np.abs(np.arctan2(p_BT[:, 1], p_BT[:, 0])) < 0.8)
    # Some 22 pixels, of tags 40 wide.
    assert not len(turned[0.03].ids)


def test_the_camera_s_data_sheet_is_what_the_explorer_believes():
    scenario = ApplySettings(LoadScenario("house"), ["station.eyes=camera", "scan.range=4"])
    assert scenario.tags.field_of_view == scenario.scan.field_of_view == pytest.approx(math.radians(65.0))
    # A tag of 16 cm is 24 pixels wide there.
    assert 502.3 * 0.16 / scenario.tags.range == pytest.approx(24.0, abs=0.01)
    assert scenario.tags.max_incidence == pytest.approx(math.radians(60.0))
    assert scenario.scan.range == 4.0


def test_a_scenario_file_may_say_it_too():
    text = "base: house\nstation: {eyes: camera}\ncamera: {tag_size: 0.08}\nscan: {range: 3}\n"
    scenario = LoadScenario(data=text)
    assert scenario.station.eyes == "camera"
    assert 502.3 * 0.08 / scenario.tags.range == pytest.approx(24.0, abs=0.01)
    assert scenario.scan.range == 3.0
    assert scenario.tags.field_of_view == pytest.approx(math.radians(65.0))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("station.eyes=eagle", "--set station.eyes=eagle: station.eyes: must be one of ideal, camera, is eagle"),
        (
            "reality.tags.clock_offset=0.1",
            "--set: reality.tags.clock_offset: of ideal sensors; leave it out where station.eyes is camera",
        ),
        (
            "tags.field_of_view=3",
            "--set: tags.field_of_view: must be at most 2.61799 where station.eyes is camera",
        ),
        ("scan.least_range=6", "--set: scan.least_range: must be less than scan.range, 5"),
    ],
)
def test_what_a_camera_cannot_do_is_told(setting, message):
    with pytest.raises(ScenarioError) as error:
        seeing(setting)
    assert str(error.value) == message


def test_changes_of_the_world_are_not_rendered():
    scenario = Scenario(world=WORLD)
    scenario.reality.changes = [ChangeConfig(time=1.0)]
    with pytest.raises(ScenarioError, match=r"--set: reality\.changes: cannot be rendered"):
        ApplySettings(scenario, ["station.eyes=camera"])


def test_an_id_without_a_picture_is_told():
    world = WorldConfig(walls=WORLD.walls, tags=[TagConfig(id=600, position=[1.99, 0.5], facing=np.pi)])
    with pytest.raises(ScenarioError, match="id 600 cannot be drawn"):
        ApplySettings(Scenario(world=world), ["station.eyes=camera"])


def test_without_its_packages_it_says_how_to_get_them(monkeypatch):
    monkeypatch.setitem(sys.modules, "robotpy_apriltag", None)
    with pytest.raises(ScenarioError) as error:
        seeing()
    hint = f"get it with {pip_install('camera')}"
    assert str(error.value) == f"--set: station.eyes=camera: robotpy_apriltag is not installed; {hint}"


def test_people_are_seen():
    scenario = seeing("reality.people=1")
    eyes = MakeRenderedEyes(scenario, MakeWorld(scenario.world))
    simulator = Simulator(eyes)
    context = simulator.get_mutable_context()
    eyes.GetInputPort("pose").FixValue(context, np.zeros(5))
    eyes.GetInputPort("noise").FixValue(context, [0.5])
    person = replace(nobody(), p_WP=np.array([[1.2, 0.1]]), v_WP=np.zeros((1, 2)))
    eyes.GetInputPort("people").FixValue(context, AbstractValue.Make(person))
    simulator.AdvanceTo(0.05)
    scan = eyes.GetOutputPort("ranges").Eval(context)
    assert np.nanmin(scan.ranges) == pytest.approx(np.hypot(1.2, 0.1) - RADIUS, abs=0.01)


@pytest.mark.slow
def test_the_house_is_explored_through_pixels(tmp_path):
    scenario = ApplySettings(LoadScenario("house"), ["station.eyes=camera", "seed=2"])
    summary = run_mission(scenario, out_dir=tmp_path, record=False).summary
    assert summary["outcome"] == "complete"
    assert summary["contacts"] == 0
    assert summary["landmarks_reachable"] == 120
    assert summary["landmarks_mapped"] >= 119
    assert summary["landmark_rmse_m"] <= 0.03

"""A mission of a robot that does not know the truth, and one that does not know the world either."""

import json

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.framework import DiagramBuilder

from tests.diagrams.rooms import QUICK_LOOK, ROOM, tagged
from tfg_drake.diagrams.methods import FindMethod
from tfg_drake.diagrams.missions import run, summary_words
from tfg_drake.diagrams.robots import Robot
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.geometry.se2 import compose
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.storage.trajectory import read_tum

START = np.array([2.0, 1.5, 0.3])
TRUTH = ["pose_anees", "online_pose_anees", "area_coverage", "area_seen_s"]
TRUTH += ["contacts", "contacts_received", "min_clearance_m"]
WORLD = ["landmarks_present", "landmarks_reachable", "landmarks_extra", "landmark_rmse_m", "landmark_rmse_aligned_m"]
WORLD += ["landmark_anees", "landmark_nees", "surface_coverage", "surface_coverage_5cm", "surface_phantom_m"]
NOTHING = {"mean": None, "std": None, "max": None, "final": None}


def room():
    return tagged(ROOM + QUICK_LOOK)


def MakeTruthlessStation(scenario):
    """The simulated station behind the ports that any robot has."""
    builder = DiagramBuilder()
    inner = builder.AddNamedSystem("inner", MakeTurtlebotStation(scenario))
    for i in range(inner.num_input_ports()):
        builder.ExportInput(inner.get_input_port(i), inner.get_input_port(i).get_name())
    for i in range(inner.num_output_ports()):
        port = inner.get_output_port(i)
        if not port.get_name().startswith("truth."):
            builder.ExportOutput(port, port.get_name())
    return builder.Build()


def explore(folder, robot, **arguments):
    return run.run_mission(room(), name="room", max_time=30.0, out_dir=folder, robot=robot, **arguments)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    return run.run_mission(room(), name="room", max_time=30.0, out_dir=tmp_path_factory.mktemp("simulated"))


@pytest.fixture(scope="module")
def truthless(tmp_path_factory):
    return explore(tmp_path_factory.mktemp("truthless"), Robot("odd", MakeTruthlessStation, world_known=True))


@pytest.fixture(scope="module")
def worldless(tmp_path_factory):
    return explore(tmp_path_factory.mktemp("worldless"), Robot("odd", MakeTruthlessStation, world_known=False))


def test_without_the_truth_its_figures_are_null_and_the_others_as_they_are(simulated, truthless):
    summary = truthless.summary
    assert list(summary) == list(simulated.summary)
    assert all(summary[name] is None for name in TRUTH)
    errors = ("position_error_m", "position_error_moving_m", "heading_error_rad")
    assert all(summary[name] == NOTHING for name in errors)
    for name in [*WORLD, "landmarks_mapped", "stages", "outcome", "sim_time_s", "landmark_entropy_nats", "map_bytes"]:
        assert summary[name] == simulated.summary[name], name
    assert summary["distance_m"] == pytest.approx(simulated.summary["distance_m"], abs=0.3)
    assert not (truthless.folder / "truth.tum").exists()
    for name in ("map.npz", "trajectory.tum", "stages.jsonl"):
        assert (truthless.folder / name).read_bytes() == (simulated.folder / name).read_bytes()


def test_without_a_world_all_is_in_the_map_frame(simulated, worldless):
    summary = worldless.summary
    assert list(summary) == list(simulated.summary)
    assert all(summary[name] is None for name in [*TRUTH, *WORLD])
    assert summary["map_variables"] == simulated.summary["map_variables"]
    assert summary["landmarks_mapped"] > 0
    saved, known = load_map(worldless.folder / "map.npz"), load_map(simulated.folder / "map.npz")
    assert saved.X_WM.tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(saved.p_ML, known.p_ML)
    _, X_MB = read_tum(worldless.folder / "trajectory.tum")
    _, X_WB = read_tum(simulated.folder / "trajectory.tum")
    np.testing.assert_allclose(compose(START, X_MB), X_WB, atol=1e-6)
    assert (worldless.folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((worldless.folder / "summary.json").read_text()) == summary


def test_the_closing_table_shows_what_is_known(truthless, worldless):
    rows = dict(summary_words.table_rows(truthless.summary))
    assert rows["pose error"] == rows["safety"] == "-"
    assert rows["coverage"] == "100.0 % of the surface within 5 cm"
    rows = dict(summary_words.table_rows(worldless.summary))
    assert rows["tags"] == f"{worldless.summary['landmarks_mapped']} mapped"
    assert rows["coverage"] == "-"


def test_a_truth_of_an_earlier_run_does_not_stay(tmp_path):
    (tmp_path / "truth.tum").write_text("")
    explore(tmp_path, Robot("odd", MakeTruthlessStation, world_known=True, end_time=0.5))
    assert not (tmp_path / "truth.tum").exists()


def test_an_empty_battery_ends_a_mission_by_a_word_of_its_own(tmp_path):
    asked = []

    def empty(recalls):
        asked.append(recalls)
        return "The battery is nearly empty, 13.0 V" if len(asked) > 3 else ""

    robot = Robot("odd", MakeTruthlessStation, world_known=True, empty=empty)
    result = explore(tmp_path, robot)
    assert result.summary["outcome"] == "battery"
    x, y = read_tum(tmp_path / "trajectory.tum")[1][-1, :2]
    where = f"the robot stands at ({x:.2f}, {y:.2f}) m."
    assert result.summary["reason"] == f"The battery is nearly empty, 13.0 V: {where}"
    # A look a second, and this mission can be recalled.
    assert (result.summary["sim_time_s"], set(asked)) == (3.0, {True})


def test_a_mission_ends_with_its_robot(tmp_path):
    robot = Robot("odd", MakeTruthlessStation, world_known=True, end_time=1.5)
    summary = explore(tmp_path, robot).summary
    assert (summary["outcome"], summary["reason"]) == ("time_limit", "the recording has ended")
    assert summary["sim_time_s"] == 1.5


@pytest.mark.parametrize("method", ["tfg", "grid-nearest"])
def test_it_is_shown_in_the_map_frame(method, tmp_path):
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    robot = Robot("odd", MakeTruthlessStation, world_known=False, end_time=1.0)
    explore(tmp_path, robot, meshcat=meshcat, method=FindMethod(method))
    # The ghost of the true pose is there, unseen.
    assert meshcat.HasPath("/tfg/truth")
    assert not meshcat.HasPath("/tfg/world")

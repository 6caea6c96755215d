"""A map that was saved and loaded goes on to the bit as the one that never left memory: estimator and TFG."""

import numpy as np
import pytest

from tfg_drake.config import ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.mapfile.message_arrays import to_arrays
from tfg_drake.mapfile.saved_map import REGISTRY, load_map, resumed, save_map, saved_map
from tfg_drake.messages import LaserScan, Odometry
from tfg_drake.slam.estimator import begin_turn, end_turn, pose_estimate, process_detections, process_odometry
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.tfg.graph import empty_graph, no_sightings, note_sightings, resolve, update
from tfg_drake.tfg.panorama import build_panorama

# 0.05 m behind the tags nearest to them, so that edges, wall ends and loose surfaces come about.
WALLS = np.array([[-9, -9, 9, -9], [9, -9, 9, 9], [9, 9, -9, 9], [-9, 9, -9, -9], [-2, 0, 2, 0]], dtype=float)
ANGLES = np.arange(-124, 125) * np.deg2rad(0.5)


class Explorer:
    """Estimator and TFG side by side, fed with the same messages."""

    def __init__(self, state, tfg_graph):
        self.state, self.tfg_graph, self.sightings, self.tfg = state, tfg_graph, no_sightings(), None

    def feed(self, messages):
        for message in messages:
            process = process_odometry if isinstance(message, Odometry) else process_detections
            self.state = process(self.state, message)
        self.sightings = note_sightings(self.sightings, pose_estimate(self.state))

    def add_goal(self, stamp, scans):
        robot, explorer = RobotConfig(), ExplorerConfig()
        self.state = end_turn(self.state, stamp)
        estimate = self.state.map
        panorama = build_panorama(scans, estimate.observation.stamps, estimate.observation.X_AB)
        self.tfg_graph = update(self.tfg_graph, estimate, panorama, self.sightings, TagSensorConfig(), robot, explorer)
        self.tfg = resolve(self.tfg_graph, estimate, robot, explorer)
        self.sightings = no_sightings()

    def saved(self):
        return saved_map(np.zeros(3), self.state, self.tfg_graph, self.tfg)


def drive_on(robot, explorers, goals, first):
    """Goals on a ring of 6 m; the first of all needs no way there."""
    for goal in range(goals):
        if goal > 0 or not first:
            for _ in range(int(6.0 * 2.0 * np.pi / 8.0 / 0.5 * 32.0)):
                messages = robot.step(0.5, 0.5 / 6.0)
                for explorer in explorers:
                    explorer.feed(messages)
        for explorer in explorers:
            explorer.state = begin_turn(explorer.state, robot.time)
        scans = []
        for step in range(201):
            messages = robot.step(0.0, 1.0)
            for explorer in explorers:
                explorer.feed(messages)
            if step % 3 == 0:
                ranges = cast_rays(WALLS, robot.X_WB[:2], ANGLES + robot.X_WB[2], 10.0)
                ranges = ranges + 0.015 * robot.random.normal(size=len(ranges))
                scans.append(LaserScan(robot.time, ANGLES, ranges, 10.0, 0.015))
        for explorer in explorers:
            explorer.add_goal(robot.time, scans)


@pytest.mark.parametrize("goals", [1, 3])
def test_a_loaded_map_goes_on_to_the_bit(drive, tmp_path, goals):
    rows = np.linspace(-8.5, 8.5, 12)
    tags = np.vstack([[x, y] for x in rows for y in (-8.95, 8.95)] + [[x, y] for y in rows for x in (-8.95, 8.95)])
    robot = drive(tags, 7, 1.0, start=(6.0, 0.0, 0.5 * np.pi))
    explorer = Explorer(process_odometry(initial_state(robot.config), robot.odometry()), empty_graph())
    drive_on(robot, [explorer], goals, first=True)

    save_map(tmp_path / "map.npz", explorer.saved())
    saved = load_map(tmp_path / "map.npz")
    kept, loaded = explorer, Explorer(resumed(saved, explorer.state), saved.tfg_graph)
    for name in ("ids", "p_ML", "X_MD", "X_MA", "covariance"):
        np.testing.assert_array_equal(getattr(kept.state.map, name), getattr(loaded.state.map, name))
    assert kept.state.map.entropy == loaded.state.map.entropy

    drive_on(robot, [kept, loaded], 2, first=False)
    assert kept.state.map.stage == goals + 2
    np.testing.assert_array_equal(kept.state.map.covariance, loaded.state.map.covariance)
    one, other = to_arrays(kept.saved(), REGISTRY), to_arrays(loaded.saved(), REGISTRY)
    assert list(one) == list(other)
    for name in one:
        assert one[name].tobytes() == other[name].tobytes(), name
    assert pose_estimate(kept.state).X_MB.tobytes() == pose_estimate(loaded.state).X_MB.tobytes()
    assert set(kept.tfg.segment_kind.tolist()) >= {0, 2}


def test_a_new_estimator_goes_on_where_the_map_ends(drive, small_map):
    state = initial_state(drive(np.zeros((0, 2)), 1, 0.0).config)
    state = process_odometry(resumed(small_map, state), Odometry(0.0, np.array([7.0, 8.0, 1.0]), np.zeros(2)))
    assert pose_estimate(state).stage == small_map.stage
    np.testing.assert_allclose(pose_estimate(state).X_MB, small_map.graph.X_MD[-1], atol=1e-12)
    np.testing.assert_allclose(
        pose_estimate(state).covariance, small_map.graph.departure_covariance[-1], rtol=1e-6, atol=1e-12
    )


def test_there_is_no_map_before_the_first_goal():
    with pytest.raises(ValueError, match="no map before the first goal"):
        saved_map(np.zeros(3), initial_state(OdometryConfig()), empty_graph(), None)

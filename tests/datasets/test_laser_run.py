"""A laser log mapped by walls and by GMapping, against the true way through a simulated room."""

import dataclasses
import math

import numpy as np
import pytest

from tfg_drake.config import GridConfig, OdometryConfig, ScanConfig
from tfg_drake.datasets.evaluation import hits, relative_error, wall_thickness
from tfg_drake.datasets.laser_log import EXACT_SCANNER, load_breezyslam
from tfg_drake.datasets.laser_run import poses_between, run_grid, run_walls
from tfg_drake.datasets.recording import Recording
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry
from tfg_drake.simulation.laser_scanner import ray_angles, scan
from tfg_drake.slam.estimator_state import EXACT_CAMERA
from tfg_drake.slam.shared import SCANNER_X, Shared, by_data_sheet

CORNERS = np.array([[-5.0, -4.0], [5.0, -4.0], [5.0, 4.0], [1.0, 4.0], [1.0, 2.5], [-5.0, 2.5]])
WALLS = np.hstack([CORNERS, np.roll(CORNERS, -1, axis=0)])
SCANNER = ScanConfig(field_of_view=math.pi)
AHEAD = 0.2


@pytest.fixture(scope="module")
def room():
    """Two rounds of a room by bad odometry, the scanner AHEAD of the wheels, and its true poses."""
    rng, angles, model = np.random.default_rng(1), ray_angles(SCANNER), OdometryConfig()
    turn = np.linspace(0.0, 4.0 * math.pi, 160)
    X_WB = np.column_stack([2.0 * np.sin(turn), -0.5 - 2.0 * np.cos(turn), se2.wrap_angle(turn)])
    X_WS = se2.compose(X_WB, np.array([AHEAD, 0.0, 0.0]))
    steps = se2.between(X_WB[:-1], X_WB[1:]) * [1.01, 1.0, 1.02] + rng.normal(size=(159, 3)) * [0.005, 0.0, 0.005]
    X_OB = [np.zeros(3)]
    for step in steps:
        X_OB.append(se2.compose(X_OB[-1], step))
    scans = [scan(WALLS, X, 0.5 * k, angles, rng.normal(size=len(angles)), SCANNER) for k, X in enumerate(X_WS)]
    prior = by_data_sheet(model, EXACT_CAMERA, EXACT_SCANNER)
    return Recording(
        name="room",
        odometry=tuple(Odometry(0.5 * k, X, np.zeros(2)) for k, X in enumerate(X_OB)),
        detections=(),
        model=model,
        truth=None,
        scans=tuple(scans),
        prior=Shared(prior.mean + AHEAD * np.eye(len(prior.mean))[SCANNER_X], prior.covariance),
    ), X_WS


def test_walls_map_a_room(room):
    log, X_WS = room
    shares = []
    run = run_walls(log, shares.append)
    translation, rotation = relative_error(X_WS, run.X_MS)
    assert translation["mean"] < 0.02
    assert rotation["mean"] < 5e-3
    assert translation["worst_tenth"] > translation["mean"]
    assert len(run.X_MS) == len(run.online) == len(log.scans)
    assert len(CORNERS) <= len(run.state.walls.first) <= len(CORNERS) + 4
    assert wall_thickness(hits(log.scans, run.X_MS)) < 0.03
    assert 0.9 < shares[-1] <= 1.0


def test_gmapping_maps_a_room(room):
    log, X_WS = room
    run = run_grid(log, GridConfig(particles=20), 0)
    assert len(run.stamps) == len(run.X_MS) == len(run.online) == run.state.updates
    translation, _ = relative_error(X_WS, poses_between(log, run.stamps, run.X_MS))
    assert translation["mean"] < 0.05


def test_poses_between_known_ones_share_what_odometry_is_off(room):
    log, _ = room
    some = dataclasses.replace(
        log, odometry=tuple(Odometry(float(k), np.array([k, 0.0, 0.0]), np.zeros(2)) for k in range(80))
    )
    X_MB = np.array([[0.0, 0.0, 0.0], [8.0, 0.8, 0.0]])
    found = poses_between(some, np.array([0.0, 10.0]), X_MB)
    np.testing.assert_allclose(found[::2][:11, 0], np.arange(11) * 0.8)
    np.testing.assert_allclose(found[::2][:11, 1], np.arange(11) * 0.08)
    np.testing.assert_allclose(found[22], [9.0, 0.8, 0.0])  # Beyond them odometry alone tells.


def test_a_log_without_odometry_is_not_mapped(room):
    with pytest.raises(ValueError, match="without odometry"):
        run_walls(dataclasses.replace(room[0], odometry=()))


def test_walls_that_are_seen_twice_are_thick():
    x = np.linspace(0.0, 5.0, 500)
    one = np.column_stack([x, np.zeros(500)])
    assert wall_thickness(one) == pytest.approx(0.0, abs=1e-9)
    assert wall_thickness(np.vstack([one, one + np.array([0.0, 0.1])])) == pytest.approx(0.05, rel=0.02)
    assert math.isnan(wall_thickness(one[::100]))


def test_relative_errors_forget_where_the_map_lies():
    X_WS = np.column_stack([np.arange(50.0), np.zeros(50), np.zeros(50)])
    moved = se2.compose(np.array([3.0, -2.0, 2.5]), X_WS)
    assert max(*relative_error(X_WS, moved)[0].values(), *relative_error(X_WS, moved)[1].values()) < 1e-9
    longer = X_WS * [1.1, 1.0, 1.0]
    translation, rotation = relative_error(X_WS, longer)
    assert 0.5 < translation["mean"] < translation["worst_tenth"] <= 2.0 + 1e-9
    assert rotation["worst_tenth"] < 1e-9


def test_the_rovers_walls_are_sharp(shared_data):
    log = load_breezyslam(shared_data("breezyslam") / "exp1.dat.gz")
    # By its stamps as they are they would be 72 mm thick.
    assert wall_thickness(hits(log.scans, run_walls(log).X_MS)) < 0.06

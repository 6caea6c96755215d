"""What every test shares."""

import dataclasses
import fcntl
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

# Before anything loads BLAS, and for every process that a test starts: small dense operations are many times slower
# when each of several processes spreads them over all cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# They start Python some hundred times: it compiles what they import once.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import hypothesis
import numpy as np
import pytest

from tfg_drake import kernels
from tfg_drake.cockpit.browser import BrowserMissing, open_browser
from tfg_drake.diagrams.compile_kernels import MODULE
from tfg_drake.messages import WALLS_BELOW

# As for the processes above.
sys.dont_write_bytecode = False

# The same examples in every run, and no limit on an example's time: the first call of a kernel compiles it.
hypothesis.settings.register_profile("tfg_drake", deadline=None, derandomize=True)
hypothesis.settings.load_profile("tfg_drake")


# Robots keep real time: most of theirs they wait.
WAITING = ("tests/hardware/", "tests/integration/test_real_robot.py")
# Whole missions: begun first, so that none of them is left over when all else is done.
LONG = ("tests/diagrams/", "tests/integration/")


def pytest_collection_modifyitems(items):
    """File by file, the long ones first; after two that compute comes one that waits: of three at a time one does."""
    files = {}
    for item in items:
        files.setdefault(item.nodeid.partition("::")[0], []).append(item)
    waiting = [name for name in files if name.startswith(WAITING)]
    order = sorted(files.keys() - set(waiting), key=lambda name: (not name.startswith(LONG), name))
    for k, name in enumerate(waiting):
        order.insert(3 * k + 2, name)
    items[:] = [item for name in order for item in files[name]]


@pytest.fixture(scope="session")
def compiled():
    """The kernels of a mission are compiled, by one of the workers: no command has to, or to say that it does."""
    kernels.folder().mkdir(parents=True, exist_ok=True)
    with (kernels.folder() / "tests.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kernels.are_compiled():
            subprocess.run([sys.executable, "-m", MODULE], check=True, stdout=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def coarse_figures():
    """Figures are drawn coarsely, in half the time."""
    from tfg_drake.pictures.figure_file import write_figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write_figure, "__defaults__", (50.0,))
        yield


# Beside the project, where there is one; nothing of it is the project's own.
SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data():
    """A folder of recorded data by name; the test is skipped where it is not there."""

    def folder(name):
        path = SHARED_DATA / name
        if not path.is_dir():
            pytest.skip(f"no recorded data in {path}")
        return path

    return folder


@pytest.fixture
def call(capsys, monkeypatch):
    """tfg-drake with some arguments: its exit code, standard output and standard error, in which nothing that takes
    long on a busy machine is said meanwhile."""
    from tfg_drake.diagrams import cli, screen

    monkeypatch.setattr(screen, "INTERVAL", 1e6)

    def run(*arguments):
        handler = signal.getsignal(signal.SIGINT)
        try:
            with pytest.raises(SystemExit) as caught:
                cli.main([str(argument) for argument in arguments])
        finally:
            signal.signal(signal.SIGINT, handler)
        return (caught.value.code, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def walled_map(small_map):
    """The small map with a wall as a landmark besides, seen from (1, 1), its anchor, to (4, 5) in M, its ends known
    across it to 0.02 m and 0.3 m, independent of each other."""
    near, far = 0.02**2, 0.3**2
    graph, none = small_map.graph, np.zeros((len(small_map.graph.ids), 2))
    graph = dataclasses.replace(
        graph,
        ids=np.append(WALLS_BELOW - 1, graph.ids),
        p_ML=np.vstack([[math.atan2(-0.6, 0.8), 0.0], graph.p_ML]),
        anchor=np.vstack([[1.0, 1.0], none]),
        reach=np.vstack([[0.0, 5.0], none]),
        landmark_covariance=np.concatenate(
            [[[[(near + far) / 25.0, near / 5.0], [near / 5.0, near]]], graph.landmark_covariance]
        ),
    )
    return dataclasses.replace(small_map, graph=graph)


@pytest.fixture(scope="session")
def small_map():
    """Two views, four landmarks, an edge, a wall end, a loose surface, a frontier; X_WM = (5, 3, pi/2)."""
    from tfg_drake.config import OdometryConfig, TagSensorConfig
    from tfg_drake.mapfile.saved_map import saved_map
    from tfg_drake.messages import TfgMap
    from tfg_drake.slam.estimator_state import initial_state
    from tfg_drake.slam.keyframe import of_places, way
    from tfg_drake.slam.keyframe_graph import empty_graph, empty_map, no_observation
    from tfg_drake.slam.map_solver import solve
    from tfg_drake.slam.map_update import updated
    from tfg_drake.slam.shared import by_data_sheet
    from tfg_drake.table import empty
    from tfg_drake.tfg.feature_graph import TfgGraph
    from tfg_drake.tfg.frontier import points_of
    from tfg_drake.tfg.surfaces import Surfaces

    tags = np.array([[2.0, 1.0], [2.0, -1.0], [-1.0, 2.0], [4.0, 1.5]])

    def keyframe(rows, X_MA, X_AD, seed=0):
        """What an exact turn at X_MA sees of some tags, with a dense covariance."""
        n = len(rows)
        R = np.array([[np.cos(X_MA[2]), -np.sin(X_MA[2])], [np.sin(X_MA[2]), np.cos(X_MA[2])]])
        root = np.random.default_rng(seed).normal(size=(2 * n + 3, 2 * n + 3))
        covariance = 1e-3 * (np.eye(2 * n + 3) + 0.1 * root @ root.T)
        p_AL = (tags[rows] - X_MA[:2]) @ R
        none = np.zeros((n, 2))
        return of_places(np.array(rows) + 10, p_AL, none, none, np.array(X_AD), 0.5 * (covariance + covariance.T))

    prior = by_data_sheet(OdometryConfig(), TagSensorConfig())
    driven = way(np.array([1.0, -0.03, 0.08]), 1e-3 * np.eye(3))
    graph, estimate, _ = updated(
        empty_graph(prior), empty_map(prior), keyframe([0, 1, 2], np.zeros(3), [0.0, 0.01, 0.02], 1)
    )
    graph, estimate, _ = updated(graph, estimate, driven, is_view=False)
    graph, estimate, _ = updated(graph, estimate, keyframe([0, 1, 3], np.array([1.0, 0.0, 0.1]), [0.01, 0.0, 0.0], 2))
    graph, estimate = solve(graph, 20.25, no_observation())
    surfaces = Surfaces(
        ids=np.array([[11, 10], [12, -1], [-1, -1]]),
        view=np.array([0, 0, 1]),
        range=np.array([2.3, 2.4, 1.0]),
        offsets=np.array([0, 2, 4, 7]),
        vertices=np.array([[0, 0], [1, 0], [0, 0], [-0.5, 0.1], [0, 1], [0.5, 1.25], [1, 1.25]], dtype=float),
    )
    star = np.array([[1.5, -1.0], [1.5, 1.0], [-1.0, 1.5], [-1.0, -1.0]])
    tfg_graph = empty(
        TfgGraph,
        stage=2,
        surfaces=surfaces,
        tag_ids=estimate.ids,
        tag_view=np.array([0, 0, 0, 1]),
        tag_facing=np.array([[-1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]]),
        tag_range=np.array([2.2, 2.2, np.inf, 3.4]),
        star_offsets=np.array([0, 4, 8]),
        star_vertices=np.vstack([star, star]),
        frontiers=points_of(0, np.array([[-2.0, 0.0]]), np.array([[1.0, 0.0]]), np.array([0.4])),
    )
    segments, kind, ids = np.zeros((4, 4)), np.array([0, 1, 2, 2]), np.array([[11, 10], [12, -1], [-1, -1], [-1, -1]])
    segments[:] = [[2, -1, 2, 1], [-1, 2, -1.5, 2.1], [0.9, 1, 1.4, 1.25], [1.4, 1.25, 1.9, 1.3]]
    resolved = TfgMap(
        stage=2,
        segments=segments,
        segment_kind=kind,
        segment_ids=ids,
        facing=tfg_graph.tag_facing,
        frontiers=np.array([[-2.0, 0.0]]),
        frontier_length=np.array([0.4]),
        frontier_normal=np.array([[1.0, 0.0]]),
        star_offsets=tfg_graph.star_offsets,
        star_vertices=np.vstack([star, star + np.array([1.0, 0.0])]),
        star_centers=estimate.X_MA[:, :2],
    )
    state = dataclasses.replace(initial_state(OdometryConfig(), prior=prior), graph=graph, map=estimate)
    return saved_map(np.array([5.0, 3.0, 0.5 * np.pi]), state, tfg_graph, resolved)


@pytest.fixture(scope="module")
def driver():
    """A browser, for tests of pages; they are skipped where there is none."""
    try:
        driver = open_browser(820, 560)
    except BrowserMissing as error:
        pytest.skip(str(error))
    yield driver
    driver.quit()

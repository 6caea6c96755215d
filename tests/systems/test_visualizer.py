import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from tfg_drake.messages import (
    GoalChoice,
    LaserScan,
    MapEstimate,
    MissionStatus,
    Observation,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)
from tfg_drake.simulation.people import People
from tfg_drake.systems.visualizer import TfgVisualizer
from tfg_drake.world.world import World


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat(MeshcatParams(host="localhost"))


def make_world():
    walls = np.array([[0.0, 0.0, 8.0, 0.0], [8.0, 0.0, 8.0, 5.0]])
    return World(
        walls=walls,
        tag_ids=np.array([3]),
        p_WT=np.array([[4.0, 0.0]]),
        tag_facing=np.array([np.pi / 2]),
        start=np.array([2.0, 2.0, 0.5]),
    )


def make_map(n=2, stage=1):
    observation = Observation(
        ids=np.zeros(0, dtype=int),
        p_AL=np.zeros((0, 2)),
        X_AD=np.zeros(3),
        covariance=np.eye(3),
        stamps=np.zeros(0),
        X_AB=np.zeros((0, 3)),
    )
    return MapEstimate(
        stage=stage,
        stamp=1.0,
        ids=np.arange(n),
        p_ML=np.arange(2.0 * n).reshape(n, 2),
        X_MD=np.zeros(3),
        local=np.arange(n),
        covariance=0.01 * np.eye(2 * n + 3),
        landmark_covariance=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        X_MA=np.zeros((stage, 3)),
        observation=observation,
        entropy=-1.0,
    )


def make_messages(f=2):
    """One of each; f frontiers, surfaces, candidates and path points, 0 for the empty messages of the beginning."""
    points = np.arange(2.0 * f).reshape(f, 2)
    tfg = TfgMap(
        stage=1,
        segments=np.hstack([points, points + 1.0]),
        segment_kind=np.arange(f) % 3,
        segment_ids=np.full((f, 2), -1),
        facing=np.zeros((f, 2)),
        frontiers=points,
        frontier_length=np.ones(f),
        frontier_normal=np.zeros((f, 2)),
        star_offsets=np.zeros(1, dtype=int),
        star_vertices=np.zeros((0, 2)),
        star_centers=np.zeros((0, 2)),
    )
    roadmap = Roadmap(
        stage=1,
        points=points,
        edges=np.array([[0, 1]] if f else np.zeros((0, 2), dtype=int)),
        reachable=np.ones(f, dtype=bool),
        enterable=np.ones(f, dtype=bool),
        entry=np.arange(f),
        travel_time=np.ones(f),
        travel_length=np.ones(f),
    )
    goal = GoalChoice(
        stage=1,
        node=0 if f else -1,
        p_MG=np.zeros(2),
        candidates=np.arange(f),
        exploitation=np.ones(f),
        exploration=np.ones(f),
        pose_price=np.zeros(f),
        gain=np.ones(f),
        value=np.ones(f),
        verdict="goal" if f else "complete",
        reason="",
    )
    pose = PoseEstimate(
        stamp=1.0,
        X_MB=np.array([1.0, 0.0, 0.1]),
        covariance=1e-4 * np.eye(3),
        speed=np.zeros(2),
        stage=1,
        new_ids=np.zeros(0, dtype=int),
        p_MU=np.zeros((0, 2)),
    )
    ranges = np.array([1.0, np.inf, 2.0]) if f else np.full(3, np.inf)
    scan = LaserScan(stamp=1.0, angles=np.array([-1.0, 0.0, 1.0]), ranges=ranges, range_max=10.0, sigma=0.01)
    return {
        "map": make_map(f),
        "tfg": tfg,
        "roadmap": roadmap,
        "goal": goal,
        "path": Path(id=1, stage=1, points=points),
        "pose": pose,
        "scan": scan,
        "mission": MissionStatus(phase="follow", stage=1, since=0.0),
    }


def make_diagram(meshcat, messages, world=None):
    builder = DiagramBuilder()
    visualizer = TfgVisualizer(meshcat, world, np.array([2.0, 2.0, 0.5]), 0.18, "test")
    builder.AddNamedSystem("visualizer", visualizer)
    for name, message in messages.items():
        source = builder.AddSystem(ConstantValueSource(Value[object](message)))
        builder.Connect(source.get_output_port(), visualizer.GetInputPort(name))
    if messages:
        truth = builder.AddSystem(ConstantVectorSource([3.0, 2.0, 0.5, 0.0, 0.0]))
        builder.Connect(truth.get_output_port(), visualizer.GetInputPort("truth"))
    return builder.Build()


STAGE_PATHS = ["map/landmarks", "map/surfaces/edge", "map/frontiers", "map/roadmap", "map/candidates", "map/path/line"]


def test_draws_everything_that_is_there(meshcat):
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(1.0)
    for path in [*STAGE_PATHS, "walls", "map/robot", "map/scan", "truth", "caption", "map/ellipses", "map/path/goal"]:
        assert meshcat.HasPath(f"/tfg/{path}"), path


def test_draws_who_walks_about(meshcat):
    none, nobody = np.zeros(2), np.zeros(2, dtype=bool)
    p_WP = np.array([[1.0, 2.0], [3.0, 4.0]])
    people = People(0.0, p_WP, np.zeros((2, 2)), none, none, none, nobody, nobody, (np.zeros((0, 2)),) * 2)
    Simulator(make_diagram(meshcat, {"people": people}, make_world())).AdvanceTo(0.5)
    assert meshcat.HasPath("/tfg/people")
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(0.5)
    assert not meshcat.HasPath("/tfg/people")


def test_empty_messages_leave_nothing_behind(meshcat):
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(0.5)
    Simulator(make_diagram(meshcat, make_messages(f=0), make_world())).AdvanceTo(0.5)
    for path in ("map/landmarks", "map/frontiers", "map/candidates", "map/path/line", "map/scan"):
        assert not meshcat.HasPath(f"/tfg/{path}"), path


def test_works_with_nothing_connected(meshcat):
    diagram = make_diagram(meshcat, {})
    Simulator(diagram).AdvanceTo(0.5)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    assert meshcat.HasPath("/tfg/caption")


def test_before_there_is_anything_the_true_robot_stands_at_the_start(meshcat):
    visualizer = TfgVisualizer(meshcat, make_world(), np.array([2.0, 2.0, 0.5]), 0.18, "test")
    meshcat.Delete("/tfg/caption")
    visualizer.word = "compiling"
    visualizer.ShowBeginning()
    assert meshcat.HasPath("/tfg/caption")
    assert meshcat._GetPackedProperty("/tfg/truth", "visible").endswith(b"\xc3")
    start = np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0, -np.sin(0.5), np.cos(0.5), 0, 0, 0, 0, 1, 0, 2.0, 2.0, 0, 1])
    assert start.astype(">f8").tobytes()[:8] in meshcat._GetPackedTransform("/tfg/truth")


def test_a_caption_is_kept_for_browsers_that_are_late(meshcat, monkeypatch):
    shown = []
    monkeypatch.setattr("tfg_drake.systems.visualizer.render_caption", lambda *words: shown.append(words) or b"")
    now = [0.0]
    monkeypatch.setattr("tfg_drake.systems.visualizer.time.monotonic", lambda: now[0])
    visualizer = TfgVisualizer(meshcat, None, np.zeros(3), 0.18, "test")
    for _ in range(3):  # two in CAPTION_INTERVAL
        visualizer.ShowBeginning()
        now[0] += 0.3
    assert len(shown) == 2
    assert meshcat.HasPath("/tfg/captions/0")
    assert meshcat.HasPath("/tfg/captions/1")
    assert meshcat._GetPackedProperty("/tfg/captions", "visible").endswith(b"\xc2")


def test_the_end_is_drawn_whenever_it_comes(meshcat, monkeypatch):
    shown = []
    monkeypatch.setattr(
        TfgVisualizer, "_ShowCaption", lambda self, title, figures: shown.append((title, dict(figures)))
    )
    mission = MissionStatus(phase="done", stage=1, since=0.4, outcome="complete")
    diagram = make_diagram(meshcat, make_messages() | {"mission": mission})
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.4)
    diagram.ForcedPublish(simulator.get_context())
    assert shown[-1][0] == "test, complete"
    assert shown[-1][1]["stage"] == "1"


@pytest.mark.parametrize(
    ("phase", "moving", "shown"),
    [("follow", True, True), ("glance", True, True), ("map", True, True), ("map", False, False)],
)
def test_the_path_is_shown_as_long_as_the_robot_drives(meshcat, phase, moving, shown):
    mission = MissionStatus(phase=phase, stage=1, since=0.0, moving=moving)
    Simulator(make_diagram(meshcat, make_messages() | {"mission": mission})).AdvanceTo(0.5)
    true, false = b"\xc3", b"\xc2"  # as msgpack has them
    assert meshcat._GetPackedProperty("/tfg/map/path", "visible").endswith(true if shown else false)


class GrowingMap(LeafSystem):
    """A map that gains a landmark at 0.3 s."""

    def __init__(self, first, second):
        super().__init__()
        state = self.DeclareAbstractState(Value[object](first))
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            10.0, 0.3, lambda _c, s: s.get_mutable_abstract_state(0).set_value(second)
        )
        self.DeclareStateOutputPort("map", state)


def test_redraws_a_stage_once_and_only_when_it_changes(meshcat, monkeypatch):
    builder = DiagramBuilder()
    first, second = make_map(1, 1), make_map(2, 2)
    source = builder.AddSystem(GrowingMap(first, second))
    visualizer = builder.AddSystem(TfgVisualizer(meshcat, None, np.zeros(3), 0.18, "test"))
    builder.Connect(source.get_output_port(), visualizer.GetInputPort("map"))
    shown = []
    monkeypatch.setattr(visualizer, "_ShowLandmarks", shown.append)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    assert [message.stage for message in shown] == [1, 2]

    # What is drawn belongs to the context: a new one begins anew.
    Simulator(simulator.get_system()).AdvanceTo(0.2)
    assert [message.stage for message in shown] == [1, 2, 1]

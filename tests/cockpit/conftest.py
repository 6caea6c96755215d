"""A mission to look at, made up: a room of 6 x 4 m, three stages, an end."""

import numpy as np
import pytest

from tfg_drake.cockpit.server import Cockpit
from tfg_drake.pictures.rows import Table
from tfg_drake.storage.timeline import FILE_NAME, TimelineWriter

WALLS = np.array([[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]], dtype=float)
STAGES = (2.0, 5.0, 8.0)
SUMMARY = {
    "outcome": "complete",
    "reason": "Nothing is left <b>to see</b>.",
    "sim_time_s": 9.85,
    "distance_m": 4.04,
    "stages": 3,
    "landmarks_mapped": 3,
    "landmarks_reachable": 3,
    "landmark_rmse_m": 0.02,
    "landmark_rmse_aligned_m": 0.01,
    "position_error_moving_m": {"mean": 0.015},
    "area_coverage": 1.0,
    "surface_coverage_5cm": 0.9996,
    "contacts": 0,
    "contacts_received": 1,
    "folder": "runs/room",
}
GOAL = {"at": [1.0, 1.0], "exploitation": 2.0, "exploration": 3.5, "pose_price": 0.5, "gain": 5.5, "time": 4.0}
EXPLAINED = [{**GOAL, "rate": 1.4, "chosen": i == 0} for i in range(4)]
# Somebody's push, at 4 s, and what the scenario says, at 7 s and after the end.
PUSH = {"time": 4.0, "duration": 0.5, "ahead": 0.0, "left": 0.5, "turn": 0.5235987755982988, "gyro_feels": True}
SCRIPTED = [{**PUSH, "time": 7.0, "left": -0.2}, {**PUSH, "time": 70.0}]


# The ends of a scan's rays: a wall one metre ahead, as far as half a metre to the left; to the right nothing is met.
ENDS = np.array([[2.0, -3.0], [3.0, -1.0], [3.0, -0.4], *((1.0, y) for y in np.arange(-0.1, 0.51, 0.05)), [1.5, 1.5]])


def f4(*values):
    return {"pose": np.array(values, dtype=np.float32)}


def begin(writer, *, simulated=True):
    """The mission before it has begun to move."""
    camera = {"range": 2.0, "field_of_view": 2.0}
    told = {"title": "room, seed 3", "radius": 0.18, "rule": "tour", "simulated": simulated, "camera": camera}
    told["pushes"] = SCRIPTED if simulated else []
    tags = {"tags": np.array([[3.0, 0.0]]), "tag_facing": np.array([1.57]), "ids": np.array([1])}
    writer.write("world", 0.0, {"segments": WALLS, **tags} if simulated else {}, **told)
    writer.write("frame", 0.0, f4(1.0, 2.0, 0.0))
    writer.write("enabled", 0.0, {}, enabled=True)
    writer.write("mission", 0.0, {}, phase="observe", stage=0, outcome="", reason="", drives=False)
    drive(writer, 0.0)


def drive(writer, time):
    """Where the robot is, as it believes and truly, and what it scans."""
    x = 0.4 * time
    writer.write("pose", time, f4(x, 0.0, 0.0, 1e-2, 0.0, 2e-2, 1e-3))
    writer.write("truth", time, f4(1.02 + x, 2.0, 0.0))
    rays, met = np.array([[x, 0.0]]) + np.vstack([[[0.0, 0.0]], ENDS]), np.arange(len(ENDS)) > 2
    writer.write("scan", time, {"rays": rays, "met": met})


def stage(writer, number, time):
    """What is known after a stage: a tag and a wall more each."""
    k = np.arange(number)
    points = np.stack([1.5 * k, np.full(number, -1.9)], axis=1)
    covariance = np.tile(np.array([0.01, 0.002, 0.02], dtype=np.float32), (number, 1))
    doubtful = k == 2
    tags = Table({"points": points, "covariance": covariance, "doubtful": doubtful, "ids": k}, points, k)
    writer.write_rows("map", time, tags, stage=number, entropy=-5.0 * number, views=number)
    segments = np.array([[-0.9, -2.0, 1.5, -2.0], [1.5, -2.0, 3.0, -2.0], [5.0, -2.0, 5.0, 0.5]])[:number]
    segments = np.vstack([segments, [[4.0, 0.0, 4.5, 0.5]]])  # of an area to keep out of
    walls = np.array([[-0.9, -2.0, 1.5, -2.0], [5.0, -2.0, 5.0, 0.5]])[: number - 1]
    known = {"segments": walls, "deviation": np.array([[0.1, 0.3], [1e-4, 1e-4]], dtype=np.float32)[: number - 1]}
    writer.write_rows("wall_landmarks", time, Table(known, walls, k[1:]))
    kind = np.append(k, 3).astype(np.uint8)
    writer.write_rows("tfg", time, Table({"segments": segments, "kind": kind}, 1e3 * segments))
    bars = np.array([[3.0, -1.0, 3.0, -0.6], [3.2, 0.0, 3.2, 0.4]])
    writer.write_rows("frontiers", time, Table({"segments": bars}, bars))
    star = np.array([[1.0, 0.0], [-0.8, -1.8], [2.0 + number, -1.8], [2.0 + number, 1.8], [-0.8, 1.8]])
    writer.write("free", time, {"index": np.array([0]), "count": np.array([5]), "points": star})
    nodes = np.array([[0.0, 1.0], [2.0, 1.0], [2.0, -1.0], [3.5, 1.2]])
    ids, edges = np.array([2, 5, 6, 9]), np.array([[2, 5], [5, 6], [5, 9]])
    writer.write_rows("nodes", time, Table({"points": nodes, "ids": ids}, nodes, ids))
    writer.write_rows("roadmap", time, Table({"edges": edges}, edges.astype(float)))
    stops = 3 - number if number > 1 else 3
    tour = {"tour": nodes[[3, 2, 0]][:stops], "done": np.array([6.0, 11.5, 21.0], dtype=np.float32)[:stops]}
    # By way of the roadmap's corner (2, 1), and straight on.
    tour["legs"] = np.array([[3.5, 1.2, 2, 1], [2, 1, 2, -1], [2, -1, 2, 1], [2, 1, 0, 1]])[: 2 * max(stops - 1, 0)]
    told = {"verdict": "goal", "reason": "It looks round once more.", "stage": number, "sent": False, "most": 31.4}
    writer.write("goal", time, {"points": nodes[-1:], **tour}, **told)
    share = np.array([25, 128, 180, 255], dtype=np.uint8)
    writer.write("gains", time, {"points": nodes, "share": share}, explained=EXPLAINED, stage=number)
    writer.write("path", time, {"segments": np.array([[0.0, 0.0, 2.0, 1.0], [2.0, 1.0, 3.5, 1.2]])})
    writer.write("mission", time, {}, phase="follow", stage=number, outcome="", reason="", drives=True)


def end(writer):
    """The mission's end, at 10 s."""
    writer.write("mission", 10.0, {}, phase="done", stage=3, outcome="complete", reason="", drives=False)
    writer.write("end", 10.0, {}, **SUMMARY)
    writer.flush()


def write_mission(path):
    """All of it."""
    with TimelineWriter(path) as writer:
        begin(writer)
        for time in np.arange(0.25, 10.01, 0.25):
            drive(writer, time)
            if time < STAGES[0]:
                seen = np.array([[1.5, 0.4], [2.0, 0.4 + time]])
                writer.write("sighted", time, {"points": seen, "ids": np.array([3, int(time)])})
            if time == PUSH["time"]:
                writer.write("pushes", time, {}, pushes=[PUSH])
            if time in STAGES:
                stage(writer, STAGES.index(time) + 1, time)
        end(writer)


@pytest.fixture(scope="session")
def mission(tmp_path_factory):
    """The file of a mission that has ended."""
    path = tmp_path_factory.mktemp("mission") / FILE_NAME
    write_mission(path)
    return path


@pytest.fixture
def cockpit(mission):
    """A mission under way, as far as its server knows; simulated."""
    with Cockpit("/* viewer */", "room", timeline=mission, rate=8.0) as cockpit:
        yield cockpit

"""What an explorer knows of a room of 4 m by 3 m, mapped from its middle; its right half is hidden."""

import numpy as np

from tfg_drake.messages import (
    GoalChoice,
    GridMap,
    MapEstimate,
    Observation,
    Odometry,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)


def estimate():
    """Two landmarks on the lower and the left wall."""
    return MapEstimate(
        stage=1,
        stamp=10.0,
        ids=np.array([7, 12]),
        p_ML=np.array([[-1.0, -1.52], [-2.02, 0.5]]),
        anchor=np.zeros((2, 2)),
        reach=np.zeros((2, 2)),
        X_MD=np.zeros(3),
        local=np.arange(2),
        covariance=1e-4 * np.eye(7),
        landmark_covariance=np.array([np.diag([4e-4, 1e-4]), np.diag([1e-4, 1e-4])]),
        X_MA=np.zeros((1, 3)),
        observation=Observation(
            ids=np.zeros(0, dtype=int),
            stamps=np.zeros(0),
            X_AB=np.zeros((0, 3)),
        ),
        entropy=-1.0,
    )


def tfg():
    """Free from the left wall to x = 0.5; walls to the left, below and above."""
    star = np.array([[-1.96, -1.46], [0.5, -1.46], [0.5, 1.46], [-1.96, 1.46]])
    return TfgMap(
        stage=1,
        segments=np.array([[-2.02, -1.52, 0.5, -1.52], [-2.02, 1.52, -2.02, -1.52], [-2.02, 1.52, 0.5, 1.52]]),
        segment_kind=np.array([0, 1, 2]),
        segment_ids=np.array([[7, 12], [12, -1], [-1, -1]]),
        facing=np.array([[0.0, 1.0], [1.0, 0.0]]),
        frontiers=np.array([[0.6, 0.0]]),
        frontier_length=np.array([2.9]),
        frontier_normal=np.array([[-1.0, 0.0]]),
        star_offsets=np.array([0, 4]),
        star_vertices=star,
        star_centers=np.zeros((1, 2)),
    )


def roadmap():
    """Two places to go to."""
    points, every = np.array([[0.3, 0.0], [-1.0, 1.0]]), np.ones(2, dtype=bool)
    return Roadmap(1, points, np.array([[0, 1]]), every, every, np.arange(2), np.ones(2), np.ones(2))


def goal():
    """The first of them, the second worth half as much."""
    gain = np.array([4.0, 2.0])
    return GoalChoice(1, 0, np.array([0.3, 0.0]), np.arange(2), gain, gain, np.zeros(2), gain, gain, "goal", "")


def path():
    """To the right, then up."""
    return Path(1, 1, np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.4]]))


def pose(stamp):
    """The map's estimate at a stamp, s."""
    covariance = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 3e-4, -1e-5], [2e-5, -1e-5, 1e-5]])
    none = np.zeros(0, dtype=int)
    return PoseEstimate(stamp, np.array([0.2, -0.1, 0.6]), covariance, np.zeros(2), 1, none, np.zeros((0, 2)))


def odometry(stamp):
    """Where the base believes to be: elsewhere."""
    return Odometry(stamp, np.array([3.0, 1.0, -2.0]), np.zeros(2))


def grid():
    """Two rows of three cells: occupied, free, unknown; free, free, occupied."""
    probability = np.array([[0.9, 0.1, 0.5], [0.2, 0.3, 0.8]], dtype=np.float32)
    return GridMap(1, 10.0, 0.1, np.array([-1.0, 2.0]), probability)


def messages(stamp):
    """All of the TFG explorer's, and the odometry, by the ports of MapPublisher."""
    return {
        "pose": pose(stamp),
        "odometry": odometry(stamp),
        "map": estimate(),
        "tfg": tfg(),
        "roadmap": roadmap(),
        "goal": goal(),
        "path": path(),
    }

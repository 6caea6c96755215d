"""A ring one step before its loop closes: the gains that a window promises against those of the full covariance.

    python benchmarks/ring.py --goals 160

A robot goes nearly once round a ring of tags, 5 m from goal to goal. The estimator sees the ring through a window round
the robot; then the whole map is made known jointly. A row a place along the ring, from before the robot to beyond the
gap: tags in view, exploitation by window and whole, and their ratio; then, of the landmarks beyond the gap, how far
off (m, one standard deviation) window and whole take them to be, seen from the robot.
"""

from __future__ import annotations

import argparse

import numpy as np
from map_size import PITCH, REACH, SEGMENT, X_AD, Synthetic
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, MapEstimate
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain
from tfg_drake.planning.information_gain import (
    departure_given_landmarks,
    odometry_covariance,
    sightings_of_turn,
    turn_noise,
)
from tfg_drake.slam import map_solver
from tfg_drake.slam.departure_frame import in_departure_frame
from tfg_drake.slam.goal_arrival import add_goal
from tfg_drake.slam.goal_graph import empty_graph

# Goals short of the whole ring, and landmarks a goal.
SHORT = 4
LANDMARKS = 12
SPEED = 0.5  # m/s


def ring(goals: int) -> Synthetic:
    """Goals round a ring, and landmarks up to 5 m to either side."""
    rng = np.random.default_rng(1)
    radius = goals * PITCH / (2.0 * np.pi)
    a = 2.0 * np.pi * np.arange(goals) / goals
    X_WA = np.column_stack([radius * np.cos(a), radius * np.sin(a), rng.uniform(-np.pi, np.pi, goals)])
    b, r = rng.uniform(0.0, 2.0 * np.pi, LANDMARKS * goals), radius + rng.uniform(-5.0, 5.0, LANDMARKS * goals)
    return Synthetic(X_WA, np.column_stack([r * np.cos(b), r * np.sin(b)]), rng)


def exploitation(estimate: MapEstimate, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nats (c,) of a turn at places (c, 2), m in M, and the tags (c,) in view."""
    p_ML = estimate.p_ML[estimate.local]
    views = [np.sort(np.array(rows, dtype=np.int64)) for rows in cKDTree(p_ML).query_ball_point(places, REACH)]
    count = np.array([len(rows) for rows in views])
    offsets, none = np.append(0, np.cumsum(count)), np.zeros(0, dtype=np.int64)
    distance = np.hypot(*(places - estimate.X_MD[:2]).T)
    Q = odometry_covariance(estimate.X_MD, places, distance, distance / SPEED, OdometryConfig())
    arrival = Arrival(estimate.X_MD, departure_given_landmarks(estimate), Q)
    known = Known(offsets, np.concatenate(views), p_ML, estimate.covariance)
    no_new = np.zeros(len(places) + 1, dtype=np.int64)
    new = New(no_new, none, np.zeros((0, 2)), np.zeros(0), 10.0, np.array([REACH, 0.5 * REACH]))
    noise = turn_noise(TagSensorConfig(), sightings_of_turn(TagSensorConfig(), 1.0))
    gains = exact_gain(places, arrival, known, new, noise)
    return gains[:, 0], count


def main() -> None:
    """Drive round, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=160)
    goals = parser.parse_args().goals
    world = ring(goals)
    graph, estimate = empty_graph(), None
    with threadpool_limits(1):
        for k in range(goals - SHORT):
            observation = world.observation(k)
            graph, _ = add_goal(graph, estimate, observation, world.segment(k) if k else X_AD, SEGMENT)
            graph, estimate = map_solver.solve(graph, float(k), observation)
        assert estimate is not None
        _, everything = map_solver.whole(graph, 0.0, observation)
    at = np.arange(goals - 2 * SHORT, goals + 4, 0.5)
    a = 2.0 * np.pi * at / goals
    on_ring = np.hypot(*world.X_WA[0, :2]) * np.column_stack([np.cos(a), np.sin(a)])
    places = np.ascontiguousarray(se2.transform(se2.inverse(world.X_WA[0]), on_ring))
    window, count = exploitation(estimate, places)
    full, _ = exploitation(everything, places)
    print(f"{len(estimate.ids)} landmarks, {len(estimate.local)} known jointly, the robot at {goals - SHORT - 1}")
    print("   at  tags  window  whole  ratio")
    for row in zip(at, count, window, full, window / full, strict=True):
        print("{:5.1f}{:6d}{:8.2f}{:7.2f}{:7.3f}".format(*row))
    print(f"largest error {np.max(np.abs(window / full - 1.0)):.1%}")
    angle = np.arctan2(*world.p_WL[estimate.ids[estimate.local]].T[::-1])
    beyond = estimate.local[(angle > 0.0) & (angle < np.pi / 2.0)]
    seen = [in_departure_frame(one, beyond)[1][: 2 * len(beyond)] for one in (estimate, everything)]
    off = [float(np.sqrt(2.0 * np.diag(P[:, : 2 * len(beyond)]).mean())) for P in seen]
    print(f"beyond the gap {off[0]:.2f} and {off[1]:.2f} m off")


if __name__ == "__main__":
    main()

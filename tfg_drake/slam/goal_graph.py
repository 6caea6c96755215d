"""The goal graph: what every goal saw, the segments between goals, and where all that lies in the map.

Variables: arrival pose A_k and departure pose D_k of every goal, landmarks L_i; A_0 is the map's origin. The graph is
kept as plain arrays and built in GTSAM where it is solved (`goal_factors`, `map_solver`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import BoolArray, FloatArray, GoalObservation, IntArray, MapEstimate, message, replace

# Landmarks that tell where a goal lies without odometry.
WITNESSES = 2
# Range scales that differ by less are the same: a millimetre at ten metres.
SAME_SCALE = 1e-4


@message
class GoalFactor:
    """A goal's observation as the graph keeps it: without the trajectory, in a quarter of the memory.

    ids: (n,). p_AL: (n, 2), m. X_AD: (3,). root: ((2n + 3)(n + 2),) the lower Cholesky factor of the observation's
    covariance, row by row, in single precision: whatever the rounding, it stays a covariance. range_scale: the error of
    scale taken out of its ranges.
    """

    ids: IntArray
    p_AL: FloatArray
    X_AD: FloatArray
    root: NDArray[np.float32]
    range_scale: float

    @property
    def cholesky(self) -> FloatArray:
        """(2n + 3, 2n + 3) lower triangular."""
        size = 2 * len(self.ids) + 3
        factor = np.zeros((size, size))
        factor[np.tri(size, dtype=bool)] = self.root
        return factor

    @property
    def observation(self) -> GoalObservation:
        """The observation, without its trajectory."""
        root = self.cholesky
        nothing = np.empty(0), np.empty((0, 3))
        return GoalObservation(self.ids, self.p_AL, self.X_AD, root @ root.T, *nothing, self.range_scale)


def goal_factor(observation: GoalObservation) -> GoalFactor:
    """What is kept of an observation. Raises numpy.linalg.LinAlgError where its covariance is singular."""
    root = np.linalg.cholesky(observation.covariance)
    packed = root[np.tri(len(root), dtype=bool)].astype(np.float32)
    return GoalFactor(observation.ids, observation.p_AL, observation.X_AD, packed, observation.range_scale)


def rescaled(graph: GoalGraph, range_scale: float) -> GoalGraph:
    """The graph with the range scale error, as it is known now, taken out of the observations from when it was not.

    The robot turned in place: what it saw grows or shrinks about A.
    """

    def again(factor: GoalFactor) -> GoalFactor:
        if abs(factor.range_scale - range_scale) < SAME_SCALE:
            return factor
        p_AL = factor.p_AL * ((1.0 + factor.range_scale) / (1.0 + range_scale))
        return replace(factor, p_AL=p_AL, range_scale=range_scale)

    return replace(graph, observations=tuple(again(factor) for factor in graph.observations))


@message
class GoalGraph:
    """The factors and current values of k goals and n landmarks, and how well the values are known.

    A piece of the way between two goals that is mapped too (a path keyframe) is kept as a goal is. observations: k.
    is_goal: (k,) False for such pieces. X_DA: (k - 1, 3) and segment_covariance: (k - 1, 3,
    3), the segments from D_j to A_j+1, of (x, y) in D and theta. X_MA, X_MD: (k, 3). ids: (n,) ascending, p_ML: (n, 2).

    sightings: (n,) how many of the observations each landmark is in. travel_covariance: (k - 1, 3, 3) of the way from
    D_j to D_j+1, of (x, y) in D_j and theta, as all tags known on arrival had it; over a mapped piece, the piece's own.
    departure_covariance: (k, 3, 3) of X_MD when that goal was the newest, infinite for pieces of the way, and
    landmark_covariance: (n, 2, 2) of p_ML, on a large map as it was when the robot was last near. entropy: of the
    landmarks, nats; on a large map what its windows gained one after another, until the whole is solved.
    """

    observations: tuple[GoalFactor, ...]
    is_goal: BoolArray
    X_DA: FloatArray
    segment_covariance: FloatArray
    X_MA: FloatArray
    X_MD: FloatArray
    ids: IntArray
    p_ML: FloatArray
    sightings: IntArray
    travel_covariance: FloatArray
    departure_covariance: FloatArray
    landmark_covariance: FloatArray
    entropy: float


def empty_graph() -> GoalGraph:
    """The graph before the first goal."""
    none, poses, covariances = np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 3, 3))
    return GoalGraph(
        observations=(),
        is_goal=np.empty(0, dtype=bool),
        X_DA=poses,
        segment_covariance=covariances,
        X_MA=poses,
        X_MD=poses,
        ids=none,
        p_ML=np.empty((0, 2)),
        sightings=none,
        travel_covariance=covariances,
        departure_covariance=covariances,
        landmark_covariance=np.empty((0, 2, 2)),
        entropy=0.0,
    )


def empty_map() -> MapEstimate:
    """The map of stage 0: no landmark, the robot at the origin, known exactly."""
    none = np.empty(0, dtype=np.int64)
    nothing = GoalObservation(
        ids=none,
        p_AL=np.empty((0, 2)),
        X_AD=np.zeros(3),
        covariance=np.zeros((3, 3)),
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
    )
    return MapEstimate(
        stage=0,
        stamp=0.0,
        ids=none,
        p_ML=np.empty((0, 2)),
        X_MD=np.zeros(3),
        local=none,
        covariance=np.zeros((3, 3)),
        landmark_covariance=np.empty((0, 2, 2)),
        X_MA=np.empty((0, 3)),
        observation=nothing,
        entropy=0.0,
    )


def rows_of(ids: IntArray, known: IntArray) -> tuple[IntArray, BoolArray]:
    """Rows (m,) of some ids among the known ones (n,), ascending, and which of them are known (m,)."""
    if len(known) == 0:
        return np.zeros(len(ids), dtype=np.int64), np.zeros(len(ids), dtype=bool)
    row = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return row, np.asarray(known[row] == ids)


def loosened(graph: GoalGraph, covariance: FloatArray) -> GoalGraph:
    """The graph with this covariance (3, 3) for the newest segments, back to one whose end shares WITNESSES landmarks
    with the goals before it: nothing but odometry speaks for those, and it has been found wrong."""
    segment_covariance, travel_covariance = graph.segment_covariance.copy(), graph.travel_covariance.copy()
    for k in range(len(graph.observations) - 1, 0, -1):
        before = [other.ids for other in graph.observations[:k]]
        if np.isin(graph.observations[k].ids, np.concatenate(before)).sum() >= WITNESSES:
            break
        segment_covariance[k - 1] = travel_covariance[k - 1] = covariance
    return replace(graph, segment_covariance=segment_covariance, travel_covariance=travel_covariance)


def forget(graph: GoalGraph, ids: IntArray) -> GoalGraph:
    """The graph without some landmarks, as if they had never been seen: they stand elsewhere now."""
    keep = ~np.isin(graph.ids, ids)
    lost = np.linalg.slogdet(2.0 * math.pi * math.e * graph.landmark_covariance[~keep])[1]
    return replace(
        graph,
        observations=tuple(forgetting(factor, ids) for factor in graph.observations),
        ids=graph.ids[keep],
        p_ML=graph.p_ML[keep],
        sightings=graph.sightings[keep],
        landmark_covariance=graph.landmark_covariance[keep],
        entropy=graph.entropy - 0.5 * float(np.sum(lost)),
    )


def forgetting(factor: GoalFactor, ids: IntArray) -> GoalFactor:
    """A goal's observation with some tags marginalised out."""
    if not np.isin(factor.ids, ids).any():
        return factor
    return goal_factor(without_tags(factor.observation, ids))


def without_tags(observation: GoalObservation, ids: IntArray) -> GoalObservation:
    """The observation with some tags marginalised out."""
    if len(ids) == 0:
        return observation
    keep = ~np.isin(observation.ids, ids)
    rows = np.concatenate([np.repeat(keep, 2), np.ones(3, dtype=bool)])
    return GoalObservation(
        ids=observation.ids[keep],
        p_AL=observation.p_AL[keep],
        X_AD=observation.X_AD,
        covariance=observation.covariance[np.ix_(rows, rows)],
        stamps=observation.stamps,
        X_AB=observation.X_AB,
        range_scale=observation.range_scale,
    )

"""The information about the landmarks that a full turn at a candidate goal is expected to bring.

By default the mutual information of all landmarks, known and new, and the measurements of the turn (`exact_gain`). It
is what the paper's Section IV approximates (Theorem 1); it holds for a pose that odometry ties to the map, and depends
on relative covariance only. The approximations, by name: `approximate_gain`.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tfg_drake.config import ExplorerConfig, OdometryConfig, TagSensorConfig
from tfg_drake.messages import FloatArray, MapEstimate, TfgMap
from tfg_drake.planning.approximate_gain import authors_gain, limit_gain, paper_gain
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain
from tfg_drake.planning.expected_view import View, local_view
from tfg_drake.planning.odometry_drift import odometry_covariance

# A turn's measurements of one tag are never worth more than this, m and rad: the headings of its frames are uncertain
# and tie all tags of a goal together.
RANGE_FLOOR = 0.01
BEARING_FLOOR = 0.002
# A frontier yields its full number of new landmarks to a view that reaches this share of the sensor's range beyond it.
FRONTIER_DEPTH = 0.5


@dataclasses.dataclass(frozen=True)
class Gains:
    """Expected gains of c candidates, all (c,), nats.

    exploitation: what the known landmarks alone would bring. exploration: what the new ones add. pose_price: how much
    more both would bring were the arrival pose known in M; that of the whole map counts then, too, so it grows with how
    far map and robot have drifted together. gain: exploitation + exploration, the price paid.
    """

    exploitation: FloatArray
    exploration: FloatArray
    pose_price: FloatArray

    @property
    def gain(self) -> FloatArray:
        """Exploitation + exploration, (c,), nats."""
        return self.exploitation + self.exploration


def frontier_reach(sensor: TagSensorConfig) -> FloatArray:
    """(sensor range, depth), m: a frontier counts in full where the view goes on behind it by this depth."""
    return np.array([sensor.range, FRONTIER_DEPTH * sensor.range])


def sightings_of_turn(sensor: TagSensorConfig, turn_rate: float) -> float:
    """How often each tag is seen in a full turn at turn_rate (rad/s): it is in view for field_of_view / turn_rate s."""
    return sensor.detection_probability * sensor.rate * sensor.field_of_view / turn_rate


def turn_noise(sensor: TagSensorConfig, sightings: float) -> FloatArray:
    """Deviations of one tag's range and bearing by so many sightings in a turn, as exact_gain takes them.

    The sightings' noise averages down to the floors.
    """
    root = math.sqrt(max(1.0, sightings))
    return np.array(
        [
            sensor.range_noise / root,
            sensor.range_noise_per_metre / root,
            RANGE_FLOOR,
            max(sensor.bearing_noise / root, BEARING_FLOOR),
        ]
    )


@functools.lru_cache(maxsize=1)
def departure_given_landmarks(estimate: MapEstimate) -> FloatArray:
    """Covariance (3, 3) of the departure pose X_MD given all landmarks that are known jointly with it."""
    n = 2 * len(estimate.local)
    S = estimate.covariance
    S_DD = np.array(S[n:, n:])
    if n == 0:
        return S_DD
    factor = cho_factor(S[:n, :n], lower=True, check_finite=False)
    conditional = S_DD - S[n:, :n] @ cho_solve(factor, S[:n, n:], check_finite=False)
    return np.asarray(0.5 * (conditional + conditional.T))


def information_gain(
    points: FloatArray,
    distance: FloatArray,
    time: FloatArray,
    tags: View,
    frontiers: View,
    estimate: MapEstimate,
    tfg: TfgMap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    explorer: ExplorerConfig,
) -> Gains:
    """Expected gains of a full turn at each point (c, 2), m in M, reached after distance (c,) m and time (c,) s.

    tags and frontiers: what the points see. Each metre of frontier in view stands for explorer.density new landmarks,
    seen where the frontier point is, less where the view ends soon behind it. The arrival pose is known through
    odometry since the last departure alone, as in the factor that will join the two goals. Landmarks that are not known
    jointly with the departure pose count for nothing. explorer.gain names the formula.
    """
    tags = local_view(tags, estimate)
    points = np.ascontiguousarray(points)
    number, reach = explorer.density * tfg.frontier_length, frontier_reach(sensor)
    known = Known(tags.offsets, tags.index, estimate.p_ML[estimate.local], estimate.covariance)
    new = New(frontiers.offsets, frontiers.index, tfg.frontiers, number, explorer.prior_sigma, reach)
    noise = turn_noise(sensor, sightings_of_turn(sensor, explorer.turn_rate))
    if explorer.gain == "authors":
        out = authors_gain(points, known, new, tfg.frontier_normal)
    elif explorer.gain == "paper":
        out = paper_gain(points, known, new, noise)
    else:
        Q = odometry_covariance(estimate.X_MD, points, distance, time, odometry)
        arrival = Arrival(estimate.X_MD, departure_given_landmarks(estimate), Q)
        gain = exact_gain if explorer.gain == "exact" else limit_gain
        out = gain(points, arrival, known, new, noise)
    return Gains(exploitation=out[:, 0], exploration=out[:, 1], pose_price=out[:, 2])

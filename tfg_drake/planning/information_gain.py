"""The expected information gain about the landmarks by a full turn at a candidate.

By default it is the mutual information of all landmarks, known and new, and the measurements of the turn
(`exact_gain`), which the paper's Theorem 1 approximates (Sec. III-C). It is valid for a pose that odometry ties to the
map, and depends on relative covariance only. `approximate_gain` has the approximations.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Annotated

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tfg_drake.config import ExplorerConfig, TagSensorConfig
from tfg_drake.geometry.segment_grid import SegmentGrid, segment_grid
from tfg_drake.messages import FloatArray, MapEstimate, TfgMap, is_tag
from tfg_drake.planning.approximate_gain import authors_gain, limit_gain, paper_gain
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain
from tfg_drake.planning.expected_view import Targets, Visibility, expected_tags, expected_walls, targets
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.planning.parameters import PlanningParameters

# A turn's measurements of one tag are never worth more than this, m and rad: the headings of its frames are uncertain
# and tie all tags of a view together.
RANGE_FLOOR = 0.01
BEARING_FLOOR = 0.002
# A frontier yields its full number of new landmarks to a view that sees beyond it by this share of the sensor's range.
FRONTIER_DEPTH = 0.5
# The prior of the tags' density counts like this length of inspected surface, m.
PRIOR_LENGTH = 10.0


@dataclasses.dataclass(frozen=True)
class Gains:
    """Expected gains of c candidates, all (c,), nats.

    exploitation: gain from the known landmarks alone. exploration: additional gain from the new ones. pose_price: the
    gain in excess of both if the arrival pose were known in M; that would also locate the whole map, so the price grows
    with the common drift of map and robot. gain: exploitation + exploration, with the price deducted.
    """

    exploitation: Annotated[FloatArray, "c"]
    exploration: Annotated[FloatArray, "c"]
    pose_price: Annotated[FloatArray, "c"]

    @property
    def gain(self) -> FloatArray:
        """The gain, exploitation + exploration, (c,), nats."""
        return self.exploitation + self.exploration


def frontier_reach(sensor: TagSensorConfig) -> FloatArray:
    """Return (sensor range, depth), m: a frontier counts in full if the view extends behind it by this depth."""
    return np.array([sensor.range, FRONTIER_DEPTH * sensor.range])


def sightings_of_turn(sensor: TagSensorConfig, turn_rate: float, frame_worth: float = 1.0) -> float:
    """Return the number of independent sightings of each tag in a full turn at turn_rate (rad/s): it is in view for
    field_of_view / turn_rate s. frame_worth: as in MapEstimate."""
    frames = sensor.detection_probability * sensor.rate * sensor.field_of_view / turn_rate
    return frames - max(frames - 1.0, 0.0) * (1.0 - frame_worth)


def turn_noise(sensor: TagSensorConfig, sightings: float, tag_error: FloatArray | None = None) -> FloatArray:
    """Return the deviations of one tag's range and bearing after a number of sightings in a turn, for exact_gain.

    The sightings' noise averages down to the floors, or to the constant errors that tags have, tag_error: (2,).
    """
    root = math.sqrt(max(1.0, sightings))
    of_range, of_bearing = (0.0, 0.0) if tag_error is None else tag_error
    return np.array(
        [
            sensor.range_noise / root,
            sensor.range_noise_per_metre / root,
            max(RANGE_FLOOR, of_range),
            max(sensor.bearing_noise / root, BEARING_FLOOR, of_bearing),
        ]
    )


def density_shown(landmarks: MapEstimate, tfg: TfgMap, explorer: ExplorerConfig) -> float:
    """Return the expected number of new landmarks per metre of surface, from this building so far: tags on inspected
    surface, and walls, which count like tags, as both have two numbers. A map without walls adds nothing to
    explorer.density."""
    tags = np.count_nonzero(is_tag(landmarks.ids))
    walls = len(landmarks.ids) - tags
    if not walls:
        return explorer.density
    surface = np.hypot(*(tfg.segments[:, 2:] - tfg.segments[:, :2]).T).sum()
    of_tags = (tags + PRIOR_LENGTH * explorer.density) / (tfg.inspected + PRIOR_LENGTH)
    return float(of_tags + walls / (surface + PRIOR_LENGTH))


def departure_given_landmarks(estimate: MapEstimate) -> FloatArray:
    """Return the covariance (3, 3) of the departure pose X_MD given all landmarks jointly known with it."""
    S = estimate.covariance
    n = len(S) - 3
    S_DD = np.array(S[n:, n:])
    if n == 0:
        return S_DD
    factor = cho_factor(S.T[:n, :n], lower=True, check_finite=False)  # in the order of its memory
    conditional = S_DD - S[n:, :n] @ cho_solve(factor, S[:n, n:], check_finite=False)
    return np.asarray(0.5 * (conditional + conditional.T))


@dataclasses.dataclass(frozen=True)
class Turns:
    """The input of the gains at one stage: map, TFG and parameters."""

    estimate: MapEstimate
    tfg: TfgMap
    parameters: PlanningParameters

    @functools.cached_property
    def departure_given_map(self) -> FloatArray:
        """See `departure_given_landmarks`."""
        return departure_given_landmarks(self.estimate)

    @functools.cached_property
    def noise(self) -> FloatArray:
        """As in `exact_gain`."""
        sensor, explorer = self.parameters.sensor, self.parameters.explorer
        sightings = sightings_of_turn(sensor, explorer.turn_rate, self.estimate.frame_worth)
        return turn_noise(sensor, sightings, self.estimate.tag_error)

    @functools.cached_property
    def targets(self) -> Targets:
        """The points that represent the known landmarks."""
        return targets(self.estimate, self.tfg)

    def at(self, points: FloatArray, distance: FloatArray, time: FloatArray, frontiers: Visibility) -> Gains:
        """Return the gains of a full turn at each point (c, 2) after distance (c,) m and time (c,) s."""
        return self.gains(points, self.arrival(points, distance, time), self.seen(points), frontiers)

    def arrival(self, points: FloatArray, distance: FloatArray, time: FloatArray) -> Arrival:
        """Return the arrival at each point (c, 2), m in M, after distance (c,) m and time (c,) s. The pose is known
        only by odometry since the last departure, as in the factor that will tie the two views."""
        X_MD = self.estimate.X_MD
        Q = odometry_covariance(X_MD, points, distance, time, self.parameters.odometry)
        return Arrival(X_MD, self.departure_given_map, Q)

    def seen(self, points: FloatArray, grid: SegmentGrid | None = None) -> Visibility:
        """Return the known landmarks that a full turn at each point (c, 2), m in M, should see; index: rows of the
        targets.

        grid: the segment_grid of tfg.segments, if available.
        """
        tfg, grid, walls = self.tfg, grid or segment_grid(self.tfg.segments), self.targets.of_walls
        tags = expected_tags(points, self.estimate, tfg, self.parameters.sensor, grid)
        if not walls:
            return tags
        return expected_walls(points, self.targets, tfg, self.parameters.scan_range, grid).joined(tags, walls)

    def gains(self, points: FloatArray, arrival: Arrival, seen: Visibility, frontiers: Visibility) -> Gains:
        """Return the expected gains of a full turn at each point (c, 2), m in M, for an arrival.

        seen, frontiers: landmarks and frontiers in view. Each metre of frontier stands for explorer.density new
        landmarks at the frontier point, fewer if the view ends soon behind it. Landmarks that are not jointly known
        with the departure pose do not count. explorer.gain selects the formula.
        """
        explorer, of, tfg, noise = self.parameters.explorer, self.targets, self.tfg, self.noise
        seen = of.known_jointly(seen)
        points = np.ascontiguousarray(points)
        at = of.p_MT, of.entry, of.by_landmark, of.normal
        known = Known(seen.offsets, seen.index, *at, self.estimate.covariance)
        number, reach = explorer.density * tfg.frontier_length, frontier_reach(self.parameters.sensor)
        new = New(frontiers.offsets, frontiers.index, tfg.frontiers, number, explorer.prior_sigma, reach)
        if explorer.gain == "authors":
            out = authors_gain(points, known, new, tfg.frontier_normal)
        elif explorer.gain == "paper":
            out = paper_gain(points, known, new, noise)
        else:
            gain = exact_gain if explorer.gain == "exact" else limit_gain
            out = gain(points, arrival, known, new, noise)
        return Gains(exploitation=out[:, 0], exploration=out[:, 1], pose_price=out[:, 2])

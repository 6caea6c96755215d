"""The clearance that keeps the probability of a collision small (the paper's Sec. V, last equation).

The paper asks for Pr(x in edge) < delta, which is zero for any line. Here the robot is a disc of radius r, and what
counts is its position relative to the surface: a path must keep

    d >= r + Phi^-1(1 - delta) sigma

from every surface, sigma being the predicted deviation of the robot relative to the landmarks nearby, across any
direction. Its absolute uncertainty far from the start does not close a door: the door moves with it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial import cKDTree
from scipy.stats import norm

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, TfgMap
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, visible_targets

# Landmarks farther away are left out of the prediction: they add little and cost most, m.
LOCALISATION_RANGE = 5.0
# The pose is what this much time of frames makes it, s.
LOCALISATION_TIME = 1.0
# Deviation of the robot from its path and of a surface from the landmarks it is anchored to, m.
TRACKING_DEVIATION = 0.02


@njit(cache=True)
def localised_deviation(
    points: FloatArray,
    offsets: IntArray,
    index: IntArray,
    targets: FloatArray,
    range_noise: float,
    range_noise_per_metre: float,
    bearing_noise: float,
    frames: float,
) -> FloatArray:
    """Greatest deviation (n,), m, of a robot's position at each point, relative to the landmarks it sees there.

    Point i sees targets[index[offsets[i]:offsets[i + 1]]], each in `frames` frames of range and bearing; heading
    unknown. inf with fewer than two in view.
    """
    out = np.full(len(points), np.inf)
    for i in range(len(points)):
        if offsets[i + 1] - offsets[i] < 2:
            continue
        a, b, c = 0.0, 0.0, 0.0  # information on x, y: [[a, b], [b, c]]
        hx, hy, h = 0.0, 0.0, 0.0  # its cross terms with the heading, and the heading's own
        for k in range(offsets[i], offsets[i + 1]):
            dx, dy = targets[index[k], 0] - points[i, 0], targets[index[k], 1] - points[i, 1]
            r = max(math.sqrt(dx * dx + dy * dy), 0.05)
            ux, uy = dx / r, dy / r
            w_range = frames / (range_noise + range_noise_per_metre * r) ** 2
            w_bearing = frames / bearing_noise**2
            a += w_range * ux * ux + w_bearing * uy * uy / (r * r)
            b += w_range * ux * uy - w_bearing * ux * uy / (r * r)
            c += w_range * uy * uy + w_bearing * ux * ux / (r * r)
            hx -= w_bearing * uy / r
            hy += w_bearing * ux / r
            h += w_bearing
        a, b, c = a - hx * hx / h, b - hx * hy / h, c - hy * hy / h
        least = 0.5 * (a + c) - math.sqrt(0.25 * (a - c) ** 2 + b * b)
        if least > 0.0:
            out[i] = 1.0 / math.sqrt(least)
    return out


def predicted_deviation(
    points: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    speed: float,
) -> FloatArray:
    """Deviation sigma (n,), m, of the robot relative to the surfaces near each point (n, 2), in M.

    Where two or more landmarks are in view, that of a pose from one second of frames (the share of a turn that the
    field of view covers); elsewhere that of the nearest such point, or of the place where the robot stands, grown by
    odometry over the straight way from there at `speed` (m/s).
    """
    near = visible_targets(
        points, estimate.p_ML, tfg.facing, tfg.segments,
        min(sensor.range, LOCALISATION_RANGE), sensor.max_incidence, SURFACE_TOLERANCE,
    )  # fmt: skip
    frames = sensor.detection_probability * sensor.rate * LOCALISATION_TIME
    frames *= min(1.0, sensor.field_of_view / (2 * math.pi))
    sigma = localised_deviation(
        points, *near, estimate.p_ML, sensor.range_noise, sensor.range_noise_per_metre, sensor.bearing_noise, frames
    )
    localised = np.isfinite(sigma)
    if not localised.all():
        anchors = np.vstack([points[localised], estimate.X_MD[None, :2]])
        at_anchor = np.append(sigma[localised], 0.0)
        d, nearest = cKDTree(anchors).query(points[~localised])
        time = d / speed
        along = odometry.distance_noise**2 * d + (odometry.distance_scale * d) ** 2
        across = d**2 * (odometry.gyro_noise**2 * time / 3 + (odometry.gyro_bias * time) ** 2 / 4)
        sigma[~localised] = np.sqrt(at_anchor[nearest] ** 2 + np.maximum(along, across))
    return np.sqrt(sigma**2 + TRACKING_DEVIATION**2)


def required_clearance(radius: float, sigma: FloatArray, collision_probability: float) -> FloatArray:
    """Clearance (n,), m, that a disc of this radius (m) needs with deviation sigma (n,), m."""
    return np.asarray(radius + norm.ppf(1.0 - collision_probability) * sigma)

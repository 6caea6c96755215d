"""The feature sensor: range and bearing of every coded landmark in view, as far as the paper's sees (Table I)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.special import ndtr, ndtri

from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.visibility import disc_distances, in_sight
from tfg_drake.messages import FloatArray, IntArray, TagDetections
from tfg_drake.table import empty
from tfg_drake.world.tag_placement import TAG_OFFSET
from tfg_drake.world.world import World

# Standard normal numbers per tag and frame: range, bearing, detection.
NOISE_PER_TAG = 3
# Standard deviation of a gross error's bearing, rad; its range may be anything.
OUTLIER_BEARING = 0.3


@njit(cache=True)
def visible_tags(
    p_WT: FloatArray,
    facing: FloatArray,
    walls: FloatArray,
    X_WB: FloatArray,
    range_max: float,
    field_of_view: float,
    max_incidence: float,
) -> IntArray:
    """Rows (k,) of the tags that the sensor at X_WB (3,) has in view.

    In view means within range (m) and field of view (rad), seen at no more than max_incidence (rad) from the tag's
    normal, and with no wall in between. p_WT: (n, 2) m, facing: (n,) rad, of all tags. walls: (w, 4) m.
    """
    rows = np.empty(p_WT.shape[0], dtype=np.int64)
    count = 0
    ahead_x, ahead_y = math.cos(X_WB[2]), math.sin(X_WB[2])
    cos_half, cos_incidence = math.cos(0.5 * field_of_view), math.cos(max_incidence)
    for i in range(p_WT.shape[0]):
        dx, dy = p_WT[i, 0] - X_WB[0], p_WT[i, 1] - X_WB[1]
        distance = math.hypot(dx, dy)
        if distance > range_max or distance == 0.0:
            continue
        if ahead_x * dx + ahead_y * dy < cos_half * distance:
            continue
        if -(math.cos(facing[i]) * dx + math.sin(facing[i]) * dy) < cos_incidence * distance:
            continue
        rows[count] = i
        count += 1
    rows = rows[:count]
    # The wall that a tag is on, or in front of, must not hide it.
    return rows[in_sight(walls, X_WB[:2], p_WT[rows], TAG_OFFSET)]


def detect(
    world: World,
    X_WS: FloatArray,
    stamp: float,
    standard_normal: FloatArray,
    config: TagSensorConfig,
    stated: TagSensorConfig | None = None,
    tag_errors: FloatArray | None = None,
    discs: FloatArray | None = None,
    detection_range: float = 0.0,
) -> TagDetections:
    """One frame of the sensor at its true pose X_WS (3,), the true ids ascending.

    standard_normal: (n, NOISE_PER_TAG) numbers, row for row with world.tag_ids. config: what the sensor does. The
    standard deviations told are those of the data sheet `stated`, config's where there is none: range_noise +
    range_noise_per_metre * r at the measured range r, and bearing_noise; gross errors and misread ids come on top.
    tag_errors: (n, 2) constant errors of each tag's range, m, and bearing, rad. discs: (d, 3) what else hides tags,
    centre and radius in m. detection_range: m, see `detected_share`; 0: detection does not fall with range.
    """
    limits = config.range, config.field_of_view, config.max_incidence
    rows = visible_tags(world.p_WT, world.tag_facing, world.walls, X_WS, *limits)
    rows = rows[standard_normal[rows, 2] < ndtri(config.detection_probability)]
    rows = rows[np.argsort(world.tag_ids[rows], kind="stable")]
    if discs is not None:
        east, north = (world.p_WT[rows] - X_WS[:2]).T
        rows = rows[disc_distances(discs, X_WS[:2], np.arctan2(north, east)) > np.hypot(east, north)]
    probability: float | FloatArray = config.detection_probability
    if detection_range > 0.0:
        east, north = (world.p_WT[rows] - X_WS[:2]).T
        aslant = -(np.cos(world.tag_facing[rows]) * east + np.sin(world.tag_facing[rows]) * north)
        probability = probability * detected_share(np.hypot(east, north), aslant, detection_range)
        shown = ndtr(standard_normal[rows, 2]) < probability
        rows, probability = rows[shown], probability[shown]
    east, north = (world.p_WT[rows] - X_WS[:2]).T
    distance = np.hypot(east, north)
    noise = (config.range_noise + config.range_noise_per_metre * distance) * standard_normal[rows, 0]
    measured = config.range_scale * distance + noise
    bearing = np.arctan2(north, east) - X_WS[2] + config.bearing_noise * standard_normal[rows, 1]
    if tag_errors is not None:
        measured += tag_errors[rows, 0]
        bearing += tag_errors[rows, 1]
    ids = world.tag_ids[rows]
    # The number that let the tag be detected is uniform below the detection probability: its lowest part makes gross
    # errors, the next misread ids, and the place within its part says which.
    gross = config.outlier_probability > 0.0 or config.wrong_id_probability > 0.0
    chance = ndtr(standard_normal[rows, 2]) / probability if gross else np.empty(0)
    if config.outlier_probability > 0.0:
        bad = chance < config.outlier_probability
        measured[bad] = config.range * chance[bad] / config.outlier_probability
        bearing[bad] += OUTLIER_BEARING * standard_normal[rows[bad], 1]
    if config.wrong_id_probability > 0.0:
        share = (chance - config.outlier_probability) / config.wrong_id_probability
        wrong = (share >= 0.0) & (share < 1.0)
        ids[wrong] = world.tag_ids[(share[wrong] * len(world.tag_ids)).astype(np.int64)]
    stated, measured = stated or config, np.maximum(measured, 0.0)
    return TagDetections(
        stamp=stamp,
        ids=ids,
        range=measured,
        bearing=wrap_angle(bearing),
        sigma_range=stated.range_noise + stated.range_noise_per_metre * measured,
        sigma_bearing=np.full(len(ids), stated.bearing_noise),
    )


def detected_share(distance: FloatArray, ahead: FloatArray, detection_range: float) -> FloatArray:
    """The share (n,) of the tags in view are detected, by how large they seem: all at twice the size of a tag that is
    looked at straight from detection_range (m), half at that size, none at two thirds of it, smoothly between.

    distance: (n,) m from the sensor, ahead: (n,) m of that along the tag's normal. The shape is made up; that detectors
    of AprilTags find fewer the smaller they seem in the image, down to none, is not (Wang, Olson 2016).
    """
    seems = distance * distance / np.maximum(ahead * detection_range, 1e-9)
    beyond = np.clip(seems - 0.5, 0.0, 1.0)
    return np.asarray(1.0 - beyond * beyond * (3.0 - 2.0 * beyond))


def correlated(before: FloatArray, fresh: FloatArray, interval: float, correlation_time: float) -> FloatArray:
    """Standard normal numbers whose correlation with those `interval` (s) before falls to 1/e in correlation_time (s):
    a first-order Gauss-Markov process, driven by fresh ones of the same shape."""
    kept = math.exp(-interval / correlation_time) if correlation_time > 0.0 else 0.0
    return np.asarray(kept * before + math.sqrt(1.0 - kept * kept) * fresh)


def no_detections() -> TagDetections:
    """The sensor's output before its first frame: nothing, stamped -inf."""
    return empty(TagDetections, stamp=-math.inf)

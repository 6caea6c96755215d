"""The scale of the tag sensor's ranges, learnt from the laser scan: tags stand on the surfaces that the scan meets.

A range scale error is invisible to a map of bearings and ranges alone, scales all of it and dominates every other
error; one turn beside a scan tells it to a part in a thousand. Measured range = (1 + r) * true range + noise, and the
tag's centre lies an unknown constant o in front of its surface.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, LaserScan, TagDetections, message

# Prior standard deviations of the scale error r and of the offset o (m).
SCALE_SIGMA = 0.01
OFFSET_SIGMA = 0.02
# Pairs that differ by more than this many standard deviations are of two different things.
GATE = 4.0
# Surfaces seen more slantwise than this are left out (tangent of 60 degrees): a bearing error becomes a range error.
STEEPEST = 1.75
# Neighbouring rays belong to one surface when their ranges differ by less than this share.
SAME_SURFACE = 0.1


@message
class RangeScale:
    """Gaussian of (r, o) in information form. information: (2, 2), vector: (2,), pairs: how many went into it."""

    information: FloatArray
    vector: FloatArray
    pairs: int

    @property
    def mean(self) -> FloatArray:
        """(2,) of r and o (m)."""
        return np.asarray(np.linalg.solve(self.information, self.vector))

    @property
    def sigma(self) -> float:
        """Standard deviation of r."""
        return float(np.sqrt(np.linalg.inv(self.information)[0, 0]))


def unknown_scale() -> RangeScale:
    """Before the first pair: r = 0, o = 0 within their priors."""
    return RangeScale(np.diag([SCALE_SIGMA**-2, OFFSET_SIGMA**-2]), np.zeros(2), 0)


def compare(scale: RangeScale, detections: TagDetections, scan: LaserScan) -> RangeScale:
    """The scale after one frame of tags, ranges as measured, and the scan of the same instant."""
    step = scan.angles[1] - scan.angles[0] if len(scan.angles) > 1 else np.inf
    position = (detections.bearing - scan.angles[0]) / step if len(scan.angles) > 1 else np.full(0, 0.0)
    inside = (position >= 0.0) & (position < len(scan.angles) - 1)
    z, at = detections.range[inside], position[inside]
    if not len(z):
        return scale
    i = at.astype(np.int64)
    before, after = scan.ranges[i], scan.ranges[i + 1]
    with np.errstate(invalid="ignore"):
        distance = before + (at - i) * (after - before)
        slant = np.abs(after - before) / (step * distance)
        usable = np.isfinite(distance) & (slant < STEEPEST) & (np.abs(after - before) < SAME_SURFACE * distance)
    z, distance, slant = z[usable], distance[usable], slant[usable]
    variance = (
        detections.sigma_range[inside][usable] ** 2
        + (slant * distance * detections.sigma_bearing[inside][usable]) ** 2
        + scan.sigma**2
    )
    J = np.stack([distance, np.ones_like(distance)], axis=1)
    covariance = np.linalg.inv(scale.information)
    error = z - distance - J @ scale.mean
    good = error**2 <= GATE**2 * (variance + np.einsum("ni,ij,nj->n", J, covariance, J))
    J, weight = J[good], 1.0 / variance[good]
    return RangeScale(
        scale.information + J.T @ (weight[:, None] * J),
        scale.vector + J.T @ (weight * (z - distance)[good]),
        scale.pairs + int(np.count_nonzero(good)),
    )


def corrected(detections: TagDetections, scale: RangeScale) -> TagDetections:
    """The detections with the scale's expected error taken out of their ranges."""
    if scale.pairs == 0 or not len(detections.ids):
        return detections
    return TagDetections(
        stamp=detections.stamp,
        ids=detections.ids,
        range=detections.range / (1.0 + scale.mean[0]),
        bearing=detections.bearing,
        sigma_range=detections.sigma_range,
        sigma_bearing=detections.sigma_bearing,
    )

"""Curves over a run, from its true and estimated poses alone, so that one measure serves every method; and the mean and
range of several such curves. What sensors see from poses is told here, too."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from tfg_drake.comparison.metrics import pose_errors
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.visibility import in_sight
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.storage.trajectory import poses_at

# Spacing of the poses whose views count, m or rad, whichever comes first.
STEP, TURN = 0.25, 0.25


@dataclasses.dataclass(frozen=True)
class Curve:
    """A quantity y (n,) at ascending x (n,)."""

    x: FloatArray
    y: FloatArray


@dataclasses.dataclass(frozen=True)
class Band:
    """Several runs' curves at common x (n,): mean, least and greatest (n,); common: up to which x all of them go."""

    x: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    common: float


def error_curves(
    stamps: FloatArray, X_WB: FloatArray, true_stamps: FloatArray, X_WB_true: FloatArray
) -> tuple[Curve, Curve]:
    """Error of the position (m) and of the heading (rad, absolute) against time (s).

    stamps (n,) and X_WB (n, 3): the estimate as it was at the time; true_stamps (m,) and X_WB_true (m, 3): the truth.
    """
    position, heading = pose_errors(X_WB, poses_at(stamps, true_stamps, X_WB_true))
    return Curve(stamps, position), Curve(stamps, heading)


def coverage_curve(
    X_WB: FloatArray, p_WC: FloatArray, walls: FloatArray, scan_range: float, field_of_view: float
) -> Curve:
    """Share of the cells seen so far by the scanner against the distance driven (m); see `scan_coverage`."""
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(X_WB[:, :2], axis=0).T))])
    rows, share = scan_coverage(X_WB, p_WC, walls, scan_range, field_of_view)
    return Curve(driven[rows], share)


def scan_coverage(
    X_WB: FloatArray, p_WC: FloatArray, walls: FloatArray, scan_range: float, field_of_view: float
) -> tuple[IntArray, FloatArray]:
    """Rows (k,) of the poses from which the scanner's view counts, and the share (k,) of the cells seen up to each.

    Args:
        X_WB: (n, 3) true poses in W, close enough together to add up the distance.
        p_WC: (c, 2) centres of the cells that count, in W, m.
        walls: (w, 4) in W, m.
        scan_range: m. field_of_view: rad, ahead of the robot.
    """
    if not len(X_WB) or not len(p_WC):
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = view_rows(X_WB)
    limits = np.tile([scan_range, 0.5 * field_of_view, -1.0], (len(p_WC), 1))
    first = seen_from(X_WB[rows], p_WC, np.zeros_like(p_WC), limits, walls)
    unseen = len(p_WC) - np.cumsum(np.bincount(first, minlength=len(rows) + 1)[: len(rows)])
    return rows, 1.0 - unseen / len(p_WC)


def view_rows(X_WB: FloatArray) -> IntArray:
    """Rows (k,) of poses (n, 3) that lie STEP or TURN from the one before, and the last: those whose views count."""
    kept = [0]
    for i, (x, y, heading) in enumerate(X_WB.tolist()):
        x0, y0, heading0 = X_WB[kept[-1]]
        turned = abs(np.remainder(heading - heading0 + np.pi, 2.0 * np.pi) - np.pi)
        if turned >= TURN or np.hypot(x - x0, y - y0) >= STEP:
            kept.append(i)
    return np.array(kept if kept[-1] == len(X_WB) - 1 else [*kept, len(X_WB) - 1])


@read_only_arguments
@njit(cache=True)
def seen_from(
    X_WB: FloatArray, points: FloatArray, normals: FloatArray, limits: FloatArray, walls: FloatArray
) -> IntArray:
    """Row (t,) of the first of poses (k, 3) that each of points (t, 2) is seen from past walls (m, 4), k where none is;
    see `tfg_drake.comparison.best_tour.ToSee`. A half field of view of pi or more sees all round."""
    first = np.full(len(points), len(X_WB))
    near, rows = np.empty_like(points), np.empty(len(points), dtype=np.int64)
    for k in range(len(X_WB)):
        x, y, c, s = X_WB[k, 0], X_WB[k, 1], math.cos(X_WB[k, 2]), math.sin(X_WB[k, 2])
        count = 0
        for j in range(len(points)):
            if first[j] < k:
                continue
            dx, dy = points[j, 0] - x, points[j, 1] - y
            d = math.hypot(dx, dy)
            if d > limits[j, 0] or dx * c + dy * s < d * math.cos(min(limits[j, 1], math.pi)) - 1e-12:
                continue
            if limits[j, 2] > -1.0 and -(dx * normals[j, 0] + dy * normals[j, 1]) < limits[j, 2] * d:
                continue
            near[count, 0], near[count, 1], rows[count] = points[j, 0], points[j, 1], j
            count += 1
        visible = in_sight(walls, X_WB[k, :2].copy(), near[:count], 1e-3)
        for i in range(count):
            if visible[i]:
                first[rows[i]] = k
    return first


def averaged(curve: Curve, step: float) -> Curve:
    """Means of a curve over stretches of x of length `step`, from 0, at their middles; stretches without a point are
    left out."""
    stretch = np.floor(curve.x / step).astype(np.int64)
    rows, inverse, count = np.unique(stretch, return_inverse=True, return_counts=True)
    means: FloatArray = np.bincount(inverse, weights=curve.y) / count
    return Curve(np.asarray((rows + 0.5) * step, dtype=np.float64), means)


def band(curves: Sequence[Curve], step: float, *, hold: bool = False) -> Band | None:
    """Mean and range of several curves every `step` from the first point to the last, None where no curve has a point.

    A curve counts up to its own end; with `hold` it keeps its last value, as what was seen stays seen.
    """
    curves = [curve for curve in curves if len(curve.x)]
    if not curves:
        return None
    end = max(curve.x[-1] for curve in curves)
    x = np.append(np.arange(min(curve.x[0] for curve in curves), end, step), end)
    table = np.array([np.interp(x, curve.x, curve.y, right=curve.y[-1] if hold else np.nan) for curve in curves])
    common = float(min(curve.x[-1] for curve in curves))
    return Band(x, np.nanmean(table, axis=0), np.nanmin(table, axis=0), np.nanmax(table, axis=0), common)

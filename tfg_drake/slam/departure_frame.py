"""The map as seen from the last departure pose D, where a robot knows it best.

Far from the map's origin, or before a loop closes, absolute positions may be metres off while neighbours agree to
centimetres. A filter linearised in M then takes the heading it shares with the whole map for something that its
sightings tell (the well-known inconsistency of EKF SLAM); in D those uncertainties are small and nothing is lost.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, MapEstimate


def local_positions(estimate: MapEstimate) -> FloatArray:
    """p_DL (m, 2) of the landmarks known jointly."""
    return (estimate.local_p_ML - estimate.X_MD[:2]) @ se2.rotation(float(estimate.X_MD[2]))


# p_DL = R_MD^T (p_ML - t_MD), so an error of X_MD moves it by -R_MD^T and turns it about D.
@njit(cache=True)
def covariance_in_departure_frame(
    covariance: FloatArray, heading: float, p_DL: FloatArray, rows: IntArray, columns: IntArray
) -> FloatArray:
    """The covariance (2k, 2l) in D of some landmarks with others.

    covariance: (2m + 3, 2m + 3) of (p_ML row by row, X_MD), heading: rad, of X_MD. p_DL: (m, 2), of which rows (k,) and
    columns (l,) name some.
    """
    c, s = math.cos(heading), math.sin(heading)
    D = len(covariance) - 3
    D_xx, D_xy, D_yy = covariance[D, D], covariance[D, D + 1], covariance[D + 1, D + 1]
    D_xt, D_yt, D_tt = covariance[D, D + 2], covariance[D + 1, D + 2], covariance[D + 2, D + 2]
    result = np.empty((2 * len(rows), 2 * len(columns)))
    for k in range(len(rows)):
        i = 2 * rows[k]
        x, y = covariance[i, D + 2] - D_xt, covariance[i + 1, D + 2] - D_yt
        turn_x, turn_y = c * x + s * y, -s * x + c * y
        for m in range(len(columns)):
            j = 2 * columns[m]
            # Both less D's position, in M; then turned into D; then what D's heading adds.
            xx = covariance[i, j] - covariance[i, D] - covariance[D, j] + D_xx
            xy = covariance[i, j + 1] - covariance[i, D + 1] - covariance[D, j + 1] + D_xy
            yx = covariance[i + 1, j] - covariance[i + 1, D] - covariance[D + 1, j] + D_xy
            yy = covariance[i + 1, j + 1] - covariance[i + 1, D + 1] - covariance[D + 1, j + 1] + D_yy
            xx, xy, yx, yy = c * xx + s * yx, c * xy + s * yy, -s * xx + c * yx, -s * xy + c * yy
            xx, xy, yx, yy = c * xx + s * xy, -s * xx + c * xy, c * yx + s * yy, -s * yx + c * yy
            x, y = covariance[D + 2, j] - D_xt, covariance[D + 2, j + 1] - D_yt
            other_x, other_y = c * x + s * y, -s * x + c * y
            p_x, p_y, q_x, q_y = p_DL[rows[k], 1], -p_DL[rows[k], 0], p_DL[columns[m], 1], -p_DL[columns[m], 0]
            result[2 * k, 2 * m] = xx + turn_x * q_x + p_x * (other_x + D_tt * q_x)
            result[2 * k, 2 * m + 1] = xy + turn_x * q_y + p_x * (other_y + D_tt * q_y)
            result[2 * k + 1, 2 * m] = yx + turn_y * q_x + p_y * (other_x + D_tt * q_x)
            result[2 * k + 1, 2 * m + 1] = yy + turn_y * q_y + p_y * (other_y + D_tt * q_y)
    return result


@njit(cache=True)
def covariance_with_departure(covariance: FloatArray, heading: float, p_DL: FloatArray, rows: IntArray) -> FloatArray:
    """The covariance (2k, 3) of some landmarks in D with X_MD; arguments as above."""
    c, s = math.cos(heading), math.sin(heading)
    D = len(covariance) - 3
    result = np.empty((2 * len(rows), 3))
    for k in range(len(rows)):
        i = 2 * rows[k]
        for a in range(3):
            x, y = covariance[i, D + a] - covariance[D, D + a], covariance[i + 1, D + a] - covariance[D + 1, D + a]
            result[2 * k, a] = c * x + s * y + p_DL[rows[k], 1] * covariance[D + 2, D + a]
            result[2 * k + 1, a] = -s * x + c * y - p_DL[rows[k], 0] * covariance[D + 2, D + a]
    return result

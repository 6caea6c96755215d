"""Where a scan fits a particle's own grid, and a draw from GMapping's improved proposal.

The likelihood of a scan is that of its end points, each by the distance to the nearest mean end of an
occupied cell (likelihood fields; Thrun, Burgard and Fox 2005, section 6.4), of the particle's grid alone. The
proposal is the Gaussian that fits likelihood times motion model round their common mode (Grisetti, Stachniss and
Burgard 2007, section III-B).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tfg_drake.grid.occupancy import FINE, MEAN_X, MEAN_Y, ODDS, TILE, TileMaps
from tfg_drake.messages import FloatArray, IntArray, LaserScan
from tfg_drake.slam.odometry_model import wrap

# Standard deviation of the distance from an end point to the mean of an occupied cell's, m: range noise, and how far
# apart those means are along a surface.
SIGMA = 0.045
# Likelihoods, relative to an end point in the middle of an occupied cell: of one in free space (moved, or no surface
# of this map at all), and of one where nothing was ever measured.
MISS, UNKNOWN = 0.05, 0.25
# Weight of a scan's log likelihood, as neighbouring rays share the errors of the map.
INDEPENDENCE = 0.3
# Least share of the end points in occupied cells for a match, and least number of end points.
LEAST_SHARE, LEAST_POINTS = 0.25, 12
# Greatest displacement of end points from odometry within which the map is searched, m.
MARGIN = 0.5
# First steps of the hill climbing, m and rad, and number of times they are halved.
STEP_POSITION, STEP_HEADING, HALVINGS = 0.05, 0.02, 5
# Steps of the differences for the mode's curvature, m and rad.
DIFFERENCE = np.array([0.025, 0.025, 0.008])

# Reach of an occupied cell's likelihood to either side, cells.
_SPLAT = 3
# Resolution of the field, parts of a cell's side.
_PARTS = 10

LogLikelihoods = NDArray[np.float32]


class Field(NamedTuple):
    """Log likelihoods (s, s) of an end point in each cell round a robot, where their corner is in M, and a cell's side,
    m."""

    value: LogLikelihoods
    x0: float
    y0: float
    resolution: float


class Prior(NamedTuple):
    """A pose by the motion model: (3,), and the information (3, 3) of (x, y) in M and theta."""

    X: FloatArray
    information: FloatArray


def end_points(scan: LaserScan, spacing: float) -> FloatArray:
    """p_BP (k, 2), m: where rays met something, thinned so that neighbours are a spacing (m) apart."""
    met = np.isfinite(scan.ranges) & (scan.ranges > 0.0) & (scan.ranges <= scan.range_max)
    angles, ranges = scan.angles[met], scan.ranges[met]
    p_BP = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    return np.asarray(p_BP[_thinned(p_BP, spacing)])


@njit(cache=True)
def _thinned(p_BP: FloatArray, spacing: float) -> IntArray:
    kept = np.empty(len(p_BP), dtype=np.int64)
    count = 0
    x, y = math.inf, math.inf
    for k in range(len(p_BP)):
        if not math.hypot(p_BP[k, 0] - x, p_BP[k, 1] - y) < spacing:
            x, y = p_BP[k, 0], p_BP[k, 1]
            kept[count] = k
            count += 1
    return kept[:count]


def _splat_table(resolution: float) -> LogLikelihoods:
    """Log likelihood of an end point: by the part of an occupied cell, rows and columns, that its mean is in, and by
    how many rows and columns the end point's cell is from it."""
    mean = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5)[:, None]
    squared = (resolution * (np.arange(-_SPLAT, _SPLAT + 1) - mean)) ** 2
    squared = squared[:, None, :, None] + squared[None, :, None, :]
    return np.asarray(np.log(MISS + (1.0 - MISS) * np.exp(-0.5 * squared / SIGMA**2)), dtype=np.float32)


def propose(
    maps: TileMaps, X_MB: FloatArray, covariance: FloatArray, p_BP: FloatArray, standard_normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A pose drawn for every particle, and the logarithm of what its weight is multiplied by.

    maps: of n particles. X_MB: (n, 3) where odometry puts each. covariance: (n, 3, 3) of that, of (x, y) in M and
    theta, regular. p_BP: (k, 2) end points, m. standard_normal: (n, 3) numbers. Returns (n, 3) and (n,).

    A particle whose scan finds too little of its map is drawn from the motion model and weighted by the likelihood
    there; the others by p(z | m, x', u), the integral of likelihood times motion model (eq. 13 there).
    """
    reach = MARGIN + (float(np.hypot(*p_BP.T).max()) if len(p_BP) else 0.0)
    window = int(2.0 * reach / (TILE * maps.resolution)) + 2
    X_MB, covariance, p_BP = (np.ascontiguousarray(array) for array in (X_MB, covariance, p_BP))
    return _propose(maps, window, X_MB, covariance, p_BP, standard_normal, _splat_table(maps.resolution))


@njit(cache=True)
def _tile_at(maps: TileMaps, particle: int, x: int, y: int) -> int:
    """The tile of a particle's grid that lies so many tiles from M's origin; 0, the unknown, where there is none."""
    row, column = y - maps.corner[1], x - maps.corner[0]
    known = 0 <= row < maps.table.shape[1] and 0 <= column < maps.table.shape[2]
    return maps.table[particle, row, column] if known else 0


@njit(cache=True)
def _fill(value: LogLikelihoods, maps: TileMaps, particle: int, splat: LogLikelihoods, X_MB: FloatArray) -> Field:
    """The field round the robot by a particle's grid, its values put into `value`."""
    window = len(value) // TILE
    side = TILE * maps.resolution
    half = 0.5 * (window - 1) * side
    tile_x, tile_y = math.floor((X_MB[0] - half) / side), math.floor((X_MB[1] - half) / side)
    miss, unknown = np.float32(math.log(MISS)), np.float32(math.log(UNKNOWN))
    most = len(value) - 1
    for a in range(window):
        for b in range(window):
            name = _tile_at(maps, particle, tile_x + b, tile_y + a)
            part = value[a * TILE : (a + 1) * TILE, b * TILE : (b + 1) * TILE]
            if name == 0:
                part[:] = unknown
            else:
                tile = maps.tiles[name]
                for i in range(TILE):
                    for j in range(TILE):
                        part[i, j] = unknown if tile[i, j, ODDS] == 0 else miss
    for a in range(window):
        for b in range(window):
            name = _tile_at(maps, particle, tile_x + b, tile_y + a)
            if name == 0:
                continue
            tile = maps.tiles[name]
            for i in range(TILE):
                for j in range(TILE):
                    if tile[i, j, ODDS] <= 0:
                        continue
                    y, x = a * TILE + i, b * TILE + j
                    part_y = (int(tile[i, j, MEAN_Y]) + FINE // 2) * _PARTS // (FINE + 1)
                    part_x = (int(tile[i, j, MEAN_X]) + FINE // 2) * _PARTS // (FINE + 1)
                    bump = splat[part_y, part_x]
                    for v in range(max(0, y - _SPLAT), min(most, y + _SPLAT) + 1):
                        for u in range(max(0, x - _SPLAT), min(most, x + _SPLAT) + 1):
                            value[v, u] = max(value[v, u], bump[v - y + _SPLAT, u - x + _SPLAT])
    return Field(value, tile_x * side, tile_y * side, maps.resolution)


@njit(cache=True)
def _score(field: Field, p_BP: FloatArray, X_MB: FloatArray) -> float:
    """Log likelihood of all end points, bilinear between the middles of cells."""
    value, resolution = field.value, field.resolution
    c, s = math.cos(X_MB[2]) / resolution, math.sin(X_MB[2]) / resolution
    x, y = (X_MB[0] - field.x0) / resolution - 0.5, (X_MB[1] - field.y0) / resolution - 0.5
    most = len(value) - 1
    total = 0.0
    for k in range(len(p_BP)):
        u = x + c * p_BP[k, 0] - s * p_BP[k, 1]
        v = y + s * p_BP[k, 0] + c * p_BP[k, 1]
        # Truncated, not floored: inside the field both are the same, and outside nothing is read.
        if u < 0.0 or v < 0.0 or u >= most or v >= most:
            total += math.log(UNKNOWN)
            continue
        j, i = int(u), int(v)
        u, v = u - j, v - i
        lower = value[i, j] + u * (value[i, j + 1] - value[i, j])
        upper = value[i + 1, j] + u * (value[i + 1, j + 1] - value[i + 1, j])
        total += lower + v * (upper - lower)
    return total


@njit(cache=True)
def _share_matched(field: Field, p_BP: FloatArray, X_MB: FloatArray) -> float:
    """Share of the end points within a standard deviation and a half of an occupied cell."""
    least = math.log(MISS + (1.0 - MISS) * math.exp(-0.5 * 1.5**2))
    count = 0
    for k in range(len(p_BP)):
        count += _score(field, p_BP[k : k + 1], X_MB) > least
    return count / len(p_BP)


@njit(cache=True)
def _log_posterior(field: Field, p_BP: FloatArray, prior: Prior, X: FloatArray) -> float:
    """Log of likelihood times motion model, without the latter's norm."""
    d = X - prior.X
    d[2] = wrap(d[2])
    return INDEPENDENCE * _score(field, p_BP, X) - 0.5 * float(d @ prior.information @ d)


@njit(cache=True)
def _propose(
    maps: TileMaps,
    window: int,
    X_MB: FloatArray,
    covariance: FloatArray,
    p_BP: FloatArray,
    standard_normal: FloatArray,
    splat: LogLikelihoods,
) -> tuple[FloatArray, FloatArray]:
    """See `propose`. window: side of the field, tiles."""
    n = len(X_MB)
    drawn, log_weight = np.empty((n, 3)), np.empty(n)
    value = np.empty((window * TILE, window * TILE), dtype=np.float32)
    for p in range(n):
        prior = Prior(X_MB[p], np.linalg.inv(covariance[p]))
        field = _fill(value, maps, p, splat, prior.X)
        mode = prior.X.copy()
        matched = len(p_BP) >= LEAST_POINTS
        if matched:
            mode = _climb(field, p_BP, prior)
            matched = _share_matched(field, p_BP, mode) >= LEAST_SHARE
        if matched:
            mean, root, log_norm = _gaussian(field, p_BP, prior, mode)
            drawn[p] = mean + root @ standard_normal[p]
            log_weight[p] = log_norm + 0.5 * math.log(np.linalg.det(prior.information))
        else:
            drawn[p] = prior.X + np.linalg.cholesky(covariance[p]) @ standard_normal[p]
            log_weight[p] = INDEPENDENCE * _score(field, p_BP, drawn[p])
        drawn[p, 2] = wrap(drawn[p, 2])
    return drawn, log_weight


@njit(cache=True)
def _climb(field: Field, p_BP: FloatArray, prior: Prior) -> FloatArray:
    """The mode (3,) of likelihood times motion model, by hill climbing from the prior."""
    best = prior.X.copy()
    value = _log_posterior(field, p_BP, prior, best)
    c, s = math.cos(prior.X[2]), math.sin(prior.X[2])
    position, heading, halvings = STEP_POSITION, STEP_HEADING, 0
    while halvings < HALVINGS:
        found, found_value = best, value
        for k in range(6):
            sign = 1.0 if k % 2 else -1.0
            X = best.copy()
            # Ahead, aside, and round.
            if k < 2:
                X[0] += sign * position * c
                X[1] += sign * position * s
            elif k < 4:
                X[0] -= sign * position * s
                X[1] += sign * position * c
            else:
                X[2] += sign * heading
            trial = _log_posterior(field, p_BP, prior, X)
            if trial > found_value:
                found, found_value = X, trial
        near = math.hypot(found[0] - prior.X[0], found[1] - prior.X[1]) < MARGIN
        if found_value > value and near:
            best, value = found, found_value
        else:
            position, heading, halvings = 0.5 * position, 0.5 * heading, halvings + 1
    return best


@njit(cache=True)
def _gaussian(field: Field, p_BP: FloatArray, prior: Prior, mode: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Mean (3,), root of the covariance (3, 3) and log integral of likelihood times motion model round its mode.

    The K = 27 poses are those of Gauss-Hermite's product rule of three points, spread as the curvature says: exact for
    a Gaussian, and not drawn, so that particles that agree get equal weights. The integral lacks the motion model's
    norm but for its determinant, and (2 pi)^1.5 cancels against it.
    """
    center = INDEPENDENCE * _score(field, p_BP, mode)
    curvature = np.zeros((3, 3))
    sides = np.empty((3, 2))
    for i in range(3):
        for k in range(2):
            X = mode.copy()
            X[i] += DIFFERENCE[i] * (1 - 2 * k)
            sides[i, k] = INDEPENDENCE * _score(field, p_BP, X)
        curvature[i, i] = max(0.0, (2.0 * center - sides[i, 0] - sides[i, 1]) / DIFFERENCE[i] ** 2)
    for i in range(3):
        for j in range(i):
            both = 0.0
            for k in range(2):
                X = mode.copy()
                X[i] += DIFFERENCE[i] * (1 - 2 * k)
                X[j] += DIFFERENCE[j] * (1 - 2 * k)
                both += INDEPENDENCE * _score(field, p_BP, X)
            cross = both + 2.0 * center - sides[i, 0] - sides[i, 1] - sides[j, 0] - sides[j, 1]
            cross *= -0.5 / (DIFFERENCE[i] * DIFFERENCE[j])
            # No more than a correlation of 0.9: differences of a field with kinks need not be definite.
            most = 0.9 * math.sqrt(curvature[i, i] * curvature[j, j])
            curvature[i, j] = curvature[j, i] = min(max(cross, -most), most)
    total = curvature + prior.information
    if np.linalg.eigvalsh(total)[0] < 0.1 * np.linalg.eigvalsh(prior.information)[0]:
        total = np.diag(np.diag(curvature)) + prior.information
    spread = np.linalg.cholesky(np.linalg.inv(total))

    value = _log_posterior(field, p_BP, prior, mode)
    weight, offset = np.empty(27), np.empty((27, 3))
    u = np.empty(3)
    for k in range(27):
        share, rest = 1.0, k
        for i in range(3):
            node, rest = rest % 3, rest // 3
            u[i] = (node - 1.0) * math.sqrt(3.0)
            share *= 2.0 / 3.0 if node == 1 else 1.0 / 6.0
        offset[k] = spread @ u
        log_ratio = _log_posterior(field, p_BP, prior, mode + offset[k]) - value
        weight[k] = share * math.exp(min(log_ratio + 0.5 * float(u @ u), 20.0))
    norm = weight.sum()
    weight /= norm
    mean = np.zeros(3)
    for k in range(27):
        mean += weight[k] * offset[k]
    # As tight as the curvature at the least: 27 poses may all but miss a narrow mode.
    covariance = 0.05 * spread @ spread.T
    for k in range(27):
        d = offset[k] - mean
        for i in range(3):
            for j in range(3):
                covariance[i, j] += weight[k] * d[i] * d[j]
    log_norm = value + math.log(norm) + math.log(spread[0, 0] * spread[1, 1] * spread[2, 2])
    return mode + mean, np.linalg.cholesky(covariance).astype(np.float64), log_norm

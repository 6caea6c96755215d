"""Kernels of scan matching: normals of a scan's rays, and the fit of one scan's rays to the surfaces of another.

A surface is an array (n, 6), one row per ray: x, y, m, its normal (towards the scanner), the normal's variance, rad^2,
and the ray's bearing, rad, ascending.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray

# A ray's normal is fitted to the rays of its surface within REACH, m. Neighbours are on one surface if they are no
# farther apart than on a plane seen at the cosine SLANT, plus STEP, m. A normal's deviation is at most NORMAL, rad.
REACH, SLANT, STEP, NORMAL = 0.2, 0.13, 0.08, 0.15
# Correspondence distances, m, of the iterations of search (COARSE) and fit (FINE); FIT: of rays that count as fitting.
COARSE, FINE, FIT = (0.6, 0.4), (0.4, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1), 0.1
# The search starts from TURNS headings to either side of the guess, TURN_STEP, rad, apart.
TURNS, TURN_STEP = 9, 0.13
# The score is the share of fitting rays among those in view of both scans, but at least the share VIEW of all. It falls
# by UNLIKELY per radian from the guess, as a corner fits as well when turned by a right angle.
VIEW, UNLIKELY = 0.6, 0.1


@njit(cache=True)
def normals(angles: FloatArray, ranges: FloatArray, sigma: float, stride: int) -> FloatArray:
    """Return the surface (n, 6) of rays (m,), rad and m, which all hit something: of every stride-th ray that has a
    normal, given the rays' noise, m."""
    n = len(angles)
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    joined = np.zeros(n, dtype=np.bool_)
    for k in range(n - 1):
        turn = angles[k + 1] - angles[k]
        gap = math.hypot(x[k + 1] - x[k], y[k + 1] - y[k])
        joined[k] = turn < 0.1 and gap < min(ranges[k], ranges[k + 1]) * turn / SLANT + STEP
    out = np.empty((n, 6))
    found = 0
    for k in range(0, n, stride):
        first, last = k, k
        while first > 0 and joined[first - 1] and (k - first < 2 or _apart(x, y, k, first - 1) < REACH):
            first -= 1
        while last < n - 1 and joined[last] and (last - k < 2 or _apart(x, y, k, last + 1) < REACH):
            last += 1
        m = last - first + 1
        if m < 4:
            continue
        mx, my = x[first : last + 1].mean(), y[first : last + 1].mean()
        dx, dy = x[first : last + 1] - mx, y[first : last + 1] - my
        sxx, syy, sxy = (dx * dx).sum(), (dy * dy).sum(), (dx * dy).sum()
        along = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
        c, s = math.cos(along), math.sin(along)
        long = sxx * c * c + syy * s * s + 2.0 * sxy * c * s
        off = max(sxx + syy - long, 0.0) / (m - 2)
        variance = max(off, sigma * sigma) / long if long > 0.0 else np.inf
        if off > (2.0 * sigma + 0.005) ** 2 or variance > NORMAL * NORMAL:
            continue
        nx, ny = -s, c
        if nx * x[k] + ny * y[k] > 0.0:
            nx, ny = -nx, -ny
        out[found] = np.array([x[k], y[k], nx, ny, variance, angles[k]])
        found += 1
    return out[:found].copy()


@njit(cache=True)
def _apart(x: FloatArray, y: FloatArray, i: int, j: int) -> float:
    return math.hypot(x[i] - x[j], y[i] - y[j])


@njit(cache=True)
def _nearest(M: FloatArray, x: float, y: float, nx: float, ny: float, gate: float) -> int:
    """Return the ray of M nearest to a point with a normal, among similar bearings; -1 if none is nearer than the gate,
    m."""
    best, at = gate * gate, -1
    r, bearing = math.hypot(x, y), math.atan2(y, x)
    half = math.asin(gate / r) if r > gate else math.pi
    for turn in range(-1, 2):
        low = bearing - half + 2.0 * math.pi * turn
        high = low + 2.0 * half
        if high < M[0, 5] or low > M[-1, 5]:
            continue
        k = int(np.searchsorted(M[:, 5], low))
        while k < len(M) and M[k, 5] <= high:
            square = (M[k, 0] - x) ** 2 + (M[k, 1] - y) ** 2
            if square < best and M[k, 2] * nx + M[k, 3] * ny > 0.8:
                best, at = square, k
            k += 1
    return at


@njit(cache=True)
def _pulled(
    M: FloatArray, B: FloatArray, X: FloatArray, gate: float, stride: int
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Make one point-to-line step: returns the next X (3,), the information H (3, 3), its part F that is only noise of
    normals, the weighted number of rays that fit, and the number that could."""
    c, s = math.cos(X[2]), math.sin(X[2])
    scale = max(gate / 3.0, 0.03)
    H, F, g = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    fit = squares = weights = 0.0
    could = 0
    J, T = np.empty(3), np.empty(3)
    for k in range(0, len(B), stride):
        rx, ry = c * B[k, 0] - s * B[k, 1], s * B[k, 0] + c * B[k, 1]
        x, y = X[0] + rx, X[1] + ry
        bearing = math.atan2(y, x)
        in_view = False
        for turn in range(-1, 2):
            in_view |= M[0, 5] <= bearing + 2.0 * math.pi * turn <= M[-1, 5]
        could += in_view
        i = _nearest(M, x, y, c * B[k, 2] - s * B[k, 3], s * B[k, 2] + c * B[k, 3], gate)
        if i < 0:
            continue
        nx, ny = M[i, 2], M[i, 3]
        e = nx * (x - M[i, 0]) + ny * (y - M[i, 1])
        w = 1.0 / (1.0 + (e / scale) ** 2)
        fit += w
        squares += w * e * e
        weights += w
        J[0], J[1], J[2] = nx, ny, ny * rx - nx * ry
        T[0], T[1], T[2] = -ny, nx, nx * rx + ny * ry
        for a in range(3):
            g[a] += w * e * J[a]
            for b in range(3):
                H[a, b] += w * J[a] * J[b]
                F[a, b] += w * M[i, 4] * T[a] * T[b]
    step = np.linalg.solve(H + 0.05 * np.eye(3), g)
    largest = max(abs(step[0]), abs(step[1]), abs(step[2]))
    if largest > 0.5:
        step *= 0.5 / largest
    variance = max(squares / max(weights, 1.0), 0.003**2)
    return X - step, H / variance, F / variance, fit, float(max(could, 1))


@njit(cache=True)
def fitting(M: FloatArray, B: FloatArray, X: FloatArray) -> float:
    """Return the share of the rays of B in view of M that fit it at the pose X (3,), or one step from it."""
    X, _, _, _, _ = _pulled(M, B, X, FIT, 1)
    _, _, _, fit, could = _pulled(M, B, X, FIT, 1)
    return fit / could


@njit(cache=True)
def searched(
    M: FloatArray, B: FloatArray, X_guess: FloatArray
) -> tuple[FloatArray, float, FloatArray, FloatArray, FloatArray, float, float]:
    """Return the best X (3,), its score, H and F, see `_pulled`; the second best elsewhere and its score; the share of
    rays that fit."""
    starts, scores = np.empty((2 * TURNS + 1, 3)), np.zeros(2 * TURNS + 1)
    stride = max(1, len(B) // 50)
    for k in range(2 * TURNS + 1):
        X = X_guess.copy()
        X[2] += (k - TURNS) * TURN_STEP
        for gate in COARSE:
            X, _, _, _, _ = _pulled(M, B, X, gate, stride)
        _, _, _, fit, could = _pulled(M, B, X, COARSE[-1], stride)
        starts[k] = X
        scores[k] = fit / max(could, VIEW * len(B) / stride) * (1.0 - UNLIKELY * abs(k - TURNS) * TURN_STEP)
    best, rival = np.zeros(3), np.zeros(3)
    H, F = np.zeros((3, 3)), np.zeros((3, 3))
    score = second = share = 0.0
    for k in np.argsort(-scores)[:3]:
        X = starts[k].copy()
        for gate in FINE:
            before = X
            X, _, _, _, _ = _pulled(M, B, before, gate, 1)
            if gate == FIT and np.abs(X - before).max() < 1e-4:
                break
        X[2] = math.pi - (math.pi - X[2]) % (2.0 * math.pi)
        _, H_k, F_k, fit, could = _pulled(M, B, X, FIT, 1)
        off = abs(math.pi - (math.pi - X[2] + X_guess[2]) % (2.0 * math.pi))
        value = fit / max(could, VIEW * len(B)) * (1.0 - UNLIKELY * off)
        if value > score:
            rival, second = best, score
            best, score, H, F, share = X, value, H_k, F_k, fit / could
        elif value > second:
            rival, second = X, value
    return best, score, H, F, rival, second, share

"""Planar rigid transforms. A pose X_AB is (x, y, theta): position of B's origin in A (m) and B's heading in A (rad)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray


def wrap_angle(angle: FloatArray | float) -> FloatArray:
    """Angle(s) in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2.0 * np.pi))


def rotation(theta: float) -> FloatArray:
    """R_AB (2, 2) of heading theta."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s], [s, c]])


# One pose at a time is what every tick of every filter asks for: many times faster compiled.
@njit(cache=True)
def _compose(X_AB: FloatArray, X_BC: FloatArray) -> FloatArray:
    c, s = math.cos(X_AB[2]), math.sin(X_AB[2])
    X_AC = np.empty(3)
    X_AC[0] = X_AB[0] + c * X_BC[0] - s * X_BC[1]
    X_AC[1] = X_AB[1] + s * X_BC[0] + c * X_BC[1]
    X_AC[2] = math.pi - (math.pi - X_AB[2] - X_BC[2]) % (2.0 * math.pi)
    return X_AC


@njit(cache=True)
def _inverse(X_AB: FloatArray) -> FloatArray:
    c, s = math.cos(X_AB[2]), math.sin(X_AB[2])
    X_BA = np.empty(3)
    X_BA[0] = -c * X_AB[0] - s * X_AB[1]
    X_BA[1] = s * X_AB[0] - c * X_AB[1]
    X_BA[2] = math.pi - (math.pi + X_AB[2]) % (2.0 * math.pi)
    return X_BA


@njit(cache=True)
def _between(X_AB: FloatArray, X_AC: FloatArray) -> FloatArray:
    return _compose(_inverse(X_AB), X_AC)


def compose(X_AB: FloatArray, X_BC: FloatArray) -> FloatArray:
    """X_AC = X_AB X_BC; either argument may be (3,) or (n, 3)."""
    X_AB, X_BC = np.asarray(X_AB, dtype=float), np.asarray(X_BC, dtype=float)
    if X_AB.ndim == X_BC.ndim == 1:
        return _compose(X_AB, X_BC)
    c, s = np.cos(X_AB[..., 2]), np.sin(X_AB[..., 2])
    x = X_AB[..., 0] + c * X_BC[..., 0] - s * X_BC[..., 1]
    y = X_AB[..., 1] + s * X_BC[..., 0] + c * X_BC[..., 1]
    return np.stack([x, y, wrap_angle(X_AB[..., 2] + X_BC[..., 2])], axis=-1)


def inverse(X_AB: FloatArray) -> FloatArray:
    """X_BA, for (3,) or (n, 3)."""
    X_AB = np.asarray(X_AB, dtype=float)
    if X_AB.ndim == 1:
        return _inverse(X_AB)
    c, s = np.cos(X_AB[..., 2]), np.sin(X_AB[..., 2])
    x, y = X_AB[..., 0], X_AB[..., 1]
    return np.stack([-c * x - s * y, s * x - c * y, wrap_angle(-X_AB[..., 2])], axis=-1)


def between(X_AB: FloatArray, X_AC: FloatArray) -> FloatArray:
    """X_BC from two poses in A; either argument may be (3,) or (n, 3)."""
    X_AB, X_AC = np.asarray(X_AB, dtype=float), np.asarray(X_AC, dtype=float)
    if X_AB.ndim == X_AC.ndim == 1:
        return _between(X_AB, X_AC)
    return compose(inverse(X_AB), X_AC)


def transform(X_AB: FloatArray, p_BP: FloatArray) -> FloatArray:
    """p_AP (n, 2) or (2,) of points p_BP (n, 2) or (2,) in B, for one pose X_AB (3,)."""
    p_BP = np.asarray(p_BP, dtype=float)
    return p_BP @ rotation(float(X_AB[2])).T + np.asarray(X_AB[:2])

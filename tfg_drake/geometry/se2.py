"""Planar rigid transforms. A pose X_AB is (x, y, theta): position of B's origin in A (m) and B's heading in A (rad)."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import FloatArray, PoseEstimate


def wrap_angle(angle: FloatArray | float) -> FloatArray:
    """Angle(s) in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2.0 * np.pi))


def rotation(theta: float) -> FloatArray:
    """R_AB (2, 2) of heading theta."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s], [s, c]])


def compose(X_AB: FloatArray, X_BC: FloatArray) -> FloatArray:
    """X_AC = X_AB X_BC; either argument may be (3,) or (n, 3)."""
    X_AB, X_BC = np.asarray(X_AB, dtype=float), np.asarray(X_BC, dtype=float)
    if X_AB.ndim == X_BC.ndim == 1:
        return np.array(_composed(X_AB.tolist(), X_BC.tolist()))
    c, s = np.cos(X_AB[..., 2]), np.sin(X_AB[..., 2])
    x = X_AB[..., 0] + c * X_BC[..., 0] - s * X_BC[..., 1]
    y = X_AB[..., 1] + s * X_BC[..., 0] + c * X_BC[..., 1]
    return np.stack([x, y, wrap_angle(X_AB[..., 2] + X_BC[..., 2])], axis=-1)


def inverse(X_AB: FloatArray) -> FloatArray:
    """X_BA, for (3,) or (n, 3)."""
    X_AB = np.asarray(X_AB, dtype=float)
    if X_AB.ndim == 1:
        return np.array(_inverted(X_AB.tolist()))
    c, s = np.cos(X_AB[..., 2]), np.sin(X_AB[..., 2])
    x, y = X_AB[..., 0], X_AB[..., 1]
    return np.stack([-c * x - s * y, s * x - c * y, wrap_angle(-X_AB[..., 2])], axis=-1)


def between(X_AB: FloatArray, X_AC: FloatArray) -> FloatArray:
    """X_BC from two poses in A; either argument may be (3,) or (n, 3)."""
    X_AB, X_AC = np.asarray(X_AB, dtype=float), np.asarray(X_AC, dtype=float)
    if X_AB.ndim == X_AC.ndim == 1:
        return np.array(_composed(_inverted(X_AB.tolist()), X_AC.tolist()))
    return compose(inverse(X_AB), X_AC)


# Every tick of every filter asks for one pose: on a few numbers Python is several times faster than numpy.
def _composed(X_AB: list[float], X_BC: list[float]) -> list[float]:
    (x, y, theta), (dx, dy, turn) = X_AB, X_BC
    c, s = math.cos(theta), math.sin(theta)
    return [x + c * dx - s * dy, y + s * dx + c * dy, math.pi - (math.pi - theta - turn) % (2.0 * math.pi)]


def _inverted(X_AB: list[float]) -> list[float]:
    x, y, theta = X_AB
    c, s = math.cos(theta), math.sin(theta)
    return [-c * x - s * y, s * x - c * y, math.pi - (math.pi + theta) % (2.0 * math.pi)]


def transform(X_AB: FloatArray, p_BP: FloatArray) -> FloatArray:
    """p_AP (n, 2) or (2,) of points p_BP (n, 2) or (2,) in B, for one pose X_AB (3,), or for one each, (n, 3)."""
    X_AB, p_BP = np.asarray(X_AB, dtype=float), np.asarray(p_BP, dtype=float)
    if X_AB.ndim == 1:
        return np.asarray(p_BP @ rotation(float(X_AB[2])).T + X_AB[:2])
    (x, y, theta), (dx, dy) = X_AB.T, p_BP.T
    c, s = np.cos(theta), np.sin(theta)
    return np.column_stack([x + c * dx - s * dy, y + s * dx + c * dy])


def pose_at(pose: PoseEstimate, stamp: float) -> FloatArray:
    """The pose X_MB (3,) at a time (s) near pose.stamp, by the measured speed: messages have stamps of their own."""
    dt = stamp - pose.stamp
    v, w = pose.speed * dt
    return compose(pose.X_MB, np.array([v * np.cos(0.5 * w), v * np.sin(0.5 * w), w]))


def poses_of(steps: FloatArray) -> FloatArray:
    """(n + 1, 3) poses by steps (n, 3), each in the frame of the pose before it, from the origin on."""
    heading = np.append(0.0, np.cumsum(steps[:, 2]))
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.append(0.0, np.cumsum(c * steps[:, 0] - s * steps[:, 1]))
    y = np.append(0.0, np.cumsum(s * steps[:, 0] + c * steps[:, 1]))
    return np.column_stack([x, y, wrap_angle(heading)])


def arcs(ahead: FloatArray, turn: FloatArray) -> FloatArray:
    """(n, 3) steps along arcs of these lengths (n,), m, and turns (n,), rad."""
    chord = ahead * np.sinc(0.5 * turn / np.pi)
    return np.column_stack([chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn])

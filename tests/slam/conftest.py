"""A tiny simulator: a unicycle among point tags without walls, odometry at 32 Hz, tags at 10 Hz."""

from __future__ import annotations

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, TagDetections
from tfg_drake.slam.odometry_model import interpolate
from tfg_drake.slam.turn import TurnFrame, no_detections

PERIOD = 1.0 / 32.0


class RingDrive:
    """noise scales every error: 0 is exact, 1 the `paper` scenario's."""

    def __init__(self, tags, seed, noise, start=(0.0, 0.0, 0.0), view=2.164):
        self.random = np.random.default_rng(seed)
        self.config = OdometryConfig()
        self.tags, self.noise, self.view = tags, noise, view
        self.X_WM = np.array(start, dtype=float)
        self.X_WB = self.X_WM.copy()
        self.X_OB = np.zeros(3)
        self.time, self.next_frame = 0.0, 0.0
        sigma = [self.config.distance_scale, self.config.gyro_bias, self.config.gyro_scale]
        self.errors = noise * self.random.normal(size=3) * sigma
        self.last = self.odometry()

    @property
    def X_MB(self):
        return se2.between(self.X_WM, self.X_WB)

    def p_ML(self, ids):
        return se2.transform(se2.inverse(self.X_WM), self.tags[ids - 100])

    def odometry(self):
        return Odometry(stamp=self.time, X_OB=self.X_OB, V_B=np.zeros(2))

    @staticmethod
    def _motion(distance, turn):
        chord = distance * np.sinc(0.5 * turn / np.pi)
        return np.array([chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn])

    def _frame(self, X_WB, stamp):
        p_BL = se2.transform(se2.inverse(X_WB), self.tags)
        r, b = np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0])
        seen = np.flatnonzero((r < 10.0) & (r > 0.1) & (np.abs(b) < 0.5 * self.view))
        r, b = r[seen], b[seen]
        sigma_r, sigma_b = 0.02 + 0.01 * r, np.full(len(seen), 0.01)
        normal = self.noise * self.random.normal(size=(2, len(seen)))
        return TagDetections(stamp, seen + 100, r + sigma_r * normal[0], b + sigma_b * normal[1], sigma_r, sigma_b)

    def step(self, speed, turn_rate):
        """The messages of one odometry period, in the order of their stamps."""
        messages = []
        while self.next_frame < self.time + PERIOD - 1e-9:
            dt = self.next_frame - self.time
            X_WB = se2.compose(self.X_WB, self._motion(speed * dt, turn_rate * dt))
            messages.append(self._frame(X_WB, self.next_frame))
            self.next_frame = round(self.next_frame + 0.1, 6)
        distance, turn = speed * PERIOD, turn_rate * PERIOD
        self.X_WB = se2.compose(self.X_WB, self._motion(distance, turn))
        s, b, g = self.errors
        normal = self.noise * self.random.normal(size=2)
        distance = (1.0 + s) * distance + self.config.distance_noise * np.sqrt(abs(distance)) * normal[0]
        turn = (1.0 + g) * turn + b * PERIOD + self.config.gyro_noise * np.sqrt(PERIOD) * normal[1]
        self.X_OB = se2.compose(self.X_OB, self._motion(distance, turn))
        self.time += PERIOD
        return [*messages, self.odometry()]

    def frames(self, speed, turn_rate, steps):
        """The frames of several periods, each with the odometry interpolated at its stamp."""
        result = []
        for _ in range(steps):
            *seen, odometry = self.step(speed, turn_rate)
            result += [TurnFrame(d.stamp, d.stamp, interpolate(self.last, odometry, d.stamp), d) for d in seen]
            self.last = odometry
        return tuple(result)

    def instant(self):
        return TurnFrame(self.time, self.time, self.X_OB, no_detections(self.time))


@pytest.fixture(scope="session")
def drive():
    """RingDrive, the class."""
    return RingDrive


def _nees(error, covariance):
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


@pytest.fixture(scope="session")
def nees():
    """Normalised squared error e' P^-1 e / n."""
    return _nees

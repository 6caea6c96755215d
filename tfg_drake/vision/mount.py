"""Where a camera sits on the robot."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from tfg_drake.messages import FloatArray

# Optical frame C (z forward, x right, y down; REP 103) in the frame of x forward, y left, z up.
_R_FC = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclasses.dataclass(frozen=True)
class CameraMount:
    """X_BC: x, y in the body frame B and z above the floor, m; yaw, pitch (downward) and roll (clockwise as the camera
    looks), rad, turned about z, then y, then x."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @property
    def R_BC(self) -> FloatArray:
        """(3, 3) from the optical frame C to the body's, z up."""
        turned = Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix()
        return np.asarray(turned @ _R_FC)

    @property
    def p_BC(self) -> FloatArray:
        """(3,) m."""
        return np.array([self.x, self.y, self.z])

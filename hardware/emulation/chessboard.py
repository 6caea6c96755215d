"""A chessboard before a camera that is not there, to calibrate it by."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.image import Image

# Number of inner corners in a row and in a column, side of a square, m.
COLUMNS, ROWS, SQUARE = 9, 6, 0.025
# Side of a square in the board's texture, pixels; oversampling of the drawn image; grey level of the background.
_CELL, _FINER, _BESIDE = 40, 3, 128
# Of the board's pose: greatest tilt and turn, rad; least and greatest distance, m; greatest offset from the optical
# axis, as a share of the distance.
_TILT, _TURN, _NEAR, _FAR, _ASIDE = 0.5, 0.3, 0.32, 0.45, 0.22


def board_view(calibration: CameraCalibration, number: int) -> Image:
    """Return the image (h, w) of the board in the pose drawn by a number, by a camera without distortion."""
    chance = np.random.default_rng(number)
    R = Rotation.from_euler("xyz", [*chance.uniform(-_TILT, _TILT, 2), chance.uniform(-_TURN, _TURN)]).as_matrix()
    z = chance.uniform(_NEAR, _FAR)
    p = np.append(chance.uniform(-_ASIDE, _ASIDE, 2) * z, z)
    # The squares' outer corners, a square beyond the inner ones.
    inner = np.array([COLUMNS - 1, ROWS - 1])
    outer = np.array([[-1, -1], [COLUMNS, -1], [COLUMNS, ROWS], [-1, ROWS]]) - 0.5 * inner
    corners = (np.column_stack([outer * SQUARE, np.zeros(4)]) @ R.T + p) @ calibration.matrix.T
    seen = corners[:, :2] / corners[:, 2:]
    drawn = (np.array([[1, 1], [COLUMNS + 2, 1], [COLUMNS + 2, ROWS + 2], [1, ROWS + 2]]) * _CELL - 0.5).astype(float)
    size = calibration.width * _FINER, calibration.height * _FINER
    H = cv2.getPerspectiveTransform(drawn.astype(np.float32), ((seen + 0.5) * _FINER - 0.5).astype(np.float32))
    large = cv2.warpPerspective(_board(), H, size, borderValue=_BESIDE)
    small = cv2.resize(large, (calibration.width, calibration.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _board() -> Image:
    """White, a square wide, round the squares."""
    squares = (np.add.outer(np.arange(ROWS + 1), np.arange(COLUMNS + 1)) % 2 * 255).astype(np.uint8)
    return np.pad(np.kron(squares, np.ones((_CELL, _CELL), dtype=np.uint8)), _CELL, constant_values=255)

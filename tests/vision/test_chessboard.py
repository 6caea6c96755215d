"""A camera that renders a chessboard is calibrated by its images."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.vision.rendering import cv2, projected
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.chessboard import board_corners, calibrated, is_new_view

K = np.array([[520.5, 0.0, 325.0], [0.0, 519.0, 236.0], [0.0, 0.0, 1.0]])
CAMERA = CameraCalibration(640, 480, K, "plumb_bob", np.array([-0.1, 0.02, 0.001, -0.0005, 0.0]))
COLUMNS, ROWS, SQUARE = 9, 6, 0.025


def poses(n, tilt=0.5, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        R = Rotation.from_euler("xyz", [*rng.uniform(-tilt, tilt, 2), rng.uniform(-0.3, 0.3)]).as_matrix()
        z = rng.uniform(0.25, 0.45)
        yield R, np.append(rng.uniform(-0.12, 0.12, 2) * z / 0.35, z)


def corners_at(R, p):
    """(54, 2) pixels of the inner corners."""
    grid = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2) * SQUARE
    centred = grid - grid.mean(axis=0)
    return projected(np.column_stack([centred, np.zeros(len(grid))]) @ R.T + p, CAMERA)


def board_image(R, p, finer=3):
    """The board as an ideal camera sees it; (480, 640)."""
    cell = 40
    board = np.full(((ROWS + 3) * cell, (COLUMNS + 3) * cell), 255, np.uint8)
    for i in range(ROWS + 1):
        for j in range(COLUMNS + 1):
            if (i + j) % 2 == 0:
                board[(i + 1) * cell : (i + 2) * cell, (j + 1) * cell : (j + 2) * cell] = 0
    ideal = CameraCalibration(640, 480, K, "plumb_bob", np.zeros(0))
    outer = np.array([[-1, -1], [COLUMNS, -1], [COLUMNS, ROWS], [-1, ROWS]]) - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]
    seen = projected(np.column_stack([outer * SQUARE, np.zeros(4)]) @ R.T + p, ideal)
    on_board = np.array([[1, 1], [COLUMNS + 2, 1], [COLUMNS + 2, ROWS + 2], [1, ROWS + 2]]) * cell - 0.5
    H = cv2.getPerspectiveTransform(on_board.astype(np.float32), ((seen + 0.5) * finer - 0.5).astype(np.float32))
    big = cv2.warpPerspective(board, H, (640 * finer, 480 * finer), borderValue=128)
    return cv2.resize(big, (640, 480), interpolation=cv2.INTER_AREA)


def test_corners_are_found():
    R, p = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix(), np.array([0.01, -0.01, 0.35])
    ideal = CameraCalibration(640, 480, K, "plumb_bob", np.zeros(0))
    grid = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2) * SQUARE
    exact = projected(np.column_stack([grid - grid.mean(axis=0), np.zeros(54)]) @ R.T + p, ideal)
    found = board_corners(board_image(R, p), COLUMNS, ROWS)
    distance = np.linalg.norm(found[:, None] - exact[None], axis=2)
    assert distance.min(axis=1).max() < 0.15
    assert sorted(distance.argmin(axis=1)) == list(range(54))
    assert board_corners(np.full((480, 640), 128, np.uint8), COLUMNS, ROWS) is None


def test_a_camera_is_calibrated():
    rng = np.random.default_rng(1)
    views = [corners_at(*pose) + 0.1 * rng.normal(size=(54, 2)) for pose in poses(20)]
    result = calibrated(views, COLUMNS, ROWS, SQUARE, (640, 480))
    assert result.views == 20
    assert result.error == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    np.testing.assert_allclose(result.calibration.matrix, K, atol=5.0 * result.focal_sigma + 1.0)
    np.testing.assert_allclose(result.calibration.coefficients[:2], CAMERA.coefficients[:2], atol=0.03)
    assert result.focal_sigma < 2.0
    assert result.remarks == ()


def test_views_that_do_not_determine_it_are_told():
    with pytest.raises(ValueError, match=r"^3 views of the board, at least 8 are needed; show it from more sides$"):
        calibrated([corners_at(*pose) for pose in poses(3)], COLUMNS, ROWS, SQUARE, (640, 480))
    rng = np.random.default_rng(2)
    flat = [corners_at(np.eye(3), [0, 0, 0.8]) + 0.3 * rng.normal(size=(54, 2)) for _ in range(9)]
    try:
        told = " ".join(calibrated(flat, COLUMNS, ROWS, SQUARE, (640, 480)).remarks)
    except ValueError as error:
        told = str(error)
    assert re.search("tilt the board", told)


def test_a_view_that_is_not_new():
    R, p = next(poses(1))
    corners = corners_at(R, p)
    assert is_new_view(corners, [], 640)
    assert not is_new_view(corners + 1.0, [corners], 640)
    assert is_new_view(corners + 30.0, [corners], 640)

"""A camera's calibration from views of a chessboard (Zhang 2000), by OpenCV."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.percent import percent
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.image import Image, grey

# Least and greatest number of views: fewer leave the distortion undetermined, more take minutes and add nothing.
LEAST_VIEWS, MOST_VIEWS = 8, 60
# A view is new if its corners moved by more than this share of the image's width.
_NEW_VIEW = 0.03
# Limits for a usable calibration: reprojection error, pixels; relative deviation of the focal length; share of the
# image's width and height that the corners span; ratio of opposite sides of the board in the most oblique view.
GOOD_ERROR, GOOD_FOCAL, GOOD_SPAN, GOOD_SLANT = 1.0, 0.01, 0.6, 1.1
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)


@dataclasses.dataclass(frozen=True)
class ChessboardResult:
    """error: root mean square of reprojection, pixels. focal_sigma: standard deviation of the focal length, pixels.
    remarks: what makes the calibration doubtful, a line each."""

    calibration: CameraCalibration
    views: int
    error: float
    focal_sigma: float
    remarks: tuple[str, ...]


def board_corners(image: Image, columns: int, rows: int) -> FloatArray | None:
    """The inner corners (columns rows, 2) of a chessboard in an image, pixels; None where it is not seen whole."""
    picture = grey(image)
    found, corners = cv2.findChessboardCorners(
        picture, (columns, rows), flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    # No wider than the squares are, or another corner is found.
    sides = np.linalg.norm(np.diff(corners.reshape(rows, columns, 2), axis=1), axis=2)
    reach = int(np.clip(0.4 * sides.min(), 2, 11))
    return np.asarray(cv2.cornerSubPix(picture, corners, (reach, reach), (-1, -1), _CRITERIA), dtype=float).reshape(
        -1, 2
    )


def is_new_view(corners: FloatArray, before: Sequence[FloatArray], width: int) -> bool:
    """Whether corners (n, 2) show the board elsewhere than all views before."""
    return all(float(np.abs(corners - other).mean()) > _NEW_VIEW * width for other in before)


def calibrated(
    views: Sequence[FloatArray], columns: int, rows: int, square: float, size: tuple[int, int]
) -> ChessboardResult:
    """The calibration from the corners of each view.

    square: side of a square, m. size: (width, height) of the images, pixels. Raises ValueError where the views do not
    determine it.
    """
    if len(views) < LEAST_VIEWS:
        raise ValueError(f"{len(views)} views of the board, at least {LEAST_VIEWS} are needed; show it from more sides")
    board = np.zeros((columns * rows, 3), dtype=np.float32)
    board[:, :2] = square * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    pixels = [np.asarray(view, dtype=np.float32)[:, None] for view in views]
    try:
        error, K, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
            [board] * len(views), pixels, size, np.eye(3), np.zeros(5)
        )
    except cv2.error:
        error, K, distortion, sigma = np.nan, np.eye(3), np.zeros(5), np.zeros(18)
    if not (np.isfinite(error) and np.isfinite(K).all() and 0.0 < K[0, 2] < size[0] and 0.0 < K[1, 2] < size[1]):
        raise ValueError("the views do not determine the camera; tilt the board, by 30 degrees and more, to all sides")
    calibration = CameraCalibration(*size, np.asarray(K, dtype=float), "plumb_bob", np.asarray(distortion).ravel())
    focal_sigma = float(np.max(np.asarray(sigma).ravel()[:2]))
    found = ChessboardResult(calibration, len(views), float(error), focal_sigma, ())
    return dataclasses.replace(found, remarks=tuple(_doubts(found, views, columns)))


def _doubts(found: ChessboardResult, views: Sequence[FloatArray], columns: int) -> list[str]:
    calibration, error, focal_sigma = found.calibration, found.error, found.focal_sigma
    remarks = []
    if error > GOOD_ERROR:
        remarks.append(f"corners err by {error:.2f} pixels, more than {GOOD_ERROR:g}: is the board flat and sharp?")
    if focal_sigma > GOOD_FOCAL * calibration.focal or max(_slant(view, columns) for view in views) < GOOD_SLANT:
        share = 100.0 * focal_sigma / calibration.focal
        remarks.append(f"the focal length is known to {share:.1f} %, if at all: tilt the board by 30 degrees and more")
    corners = np.concatenate(views)
    spans = np.ptp(corners, axis=0) / (calibration.width, calibration.height)
    if spans.min() < GOOD_SPAN:
        remarks.append(
            f"corners span {percent(spans[0], 0):.0f} x {percent(spans[1], 0):.0f} % of the image: show the board at"
            " its edges, too"
        )
    return remarks


def _slant(view: FloatArray, columns: int) -> float:
    """The ratio of opposite sides of the board in a view, 1 or more: 1 where it is seen straight, which tells nothing
    of the focal length."""
    grid = view.reshape(-1, columns, 2)
    corners = np.array([grid[0, 0], grid[0, -1], grid[-1, -1], grid[-1, 0]])
    a, b, c, d = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).tolist()
    return float(max(a / c, c / a, b / d, d / b))

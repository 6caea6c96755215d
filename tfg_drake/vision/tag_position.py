"""Where tags are, from the pixels of their corners: perspective-n-point, and what noise of the corners makes of it."""

from __future__ import annotations

import cv2
import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.vision import lens
from tfg_drake.vision.calibration import CameraCalibration

# Corners of a tag with side 1, clockwise in the image from the upper left.
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
# Least area that two sides of a tag span at a corner, square pixels, as its cells have a pixel at least.
LEAST_TURN = 9.0
# Least range of a bearing, m.
LEAST_RANGE = 0.01
# Greatest distance of a corner from the axis on the plane z = 1 (89.4 degrees).
WIDEST = 100.0
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-10)


def tag_positions(
    corners: FloatArray, sizes: FloatArray, calibration: CameraCalibration
) -> tuple[FloatArray, FloatArray]:
    """The centres p_CT (n, 3) of square tags in the camera's frame C, m, and their covariance (n, 3, 3), m^2, for
    corners with independent errors of one pixel.

    corners: (n, 4, 2) pixels in order round the tag, either way. sizes: (n,) side of the black square, m. C is z
    forward, x right, y down. Rows are nan where the corners are no square's. The tag's yaw is not told: seen once it is
    ambiguous (Schweighofer, Pinz 2006), and wherever it is, the centre hardly moves.
    """
    centres, covariance = np.full((len(corners), 3), np.nan), np.full((len(corners), 3, 3), np.nan)
    points, on_pixels = lens.undistorted(corners, calibration), lens.on_pixels(corners, calibration)
    seen = (np.abs(points) <= WIDEST).all(axis=(1, 2)) & (sizes > 0.0) & (sizes < np.inf)
    for i in np.flatnonzero(seen & np.isfinite(on_pixels).all(axis=(1, 2, 3))):
        turns = _turns(corners[i])
        if not (turns > LEAST_TURN).all() and not (turns < -LEAST_TURN).all():
            continue
        order = slice(None) if turns[0] > 0.0 else slice(None, None, -1)
        solved = _solved(points[i][order], sizes[i] * SQUARE)
        if solved is not None:
            centres[i], on_points = solved
            root = np.hstack([on_points[:, 2 * k : 2 * k + 2] @ on_pixels[i][order][k] for k in range(4)])
            covariance[i] = root @ root.T
    return centres, covariance


def polar(p: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Range (n,), m, and bearing (n,), rad, of points (n, 2), m, and the variances (n,), m^2, along the line of sight
    and across it, by their covariance (n, 2, 2). What is nearer than LEAST_RANGE has no direction."""
    distance = np.hypot(p[:, 0], p[:, 1])
    along = p / np.maximum(distance, LEAST_RANGE)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    variances = (np.einsum("ni,nij,nj->n", one, covariance, one) for one in (along, across))
    return distance, np.arctan2(p[:, 1], p[:, 0]), *variances


def _turns(polygon: FloatArray) -> FloatArray:
    """The cross product (n,) of the sides that meet at each corner of a polygon (n, 2), all positive where it is convex
    and runs clockwise in an image, whose y points down."""
    before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
    return np.asarray(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])


def _solved(points: FloatArray, square: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The centre (3,) and its derivative (3, 8) on the points (4, 2) on the plane z = 1; None where there is none."""
    eye = np.eye(3)
    try:
        # Not IPPE: of a tag that hangs quite upright OpenCV 5.0 returns the wrong one of its two poses.
        found, rotation, p_CT = cv2.solvePnP(square, points[:, None], eye, None, flags=cv2.SOLVEPNP_SQPNP)
        if not found:
            return None
        rotation, p_CT = cv2.solvePnPRefineLM(square, points[:, None], eye, None, rotation, p_CT, _CRITERIA)
        jacobian = cv2.projectPoints(square, rotation, p_CT, eye, None)[1][:, :6]
        on_points = np.linalg.solve(jacobian.T @ jacobian, jacobian.T)[3:]
    except (cv2.error, np.linalg.LinAlgError):
        return None
    centre = np.asarray(p_CT, dtype=float).ravel()
    good = np.isfinite(centre).all() and centre[2] > 0.0 and np.isfinite(on_points).all()
    return (centre, on_points) if good else None

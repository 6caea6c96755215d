"""Calibrations of cameras on disk: OpenCV's YAML, ROS's camera_info and Kalibr's camchain, as their tools write."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.io.files import read_bytes, write_atomic
from tfg_drake.io.yaml_text import parse_yaml
from tfg_drake.messages import FloatArray, message

# Distortion models by their names in files. Coefficients: k1, k2, p1, p2[, k3[, k4, k5, k6[, s1 .. s4[, tx, ty]]]] of
# Brown's model, k1 to k4 of Kannala and Brandt's.
BROWN = ("plumb_bob", "rational_polynomial", "radtan", "radial-tangential")
FISHEYE = ("equidistant", "fisheye")
_COUNTS = {"plumb_bob": (0, 4, 5, 8, 12, 14), "equidistant": (4,)}
# Names of each key in files.
_KEYS = {
    "image_width": ("image_width", "width"),
    "image_height": ("image_height", "height"),
    "camera_matrix": ("camera_matrix", "Camera_Matrix", "K", "k"),
    "distortion_coefficients": ("distortion_coefficients", "Distortion_Coefficients", "D", "d", "distortion_coeffs"),
}
# Greatest size of a calibration file, bytes, width of an image, pixels, and magnitude of a coefficient.
_LONGEST_FILE, WIDEST_IMAGE, _GREATEST = 100_000, 100_000, 1e6
_ANEW = "calibrate anew with tfg-drake camera calibrate"


class CalibrationError(ValueError):
    """A calibration that cannot be used; the message is one line: file, key, what is wrong, how to mend it."""


@message
class CameraCalibration:
    """How a camera sees.

    width, height: of its images, pixels. matrix: (3, 3) K; pixel (0, 0) has its centre at (0, 0), as in OpenCV.
    model: "plumb_bob" or "equidistant". coefficients: (k,) of its distortion.
    """

    width: int
    height: int
    matrix: FloatArray
    model: str
    coefficients: FloatArray

    @property
    def focal(self) -> float:
        """Focal length, the mean of both axes', pixels."""
        return float(0.5 * (self.matrix[0, 0] + self.matrix[1, 1]))


def load_calibration(path: Path) -> CameraCalibration:
    """The calibration in a file; raises CalibrationError."""
    try:
        text = read_bytes(path, _LONGEST_FILE).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise CalibrationError(f"{path}: cannot be read: {reason}; name a calibration's YAML file") from None
    # OpenCV's first line is not YAML's, and its matrices bear a tag that says nothing.
    text = re.sub(r"\A%YAML[: ]\S*", "", text.lstrip("\ufeff")).replace("!!opencv-matrix", "")
    try:
        tree = parse_yaml(text)
    except ValueError as error:
        raise CalibrationError(f"{path}: {error}; mend it") from None
    if not isinstance(tree, dict):
        raise CalibrationError(f"{path}: holds no keys; name a calibration's YAML file")
    try:
        return calibration_of(tree)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def save_calibration(path: Path, calibration: CameraCalibration) -> None:
    """Writes ROS's camera_info YAML; raises OSError."""

    def matrix(rows: FloatArray) -> str:
        numbers = ", ".join(f"{float(value)!r}" for value in rows.ravel())
        return f"\n  rows: {rows.shape[0]}\n  cols: {rows.shape[1]}\n  data: [{numbers}]\n"

    coefficients = calibration.coefficients
    if calibration.model == "plumb_bob" and not len(coefficients):
        coefficients = np.zeros(5)
    model = "rational_polynomial" if calibration.model == "plumb_bob" and len(coefficients) > 5 else calibration.model
    text = (
        f"image_width: {calibration.width}\nimage_height: {calibration.height}\ncamera_name: camera\n"
        f"camera_matrix:{matrix(calibration.matrix)}distortion_model: {model}\n"
        f"distortion_coefficients:{matrix(coefficients[None])}rectification_matrix:{matrix(np.eye(3))}"
        f"projection_matrix:{matrix(np.column_stack([calibration.matrix, np.zeros(3)]))}"
    )
    write_atomic(path, text)


def calibration_of(tree: dict[Any, Any]) -> CameraCalibration:
    """The calibration that parsed YAML holds; raises CalibrationError without the file's name."""
    tree = _of_kalibr(tree)
    width, height = (_pixels(tree, key) for key in ("image_width", "image_height"))
    matrix = np.array(_numbers(tree, "camera_matrix", (9,))).reshape(3, 3)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    if not (min(fx, fy) >= 1.0 and 0.0 < cx < width and 0.0 < cy < height and (matrix[2] == [0.0, 0.0, 1.0]).all()):
        raise CalibrationError(
            "camera_matrix: is not [fx, 0, cx, 0, fy, cy, 0, 0, 1] in pixels with cx and cy within the image; " + _ANEW
        )
    model = _model(tree)
    return CameraCalibration(
        width, height, matrix, model, np.array(_numbers(tree, "distortion_coefficients", _COUNTS[model]))
    )


def _of_kalibr(tree: dict[Any, Any]) -> dict[Any, Any]:
    """The one camera of Kalibr's camchain by ROS's keys; a calibration of another kind as it is. A pinhole has four
    intrinsics, Kalibr's other models have more."""
    trees = [*tree.items(), ("", tree)]
    cameras = {key: one for key, one in trees if isinstance(one, dict) and {"intrinsics", "resolution"} & one.keys()}
    if not cameras:
        return tree
    if len(cameras) > 1:
        raise CalibrationError(f"{', '.join(map(str, cameras))}: {len(cameras)} cameras; keep one of them in the file")
    (one,) = cameras.values()
    fx, fy, cx, cy = _numbers(one, "intrinsics", (4,))
    _numbers(one, "resolution", (2,))
    width, height = one["resolution"]
    return {**one, "width": width, "height": height, "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]}


def _model(tree: dict[Any, Any]) -> str:
    named = str(tree.get("distortion_model") or ("equidistant" if tree.get("fisheye_model") else "plumb_bob"))
    if named in BROWN:
        return "plumb_bob"
    if named in FISHEYE:
        return "equidistant"
    raise CalibrationError(f"distortion_model: unknown model {named[:50]}; known are {', '.join(BROWN + FISHEYE)}")


def _value(tree: dict[Any, Any], key: str) -> Any:
    """The value of a key in a file, under any of its names; None where there is none."""
    return next((tree[name] for name in _KEYS.get(key, (key,)) if tree.get(name) is not None), None)


def _unusable(key: str, expected: str, value: Any) -> CalibrationError:
    found = "missing" if value is None else f"found {str(value)[:50]}"
    return CalibrationError(f"{key}: expected {expected}, {found}; {_ANEW}")


def _pixels(tree: dict[Any, Any], key: str) -> int:
    value = _value(tree, key)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= WIDEST_IMAGE:
        raise _unusable(key, "a number of pixels", value)
    return value


def _numbers(tree: dict[Any, Any], key: str, counts: tuple[int, ...]) -> list[float]:
    value = _value(tree, key)
    value = value.get("data") if isinstance(value, dict) else value
    numbers = [n for row in value for n in (row if isinstance(row, list) else [row])] if isinstance(value, list) else []
    good = all(isinstance(n, int | float) and not isinstance(n, bool) and abs(n) <= _GREATEST for n in numbers)
    if not (isinstance(value, list) and good and len(numbers) in counts):
        raise _unusable(key, f"{' or '.join(map(str, counts))} numbers", value)
    return [float(n) for n in numbers]

"""Calibrations of either kind are read alike, and bad ones are told in one line."""

import re

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tests.vision.rendering import cv2
from tfg_drake.vision.calibration import CalibrationError, CameraCalibration, load_calibration, save_calibration

K = np.array([[520.5, 0.0, 321.25], [0.0, 519.0, 239.5], [0.0, 0.0, 1.0]])
BROWN = np.array([-0.1, 0.02, 0.001, -0.0005, 0.003])

ROS = """
image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [520.5, 0.0, 321.25, 0.0, 519.0, 239.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.0005, 0.003]}
"""
MESSAGE = """
header: {frame_id: camera}
height: 480
width: 640
distortion_model: plumb_bob
d: [-0.1, 0.02, 0.001, -0.0005, 0.003]
k: [520.5, 0.0, 321.25, 0.0, 519.0, 239.5, 0.0, 0.0, 1.0]
"""


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def opencv_file(path, coefficients=BROWN):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", coefficients.reshape(-1, 1))
    storage.release()
    return path


@pytest.mark.parametrize("kind", ["ros", "message", "opencv"])
def test_a_calibration_is_read(kind, tmp_path):
    path = tmp_path / "camera.yaml"
    path = opencv_file(path) if kind == "opencv" else write(path, ROS if kind == "ros" else MESSAGE)
    read = load_calibration(path)
    assert (read.width, read.height, read.model) == (640, 480, "plumb_bob")
    np.testing.assert_array_equal(read.matrix, K)
    np.testing.assert_array_equal(read.coefficients, BROWN)


@pytest.mark.parametrize("count", [0, 4, 5, 8])
@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_what_is_written_is_read(model, count, tmp_path):
    if model == "equidistant" and count != 4:
        return
    written = CameraCalibration(640, 480, K, model, np.linspace(-0.1, 0.1, count))
    save_calibration(tmp_path / "out.yaml", written)
    read = load_calibration(tmp_path / "out.yaml")
    assert (read.width, read.height, read.model) == (640, 480, model)
    np.testing.assert_array_equal(read.matrix, K)
    np.testing.assert_array_equal(read.coefficients, written.coefficients if count else np.zeros(5))


ANEW = "calibrate anew with tfg-drake camera calibrate"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("image_width: 640", "image_width: wide", f"image_width: expected a number of pixels, found wide; {ANEW}"),
        ("image_width: 640", "", f"image_width: expected a number of pixels, missing; {ANEW}"),
        (
            "data: [520.5, 0.0,",
            "data: [0.0,",
            "camera_matrix: expected 9 numbers, found [0.0, 321.25, 0.0, 519.0, 239.5, 0.0, 0.0, 1.0]; " + ANEW,
        ),
        (
            "520.5",
            "0.0",
            "camera_matrix: is not [fx, 0, cx, 0, fy, cy, 0, 0, 1] in pixels with cx and cy within the image; " + ANEW,
        ),
        (
            "distortion_model: plumb_bob",
            "distortion_model: magic",
            "distortion_model: unknown model magic; known are plumb_bob, rational_polynomial, radtan, "
            "radial-tangential, equidistant, fisheye",
        ),
        (
            "-0.0005, 0.003]",
            ".nan]",
            "distortion_coefficients: expected 0 or 4 or 5 or 8 or 12 or 14 numbers, found [-0.1, 0.02, 0.001, nan]; "
            + ANEW,
        ),
        ("plumb_bob", "fisheye", "distortion_coefficients: expected 4 numbers, found [-0.1, 0.02, 0.001, -0.0005, 0.0"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(old, new, told, tmp_path):
    path = write(tmp_path / "camera.yaml", ROS.replace(old, new))
    with pytest.raises(CalibrationError, match="^" + re.escape(f"{path}: {told}")) as error:
        load_calibration(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[1, 2", "- 1", "\x00", "a: !!python/none 1", "x: " + 2000 * "9", "%YAML:1.0"])
def test_no_text_hurts(text, tmp_path):
    with pytest.raises(CalibrationError, match=r"^[^\n]+$"):
        load_calibration(write(tmp_path / "camera.yaml", text))


def test_a_file_that_is_not_there(tmp_path):
    path = tmp_path / "none.yaml"
    told = f"{path}: cannot be read: No such file or directory; name a calibration's YAML file"
    with pytest.raises(CalibrationError, match="^" + re.escape(told) + "$"):
        load_calibration(path)


def test_numbers_with_an_exponent(tmp_path, shared_data):
    exponents = ROS.replace("-0.1, 0.02, 0.001, -0.0005, 0.003", "-1e-1, 2e-2, 1E-3, -5e-04, 3.e-3")
    np.testing.assert_array_equal(load_calibration(write(tmp_path / "mine.yaml", exponents)).coefficients, BROWN)
    found = load_calibration(shared_data("reports") / "calibrations" / "ros_exp.yaml")
    assert found.coefficients.tolist() == [1e-05, -2e-06, 1e-7, -3e-7, 0.0]


KALIBR = """
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.0005]
  distortion_model: radtan
  intrinsics: [520.5, 519.0, 321.25, 239.5]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""


@pytest.mark.parametrize("text", [KALIBR, re.sub("(?m)^  |^cam0:", "", KALIBR)])
@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_kalibrs_are_read(text, model, tmp_path):
    read = load_calibration(write(tmp_path / "camchain.yaml", text.replace("radtan", model)))
    assert (read.width, read.height) == (640, 480)
    assert read.model == ("plumb_bob" if model == "radtan" else "equidistant")
    np.testing.assert_array_equal(read.matrix, K)
    np.testing.assert_array_equal(read.coefficients, BROWN[:4])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("resolution: [640, 480]", "", f"resolution: expected 2 numbers, missing; {ANEW}"),
        ("intrinsics: [520.5, 519.0, 321.25, 239.5]", "", f"intrinsics: expected 4 numbers, missing; {ANEW}"),
        ("[640, 480]", "[640.5, 480]", f"image_width: expected a number of pixels, found 640.5; {ANEW}"),
        ("[520.5", "[0.9, 520.5", f"intrinsics: expected 4 numbers, found [0.9, 520.5, 519.0, 321.25, 239.5]; {ANEW}"),
        ("cam0:", "cam1: {intrinsics: [1, 1, 1, 1]}\ncam0:", "cam1, cam0: 2 cameras; keep one of them in the file"),
    ],
)
def test_what_is_wrong_in_kalibrs_is_told(old, new, told, tmp_path):
    path = write(tmp_path / "camchain.yaml", KALIBR.replace(old, new))
    with pytest.raises(CalibrationError, match="^" + re.escape(f"{path}: {told}") + "$"):
        load_calibration(path)


@pytest.mark.parametrize(
    ("name", "model", "count"),
    [
        ("kalibr.yaml", "plumb_bob", 4),
        ("topic_echo.yaml", "plumb_bob", 5),
        ("opencv_sample.yml", "plumb_bob", 5),
        ("ros_exp.yaml", "plumb_bob", 5),
        ("ros_fisheye.yaml", "equidistant", 4),
        ("ros_rational8.yaml", "plumb_bob", 8),
    ],
)
def test_the_calibrations_found(name, model, count, shared_data):
    read = load_calibration(shared_data("reports") / "calibrations" / name)
    assert (read.width, read.height, read.focal, read.model, len(read.coefficients)) == (640, 480, 600.0, model, count)


@pytest.mark.slow
@pytest.mark.parametrize("text", [ROS, MESSAGE, KALIBR], ids=["ros", "message", "kalibr"])
def test_a_mutated_calibration_is_refused_or_read(text, tmp_path):
    path = write(tmp_path / "camera.yaml", text)
    assert_refused_or_read(path, lambda: load_calibration(path), CalibrationError, count=1000)

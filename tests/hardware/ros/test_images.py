"""Images of a ROS graph in which tags are looked for: encodings, the lens, a graph without a detector."""

import base64
import dataclasses
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.cameras import pinhole
from tests.vision.rendering import cv2, render
from tfg_drake.hardware.ros import images
from tfg_drake.hardware.ros.graph_driver import SensorDriver
from tfg_drake.hardware.ros.preset import Camera, Topic, load_preset

CAMERA = pinhole(320, 240, 260.0)
SEEN = render([(7, np.eye(3), np.array([-0.3, 0.0, 1.5]), 0.16)], CAMERA, noise=1.0)
COLOUR = np.dstack([SEEN, np.roll(SEEN, 3, axis=1), 255 - SEEN])
K, P = CAMERA.matrix.ravel().tolist(), [200.0, 0, 150, 0, 0, 210, 110, 0, 0, 0, 1, 0]
INFO = {"width": 320, "height": 240, "k": K, "d": [0.1, 0, 0, 0, 0], "p": P, "distortion_model": "plumb_bob"}


def image(pixels, encoding, padding=0):
    """sensor_msgs/Image of (h, w, bytes a pixel), each row with bytes behind it."""
    h, w, _ = pixels.shape
    data = np.pad(pixels.reshape(h, -1), ((0, 0), (0, padding))).tobytes()
    return {"height": h, "width": w, "step": w * pixels.shape[2] + padding, "encoding": encoding, "data": data}


ALPHA = np.full((240, 320, 1), 255, np.uint8)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (image(SEEN[..., None], "mono8"), SEEN),
        (image(COLOUR, "rgb8", padding=5), COLOUR),
        (image(COLOUR[..., ::-1], "bgr8"), COLOUR),
        (image(np.concatenate([COLOUR[..., ::-1], ALPHA], axis=2), "bgra8"), COLOUR),
        (image(np.concatenate([COLOUR, ALPHA], axis=2), "rgba8"), COLOUR),
    ],
)
def test_encodings(message, expected):
    """As rclpy has them and as rosbridge does."""
    np.testing.assert_array_equal(images.plain(SimpleNamespace(**message)), expected)
    sent = {**message, "data": base64.b64encode(message["data"]).decode()}
    np.testing.assert_array_equal(images.plain(sent), expected)


def test_compressed_images():
    data = cv2.imencode(".png", SEEN)[1].tobytes()
    np.testing.assert_array_equal(images.decompressed({"data": data}), SEEN)
    np.testing.assert_array_equal(images.decompressed({"data": base64.b64encode(data).decode()}), SEEN)


@pytest.mark.parametrize(
    ("read", "message", "why"),
    [
        (images.plain, image(SEEN[..., None], "bayer_rggb8"), "images are encoded as bayer_rggb8; known are mono8, "),
        (
            images.plain,
            {**image(SEEN[..., None], "mono8"), "height": 300},
            "an image of 300 rows of 320 bytes has",
        ),
        (images.plain, {**image(SEEN[..., None], "mono8"), "width": 10**9}, "width is 1000000000, no number up to"),
        (images.decompressed, {"data": b"no image"}, "a compressed image is none that OpenCV reads"),
        (images.decompressed, {"data": b""}, "a compressed image is none that OpenCV reads"),
    ],
)
def test_images_that_are_none(read, message, why):
    with pytest.raises(ValueError, match=why):
        read(message)


def test_the_lens_of_a_raw_and_of_a_rectified_image():
    raw, rectified = images.lens(INFO, False), images.lens(INFO, True)
    np.testing.assert_array_equal(raw.matrix, CAMERA.matrix)
    assert (raw.coefficients.tolist(), rectified.coefficients.tolist()) == ([0.1, 0, 0, 0, 0], [])
    np.testing.assert_array_equal(rectified.matrix, [[200.0, 0, 150], [0, 210, 110], [0, 0, 1]])
    ros1 = {**{name: INFO[name] for name in ("width", "height", "distortion_model")}, "K": K, "D": []}
    np.testing.assert_array_equal(images.lens(ros1, False).matrix, CAMERA.matrix)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"k": [0.0] * 9}, "camera_matrix: is not"),
        ({"distortion_model": "odd"}, "distortion_model: unknown model odd"),
        ({"d": [0.0] * 3}, "distortion_coefficients: expected .* numbers"),
        ({"d": [np.inf] * 5}, "distortion_coefficients: expected .* numbers"),
        ({"width": 0}, "image_width: expected a number of pixels, found 0"),
    ],
)
def test_a_camera_info_that_says_nothing(changes, why):
    with pytest.raises(ValueError, match=f"^camera_info: {why}.*; calibrate the camera with its driver$"):
        images.lens({**INFO, **changes}, False)


def test_a_graph_without_a_detector(ros_domain):
    """A camera's node on a real graph, raw and compressed; the preset has the mount."""
    from tfg_drake.hardware.ros.ros2 import Ros2Graph

    preset = dataclasses.replace(load_preset("emulated"), camera=Camera(x=0.1, tag_size=0.16))
    compressed = {"format": "png", "data": cv2.imencode(".png", SEEN)[1].tobytes()}
    sent = {
        Topic("/eye/image_raw", "sensor_msgs/msg/Image"): image(SEEN[..., None], "mono8"),
        Topic("/eye/image_raw/compressed", "sensor_msgs/msg/CompressedImage"): compressed,
        Topic("/eye/camera_info", "sensor_msgs/msg/CameraInfo"): {**INFO, "d": [0.0] * 5, "p": [0.0] * 12},
    }
    graph, stop = Ros2Graph("camera", "localhost"), threading.Event()
    publish = [(graph.publisher(topic), message) for topic, message in sent.items()]

    def run():
        while not stop.wait(0.1):
            now = time.time()
            header = {"stamp": {"sec": int(now), "nanosec": int(1e9 * (now % 1.0))}, "frame_id": "eye"}
            for say, message in publish:
                say({"header": header, **message})
            graph.spin(0.01)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        for topic in ("/eye/image_raw", "/eye/image_raw/compressed"):
            driver = SensorDriver(Ros2Graph("listener", "localhost"), preset, (("tags", topic),))
            seen, end = driver.take(), time.monotonic() + 60.0
            while not seen and time.monotonic() < end:
                driver.spin(0.05)
                seen = driver.take()
            driver.close()
            assert seen[-1].ids.tolist() == [7]
            assert seen[-1].range[0] == pytest.approx(np.hypot(1.6, 0.3), abs=0.02)
            assert seen[-1].bearing[0] == pytest.approx(np.arctan2(0.3, 1.6), abs=0.005)
            assert driver.remarks() == []
    finally:
        stop.set()
        thread.join()
        graph.close()

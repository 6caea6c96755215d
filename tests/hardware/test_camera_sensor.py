"""A camera as a source of tags: files, a folder, a stream that stops and comes back, and what is told of each."""

import threading
import time

import numpy as np
import pytest

from tests.cameras import pinhole
from tests.vision.rendering import cv2, render
from tfg_drake.config import RobotCameraConfig
from tfg_drake.hardware import camera_sensor, sensor_reader
from tfg_drake.hardware.camera_sensor import CameraDriver, known_view
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.mjpeg_stream import MjpegStream
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.sensor_source import open_sources
from tfg_drake.messages import TagDetections
from tfg_drake.vision.calibration import save_calibration

CAMERA = pinhole(320, 240, 260.0)


def image(*tags):
    """Of tags, each (id, x to the right, distance), m."""
    return render([(tag, np.eye(3), np.array([x, 0.0, z]), 0.16) for tag, x, z in tags], CAMERA, noise=1.0)


# Two tags, and how far away and where they are.
SEEN = image((7, -0.3, 1.5), (9, 0.3, 1.2))
RANGES, BEARINGS = np.hypot([0.3, 0.3], [1.5, 1.2]), np.arctan2([0.3, -0.3], [1.5, 1.2])


@pytest.fixture
def camera(tmp_path):
    """The configuration of a calibrated camera."""
    save_calibration(tmp_path / "camera.yaml", CAMERA)
    return RobotCameraConfig(calibration=str(tmp_path / "camera.yaml"))


@pytest.fixture
def stream():
    """What a test shows, twenty times a second, as pictures: a list whose last one counts."""
    stream, pictures, stop = MjpegStream(), [SEEN], threading.Event()

    def run():
        while not stop.wait(0.05):
            stream.show(pictures[-1])

    thread = threading.Thread(target=run)
    thread.start()
    stream.pictures = pictures
    yield stream
    stop.set()
    thread.join()
    stream.stop()


def until(condition, driver):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "in vain"
        driver.spin(0.05)


def next_of(driver):
    taken = []
    driver.take()
    until(lambda: taken.extend(driver.take()) or taken, driver)
    return taken[-1]


def is_right(detections):
    assert detections.ids.tolist() == [7, 9]
    np.testing.assert_allclose(detections.range, RANGES, atol=0.02)
    np.testing.assert_allclose(detections.bearing, BEARINGS, atol=0.005)
    assert 0.0 <= time.monotonic() - detections.stamp < 5.0


def folder(tmp_path):
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "1.png"), SEEN)
    (tmp_path / "images" / "notes.txt").write_text("no image")
    return tmp_path / "images"


def video(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "seen.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (320, 240))
    for _ in range(3):
        writer.write(np.dstack([SEEN] * 3))
    writer.release()
    return tmp_path / "seen.avi"


@pytest.mark.parametrize("recorded", [folder, video])
def test_a_recording_plays_as_if_it_came_now_and_begins_again(recorded, tmp_path, camera, monkeypatch):
    monkeypatch.setattr(sensor_reader, "BACK_OFF", 0.05)
    source = str(recorded(tmp_path))
    driver = CameraDriver(source, camera)
    is_right(next_of(driver))
    said = []
    until(lambda: said.extend(driver.remarks()) or len(said) > 1, driver)
    is_right(next_of(driver))
    driver.close()
    name = f"camera:{source}"
    assert said[:2] == [f"{name}: no more images; they begin again", f"{name}: connected again"]


def test_a_stream_in_a_process_of_its_own(stream, camera):
    hardware = type("Hardware", (), {"camera": camera})
    sources = open_sources({"tags": f"camera:{stream.url}"}, load_preset("turtlebot2"), None, hardware)
    source = sources["tags"]
    try:
        end = time.monotonic() + 60.0
        while source.newest(TagDetections) is None and time.monotonic() < end:
            time.sleep(0.02)
        is_right(source.newest(TagDetections))
    finally:
        source.close()
    assert source._process.returncode == 0


def test_a_stream_that_stops_and_comes_back(stream, camera, monkeypatch):
    monkeypatch.setattr(sensor_reader, "BACK_OFF", 0.05)
    driver, said = CameraDriver(stream.url, camera), []
    is_right(next_of(driver))
    stream.stop()
    until(lambda: said.extend(driver.remarks()) or said, driver)
    driver.take()
    stopped = time.monotonic()
    stream.start()
    until(lambda: said.extend(driver.remarks()) or len(said) > 1, driver)
    again = next_of(driver)
    driver.close()
    is_right(again)
    assert again.stamp > stopped
    name = f"camera:{stream.url}"
    assert said == [f"{name}: no more images: is it plugged in? It is looked for", f"{name}: connected again"]


def test_stamps_are_older_than_the_arrival_by_the_latency(stream, camera):
    camera.latency = 3.0
    driver = CameraDriver(stream.url, camera)
    before = time.monotonic()
    assert next_of(driver).stamp < before - 1.0
    driver.close()


def test_the_mount(stream, camera):
    camera.x, camera.y, camera.yaw = 0.1, -0.05, 0.4
    driver = CameraDriver(stream.url, camera)
    found = next_of(driver)
    driver.close()
    p = np.stack([RANGES * np.cos(BEARINGS + 0.4) + 0.1, RANGES * np.sin(BEARINGS + 0.4) - 0.05])
    np.testing.assert_allclose(found.range, np.hypot(*p), atol=0.02)
    np.testing.assert_allclose(found.bearing, np.arctan2(p[1], p[0]), atol=0.005)


def test_frames_of_a_camera_that_stands_tell_little_until_it_moves(stream, camera):
    driver = CameraDriver(stream.url, camera)
    (first, *_), again = driver.take(), next_of(driver)
    stream.pictures.append(image((7, -0.32, 1.5), (9, 0.28, 1.2)))
    taken = []
    until(lambda: taken.extend(driver.take()) or any(one.bearing[0] > BEARINGS[0] + 0.005 for one in taken), driver)
    driver.close()
    moved = next(one for one in taken if one.bearing[0] > BEARINGS[0] + 0.005)
    for name in ("sigma_range", "sigma_bearing"):
        sigma = [getattr(one, name) for one in (first, again, moved)]
        np.testing.assert_allclose(sigma[1], 20.0 * sigma[0], rtol=0.2)
        np.testing.assert_allclose(sigma[2], sigma[0], rtol=0.2)


GREY = np.full((240, 320), 128, dtype=np.uint8)


@pytest.mark.parametrize(
    ("picture", "line"),
    [
        (np.full((240, 320), 8, dtype=np.uint8), "images are dark; switch on a light, or take the cap off"),
        (np.full((240, 320), 250, dtype=np.uint8), "images are too bright; lower the exposure"),
        (GREY, "no tag of tag36h11 in sight for 0 s"),
        (
            image((7, -0.3, 1.5), (7, 0.3, 1.5)),
            "tag 7: 2 times in one image; all are left out, print each id once",
        ),
        ((200.0 + 0.1 * (SEEN - 128.0)).astype(np.uint8), "left out as hidden, blurred or far"),
        (cv2.GaussianBlur(SEEN, (0, 0), 3.0), "no tag of tag36h11 in sight for 0 s"),
    ],
    ids=["dark", "glare", "no tag", "two of an id", "veiled", "blurred"],
)
def test_what_is_told_once(picture, line, stream, camera, monkeypatch):
    monkeypatch.setattr(camera_sensor, "LASTS", 0.1)
    monkeypatch.setattr(camera_sensor, "WITHOUT_TAG", 0.1)
    driver, said = CameraDriver(stream.url, camera), []
    stream.pictures.append(picture)
    until(lambda: said.extend(driver.remarks()) or any(line in one for one in said), driver)
    seen = driver._device.take(1.0)
    assert seen is not None
    until(lambda: len(driver._looked) > 10, driver)
    said += driver.remarks()
    driver.close()
    assert sum(line in one for one in said) == 1
    assert all(one.startswith(f"camera:{stream.url}: ") for one in said)


def test_a_half_hidden_tag_costs_no_other(stream, camera):
    hidden = SEEN.copy()
    hidden[:, :108] = 128  # half of tag 7
    stream.pictures.append(hidden)
    driver, taken = CameraDriver(stream.url, camera), []
    until(lambda: taken.extend(driver.take()) or len(taken) > 3, driver)
    driver.close()
    assert taken[-1].ids.tolist() == [9]


def test_few_images_a_second_are_told_and_used(camera, monkeypatch):
    monkeypatch.setattr(camera_sensor, "COUNTED", 1.0)
    monkeypatch.setattr(camera_sensor, "LASTS", 0.1)
    stream = MjpegStream()
    stream.show(SEEN)
    driver, said, showing = CameraDriver(stream.url, camera), [], [time.monotonic()]

    def slowly():
        if time.monotonic() - showing[-1] > 0.35:
            showing.append(time.monotonic())
            stream.show(SEEN)
        said.extend(driver.remarks())
        return said

    until(slowly, driver)
    stream.show(SEEN)
    is_right(next_of(driver))
    driver.close()
    stream.stop()
    assert said[0].endswith(" images a second, fewer than 4: more light, smaller images or another cable may help")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (
            {"calibration": ""},
            "camera:{url}: has no calibration; make one with tfg-drake camera calibrate, and give --set "
            "hardware.camera.calibration=FILE",
        ),
        (
            {"calibration": "nowhere.yaml"},
            "camera:{url}: nowhere.yaml: cannot be read: No such file or directory; name a calibration's YAML file",
        ),
        ({"family": "tag99h1"}, "camera:{url}: tag99h1: unknown family of tags; known are tag36h11, tag16h5"),
    ],
)
def test_what_cannot_be_used(changes, line, stream, camera):
    for name, value in changes.items():
        setattr(camera, name, value)
    with pytest.raises(DeviceError) as error:
        CameraDriver(stream.url, camera)
    assert str(error.value) == line.format(url=stream.url)


def test_the_calibration_of_another_camera(stream, camera, tmp_path):
    save_calibration(tmp_path / "camera.yaml", pinhole(640, 480, 520.0))
    with pytest.raises(DeviceError) as error:
        CameraDriver(stream.url, camera)
    assert str(error.value) == (
        f"camera:{stream.url}: images of 320 x 240 pixels, the calibration is of 640 x 480; calibrate the camera as it "
        "is used"
    )


@pytest.mark.parametrize("source", ["/dev/video_none", "http://127.0.0.1:9/", "nowhere.avi"])
def test_a_camera_that_is_not_there(source, camera):
    with pytest.raises(
        DeviceError, match=rf"^camera:{source}: (cannot be opened; is it there, and free\?|no such file)"
    ):
        CameraDriver(source, camera)


def test_what_the_planner_is_told_of_the_camera(camera):
    view = known_view("camera:0", camera)
    assert view.field_of_view == pytest.approx(2.0 * np.arctan(159.5 / 260.0))
    assert view.range == pytest.approx(0.16 * 260.0 / 24.0)

"""A RealSense as a scanner: images of librealsense's own software device, recorded by its recorder and played by its
pipeline."""

import time

import numpy as np
import pytest

from tfg_drake.config import RobotScannerConfig
from tfg_drake.hardware import realsense_sensor
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.realsense_sensor import RealsenseDriver
from tfg_drake.io.extras import pip_install

# Its wheel needs the system's libusb.
rs = pytest.importorskip(
    "pyrealsense2",
    reason="pyrealsense2 or libusb-1.0 is not installed: pip install 'tfg-drake[realsense]', apt install libusb-1.0-0",
    exc_type=ImportError,
)

WIDTH, HEIGHT, FOCAL = 64, 48, 40.0
# A wall so far ahead, m, and a column of pixels without an answer.
WALL, SILENT = 2.0, 10


def sees():
    """The intrinsics."""
    sees = rs.intrinsics()
    sees.width, sees.height, sees.fx, sees.fy = WIDTH, HEIGHT, FOCAL, FOCAL
    sees.ppx, sees.ppy = 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
    sees.model, sees.coeffs = rs.distortion.none, [0.0] * 5
    return sees


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Thirty images of the wall in a second."""
    path = tmp_path_factory.mktemp("depth") / "wall.db3"
    device = rs.software_device()
    sensor = device.add_sensor("Depth")
    stream = rs.video_stream()
    stream.type, stream.fmt, stream.bpp, stream.fps = rs.stream.depth, rs.format.z16, 2, 30
    stream.width, stream.height, stream.intrinsics = WIDTH, HEIGHT, sees()
    profile = sensor.add_video_stream(stream).as_video_stream_profile()
    sensor.add_read_only_option(rs.option.depth_units, 0.001)
    depth = np.full((HEIGHT, WIDTH), round(1000.0 * WALL), dtype=np.uint16)
    depth[:, SILENT] = 0
    recorder = rs.recorder(str(path), device)
    recorded = recorder.query_sensors()[0]
    recorded.open(recorded.get_stream_profiles()[0])
    recorded.start(rs.syncer())
    for number in range(30):
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp, frame.profile = depth, 2 * WIDTH, 2, profile
        frame.timestamp, frame.domain, frame.frame_number = 33.3 * number, rs.timestamp_domain.system_time, number
        frame.depth_units = 0.001
        sensor.on_video_frame(frame)
        time.sleep(0.01)
    recorded.stop()
    recorded.close()
    return str(path)


def test_a_recording_gives_scans(recording):
    driver = RealsenseDriver(recording, RobotScannerConfig(x=0.1, z=0.3))
    (scan, *_) = driver.take()
    driver.close()
    assert len(scan.ranges) == WIDTH
    np.testing.assert_allclose((scan.ranges * np.cos(scan.angles))[:SILENT], WALL + 0.1, atol=1e-3)
    assert np.isnan(scan.ranges).sum() == 1
    # Columns go to the right, angles to the left; the lens is ahead of the body's origin.
    leftmost = np.arctan2(0.5 * (WIDTH - 1) / FOCAL * WALL, WALL + 0.1)
    np.testing.assert_allclose(scan.angles[[0, -1]], [-leftmost, leftmost], atol=1e-3)
    assert scan.range_max == realsense_sensor.MOST_DEPTH
    # The recording's own stamps are of another day.
    assert 0.0 <= time.monotonic() - scan.stamp < 60.0


def test_a_camera_upside_down_has_its_left_on_the_robots_right(recording):
    silent = []
    for flip in (False, True):
        driver = RealsenseDriver(recording, RobotScannerConfig(z=0.3, flip=flip))
        (scan, *_) = driver.take()
        driver.close()
        silent.append(scan.angles[np.isnan(scan.ranges)])
    assert silent[0] > 0.1
    np.testing.assert_allclose(silent[1], -silent[0])


def test_a_camera_that_falls_silent_is_opened_again(recording, monkeypatch):
    monkeypatch.setattr(realsense_sensor, "SILENT", 0.2)
    driver = RealsenseDriver(recording, RobotScannerConfig())
    said, end = [], time.monotonic() + 60.0
    while len(said) < 2 and time.monotonic() < end:
        driver.spin(0.05)
        said += driver.remarks()
    driver.take()
    while not driver.take() and time.monotonic() < end:
        driver.spin(0.05)
    driver.close()
    assert said == [
        f"realsense:{recording}: no more depth images: is the camera plugged in? It is looked for",
        f"realsense:{recording}: connected again",
    ]


def test_what_cannot_be_used(monkeypatch):
    with pytest.raises(DeviceError) as error:
        RealsenseDriver("no-such-serial", RobotScannerConfig())
    assert str(error.value) == (
        "realsense:no-such-serial: no such camera; plug one in, give its serial number or name a recording"
    )
    with pytest.raises(DeviceError, match=r"^realsense:: heights 0.5 to 0.1 m, .* must be increasing and above 0$"):
        RealsenseDriver("", RobotScannerConfig(low=0.5, high=0.1))
    monkeypatch.setitem(__import__("sys").modules, "pyrealsense2", None)
    with pytest.raises(DeviceError) as error:
        RealsenseDriver("", RobotScannerConfig())
    assert str(error.value) == f"realsense:: pyrealsense2 is not installed: {pip_install('realsense')}"

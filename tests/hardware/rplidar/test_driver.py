"""The RPLidar's driver against the emulated one on a pseudo-terminal."""

import math
import time

import numpy as np
import pytest

from tfg_drake.config import RobotScannerConfig
from tfg_drake.geometry.sweep import scan_of
from tfg_drake.hardware import sensor_reader
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.emulated_device import PseudoTerminal
from tfg_drake.hardware.emulation.rplidar_emulator import RplidarEmulator
from tfg_drake.hardware.rplidar import codec, driver
from tfg_drake.hardware.rplidar.driver import RplidarDriver
from tfg_drake.hardware.rplidar.sweeps import SIGMA

# A room, and a scanner that looks back.
WALLS = np.array([[-2.0, -1.0, 3.0, -1.0], [3.0, -1.0, 3.0, 2.0], [3.0, 2.0, -2.0, 2.0], [-2.0, 2.0, -2.0, -1.0]])
WALLS.setflags(write=False)
MOUNT = RobotScannerConfig(x=-0.05, y=0.02, yaw=math.pi)
X_BS = np.array([MOUNT.x, MOUNT.y, MOUNT.yaw])


def emulated(model=1):
    return RplidarEmulator(WALLS, lambda: np.zeros(3), X_BS, model=model)


@pytest.fixture
def lidar():
    with emulated() as lidar:
        yield lidar


@pytest.fixture
def opened(lidar):
    driver = RplidarDriver(lidar.device, MOUNT)
    yield driver
    driver.close()


def until(condition, driver):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "in vain"
        driver.spin(0.02)


def errors(sweep):
    """How far what was met is from the walls, m, and the scan."""
    scan = scan_of(sweep, np.zeros(2))
    x, y = scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)
    return np.minimum(np.minimum(abs(x + 2.0), abs(x - 3.0)), np.minimum(abs(y + 1.0), abs(y - 2.0))), scan


def exact_scan(driver):
    """The first scan of a whole turn that is what is there, to the resolution of the scanner's own bytes. Some may be
    less: where the driver has to wait for the machine, what does not fit into the line is lost."""
    scans = []

    def found():
        met = map(errors, driver.take())
        scans.extend(scan for off, scan in met if np.ptp(scan.angles) > 6.1 and off.max() < 0.002)
        return scans

    until(found, driver)
    return scans[0]


def test_a_scan_is_what_is_there(opened):
    """Wherever the scanner is mounted."""
    scan = exact_scan(opened)
    assert 300 < len(scan.ranges) < 420
    assert (scan.range_max, scan.sigma) == (12.0, SIGMA)
    assert scan.stamp < time.monotonic()


def test_the_motor_turns_while_it_is_read():
    """An A2's is told so; an A1's has a wire of its own."""
    with emulated(model=2) as lidar:
        opened = RplidarDriver(lidar.device, MOUNT)
        assert (lidar.duty, lidar.scanning) == (codec.DUTY, True)
        opened.close()
        end = time.monotonic() + 60.0
        while (lidar.duty or lidar.scanning) and time.monotonic() < end:
            time.sleep(0.01)
        assert (lidar.duty, lidar.scanning) == (0, False)


def test_lost_bytes_are_told_once(opened, lidar):
    lidar.lost = 0.002
    said = []
    until(lambda: said.extend(opened.remarks()) or said, opened)
    lost = opened._decoder.lost
    until(lambda: opened._decoder.lost > lost, opened)
    said += opened.remarks()
    assert said == [f"rplidar:{lidar.device}: bytes are lost on the way; the other rays are used, check the cable"]


def test_a_scanner_unplugged_and_back(opened, lidar, monkeypatch):
    monkeypatch.setattr(sensor_reader, "LONGEST_BACK_OFF", 0.2)
    name, said = f"rplidar:{lidar.device}", []
    lidar.unplug()
    until(lambda: said.extend(opened.remarks()) or said, opened)
    opened.take()
    lidar.plug()
    until(lambda: said.extend(opened.remarks()) or len(said) > 1, opened)
    assert said == [
        f"{name}: the connection is lost; plug the scanner in again, it is looked for",
        f"{name}: connected again",
    ]
    exact_scan(opened)


def test_a_scanner_that_falls_silent_is_started_again(opened, lidar, monkeypatch):
    monkeypatch.setattr(driver, "SILENT", 0.2)
    lidar.stuck = True
    said = []
    until(lambda: said.extend(opened.remarks()) or said, opened)
    lidar.stuck = False
    until(lambda: said.extend(opened.remarks()) or len(said) > 1, opened)
    name = f"rplidar:{lidar.device}"
    assert said[:2] == [f"{name}: says nothing for 0 s: does it turn? It is started again", f"{name}: connected again"]
    exact_scan(opened)


def test_a_scanner_that_stopped_itself(lidar, monkeypatch):
    monkeypatch.setattr(driver, "RESET_WITHIN", 0.1)
    lidar.health = "hung"
    opened = RplidarDriver(lidar.device, MOUNT)  # a reset mends it
    opened.close()
    lidar.health = "failed"
    with pytest.raises(DeviceError) as error:
        RplidarDriver(lidar.device, MOUNT)
    assert str(error.value) == (
        f"rplidar:{lidar.device}: the scanner says error 1 of its health; unplug it, and see that it turns freely"
    )


def test_what_is_no_rplidar(tmp_path, monkeypatch):
    monkeypatch.setattr(driver, "ANSWER_WITHIN", 0.05)
    line = PseudoTerminal(tmp_path / "other")
    with pytest.raises(DeviceError) as error:
        RplidarDriver(str(tmp_path / "other"), MOUNT)
    line.close()
    assert str(error.value) == (
        f"rplidar:{tmp_path}/other: no RPLidar answers at 115200 or 256000 baud; name the scanner's port"
    )
    with pytest.raises(DeviceError) as error:
        RplidarDriver(str(tmp_path / "none"), MOUNT)
    assert str(error.value).startswith(f"{tmp_path}/none: no such device; plug the scanner in")

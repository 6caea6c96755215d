"""The emulated TurtleBot's messages when its sensors are at fault."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.hardware.emulation.emulated_turtlebot import SENSE_EVERY
from tfg_drake.hardware.emulation.sensor_faults import sensor_fault


@pytest.fixture(scope="module")
def robot():
    return runpy.run_path(str(Path(__file__).parents[1] / "ros" / "emulated.py"))["make_robot"]()


@pytest.fixture
def said(robot):
    """The messages of one scan with a fault of a sensor."""

    def say(sensor, name, *numbers):
        robot.faults = {sensor: sensor_fault(sensor, name, numbers)} if name else {}
        messages = {}
        for _ in range(SENSE_EVERY):
            messages |= robot.step()
        return messages

    return say


@pytest.mark.parametrize(("name", "value"), [("nan", np.nan), ("empty", np.inf), ("zero", 0.0), ("near", -np.inf)])
def test_scans_that_say_nothing(said, name, value):
    np.testing.assert_array_equal(said("scan", name)["scan"]["ranges"], np.full(361, value))


def test_a_thin_scan_has_its_rays_where_they_were(said):
    whole, thin = said("scan", "")["scan"], said("scan", "thin")["scan"]
    angles = [one["angle_min"] + one["angle_increment"] * np.arange(len(one["ranges"])) for one in (whole, thin)]
    np.testing.assert_allclose(angles[1], angles[0][::100])
    assert thin["ranges"] == whole["ranges"][::100]
    assert said("scan", "none")["scan"]["ranges"] == []


def test_silence(said):
    assert set(said("scan", "silent")) == {"odometry", "tf", "detections"}
    assert set(said("tags", "silent")) == {"odometry", "tf", "scan"}


@pytest.mark.parametrize(("name", "number"), [("id", 2.0**56), ("range", np.inf)])
def test_a_tag_that_cannot_be(said, name, number):
    cloud = said("tags", name, number)["detections"]
    kinds = {6: "<u4", 8: "<f8"}
    layout = np.dtype([(one["name"], kinds[one["datatype"]]) for one in cloud["fields"]])
    assert layout.itemsize == cloud["point_step"]
    points = np.frombuffer(cloud["data"], layout)
    assert len(points) > 1
    assert points[name][0] == number
    assert (points[name][1:] < 1000).all()

"""What an emulated robot's sensors say when something is wrong with them."""

import numpy as np
import pytest

from tfg_drake.hardware.emulation.sensor_faults import FAULTS, sensor_fault, unchanged
from tfg_drake.messages import LaserScan, TagDetections

NAN, INF = np.nan, np.inf


def scan(stamp=1.0):
    """400 rays of growing length; the last meets nothing."""
    ranges = np.linspace(0.1, 2.0, 400)
    ranges[-1] = INF
    return LaserScan(stamp, np.linspace(-1.0, 1.0, 400), ranges, 10.0, 0.015)


def tags(stamp=1.0):
    ids = np.array([7, 8])
    return TagDetections(stamp, ids, np.array([1.0, 2.0]), np.array([0.1, -0.1]), np.full(2, 0.03), np.full(2, 0.01))


@pytest.mark.parametrize(("name", "value"), [("nan", NAN), ("empty", INF), ("zero", 0.0), ("near", -INF)])
def test_a_scan_that_says_the_same_of_every_ray(name, value):
    said = sensor_fault("scan", name)(scan())
    np.testing.assert_array_equal(said.ranges, np.full(400, value))
    assert said.stamp == 1.0


def test_rays_that_are_not_there():
    assert len(sensor_fault("scan", "none")(scan()).ranges) == 0
    thin = sensor_fault("scan", "thin")(scan())
    np.testing.assert_array_equal(thin.ranges, scan().ranges[[0, 100, 200, 300]])
    np.testing.assert_array_equal(thin.angles, scan().angles[[0, 100, 200, 300]])


def test_rays_that_say_nothing():
    drop = sensor_fault("scan", "drop", [0.2])
    first, second = (np.isnan(drop(scan()).ranges) for _ in range(2))
    assert 40 < first.sum() < 120
    assert (first != second).any()
    blind = sensor_fault("scan", "blind", [0.45])(scan()).ranges
    np.testing.assert_array_equal(np.isnan(blind), scan().ranges < 0.45)
    assert blind[-1] == INF


def test_a_frozen_scan_has_new_stamps():
    frozen = sensor_fault("scan", "frozen")
    first = frozen(scan(1.0))
    second = frozen(LaserScan(2.0, np.zeros(1), np.ones(1), 10.0, 0.015))
    assert (first.stamp, second.stamp) == (1.0, 2.0)
    np.testing.assert_array_equal(second.ranges, scan().ranges)


def test_nonsense_that_is_finite():
    assert sensor_fault("scan", "range_max", [1e300])(scan()).range_max == 1e300
    assert sensor_fault("tags", "range", [1e200])(tags()).range.tolist() == [1e200, 2.0]
    assert sensor_fault("tags", "id", [2.0**56])(tags()).ids.tolist() == [2**56, 8]
    certain = sensor_fault("tags", "sigma", [1e-200])(tags())
    assert certain.sigma_range.tolist() == certain.sigma_bearing.tolist() == [1e-200, 1e-200]
    chance = sensor_fault("tags", "random")
    assert (chance(tags()).ids != chance(tags()).ids).all()


@pytest.mark.parametrize("name", ["range", "id", "sigma"])
def test_no_tags_stay_none(name):
    none = TagDetections(1.0, np.zeros(0, dtype=int), *(np.zeros(0) for _ in range(4)))
    assert len(sensor_fault("tags", name, [3.0])(none).ids) == 0


@pytest.mark.parametrize("sensor", FAULTS)
def test_silence_and_health(sensor):
    assert sensor_fault(sensor, "silent")(scan()) is None
    message = scan()
    assert unchanged(message) is message


@pytest.mark.parametrize(
    ("sensor", "name", "numbers"),
    [
        ("scan", "loud", ()),
        ("scan", "drop", ()),
        ("scan", "drop", (2.0,)),
        ("scan", "nan", (1.0,)),
        ("gyro", "nan", ()),
    ],
)
def test_what_it_does_not_know(sensor, name, numbers):
    with pytest.raises(ValueError, match="no "):
        sensor_fault(sensor, name, numbers)

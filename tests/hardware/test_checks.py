"""Checks before the wheels may be enabled: each fault by its name and with its mend."""

import dataclasses
import time

import numpy as np
import pytest

from tests.hardware.fake_robot import base_state
from tests.integration.robot_explorer import wait_until
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.checks import Heard, check, judged, refuse, tag_factors
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.emulator import Emulator
from tfg_drake.hardware.robot_devices import open_devices
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections, replace

ANGLES = np.linspace(-1.0, 1.0, 201)
SCAN = LaserScan(0.0, ANGLES, np.where(ANGLES < 0.5, 2.0, np.nan), 10.0, 0.01)
NEW = np.full(3, 0.01)
TAGS = TagDetections(0.0, np.array([4, 7, 9]), np.array([2.02, 1.98, 5.0]), np.array([-0.5, 0.2, 0.7]), NEW, NEW)


def scan_with(farther):
    """SCAN with ranges that are farther, m: those of a scanner are never the same twice."""
    return replace(SCAN, ranges=SCAN.ranges + farther)


def one_in(number):
    """Every so manieth ray meets something."""
    return replace(SCAN, ranges=np.where(np.arange(201) % number, np.inf, 2.0))


def frames(ids_of):
    """20 frames of three tags, by the number of the frame."""
    return {TagDetections: Heard([replace(TAGS, ids=np.array(ids_of(k))) for k in range(20)], 0.1)}


def is_late(source):
    """Whether a scan that is 0.7 s old arrives: those sent before the fault may still be on their way."""
    now = time.monotonic()
    return any(now - one.stamp > 0.7 for one in source.take(LaserScan, now))


WELL = {
    Odometry: Heard([Odometry(0.0, np.zeros(3), np.zeros(2), True)] * 40, 0.01),
    Hazards: Heard([Hazards(0.0, 0, 0, 0)] * 40, 0.01),
    LaserScan: Heard([scan_with(1e-5 * k) for k in range(20)], 0.05),
    TagDetections: Heard([TAGS] * 20, 0.1),
}


def failed(changes=(), state=None, on_ros=False):
    """The checks that fail, as they are told, without spaces that align them."""
    checks = judged(WELL | dict(changes), state or base_state(0.0), on_ros=on_ros)
    return [" ".join(str(one).split()) for one in checks if one.mend]


def test_where_all_is_well_it_is_told_what_there_is():
    checks = judged(WELL, base_state(0.0), on_ros=False)
    refuse(checks)
    assert [" ".join(str(one).split()) for one in checks] == [
        "battery 13.8 V",
        "bumper, cliff answer, none is pressed",
        "odometry 20 a second, 0.01 s old",
        "scan 10 a second, 0.05 s old",
        "rays 150 of 201 meet something",
        "tags 10 a second, 0.10 s old",
        "tag ids 3",
        "tag size ranges of 2 tags are 1.00 times the scan's",
    ]


def tags_times(factor):
    return {TagDetections: Heard([replace(TAGS, range=factor * TAGS.range)] * 20, 0.1)}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({Hazards: Heard()}, "bumper, cliff the base says nothing of them FAILS: see the base's driver"),
        ({Hazards: Heard([Hazards(0.0, 2, 0, 4)])}, "bumper centre, wheel drop left FAILS: see what presses it"),
        ({LaserScan: Heard()}, "scan none in 2 s FAILS: see the scanner's driver, and whether its clock is this com"),
        ({LaserScan: Heard([SCAN], 0.7)}, "0.70 s old FAILS: its clock is behind this computer's, or it is slow: see"),
        ({TagDetections: Heard([TAGS], 1.2)}, "1.20 s old FAILS: its clock is behind this computer's"),
        ({LaserScan: Heard([replace(SCAN, ranges=np.full(201, np.nan))], 0.0)}, "rays 0 of 201 meet something FAILS: "),
        ({LaserScan: Heard([one_in(11)], 0.0)}, "rays 19 of 201 meet something FAILS: see whether something covers"),
        ({LaserScan: Heard([replace(SCAN, angles=ANGLES[::70], ranges=SCAN.ranges[::70])], 0.0)}, "rays 3 of 3 meet"),
        ({LaserScan: Heard([SCAN] * 5, 0.0)}, "rays 150 of 201 meet something FAILS: all scans are the same to the"),
        (frames(lambda k: [3 * k, 3 * k + 1, 3 * k + 2]), "tag ids 60 FAILS: 60 of 60 tags are in one frame of 20 "),
        (frames(lambda k: [4, 7, 100 + k]), "tag ids 22 FAILS: 20 of 22 tags are in one frame of 20 alone"),
        (tags_times(2.0), "are 2.00 times the scan's FAILS: are the tags 0.5 times as large as was said, or is the"),
        (tags_times(0.5), "are 0.50 times the scan's FAILS: are the tags 2 times as large as was said"),
    ],
)
def test_a_fault_is_told_with_its_mend(changes, told):
    lines = failed(changes)
    assert any(told in line for line in lines), lines
    with pytest.raises(DeviceError, match=r"checks that failed: .*; mend that, or leave all out by --skip-checks"):
        refuse(judged(WELL | changes, None, on_ros=False))


def test_what_a_scanner_and_a_detector_may_do():
    """Few scans may be the same, a tag at the edge of what is seen come once; most rays may meet nothing."""
    assert failed({LaserScan: Heard([SCAN] * 4, 0.0)}) == []
    assert failed({LaserScan: Heard([one_in(10)], 0.0)}) == []
    assert failed(frames(lambda k: [4, 7, 100 + k if k < 14 else 9])) == []
    assert failed(frames(lambda k: [k // 2, 40, 41])) == []


def test_a_robot_without_a_source_of_tags_lacks_none():
    heard = {kind: said for kind, said in WELL.items() if kind is not TagDetections}
    checks = judged(heard, base_state(0.0), on_ros=False)
    refuse(checks)
    assert " ".join(str(checks[-1]).split()) == "tags no source of them: walls are the landmarks"


def test_the_battery_and_what_it_hangs_on():
    assert failed(state=base_state(0.0, battery=13.4, battery_level="low")) == ["battery 13.4 V FAILS: charge it"]
    assert failed(state=base_state(0.0, charger="dock")) == ["battery 13.8 V FAILS: take the robot off its dock"]
    assert failed({Hazards: Heard()}, on_ros=True) == []


def test_one_tag_that_stands_apart_from_what_the_scan_meets_is_no_other_size():
    far = TagDetections(0.0, TAGS.ids[:1], np.array([4.0]), TAGS.bearing[:1], NEW[:1], NEW[:1])
    assert failed({TagDetections: Heard([far] * 20, 0.1)}) == []
    assert failed({TagDetections: Heard([replace(TAGS, range=np.array([4.0, 2.0, 2.0]))] * 20, 0.1)}) == []
    np.testing.assert_allclose(tag_factors(SCAN, [far, TAGS]), [0.5 * (2.0 + 1.01), 0.99])
    assert not len(tag_factors(SCAN, []))


def test_an_emulated_robot_is_well_until_something_is_wrong_with_it():
    with Emulator(MakeWorld(LoadScenario("house").world)) as emulator:
        source = "socket:{}:{}".format(*emulator.sensors)
        scenario = LoadScenario("house")
        config = dataclasses.replace(scenario.hardware, port=emulator.device, tags=source, scan=source)
        devices = open_devices(config, scenario.robot)
        try:
            refuse(check(devices))
            emulator.base.faults = {
                "scan": lambda scan: replace(scan, stamp=scan.stamp - 0.7),
                "tags": lambda tags: replace(tags, range=3.0 * tags.range),
            }
            emulator.base.cliff = 2
            wait_until(lambda: is_late(devices.scan), "no scan of the slow clock arrives")
            told = "\n".join(str(one) for one in check(devices) if one.mend)
        finally:
            devices.close()
    assert "its clock is behind this computer's" in told
    assert "times as large as was said" in told
    assert "cliff centre" in told

"""`explore --robot` against an emulated robot in real time, from the first connection to the wheels' last stop."""

import json
import time

import numpy as np
import pytest

from tests.integration.robot_explorer import Explorer, moves, stands
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.geometry.se2 import compose
from tfg_drake.hardware.emulation.emulator import Emulator
from tfg_drake.messages import replace
from tfg_drake.storage.trajectory import read_tum

WORLD = MakeWorld(LoadScenario("house").world)


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    """A robot with a scanner alone: enabled, stopped, enabled anew, paused, resumed, and ended when it has mapped."""
    folder = tmp_path_factory.mktemp("run")
    marks = {}
    with Emulator(WORLD) as emulator:
        explorer = Explorer(emulator, folder, 300.0, tags=False)

        def press(name, key, after):
            time.sleep(after)
            marks[name] = time.monotonic(), emulator.base.pose
            explorer.press(key)

        explorer.wait_for("no source of them: walls are the landmarks")
        explorer.wait_for("nothing moves before it is enabled")
        marks["start"] = emulator.base.pose
        press("enabled", "e", 0.5)
        moves(emulator, marks["enabled"][0])
        press("stopped", " ", 2.0)
        marks["stood"] = stands(emulator, marks["stopped"][0])
        press("again", "e", 1.0)
        moves(emulator, marks["again"][0])
        press("paused", "p", 1.5)
        marks["stood again"] = stands(emulator, marks["paused"][0])
        press("resumed", "p", 1.0)
        moves(emulator, marks["resumed"][0])
        explorer.wait_for(" walls ", goes_on=True)
        press("ended", "q", 1.0)
        explorer.wait_for("walls  ")
        explorer.wait_for("files")
        assert explorer.process.wait(60.0) == 130  # as Ctrl-C ends it
        time.sleep(0.3)
        marks["end"] = emulator.commands[-1]
        marks["commands"] = [(when, (one.speed, one.radius)) for when, one in emulator.commands]
        marks["pose"] = emulator.base.pose
    return folder, marks, explorer.lines


@pytest.mark.slow
def test_it_turns_only_while_it_may(mission):
    _, marks, lines = mission
    np.testing.assert_allclose(marks["enabled"][1], marks["start"])
    moving = [when for when, (speed, _) in marks["commands"] if speed]
    intervals = [(marks["enabled"][0], marks["stood"]), (marks["again"][0], marks["stood again"])]
    intervals.append((marks["resumed"][0], np.inf))
    # Within 0.6 s and 0.8 s; the rest is for a loaded machine.
    assert marks["stood"] - marks["stopped"][0] < 5.0
    assert marks["stood again"] - marks["paused"][0] < 5.0
    assert all(any(a <= when <= b for a, b in intervals) for when in moving)
    assert all(any(a <= when <= b for when in moving) for a, b in intervals)
    told = [line.partition(": ")[2] for line in lines if line.endswith((": enable", ": stop"))]
    # A busy machine may have it enabled once more.
    assert (told[:3], set(told[3:]) <= {"enable"}) == (["enable", "stop", "enable"], True)


def test_it_maps_walls(mission):
    folder, _, lines = mission
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["outcome"] == "interrupted"
    assert summary["landmark_rmse_m"] is None
    assert summary["contacts"] is None
    assert summary["walls_mapped"] > summary["landmarks_mapped"] == 0
    assert LoadScenario(folder / "scenario.yaml").explorer.landmarks == "walls"
    assert not any(line.startswith("tags  ") for line in lines[-20:])


def test_the_estimate_is_where_the_robot_is(mission):
    folder, marks, _ = mission
    _, X_MB = read_tum(folder / "trajectory.tum")
    X_WB = compose(WORLD.start, X_MB[-1])
    # The last estimate is of a moment before the wheels stood, on a busy machine of half a second before.
    np.testing.assert_allclose(X_WB[:2], marks["pose"][:2], atol=0.3)
    assert abs(np.angle(np.exp(1j * (X_WB[2] - marks["pose"][2])))) < 0.8


def _drives(emulator, explorer):
    """Enables the base half a second after it was told that it needs that; it moves then."""
    explorer.wait_for("nothing moves before it is enabled")
    begin = time.monotonic()
    time.sleep(0.5)
    explorer.press("e")
    moves(emulator, begin)


@pytest.mark.slow
def test_the_operator_is_told_and_a_low_battery_ends_the_mission(tmp_path):
    with Emulator(WORLD) as emulator:
        explorer = Explorer(emulator, tmp_path, 300.0)
        _drives(emulator, explorer)
        emulator.base.bumper = 4
        explorer.wait_for("bumper left: the robot backs away and looks for another way", goes_on=True)
        emulator.base.bumper = 0
        emulator.base.wheel_drop = 2
        explorer.wait_for("the base stands until it is enabled anew: a wheel hangs", goes_on=True)
        emulator.base.wheel_drop = 0
        over = stands(emulator, time.monotonic())
        time.sleep(1.0)
        assert not any(when > over and one.speed for when, one in list(emulator.commands))
        explorer.press("e")
        moves(emulator, over)
        emulator.base.battery = 138
        explorer.wait_for("the battery is low, 13.8 V", goes_on=True)
        explorer.wait_for("files", goes_on=True)
        assert explorer.process.wait(60.0) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["outcome"] == "budget"
    assert summary["reason"] == "The robot was called back before all was explored."
    log = (tmp_path / "log.txt").read_text()
    told = ("bumper left", "wheel drop left", "the battery is low", ": recall\n")
    assert [log.count(words) for words in told] == [1, 1, 1, 1]


@pytest.mark.slow
def test_a_robot_with_a_scanner_alone_explores_the_house(tmp_path):
    with Emulator(WORLD) as emulator:
        explorer = Explorer(emulator, tmp_path, 1200.0, tags=False)
        _drives(emulator, explorer)
        explorer.wait_for("files", goes_on=True)
        assert explorer.process.wait(60.0) == 0
        assert emulator.report()["contacts"] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "complete"


def test_its_last_word_to_the_wheels_is_a_stop(mission):
    _, marks, _ = mission
    assert marks["end"][1].speed == 0


def _mirrored(scan):
    return replace(scan, angles=-scan.angles[::-1], ranges=scan.ranges[::-1])


@pytest.mark.slow
def test_a_mirrored_scan_stops_it_until_it_is_enabled_anew_and_an_empty_battery_ends_it(tmp_path):
    with Emulator(WORLD) as emulator:
        emulator.base.faults = {"scan": _mirrored}
        explorer = Explorer(emulator, tmp_path, 300.0)
        explorer.wait_for("answer, none is pressed")
        _drives(emulator, explorer)
        explorer.wait_for("the base stands until it is enabled anew: scans turn against the odometry")
        over = stands(emulator, time.monotonic())
        explorer.press("e")
        moves(emulator, over)
        emulator.base.battery = 130
        explorer.wait_for("the battery is nearly empty, 13.0 V", goes_on=True)
        explorer.wait_for("files")
        assert explorer.process.wait(60.0) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["outcome"] == "battery"
    assert summary["reason"].startswith("The battery is nearly empty, 13.0 V: the robot stands at (")
    assert sum("enabled anew: scans turn against" in line for line in explorer.lines) == 1


@pytest.mark.slow
def test_what_is_checked_can_be_left_out_and_that_is_told(tmp_path):
    with Emulator(WORLD) as emulator:
        emulator.base.faults, emulator.base.bumper = {"scan": _mirrored}, 4
        refused = Explorer(emulator, tmp_path / "refused", 300.0)
        refused.wait_for("bumper left  FAILS: see what presses it")
        refused.wait_for("tfg-drake: checks that failed: bumper, cliff; mend that, or leave all out by --skip-checks")
        assert refused.process.wait(60.0) == 2
        assert not any(one.speed for _, one in emulator.commands)
        emulator.base.bumper = 0
        # By one turn a busy machine has lost too many scans to say so.
        turns = ["--set", "explorer.first_turns=3"]
        explorer = Explorer(emulator, tmp_path / "run", 300.0, "--skip-checks", *turns)
        explorer.wait_for("--skip-checks: battery, sensors and clocks are not checked, nor is the first turn")
        _drives(emulator, explorer)
        # The estimator says so when the turn is over.
        explorer.wait_for("scans turn against the odometry", goes_on=True)
        explorer.press("q")
        explorer.wait_for("files")
    assert not any("enabled anew: scans turn against" in line for line in explorer.lines)

"""Drives through a room, made wrong as recordings are, and the recordings that users' were like."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.intake import believed
from tfg_drake.datasets.recording import DatasetError, Recording, as_told
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.messages import Odometry, replace
from tfg_drake.simulation import laser_scanner

# A room of 7 x 5 m with a cupboard, a table and a bay.
ROOM = [(0, 0), (7, 0), (7, 5), (4, 5), (4, 6), (2.5, 6), (2.5, 5), (0, 5)]
CUPBOARD, TABLE = [(0, 1.2), (0.6, 1.2), (0.6, 2.1), (0, 2.1)], [(5.4, 2), (6.3, 2.3), (6.1, 2.9), (5.2, 2.6)]
WALLS = np.array(
    [(*a, *b) for ring in (ROOM, CUPBOARD, TABLE) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)]
)
SCANNER = ScanConfig(field_of_view=math.radians(270), resolution=math.radians(1.0), noise=0.01)
STEP = 0.05


@functools.cache
def drive(seed=0, seconds=30.0):
    """Round the middle of the room on a way that bends to and fro, for two s at rest first; odometry 1 % wrong."""
    rng = np.random.default_rng(seed)
    X_WB, X_OB, way, scans = np.array([3.5, 0.8, 0.2]), np.zeros(3), [], []
    angles = laser_scanner.ray_angles(SCANNER)
    for k in range(round(seconds / STEP)):
        t = STEP * k
        V = np.array([0.4, 0.3 + 0.3 * math.sin(0.7 * t)]) if t > 2.0 else np.zeros(2)
        turn = V[1] * STEP
        if k:
            X_WB = se2.compose(X_WB, np.array([V[0] * STEP, 0.0, turn]))
            X_OB = se2.compose(X_OB, np.array([1.01 * V[0] * STEP, 0.0, 1.005 * turn]))
        way.append(Odometry(t, X_OB, V * [1.01, 1.005], at_rest=not V.any()))
        if k % 3 == 1:
            scans.append(laser_scanner.scan(WALLS, X_WB, t, angles, rng.standard_normal(len(angles)), SCANNER))
    return Recording(
        name="drive",
        odometry=tuple(way),
        detections=(),
        model=OdometryConfig(),
        truth=None,
        scans=tuple(scans),
        odometry_arrivals=np.array([one.stamp for one in way]) + 1e-3,
        scan_arrivals=np.array([one.stamp for one in scans]) + 0.04,
    )


def off(recording, good=None):
    """RMSE, m, of the odometry's positions to those of the good drive at the same times, after alignment."""
    true = (drive() if good is None else good).odometry
    stamps = [one.stamp for one in true]
    p = np.array([one.X_OB[:2] for one in recording.odometry])
    of_true = np.array([one.X_OB[:2] for one in true]).T
    q = np.column_stack([np.interp([one.stamp for one in recording.odometry], stamps, value) for value in of_true])
    return float(np.sqrt(np.mean(np.sum((se2.transform(align(q, p), p) - q) ** 2, axis=1))))


def told(recording):
    return [(one.kind, one.text.rpartition("; ")[2]) for one in recording.notes]


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 1), st.booleans())
def test_a_good_drive_is_believed_as_it_is(seed, recorded):
    good = drive(seed)
    nothing = np.empty(0)
    good = good if recorded else replace(good, odometry_arrivals=nothing, scan_arrivals=nothing)
    assert believed(good) is good


@pytest.mark.parametrize(
    ("name", "kind"),
    [("reset", "jump"), ("slip of 1 m", "jump"), ("slip of .2 m", "slip"), ("gap", "silence"), ("turn", "jump")],
)
def test_where_odometry_is_wrong_the_scans_tell_the_way(name, kind):
    good, at = drive(), 300
    way = list(good.odometry)
    here = way[at].X_OB
    step = {"slip of 1 m": (1.0, 0.0, 0.0), "slip of .2 m": (0.2, 0.0, 0.0), "turn": (0.0, 0.0, 2.0)}.get(name)
    step = {"reset": se2.inverse(here), "gap": np.zeros(3)}.get(name, step)
    X = se2.compose(se2.compose(here, np.array(step)), se2.inverse(here))
    way[at:] = [replace(one, X_OB=se2.compose(X, one.X_OB)) for one in way[at:]]
    arrivals = good.odometry_arrivals
    if name == "gap":
        way, arrivals = way[:at] + way[at + 80 :], np.delete(arrivals, slice(at, at + 80))
    wrong = replace(good, odometry=tuple(way), odometry_arrivals=arrivals)
    result = believed(wrong)
    assert told(result) == [(kind, "the scans tell the way there")]
    assert off(result) < 0.02 < off(wrong) or name == "gap"
    assert off(result) < 0.02
    assert not any(one.breaks for one in result.odometry)
    stamps = [one.stamp for one in result.odometry]
    assert stamps == sorted(set(stamps))
    assert result.scans == good.scans
    # What came of it is believed.
    assert believed(result) is result


def test_a_way_that_scans_do_not_tell_is_unknown():
    good, at = drive(), 300
    blind = replace(good.scans[0], ranges=np.full_like(good.scans[0].ranges, np.inf))
    scans = [replace(blind, stamp=one.stamp) if 14.0 < one.stamp < 19.0 else one for one in good.scans]
    wrong = replace(
        good,
        odometry=good.odometry[:at] + good.odometry[at + 60 :],
        odometry_arrivals=np.delete(good.odometry_arrivals, slice(at, at + 60)),
        scans=tuple(scans),
    )
    result = believed(wrong)
    assert told(result) == [("silence", "the way is unknown there")]
    assert [
        one.stamp
        for one, before in zip(result.odometry[1:], result.odometry, strict=False)
        if one.breaks > before.breaks
    ] == [good.odometry[at + 60].stamp]
    # Nobody knows where these were taken.
    begin, end = good.odometry[at - 1].stamp, good.odometry[at + 60].stamp
    assert result.scans == tuple(one for one in scans if not begin < one.stamp < end)


@pytest.mark.parametrize("lost", [0, 3])
def test_frozen_scans_are_left_out(lost):
    good = drive()
    ranges = good.scans[60].ranges.copy()
    ranges[:lost] = np.nan
    frozen = replace(good.scans[60], ranges=ranges)
    scans = [replace(frozen, stamp=one.stamp) if 60 <= k < 80 else one for k, one in enumerate(good.scans)]
    result = believed(replace(good, scans=tuple(scans)))
    assert [(one.kind, one.time_s) for one in result.notes] == [("frozen", good.scans[60].stamp)]
    assert result.scans == tuple(scans[:61] + scans[80:])
    assert result.odometry == good.odometry
    # A robot that stands may see the same for long.
    scans = [replace(good.scans[0], stamp=one.stamp) if one.stamp < 2.0 else one for one in good.scans]
    assert believed(wrong := replace(good, scans=tuple(scans))) is wrong


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("jump", [-7.0, 5000.0])
def test_a_clock_that_is_set_goes_on(jump, recorded):
    good, at = drive(), 15.0
    wrong = replace(
        good,
        odometry=tuple(replace(one, stamp=one.stamp + jump * (one.stamp > at)) for one in good.odometry),
        scans=tuple(replace(one, stamp=one.stamp + jump * (one.stamp > at)) for one in good.scans),
        odometry_arrivals=good.odometry_arrivals[: None if recorded else 0],
        scan_arrivals=good.scan_arrivals[: None if recorded else 0],
    )
    result = believed(wrong)
    assert {one.kind for one in result.notes} == {"clock"}
    for name in ("odometry", "scans"):
        times = [[one.stamp for one in getattr(of, name)] for of in (result, good)]
        np.testing.assert_allclose(*times, atol=0.011)
    assert off(result) < 0.01


def test_messages_that_are_late_or_there_twice():
    good = drive()
    order = [*range(100), 101, 102, 100, 102, *range(103, len(good.odometry))]
    wrong = replace(
        good,
        odometry=tuple(good.odometry[k] for k in order),
        odometry_arrivals=good.odometry_arrivals[[0, *range(len(order) - 1)]],
        scans=(*good.scans[:50], *good.scans[49:]),
        scan_arrivals=good.scan_arrivals[[0, *range(len(good.scans))]],
    )
    result = believed(wrong)
    assert (result.odometry, result.scans) == (good.odometry, good.scans)
    assert result.notes == ()


def test_what_is_wrong_all_along_is_corrected_or_refused():
    good = drive()
    bound = {"odometry_arrivals": np.empty(0), "scan_arrivals": np.empty(0)}
    # Cm for m: most steps are those of no robot. Its twist is right.
    far = replace(good, odometry=tuple(replace(one, X_OB=one.X_OB * [100, 100, 1]) for one in good.odometry), **bound)
    with pytest.raises(
        DatasetError, match=r"^drive: scans travel 0\.0\d+ times as far as the odometry: see its unit, m"
    ):
        believed(far)
    fast = replace(good, odometry=tuple(replace(one, X_OB=one.X_OB * [5, 5, 1]) for one in good.odometry), **bound)
    result = believed(fast)
    assert told(result) == [("travel_scale", "the map is corrected for it")]
    assert off(result) < 0.03
    with pytest.raises(DatasetError, match="two clocks"):
        believed(replace(good, scans=tuple(replace(one, stamp=one.stamp - 1e9) for one in good.scans), **bound))
    with pytest.raises(DatasetError, match=r"^drive: odometry jumps \d+ times, first at 2\.05 s; see its units"):
        believed(replace(far, scans=()))


@pytest.mark.parametrize(
    ("name", "kinds", "text"),
    [
        ("A-twist-zero/twist_zero", [], ""),
        ("B-odom-reset/odom_reset", ["jump"], "the scans tell the way there"),
        ("E-clock-back/clock_back", ["clock", "clock"], "time goes on"),
        ("T-slip-gap/slip", ["jump"], "the scans tell the way there"),
        ("T-slip-gap/odom_gap", ["silence"], "the scans tell the way there"),
    ],
)
def test_recordings_as_users_had_them(name, kinds, text, shared_data):
    bag = pytest.importorskip("tfg_drake.hardware.ros.bag")
    folder = shared_data("recordings")
    result = believed(bag.load_bag(folder / f"{name}.mcap"))
    assert [one.kind for one in result.notes] == kinds
    assert all(one.text.endswith(text) for one in result.notes)
    # Odometry itself is wrong by 1 % of the way, scans are not.
    assert off(result, bag.load_bag(folder / "0-good" / "good.mcap")) < 0.05


def test_a_recording_whose_odometry_turns_the_wrong_way_is_refused(shared_data):
    bag = pytest.importorskip("tfg_drake.hardware.ros.bag")
    with pytest.raises(DatasetError, match="scans turn against the odometry"):
        believed(bag.load_bag(shared_data("recordings") / "C-yaw-inverted" / "yaw_inverted.mcap"))


@pytest.mark.parametrize(
    ("name", "yaw"), [pytest.param("rear", math.pi, marks=pytest.mark.slow), ("left", 0.5 * math.pi)]
)
def test_where_the_scanner_looks_is_found(name, yaw, shared_data):
    bag = pytest.importorskip("tfg_drake.hardware.ros.bag")
    read = bag.load_bag(shared_data("recordings") / "D-mount-untold" / f"{name}_untold.mcap")
    result = believed(read)
    assert [one.kind for one in result.notes] == ["mount", "mount_yaw"]
    nearest = int(np.nanargmin(read.scans[0].ranges)), int(np.nanargmin(result.scans[0].ranges))
    turned = result.scans[0].angles[nearest[1]] - read.scans[0].angles[nearest[0]]
    assert abs(math.remainder(turned - yaw, 2.0 * math.pi)) < 0.05


def test_a_trajectory_has_the_stamps_of_its_data_set():
    here = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(as_told(here[1:], np.column_stack([here - 0.05, here])), here[1:] - 0.05)
    np.testing.assert_array_equal(as_told(here, np.empty((0, 2))), here)
    np.testing.assert_array_equal(as_told(here, np.column_stack([[1.0, 0.5, 2.0], here])), here)

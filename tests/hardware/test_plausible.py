"""What is believed of messages, what is left out of them, and what is told of it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tfg_drake.hardware.device import Refusals
from tfg_drake.hardware.plausible import AHEAD, OLD, Judge, judged
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections, replace

NOW = 1000.0


def odometry(x=1.0, y=2.0, theta=0.5, v=0.3, w=-1.0):
    return Odometry(NOW, np.array([x, y, theta]), np.array([v, w]))


def tags(**columns):
    good = {"ids": [7, 8], "range": [2.5, 1.0], "bearing": [-0.5, 3.0]}
    good |= {"sigma_range": [0.04, 0.1], "sigma_bearing": [0.01, 0.02]}
    return TagDetections(NOW, **{name: np.array(values) for name, values in (good | columns).items()})


def scan(**fields):
    good = {"angles": [-0.5, 0.0, 0.5], "ranges": [1.0, math.inf, math.nan], "range_max": 10.0, "sigma": 0.015}
    return LaserScan(NOW, **{k: np.array(v) if isinstance(v, list) else v for k, v in (good | fields).items()})


@pytest.mark.parametrize("message", [odometry(), tags(), scan(), Hazards(NOW, 7, 0, 5), tags(range=[100.0, 1e-3])])
def test_what_is_plausible_passes_as_it_is(message):
    believed, reasons = judged(message, NOW)
    assert believed is message
    assert reasons == {}


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (odometry(x=math.nan), "pose"),
        (odometry(y=-1e200), "pose"),
        (odometry(theta=math.inf), "pose"),
        (odometry(v=50.0), "speed"),
        (odometry(w=math.nan), "speed"),
        (replace(odometry(), stamp=NOW + 2.0 * AHEAD), "stamp"),
        (replace(odometry(), stamp=NOW - 2.0 * OLD), "stamp"),
        (replace(scan(), stamp=math.nan), "stamp"),
        (tags(range=[2.5]), "shape"),
        (tags(**dict.fromkeys(("ids", "range", "bearing", "sigma_range", "sigma_bearing"), [1] * 5000)), "number"),
        (scan(range_max=1e300), "range_max"),
        (scan(range_max=math.inf), "range_max"),
        (scan(range_max=0.0), "range_max"),
        (scan(sigma=1e-12), "sigma"),
        (scan(sigma=math.nan), "sigma"),
        (scan(angles=[-0.5, -0.5, 0.5]), "angles"),
        (scan(angles=[-0.5, math.nan, 0.5]), "angles"),
        (scan(angles=[-0.5, 0.0, 7.0]), "angles"),
        (scan(ranges=[1.0]), "shape"),
        (scan(angles=list(np.linspace(-3.0, 3.0, 60_000)), ranges=[1.0] * 60_000), "number"),
    ],
)
def test_what_is_not_is_refused(message, kind):
    believed, reasons = judged(message, NOW)
    assert believed is None
    assert list(reasons) == [kind]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ids", 2**56, "id 72057594037927936"),
        ("ids", -1, "id -1"),
        ("range", 1e200, "range 1e+200 m"),
        ("range", -2.0, "range -2 m"),
        ("range", math.nan, "range nan m"),
        ("bearing", 3.5, "bearing 3.5 rad"),
        ("sigma_range", 1e-12, "deviation 1e-12 m of a range"),
        ("sigma_bearing", 1e-200, "deviation 1e-200 rad of a bearing"),
    ],
)
def test_a_single_bad_sighting_is_left_out(name, value, words):
    good = getattr(tags(), name).tolist()
    believed, reasons = judged(tags(**{name: [good[0], value]}), NOW)
    assert believed.ids.tolist() == [7]
    assert believed.range.tolist() == [2.5]
    assert reasons == {
        name: f"1 of 2 sightings refused: {words} is not plausible; check the detector; the others are used"
    }


def test_a_single_bad_range_says_that_nothing_is_known():
    believed, reasons = judged(scan(ranges=[-1.0, 10.05, 1e200]), NOW)
    np.testing.assert_array_equal(believed.ranges, [math.nan, 10.05, math.nan])
    assert reasons == {"ranges": "2 of 3 ranges are none (-1 m); nothing is taken as known there"}
    believed, reasons = judged(scan(ranges=[0.0, math.inf, math.nan]), NOW)
    np.testing.assert_array_equal(believed.ranges, [math.nan, math.inf, math.nan])
    assert reasons == {}


@pytest.mark.parametrize("bits", [8, -1, 1500])
def test_bits_that_are_none_count_as_an_alarm(bits):
    believed, reasons = judged(Hazards(NOW, 0, bits, 1), NOW)
    assert (believed.bumper, believed.cliff, believed.wheel_drop) == (0, 7, 1)
    assert reasons == {"cliff": f"cliff {bits} is no set of bits; it counts as an alarm on every side"}


def test_each_kind_of_reason_is_told_once_and_counted():
    judge = Judge({TagDetections: "tags of /detections"})
    for i in range(3):
        stamped = replace(tags(range=[1e200, 1.0]), stamp=NOW + i)
        assert judge.judged(stamped, NOW + i).ids.tolist() == [8]
    assert judge.judged(replace(scan(range_max=0.0), stamp=NOW + 3.0), NOW + 3.0) is None
    assert judge.refusals.take() == [
        "tags of /detections: 1 of 2 sightings refused: range 1e+200 m is not plausible; check the detector; "
        "the others are used",
        "LaserScan: range_max 0 m is not plausible; check the scanner's driver",
    ]
    assert judge.refusals.counts == {("tags of /detections", "range"): 3, ("LaserScan", "range_max"): 1}


def seen(ids, stamp):
    """A frame with these tags."""
    column = np.ones(len(ids))
    return TagDetections(stamp, np.array(ids, dtype=np.int64), column, 0.0 * column, 0.1 * column, 0.1 * column)


def test_tags_that_are_made_up_are_refused_until_they_come_again():
    """However many true ones are among them; frames without any say nothing of that."""
    judge = Judge({TagDetections: "tags of /detections"})
    passed = []
    for k in range(60):
        ids = [1, 2, 3, 1000 + k] if k < 40 else [1, 2, 3]
        passed.append(judge.judged(seen(ids, NOW + 0.1 * k), NOW + 6.0) is not None)
        assert judge.judged(seen([], NOW + 0.1 * k + 0.05), NOW + 6.0) is not None
    assert passed == [True] * 19 + [False] * 26 + [True] * 15
    assert judge.refusals.take() == [
        "tags of /detections: 20 of 23 tags are in one frame of 20 alone, so they are none: check their family and the "
        "camera's focus; none is used"
    ]


@pytest.mark.parametrize(("rate", "share"), [(2.0, 0.7), (10.0, 0.5), (10.0, 0.2)])
def test_a_slow_camera_that_turns_makes_no_tags_up(rate, share):
    """120 tags all round, of which a camera of 65 degrees finds a share; the robot turns at 1.2 rad/s."""
    chance, judge = np.random.default_rng(0), Judge({})
    bearing = np.radians(3.0 * np.arange(120))
    for k in range(200):
        ahead = np.abs(np.angle(np.exp(1j * (bearing - 1.2 * k / rate)))) < np.radians(32.5)
        ids = np.flatnonzero(ahead & (chance.random(120) < share))
        assert judge.judged(seen(ids, NOW + k / rate), NOW + k / rate) is not None


def test_what_a_sensor_says_late_or_twice_is_left_out_without_a_word():
    judge = Judge({})
    assert judge.judged(scan(), NOW) is not None
    assert judge.judged(scan(), NOW) is None
    assert judge.judged(replace(scan(), stamp=NOW - 0.1), NOW) is None
    assert judge.judged(tags(), NOW) is not None
    # Alarms share the stamp of the odometry's frame, and a frame may have changed nothing else.
    assert [judge.judged(Hazards(NOW, bits, 0, 0), NOW).bumper for bits in (0, 1)] == [0, 1]
    assert judge.refusals.take() == []


def test_nonsense_of_many_kinds_fills_no_screen():
    refusals = Refusals()
    for i in range(100):
        refusals.add("scan of /scan", f"kind {i}", "x\n" * 1000)
    refusals.add("tags of /tags", "one", "more")
    lines = refusals.take()
    assert len(lines) == 6
    assert all(len(line) <= 300 and "\n" not in line for line in lines)
    assert refusals.counts.total() == 101


anything = st.floats(width=64) | st.sampled_from([0.0, -0.0, 1e-300, 1e300, math.pi, -math.pi, 1.0, 2.0])


def array(n):
    return hnp.arrays(float, n, elements=anything)


@given(st.integers(0, 6).flatmap(lambda n: st.tuples(hnp.arrays(np.int64, n), array(n), array(n), array(n), array(n))))
def test_tags_that_are_believed(columns):
    believed, _ = judged(TagDetections(NOW, *columns), NOW)
    assert believed is not None
    assert ((believed.ids >= 0) & (believed.ids < 2**31)).all()
    assert ((believed.range > 0.0) & (believed.range <= 100.0)).all()
    assert (abs(believed.bearing) < 3.1416).all()
    for sigma in (believed.sigma_range, believed.sigma_bearing):
        assert ((sigma >= 1e-5) & (sigma <= 10.0)).all()


@given(st.integers(0, 6).flatmap(lambda n: st.tuples(array(n), array(n), anything, anything)))
def test_scans_that_are_believed(fields):
    believed, reasons = judged(LaserScan(NOW, *fields), NOW)
    if believed is None:
        assert reasons
        return
    assert (np.diff(believed.angles) > 0.0).all()
    assert (abs(believed.angles) < 3.1416).all()
    assert 0.0 < believed.range_max <= 1000.0
    known = believed.ranges[~np.isnan(believed.ranges)]
    assert ((known > 0.0) & ((known < believed.range_max + 10.0) | (known == math.inf))).all()

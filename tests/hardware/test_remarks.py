"""What the operator is told, and when: once a spell, in one line."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.hardware.fake_robot import base_state
from tfg_drake.hardware.remarks import LOW_LASTS, QUIET, Remark, RobotRequests, begun, watched, where
from tfg_drake.messages import Hazards


def told(holding, period=0.1, after=0.0):
    """When something was told that does or does not hold, look by look, s."""
    spells, times = {}, []
    for i, holds in enumerate(holding):
        spells, names = begun(spells, {"it": Remark("It holds.", after)} if holds else {}, period * i)
        times += [period * i for name in names if name == "it"]
    return times


def test_what_begins_is_told_once_however_long_it_lasts():
    assert told([False, False] + [True] * 1000) == [pytest.approx(0.2)]


def test_it_is_told_anew_only_where_it_was_over_for_some_time():
    flickering = ([True] * 5 + [False] * 5) * 20
    assert len(told(flickering)) == 1
    over = [False] * int(QUIET / 0.1 + 2)
    assert len(told([True, *over, True, *over, True])) == 3


def test_what_holds_at_looks_far_apart_is_told_once():
    assert len(told([True] * 20, period=1.5 * QUIET)) == 1
    assert len(told([True] * 20, period=1.5 * QUIET, after=2.0)) == 1


def test_what_must_last_is_told_when_it_has_without_a_break():
    assert told([True] * 100, after=2.0) == [pytest.approx(2.0)]
    assert told(([True] * 19 + [False]) * 20, after=2.0) == []


@given(st.lists(st.lists(st.booleans(), min_size=3, max_size=3), max_size=60))
def test_what_holds_does_not_keep_anything_else_from_being_told(looks):
    together, spells = {name: [] for name in "abc"}, {}
    for i, look in enumerate(looks):
        holds = {name: Remark(name) for name, one in zip("abc", look, strict=True) if one}
        spells, names = begun(spells, holds, float(i))
        for name in names:
            together[name].append(float(i))
    for k, name in enumerate("abc"):
        assert together[name] == told([look[k] for look in looks], period=1.0)


def lines(looks):
    """What is told in looks at a base: (s, hazards, state)."""
    watch, all_of = {}, []
    for now, hazards, state in looks:
        watch, new = watched(watch, hazards, state, now)
        all_of += new
    return all_of


def test_hazards_say_where_and_what_the_robot_does():
    assert lines([(0.0, [Hazards(0.0, 4, 0, 0)], None)]) == [
        "bumper left: the robot backs away and looks for another way"
    ]
    assert lines([(0.0, [Hazards(0.0, 0, 5, 0), Hazards(0.0, 0, 0, 1)], None)]) == [
        "cliff left, right: the robot stands; carry it away, then enable it",
        "wheel drop right: the robot stands; put it on its wheels, then enable it",
    ]
    assert where(0) == "none"


def test_a_short_press_between_two_looks_is_told():
    presses = [Hazards(0.0, 0, 0, 0), Hazards(0.02, 2, 0, 0), Hazards(0.04, 0, 0, 0)]
    assert len(lines([(0.0, presses, None)])) == 1


def battery(*levels):
    """What is told of a battery that has a level each second."""
    return lines([(float(i), [], base_state(float(i), battery_level=level)) for i, level in enumerate(levels)])


def test_a_battery_that_stays_low_is_told_and_one_that_sags_is_not():
    assert battery(*["good"] * 3, *["low"] * 20) == [
        "the battery is low, 13.8 V: the mission ends, at home if explorer.return_home is set"
    ]
    assert battery(*(["low"] * 3 + ["good"]) * 10) == []
    (line,) = battery("good", "dangerous", "dangerous", "dangerous")
    assert line == "the battery is nearly empty, 13.8 V: the robot stops and the mission ends; charge it"


def test_what_is_left_is_told_as_it_is_known():
    looks = [(float(i), [], base_state(float(i), charge=0.12, battery_level="low")) for i in range(20)]
    assert lines(looks)[0].startswith("the battery is low, 12 %: ")


def frames(*lost):
    """Remarks on shares of frames that were lost in each second."""
    return lines([(float(i), [], base_state(float(i), lost=share)) for i, share in enumerate(lost)])


def test_frames_that_are_lost_all_along_are_told_with_their_share():
    assert frames(*[0.0] * 20) == []
    assert frames(*[0.08] * 20) == []
    assert frames(*[0.6] * 20) == ["60 % of the base's frames are lost; the robot drives on; check the cable"]
    assert frames(0.0, 0.6, 0.0, 0.0, 0.6, 0.0) == []


class Base:
    """A base that says what it is told to say of itself."""

    def __init__(self):
        self.states = []

    def take(self, kind, until):
        taken, self.states = self.states, []
        return taken


@pytest.mark.parametrize("recalls", [True, False])
def test_a_low_battery_calls_the_robot_back_once_and_an_empty_one_ends_the_mission(recalls):
    base, asked, ends = Base(), [], []
    watch = RobotRequests(base)
    assert watch.requests() == []
    for i in range(30):
        base.states = [base_state(float(i), battery_level="low" if i < 20 else "dangerous")]
        # It is asked more often than the base says anything.
        asked += [(i, request) for request in watch.requests() + watch.requests()]
        ends.append(watch.empty(recalls))
    first = int(LOW_LASTS + QUIET)
    assert asked == [(first, "recall")]
    low, empty = "" if recalls else "The battery is low, 13.8 V", "The battery is nearly empty, 13.8 V"
    assert ends == [""] * first + [low] * 16 + [empty] * 8

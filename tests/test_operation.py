"""What the operator wants, request by request."""

from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.operation import Operation, noticed, requested


def after(*requests, operation=None):
    operation = operation or Operation()
    for request in requests:
        operation = noticed(operation, request) if isinstance(request, bool) else requested(operation, request)
    return operation


def test_nothing_moves_before_it_is_enabled():
    assert Operation().enabling == 0
    assert after("pause", "pause").enabling == 0


def test_each_enabling_is_another_one():
    assert [after(*["enable"] * n).enabling for n in (1, 2, 3)] == [1, 2, 3]
    assert after("enable", "stop", "enable").enabling == 2


def test_a_stop_is_latched():
    assert after("enable", True, "stop", "pause", "pause").enabling == 0
    assert after("enable", True, "stop", False).enabling == 0
    assert after("enable", True, "stop", False, "enable", True).enabling == 2


def test_a_base_that_stopped_by_itself_stays_so():
    assert after("enable", True, False).enabling == 0
    assert after("enable", True, False, True).enabling == 0
    assert after("enable", True, False, "enable", True).enabling == 2


def test_a_base_has_time_to_obey():
    assert after("enable", False, False).enabling == 1
    assert after("enable", True, "enable", False).enabling == 2


def test_pause_and_resume_do_not_touch_the_base():
    operation = after("enable", True, "pause")
    assert (operation.paused, operation.enabling) == (True, 1)
    assert not after("pause", operation=operation).paused


@given(st.lists(st.sampled_from(["enable", "stop", "pause", "end", True, False])))
def test_an_end_is_the_end(events):
    operation = after("end", *events)
    assert operation.ended
    assert operation.enabling == 0


@given(st.lists(st.sampled_from(["enable", "stop", "pause", True, False])))
def test_after_a_stop_only_enable_moves_it(events):
    moves = after("stop", *events).enabling > 0
    assert moves <= ("enable" in events)

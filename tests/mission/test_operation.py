"""What the operator wants, request by request."""

from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.mission.operation import Operation, requested


def after(*requests):
    operation = Operation()
    for request in requests:
        operation = requested(operation, request)
    return operation


def test_nothing_moves_before_it_is_enabled():
    assert Operation().enabling == 0
    assert after("pause", "pause").enabling == 0


def test_each_enabling_is_another_one():
    assert [after(*["enable"] * n).enabling for n in (1, 2, 3)] == [1, 2, 3]
    assert after("enable", "stop", "enable").enabling == 2


def test_a_stop_is_latched():
    assert after("enable", "stop", "pause", "pause").enabling == 0
    assert after("enable", "stop", "stop", "enable").enabling == 2


def test_pause_and_resume_do_not_touch_the_base():
    operation = after("enable", "pause")
    assert (operation.paused, operation.enabling) == (True, 1)
    assert not after("enable", "pause", "pause").paused


def test_a_hold_pauses_and_never_resumes():
    assert after("hold").paused
    assert after("pause", "hold", "hold").paused
    assert not after("hold", "pause").paused
    assert after("hold").enabling == 0


def test_a_recall_lasts_and_leaves_the_base_alone():
    operation = after("enable", "recall", "pause", "pause")
    assert (operation.recalled, operation.enabling, operation.ended) == (True, 1, False)
    assert not after("enable", "pause").recalled


@given(st.lists(st.sampled_from(["enable", "stop", "pause", "hold", "recall", "end"])))
def test_an_end_is_the_end(requests):
    operation = after("end", *requests)
    assert operation.ended
    assert operation.enabling == 0


@given(st.lists(st.sampled_from(["enable", "stop", "pause", "hold"])))
def test_after_a_stop_only_enable_moves_it(requests):
    assert (after("stop", *requests).enabling > 0) <= ("enable" in requests)

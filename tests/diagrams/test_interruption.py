"""A signal is noted once, a second one is for at once."""

import os
import signal
import threading

import pytest

from tfg_drake.diagrams import interruption
from tfg_drake.diagrams.interruption import NAMES, Interruption


@pytest.fixture
def clock(monkeypatch):
    """The time, s, as a list of one."""
    now = [100.0]
    monkeypatch.setattr(interruption.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize("number", NAMES)
def test_the_first_is_noted_and_a_later_one_is_for_at_once(clock, number):
    called = []
    event = Interruption()
    event.first = lambda *given: called.append(("first", given[0]))
    event.again = lambda *given: called.append(("again", given[0]))
    with event.heard():
        assert not event.is_set()
        for time in (100.0, 100.1, 100.2, 100.26, 100.3, 101.0):
            clock[0] = time
            os.kill(os.getpid(), number)
    # `timeout` sends its signal twice; who keeps pressing Ctrl-C means it.
    assert called == [("first", number), ("again", number), ("again", number)]
    assert event.is_set()
    assert event.number == number


def test_by_itself_it_raises(clock):
    event = Interruption()
    with event.heard(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGTERM)
    assert event.number == signal.SIGTERM


def test_the_handlers_are_given_back_and_what_nohup_ignores_stays_ignored():
    before = {number: signal.getsignal(number) for number in NAMES}
    try:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        event = Interruption()
        with event.heard():
            os.kill(os.getpid(), signal.SIGHUP)
        assert not event.is_set()
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before[signal.SIGHUP])
    with Interruption().heard():
        assert all(signal.getsignal(number) != handler for number, handler in before.items())
    assert {number: signal.getsignal(number) for number in NAMES} == before


def test_outside_the_main_thread_nothing_is_heard():
    before, during = signal.getsignal(signal.SIGTERM), []

    def listen():
        with Interruption().heard():
            during.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert during == [before]

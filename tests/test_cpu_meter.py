import pytest

from tfg_drake import cpu_meter
from tfg_drake.cpu_meter import charge_details, cpu_totals, metered, metered_in_detail


@pytest.fixture
def burn(monkeypatch):
    """A CPU clock that moves only when told to."""
    now = [100.0]
    monkeypatch.setattr(cpu_meter.time, "thread_time", lambda: now[0])
    monkeypatch.setattr(cpu_meter, "_totals", {})

    def advance(seconds):
        now[0] += seconds

    return advance


def test_inner_blocks_are_not_charged_to_outer_ones(burn):
    with metered("outer"):
        burn(1.0)
        with metered("inner"):
            burn(3.0)
        burn(0.5)
    burn(10.0)
    assert cpu_totals() == {"outer": 1.5, "inner": 3.0}


def test_a_block_that_raises_is_closed(burn):
    def fail():
        with metered("raising"):
            burn(1.0)
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    burn(1.0)
    assert cpu_totals() == {"raising": 1.0}


def test_open_blocks_count(burn):
    with metered("open"):
        burn(2.0)
        assert cpu_totals() == {"open": 2.0}


def test_details_are_charged_on_request_only(burn, monkeypatch):
    monkeypatch.setattr(cpu_meter, "_details", False)

    @metered_in_detail("detail")
    def work():
        burn(1.0)
        return 7

    with metered("outer"):
        assert work() == 7
        charge_details()
        assert work() == 7
    assert cpu_totals() == {"outer": 1.0, "detail": 1.0}

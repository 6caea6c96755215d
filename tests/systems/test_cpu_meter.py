import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tfg_drake.systems import cpu_meter
from tfg_drake.systems.cpu_meter import CpuMeter, metered


@pytest.fixture
def clock(monkeypatch):
    """Clocks that move only when told to: burn (s of CPU) and wait (s without)."""

    class Clock:
        cpu = wall = 100.0

        def burn(self, seconds):
            self.cpu += seconds
            self.wall += seconds

        def wait(self, seconds):
            self.wall += seconds

    now = Clock()
    monkeypatch.setattr(cpu_meter.time, "thread_time", lambda: now.cpu)
    monkeypatch.setattr(cpu_meter.time, "perf_counter", lambda: now.wall)
    return now


def test_what_was_spent_before_a_call_is_not_charged_to_it(clock):
    """On a busy machine a call lasts longer than it takes, and what came before it has taken CPU time, too."""
    meter = CpuMeter()
    clock.burn(3.0)

    def held_up():
        clock.wait(4.0)
        clock.burn(1.0)

    meter.call("component", held_up)
    assert meter.spent == {"component": 1.0}


def test_inner_calls_are_not_charged_to_outer_ones(clock):
    meter = CpuMeter()

    def outer():
        clock.burn(1.0)
        meter.call("inner", clock.burn, 3.0)
        clock.burn(0.5)
        meter.call("inner", clock.burn, 4.0)

    clock.burn(10.0)
    meter.call("outer", outer)
    assert meter.spent == {"outer": 1.5, "inner": 7.0}


def test_what_passes_between_calls_is_charged_to_nobody(clock):
    meter = CpuMeter()
    meter.call("component", clock.burn, 1.0)
    clock.burn(5.0)
    meter.call("component", clock.burn, 2.0)
    assert meter.spent == {"component": 3.0}


def test_waiting_for_the_cpu_is_not_charged(clock):
    meter = CpuMeter()
    meter.call("component", clock.wait, 5.0)
    assert meter.spent == {"component": 0.0}


def test_a_call_that_raises_is_charged(clock):
    meter = CpuMeter()

    def fail():
        clock.burn(1.0)
        raise KeyError

    with pytest.raises(KeyError):
        meter.call("raising", fail)
    clock.burn(1.0)
    assert meter.spent == {"raising": 1.0}


def test_systems_of_a_diagram_are_charged_once_a_meter_is_attached(clock):
    class Component(LeafSystem):
        @metered("component")
        def work(self, seconds):
            clock.burn(seconds)
            return seconds

    builder = DiagramBuilder()
    component = builder.AddNamedSystem("component", Component())
    diagram = builder.Build()
    assert component.work(1.0) == 1.0
    meter = CpuMeter()
    meter.attach(diagram)
    assert component.work(2.0) == 2.0
    assert meter.spent == {"component": 2.0}

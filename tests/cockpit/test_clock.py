"""The clock, as somebody who looks on wants it to go."""

from tfg_drake.cockpit.clock import Clock


def test_it_goes_until_it_is_held():
    clock = Clock(8.0)
    assert (clock.held, clock.rate) == (False, 8.0)
    clock.hold()
    assert clock.held
    clock.go()
    assert not clock.held


def test_a_step_ends_with_the_next_stage_and_only_a_step_does():
    clock = Clock()
    assert [clock.at_stage(stage) for stage in (1, 2)] == [False, False]
    clock.step()
    assert [clock.at_stage(stage) for stage in (2, 2, 3)] == [False, False, True]
    assert clock.held
    clock.go()
    assert not clock.at_stage(9)
    clock.step()
    clock.go()  # Somebody has thought better of it.
    assert not clock.at_stage(10)


def test_whatever_is_asked_for_is_noticed():
    clock = Clock()
    versions = [clock.version]
    for ask in (clock.hold, clock.go, clock.step, lambda: clock.set_rate(2.0)):
        ask()
        versions.append(clock.version)
    assert len(set(versions)) == 5
    assert clock.rate == 2.0

"""The base's motion and its contacts with walls."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arrays import frozen
from tfg_drake.config import RobotConfig
from tfg_drake.simulation import differential_drive as drive

ROBOT = RobotConfig()
PERIOD = 1.0 / 64.0
NO_WALLS = frozen(np.zeros((0, 4)))
ROOM = frozen([[-2.0, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2], [0.5, 0.5, 1.5, 0.6]])


def drive_for(state, command, walls, duration, robot=ROBOT):
    states = [state]
    for _ in range(round(duration / PERIOD)):
        states.append(drive.step(states[-1], np.array(command), walls, robot, PERIOD))
    return np.array(states)


def test_velocity_follows_within_limits():
    states = drive_for(drive.initial_state(np.zeros(3), NO_WALLS, ROBOT), [9.0, -9.0], NO_WALLS, 3.0)
    speeds, turn_rates = states[:, drive.SPEED], states[:, drive.TURN_RATE]
    assert speeds[-1] == ROBOT.max_speed
    assert turn_rates[-1] == -ROBOT.max_turn_rate
    assert np.abs(np.diff(speeds)).max() <= ROBOT.max_acceleration * PERIOD + 1e-12
    assert np.abs(np.diff(turn_rates)).max() <= ROBOT.max_turn_acceleration * PERIOD + 1e-12
    assert states[-1, drive.TIME] == 3.0
    assert states[-1, drive.CLEARANCE] == np.inf


def test_a_head_on_contact_stops_the_base_and_presses_the_centre_bumper():
    states = drive_for(drive.initial_state(np.zeros(3), ROOM, ROBOT), [0.5, 0.0], ROOM, 6.0)
    last = states[-1]
    assert last[drive.X] == pytest.approx(2.0 - ROBOT.radius, abs=1e-9)
    assert last[drive.SPEED] == pytest.approx(0.0, abs=1e-9)
    assert (last[drive.CONTACTS], last[drive.BUMPER], last[drive.CLEARANCE]) == (1, 2, pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize(("heading", "bit"), [(0.9, 1), (-0.9, 4)])
def test_a_glancing_contact_slides_and_presses_that_side(heading, bit):
    state = drive.initial_state(np.array([1.7, 0.0, heading]), ROOM[:4], ROBOT)
    states = drive_for(state, [0.3, 0.0], ROOM[:4], 2.0)
    assert states[-1, drive.BUMPER] == bit
    assert abs(states[-1, drive.Y]) > 0.1
    assert states[-1, drive.X] == pytest.approx(2.0 - ROBOT.radius, abs=1e-9)
    assert states[-1, drive.CONTACTS] == 1


def test_a_contact_counts_again_only_after_release():
    state = drive.initial_state(np.array([1.7, 0.0, 0.0]), ROOM[:4], ROBOT)
    pressed = drive_for(state, [0.1, 0.0], ROOM[:4], 3.0)[-1]
    # Back 5 mm: still pressed. Back 20 mm: released. Forward: a second contact.
    near = drive_for(pressed, [-0.01, 0.0], ROOM[:4], 0.5)[-1]
    assert near[drive.BUMPER] == 2
    free = drive_for(near, [-0.05, 0.0], ROOM[:4], 1.0)[-1]
    assert (free[drive.BUMPER], free[drive.IN_CONTACT]) == (0, 0)
    again = drive_for(free, [0.1, 0.0], ROOM[:4], 2.0)[-1]
    assert again[drive.CONTACTS] == 2


def test_a_contact_that_begins_while_the_base_is_pushed_is_not_its_own():
    state, still = drive.initial_state(np.array([1.7, 0.0, 0.0]), ROOM[:4], ROBOT), np.zeros(2)
    pushed = drive.step(state, still, ROOM[:4], ROBOT, PERIOD, np.array([0.2, 0.0, 0.0, 0.0]))
    assert (pushed[drive.CONTACTS], pushed[drive.RECEIVED], pushed[drive.BUMPER]) == (0, 1, 2)
    # It is the same contact as long as it lasts; the next one, by its own wheels, is its own.
    pressed = drive_for(pushed, [0.1, 0.0], ROOM[:4], 1.0)[-1]
    assert (pressed[drive.CONTACTS], pressed[drive.RECEIVED]) == (0, 1)
    again = drive_for(drive_for(pressed, [-0.05, 0.0], ROOM[:4], 1.0)[-1], [0.1, 0.0], ROOM[:4], 2.0)[-1]
    assert (again[drive.CONTACTS], again[drive.RECEIVED]) == (1, 1)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-np.pi, np.pi),
    st.floats(-0.5, 0.5),
    st.floats(-1.5, 1.5),
    st.integers(0, 2**32 - 1),
)
def test_the_outline_never_enters_a_wall(heading, speed, turn_rate, seed):
    # The room, and clutter with sharp corners that does not reach the start.
    rng = np.random.default_rng(seed)
    clutter = rng.uniform(-2, 2, (12, 4))
    distance = np.array([shapely.LineString(w.reshape(2, 2)).distance(shapely.Point(0, 0)) for w in clutter])
    walls = frozen(np.vstack([ROOM[:4], clutter[distance > ROBOT.radius + 0.01]]))
    lines = shapely.MultiLineString(walls.reshape(-1, 2, 2).tolist())
    states = drive_for(drive.initial_state(np.array([0, 0, heading]), walls, ROBOT), [speed, turn_rate], walls, 8.0)
    gaps = shapely.distance(shapely.points(states[:, drive.X : drive.Y + 1]), lines) - ROBOT.radius
    assert gaps.min() >= -1e-6
    assert states[-1, drive.CLEARANCE] == pytest.approx(max(0.0, gaps.min()), abs=1e-6)
    # No tunnelling either: the centre's track crosses no wall.
    assert not shapely.LineString(states[:, drive.X : drive.Y + 1]).intersects(lines)


def test_initial_clearance():
    assert drive.initial_state(np.zeros(3), ROOM[:4], ROBOT)[drive.CLEARANCE] == pytest.approx(2.0 - ROBOT.radius)


def drive_among(command, disc, steps, disc_velocity=(0.0, 0.0)):
    """The states (k, STATE_SIZE) of a base that starts at the origin, with a disc (3,) that moves at m/s."""
    states, disc = [drive.initial_state(np.zeros(3), NO_WALLS, ROBOT)], np.array(disc)
    for _ in range(steps):
        disc = disc + PERIOD * np.append(disc_velocity, 0.0)
        after = drive.step(states[-1], np.array(command), NO_WALLS, ROBOT, PERIOD)
        states.append(drive.among(states[-1], after, disc[None], ROBOT))
    return np.array(states)


def test_a_base_that_drives_into_somebody_stops_there_and_has_made_a_contact():
    last = drive_among([0.3, 0.0], [1.0, 0.0, 0.25], 400)[-1]
    assert 1.0 - 0.25 - ROBOT.radius - 0.01 < last[drive.X] <= 1.0 - 0.25 - ROBOT.radius
    assert last[drive.SPEED] < 0.01
    assert (last[drive.CONTACTS], last[drive.RECEIVED], last[drive.BUMPER]) == (1, 0, 2)
    assert last[drive.CLEARANCE] == np.inf


def test_a_base_that_stands_or_turns_receives_a_contact_and_is_not_pushed():
    states = drive_among([0.0, 0.5], [0.5, 0.0, 0.25], 20, disc_velocity=[-0.3, 0.0])
    last = states[-1]
    assert (last[drive.CONTACTS], last[drive.RECEIVED], last[drive.BUMPER]) == (0, 1, 2)
    assert (states[:, drive.X : drive.Y + 1] == 0.0).all()
    assert last[drive.THETA] > 0.1
    # Who is behind it presses no bumper.
    behind = drive_among([0.0, 0.0], [-0.5, 0.0, 0.25], 20, disc_velocity=[0.3, 0.0])[-1]
    assert (behind[drive.CONTACTS], behind[drive.RECEIVED], behind[drive.BUMPER]) == (0, 1, 0)


def test_a_base_that_is_touched_and_then_drives_on_has_made_a_contact_too():
    touched = drive_among([0.0, 0.0], [0.43, 0.0, 0.25], 20, disc_velocity=[-0.001, 0.0])[-1]
    assert (touched[drive.CONTACTS], touched[drive.RECEIVED]) == (0, 1)
    state, disc = touched, np.array([[0.4299, 0.0, 0.25]])
    for _ in range(10):
        state = drive.among(state, drive.step(state, np.array([0.3, 0.0]), NO_WALLS, ROBOT, PERIOD), disc, ROBOT)
    assert (state[drive.CONTACTS], state[drive.RECEIVED]) == (1, 1)
    for _ in range(40):
        state = drive.among(state, drive.step(state, np.array([-0.3, 0.0]), NO_WALLS, ROBOT, PERIOD), disc, ROBOT)
    assert (state[drive.CONTACTS], state[drive.TOUCHES], state[drive.BUMPER]) == (1, 0, 0)
    assert state[drive.X] < -0.05

"""The safety filter: what it lets through and what it does not."""

import numpy as np
import pytest

from tests.arrays import frozen
from tfg_drake.config import RobotConfig, SafetyConfig, ScanConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.messages import Hazards, LaserScan, Odometry, replace
from tfg_drake.safety.scan_watch import HELD, REMEMBERED, no_watch, watched
from tfg_drake.safety.velocity_filter import (
    BASE_SPEED,
    MOST_BACKED,
    MOST_REFLEXES,
    REFLEXES,
    SPEED,
    STATE_SIZE,
    TURN_RATE,
    filter_command,
    free_distance,
    held,
)
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation.laser_scanner import ray_angles, scan

ROBOT, SAFETY, SCAN = RobotConfig(), SafetyConfig(), ScanConfig()
PERIOD = 1.0 / 32.0
NONE = Hazards(0.0, 0, 0, 0)
CLEAR = LaserScan(0.0, ray_angles(SCAN), np.full(249, np.inf), 10.0, 0.015)
ORIGIN = np.zeros(3)


def moving(speed, turn_rate=0.0):
    """The filter's state of a base that drives so."""
    state = np.zeros(STATE_SIZE)
    state[[SPEED, TURN_RATE, BASE_SPEED]] = speed, turn_rate, speed
    return state


def watch_of(scan, X_OB=ORIGIN, watch=None):
    """What is believed after a scan taken at X_OB (3,), by default of a robot that has looked round and met nothing."""
    if watch is None:
        angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
        round_about = LaserScan(scan.stamp - 0.1, angles, np.full(720, np.inf), 10.0, 0.015)
        watch = watched(no_watch(round_about), round_about, X_OB, False, ROBOT.radius, 0.0)
    return watched(watch, scan, X_OB, False, ROBOT.radius, 0.0)


def filtered_command(state, stamp, command, hazards, scan, watch=None, X_OB=ORIGIN):
    """The filter's state a period later; without a watch all that it knows is this scan, taken where the robot is."""
    watch = watch_of(scan) if watch is None else watch
    odometry = Odometry(stamp, X_OB, np.zeros(2), at_rest=True)
    inputs = frozen(state), stamp, np.array(command), hazards, scan, watch, odometry
    return filter_command(*inputs, ROBOT, SAFETY, PERIOD)


def run(command, duration=2.0, hazards=NONE, scan=CLEAR, state=None):
    """The filter's state after the same input for some time; time stands still."""
    state = np.zeros(STATE_SIZE) if state is None else state
    watch = watch_of(scan)
    for _ in range(round(duration / PERIOD)):
        state = filtered_command(state, 0.0, command, hazards, scan, watch)
    return state


def scan_of(walls, X_WB=(0.0, 0.0, 0.0), stamp=0.0):
    angles = ray_angles(SCAN)
    return scan(frozen(np.reshape(walls, (-1, 4))), np.array(X_WB), stamp, angles, np.zeros(249), SCAN)


def test_limits():
    assert run([9.0, -9.0])[:2].tolist() == [ROBOT.max_speed, -ROBOT.max_turn_rate]
    first = run([9.0, -9.0], PERIOD)
    assert first[:2] == pytest.approx([ROBOT.max_acceleration * PERIOD, -ROBOT.max_turn_acceleration * PERIOD])
    assert run([-0.2, 0.0])[SPEED] == pytest.approx(-0.2)


@pytest.mark.parametrize("command", [[np.nan, 0.0], [0.1, np.inf]])
def test_a_command_that_is_not_finite_is_zero(command):
    assert run(command, state=run([0.5, 0.5]))[:2].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("hazards", [Hazards(0.0, 0, 1, 0), Hazards(0.0, 0, 0, 4)])
def test_cliff_and_wheel_drop_stop_at_once(hazards):
    assert run([0.5, 0.5], PERIOD, hazards, state=run([0.5, 0.5]))[:2].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("bits", "turn_rate"), [(2, 0.0), (4, -0.4), (1, 0.4), (5, 0.0), (6, 0.0)])
def test_the_bumper_reflex_lasts_its_time(bits, turn_rate):
    state = filtered_command(run([0.5, 0.0]), 0.0, [0.5, 0.0], Hazards(0.0, bits, 0, 0), CLEAR)
    steps = 0
    while state[SPEED] == -SAFETY.reflex_speed and state[TURN_RATE] == turn_rate and steps < 100:
        state = run([0.5, 0.0], PERIOD, state=state)
        steps += 1
    assert steps == round(SAFETY.reflex_time / PERIOD)
    # Then the command again, from where the reflex left the base.
    assert state[SPEED] == pytest.approx(-SAFETY.reflex_speed + ROBOT.max_acceleration * PERIOD)


def backed(hazards, state, scan=CLEAR, command=(0.5, 0.0)):
    """How far (m) the base backs away in ten seconds, and the filter's state then."""
    watch, way = watch_of(scan), 0.0
    for k in range(320):
        state = filtered_command(state, 0.0, list(command), hazards(k * PERIOD), scan, watch)
        way -= state[SPEED] * PERIOD
    return way, state


def test_a_bumper_that_stays_pressed_ends_the_reflex_after_so_many_metres():
    way, state = backed(lambda _: Hazards(0.0, 2, 0, 0), np.zeros(STATE_SIZE))
    assert 0.15 < way <= MOST_BACKED + 1e-9
    assert state[SPEED] == 0.0
    assert state[REFLEXES] > MOST_REFLEXES
    # Released, it drives ahead again.
    assert run([0.5, 0.0], state=state)[SPEED] == 0.5


def test_after_three_reflexes_in_a_row_the_base_stands():
    """A bumper that is pressed for a moment, again and again, by something that comes after it."""
    often = SafetyConfig(reflex_time=0.25, reflex_speed=0.05)
    state, begun, watch = np.zeros(STATE_SIZE), 0, watch_of(CLEAR)
    for k in range(320):
        hazards, before = Hazards(0.0, 2 * (k % 16 == 0), 0, 0), state[SPEED]
        odometry = Odometry(0.0, ORIGIN, np.zeros(2), at_rest=True)
        state = filter_command(frozen(state), 0.0, np.zeros(2), hazards, CLEAR, watch, odometry, ROBOT, often, PERIOD)
        begun += state[SPEED] < 0.0 <= before
    assert begun == MOST_REFLEXES


def all_round(walls):
    """A scan of 360 degrees at the origin."""
    config = ScanConfig(field_of_view=2.0 * np.pi - 0.01)
    angles = ray_angles(config)
    zeros = np.zeros(len(angles))
    return scan(np.array(walls, dtype=float).reshape(-1, 4), ORIGIN, 0.0, angles, zeros, config)


@pytest.mark.parametrize("command", [[-0.3, 0.0], [-0.3, 0.5]])
def test_backwards_the_base_stands_off_from_what_the_scan_shows(command):
    behind = all_round([[-0.2, -3.0, -0.2, 3.0]])
    assert run(command, scan=behind)[SPEED] == pytest.approx(0.0, abs=1e-9)
    assert run(command, scan=all_round([[-3.0, -3.0, -3.0, 3.0]]))[SPEED] == pytest.approx(-0.3)
    # Nor does a reflex, which lasts for 0.1 m.
    assert run([0.0, 0.0], 0.5, Hazards(0.0, 2, 0, 0), behind)[SPEED] == pytest.approx(0.0, abs=1e-9)


def test_backwards_the_base_drives_only_where_it_has_seen_or_been():
    """With a scanner that sees ahead only."""
    watch, speeds = no_watch(scan_of([])), []
    for k in range(20):
        there = np.array([0.04 * k, 0.0, 0.0])
        seen = scan_of([[3.0, -9.0, 3.0, 9.0]], there, 0.1 * k)
        watch = watched(watch, seen, there, False, ROBOT.radius, 0.0)
        still = np.zeros(STATE_SIZE)
        speeds.append(filtered_command(still, 0.1 * k, [-0.3, 0.0], NONE, seen, watch, there)[SPEED])
    assert speeds[0] == 0.0
    assert speeds[-1] < 0.0


def free(scan, X_SB, curvature):
    return free_distance(scan.angles, scan.ranges, X_SB, curvature, 0.18, 0.03, np.inf)


def test_free_distance_ahead_and_on_an_arc():
    wall = scan_of([[2.0, -5, 2, 5]])
    assert free(wall, np.zeros(3), 0.0) == pytest.approx(2.0 - 0.18, abs=1e-3)
    # From 0.3 m further on, the same wall.
    assert free(wall, np.array([0.3, 0, 0]), 0.0) == pytest.approx(1.7 - 0.18, abs=1e-3)
    # A left turn of radius 1 meets a single return when the disc round the arc's end touches it.
    post = LaserScan(0.0, np.array([np.arctan2(0.5, 1.0)]), np.array([np.hypot(0.5, 1.0)]), 10.0, 0.0)
    distance = free(post, np.zeros(3), 1.0)
    end = advance(np.zeros(3), 1.0, 1.0, distance)
    assert np.hypot(1.0 - end[0], 0.5 - end[1]) == pytest.approx(0.18, abs=1e-9)
    assert free(post, np.zeros(3), -1.0) == np.inf
    assert free(post, np.zeros(3), 0.0) == np.inf


def test_an_obstacle_ahead_stops_forward_motion_only():
    close = scan_of([[0.2, -5, 0.2, 5]])
    assert run([0.5, 0.0], scan=close)[SPEED] == 0.0
    assert run([0.5, 1.0], scan=close)[:2].tolist() == [0.0, 1.0]
    assert run([-0.3, 0.0], scan=close)[SPEED] == pytest.approx(-0.3)


def test_a_wall_alongside_and_a_door_do_not_slow_the_base():
    # The outline 0.1 m from a wall on the left, and in the middle of a 0.8 m door.
    assert run([0.5, 0.0], scan=scan_of([[-5, 0.28, 20, 0.28]]))[SPEED] == 0.5
    for x in (-1.0, -0.5, -0.1, 0.0, 0.1):
        door = scan_of([[0, 0.4, 0, 5], [0, -5, 0, -0.4]], (x, 0.0, 0.0))
        assert run([0.5, 0.0], scan=door)[SPEED] == 0.5


@pytest.mark.parametrize("stamp", [-np.inf, -1.0])
def test_without_a_fresh_scan_there_is_no_forward_motion(stamp):
    stale = LaserScan(stamp, np.zeros(0), np.zeros(0), 10.0, 0.015)
    assert run([0.5, 0.7], scan=stale)[:2].tolist() == [0.0, 0.7]


@pytest.mark.parametrize("heading", [0.0, 0.4, 0.8])
def test_full_speed_at_a_wall_ends_before_it(heading):
    walls = frozen([[3.0, -20, 3, 20]])
    state, filtered = drive.initial_state(np.array([0, 0, heading]), walls, ROBOT), np.zeros(STATE_SIZE)
    watch = None
    for k in range(64 * 20):
        t = k / 64
        X_WB = state[drive.X : drive.THETA + 1]
        if k % 6 == 0:
            latest = scan_of(walls, X_WB, t)
            watch = watch_of(latest, X_WB, watch)
        velocity = filtered[:2]
        if k % 2 == 0:
            filtered = filtered_command(filtered, t, [0.5, 0.0], NONE, latest, watch, X_WB)
        state = drive.step(state, velocity, walls, ROBOT, 1 / 64)
    assert state[drive.CONTACTS] == 0
    assert state[drive.SPEED] == pytest.approx(0.0, abs=0.01)
    # It stops near the wall, not far from it.
    assert 0.0 < state[drive.CLEARANCE] < 0.2


# Where such a turn takes the base into the tip of a wall if nothing holds it back.
@pytest.mark.parametrize("turn_rate", [1.3, -1.3])
@pytest.mark.parametrize(
    ("spike", "speed"), [((0.22, 0.22), 0.0), ((0.3, 0.22), 0.0), ((0.25, 0.23), 0.1), ((0.28, 0.23), 0.2)]
)
@pytest.mark.parametrize("cliff", [0, 1])
def test_a_turn_at_full_speed_does_not_swing_into_what_stands_beside_the_way(spike, speed, turn_rate, cliff):
    """Told to turn on the spot, or nearly so, the base drives on while it brakes, even if it had to stand at first."""
    least, turned = drive_by(spike, [speed, turn_rate], 0.0, cliff)
    assert least > 0.005
    assert abs(turned) > 0.5


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_where_a_turn_would_take_it_nearer_the_base_brakes_on_its_arc(side):
    least, _ = drive_by((0.326, 0.164), [0.0, side * 1.3], -side * 0.8)
    assert least > 0.03
    walls = np.array([[0.326, 0.164 * side, 0.326, 0.5 * side]])
    seen = scan_of(walls)
    state = filtered_command(moving(0.5, -side * 0.8), 0.0, [0.0, side * 1.3], NONE, seen)
    assert state[TURN_RATE] == pytest.approx(-side * 0.8 * state[BASE_SPEED] / 0.5)
    # So it does where the newest rays do not tell of it.
    lost = replace(seen, stamp=0.1, ranges=np.where(np.isfinite(seen.ranges), np.nan, seen.ranges))
    watch = watch_of(lost, watch=watch_of(seen))
    state = filtered_command(moving(0.5, -side * 0.8), 0.1, [0.0, side * 1.3], NONE, lost, watch)
    assert state[TURN_RATE] == pytest.approx(-side * 0.8 * state[BASE_SPEED] / 0.5)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_base_that_is_too_near_already_turns_away(side):
    """The wall is .03 m from the outline, beside its front; its arc takes it nearer, the turn that is asked for off."""
    walls = np.array([[0.2, side * 0.08, 0.6, side * 0.08]])
    state = moving(0.3, side * 0.2)
    state = filtered_command(state, 0.0, [0.0, -side * 1.3], NONE, scan_of(walls))
    assert state[TURN_RATE] == pytest.approx(side * (0.2 - ROBOT.max_turn_acceleration * PERIOD))


def test_the_filter_keeps_the_speed_of_a_base_that_backs_away_from_a_bumper():
    base, state = drive.initial_state(np.zeros(3), np.zeros((0, 4)), ROBOT), run([0.5, 0.0])
    base[drive.SPEED] = ROBOT.max_speed
    for k in range(60):
        hazards = Hazards(0.0, 2, 0, 0) if k == 0 else NONE
        state = filtered_command(state, 0.0, [0.5, 0.0], hazards, CLEAR)
        base = drive.step(base, state[:2], frozen(np.zeros((0, 4))), ROBOT, PERIOD)
        assert state[BASE_SPEED] == pytest.approx(base[drive.SPEED], abs=1e-12)


def drive_by(spike, command, turn_rate, cliff=0):
    """Least clearance (m) and turn (rad) of a base at full speed that is commanded so for 2 s beside the tip (2,), m,
    of a wall on the side that it is to turn to; turn_rate: rad/s that it has, cliff: what it is warned of at first."""
    side = np.sign(command[1])
    (x, y), base = spike, drive.initial_state(np.zeros(3), np.zeros((0, 4)), ROBOT)
    base[drive.SPEED], base[drive.TURN_RATE] = ROBOT.max_speed, turn_rate
    state = moving(ROBOT.max_speed, turn_rate)
    walls = frozen([[x, y * side, x + 0.1, (y + 0.3) * side], [x, y * side, x - 0.1, (y + 0.3) * side]])
    turned, watch = 0.0, None
    for k in range(64):
        X_WB = base[drive.X : drive.THETA + 1]
        if k % 3 == 0:
            seen = scan_of(walls, X_WB, stamp=k * PERIOD)
            watch = watch_of(seen, X_WB, watch)
        before, hazards = state, Hazards(0.0, 0, cliff if k == 0 else 0, 0)
        state = filtered_command(state, k * PERIOD, command, hazards, seen, watch, X_WB)
        base = drive.step(base, state[:2], walls, ROBOT, PERIOD)
        turned += base[drive.TURN_RATE] * PERIOD
        # What the filter takes for the base's speed is that, and it asks no more than the base can do.
        assert state[BASE_SPEED] == pytest.approx(base[drive.SPEED], abs=1e-12)
        assert abs(state[TURN_RATE] - before[TURN_RATE]) <= ROBOT.max_turn_acceleration * PERIOD + 1e-12
    return base[drive.CLEARANCE], turned


def test_where_there_is_room_the_base_turns_while_it_brakes():
    state = run([0.5, 0.0])
    walls = [[0.5, -2.0, 0.5, -0.5], [0.5, 0.5, 0.5, 2.0]]
    state = filtered_command(state, 0.0, [0.0, 1.3], NONE, scan_of(walls))
    assert state[TURN_RATE] == ROBOT.max_turn_acceleration * PERIOD


def test_what_holds_the_base_is_unseen_or_remembered():
    watch, limits = watch_of(CLEAR), (ORIGIN, 0.5, ROBOT, SAFETY)
    assert held(watch, *limits) == ""
    assert held(no_watch(CLEAR), *limits) == HELD
    # Beside it, where the scan does not look now, it met something 3 s ago.
    seen, met, p_OM = watch.space.seen.copy(), watch.space.met.copy(), watch.space.p_OM.copy()
    seen[1, 4], met[1, 4], p_OM[1, 4] = watch.newest - 3.0, True, (0.077, 0.197)
    assert held(replace(watch, space=replace(watch.space, seen=seen, met=met, p_OM=p_OM)), *limits) == REMEMBERED

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arrays import frozen
from tfg_drake.config import RobotConfig
from tfg_drake.planning.pure_pursuit import (
    ALL_ROUND,
    PLANNED_SHARE,
    TURNING_BACK,
    VIEW_MARGIN,
    at_rest,
    follow,
    turn_in_place,
    turn_to_see,
)

ROBOT = RobotConfig()
DT = 1 / 32


def drive(points, X_MB, seconds=120.0):
    """The poses of a unicycle with the base's limits that follows a path, and the time it took."""
    points = frozen(points)
    X, v, w, progress, turning, poses, speeds = np.array(X_MB, float), 0.0, 0.0, 0.0, False, [], []
    for step in range(round(seconds / DT)):
        command = follow(points, frozen(X), v, progress, turning, ROBOT)
        progress, turning = command.progress, command.turning
        assert abs(command.speed) <= ROBOT.max_speed
        assert abs(command.turn_rate) <= ROBOT.max_turn_rate
        v += np.clip(command.speed - v, -ROBOT.max_acceleration * DT, ROBOT.max_acceleration * DT)
        w += np.clip(command.turn_rate - w, -ROBOT.max_turn_acceleration * DT, ROBOT.max_turn_acceleration * DT)
        X = X + DT * np.array([v * math.cos(X[2] + w * DT / 2), v * math.sin(X[2] + w * DT / 2), w])
        poses.append(X)
        speeds.append(v)
        if command.finished and at_rest(v, w):
            return np.array(poses), np.array(speeds), step * DT
    raise AssertionError(f"not at the end after {seconds} s, but at {X}, progress {progress}")


def deviation(poses, points):
    a, d = points[:-1], np.diff(points, axis=0)
    relative = poses[:, None, :2] - a
    t = np.clip((relative * d).sum(-1) / (d * d).sum(-1), 0, 1)
    return np.linalg.norm(relative - t[..., None] * d, axis=-1).min(axis=1)


def wave(amplitude, length=12.0):
    x = np.arange(0, length, 0.1)
    return np.stack([x, amplitude * np.sin(x)], axis=1)


def rounded_corner():
    t = np.linspace(0, 1, 8)[:, None]
    arc = (1 - t) ** 2 * [3.4, 0] + 2 * t * (1 - t) * [4.0, 0] + t**2 * [4.0, 0.6]
    corner = np.vstack([[0, 0], arc, [4, 4]])
    along = np.append(0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
    s = np.linspace(0, along[-1], round(along[-1] / 0.1))
    return np.stack([np.interp(s, along, corner[:, k]) for k in range(2)], axis=1)


@pytest.mark.parametrize(
    "points", [wave(0.0), wave(0.4), wave(1.0), rounded_corner()], ids=["straight", "wave", "steep", "corner"]
)
@pytest.mark.parametrize("heading", [0.0, 0.7, math.pi])
def test_stays_on_the_path_and_stops_at_its_end(points, heading):
    poses, speeds, _ = drive(points, [*points[0], heading])
    assert deviation(poses, points).max() < 0.06
    assert np.linalg.norm(poses[-1, :2] - points[-1]) < 0.05
    assert speeds.max() <= ROBOT.max_speed + 1e-9


def test_straight_path_is_driven_at_full_speed():
    points = wave(0.0)
    _, speeds, seconds = drive(points, [0.0, 0.0, 0.0])
    assert speeds.max() > 0.99 * ROBOT.max_speed
    assert seconds < points[-1, 0] / ROBOT.max_speed + 3.0


def test_returns_to_a_path_beside_it():
    points = wave(0.0)
    poses, _, _ = drive(points, [0.0, 0.15, 0.0])
    assert deviation(poses[poses[:, 0] > 2.0], points).max() < 0.03


@pytest.mark.parametrize("length", [0.02, 0.05, 0.09, 0.1, 0.12, 0.3])
@pytest.mark.parametrize("heading", [0.0, 0.8, 1.5, 2.0, 3.0, math.pi])
def test_short_paths_end_and_are_not_left(length, heading):
    points = np.array([[0.0, 0.0], [length, 0.0]])
    poses, _, _ = drive(points, [0.0, 0.0, heading])
    assert np.linalg.norm(poses[-1, :2] - points[-1]) < 0.06
    assert np.linalg.norm(poses[:, :2] - points[-1], axis=1).max() < length + 0.1


def test_a_path_of_nothing_is_finished():
    for points in (np.zeros((0, 2)), np.zeros((1, 2))):
        assert follow(frozen(points), frozen(np.zeros(3)), 0.0, 0.0, False, ROBOT).finished


@pytest.mark.parametrize("target", [2 * math.pi, 0.3, -1.0])
def test_turn_in_place_comes_to_the_target_and_goes_hardly_beyond(target):
    turned, w = 0.0, 0.0
    for _ in range(round(20 / DT)):
        command = turn_in_place(turned, target, 1.0, ROBOT) if (target - turned) * target > 0.0 else 0.0
        assert 0.0 <= command * math.copysign(1.0, target) <= 1.0
        w += np.clip(command - w, -ROBOT.max_turn_acceleration * DT, ROBOT.max_turn_acceleration * DT)
        turned += w * DT
    assert w == 0.0
    assert 0.0 <= (turned - target) * math.copysign(1.0, target) < 0.05


def swept(turns, view):
    """Whether a robot has a heading in view (within +-view) on its turns from heading 0, and how far it turns, rad."""
    stops = np.array([0.0, *turns])
    poses = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(stops)])

    def seen(look):
        return (np.abs(np.angle(np.exp(1j * (look - poses)))) <= view + 1e-6).any()

    return seen, float(np.abs(np.diff(stops)).sum())


@settings(max_examples=30)
@given(st.lists(st.floats(-math.pi, math.pi), max_size=5), st.floats(-3.0, 3.0))
def test_a_turn_shows_all_there_is_to_look_at_and_none_is_shorter(look, heading):
    field_of_view = 2.2
    view = field_of_view / 2 - VIEW_MARGIN
    first, then = turn_to_see(np.array(look), heading, field_of_view)
    headings = (np.array(look) if look else ALL_ROUND) - heading
    seen, length = swept((first, then), view)
    assert all(seen(one) for one in headings)
    grid = np.linspace(-2 * math.pi, 2 * math.pi, 41)
    for a, b in itertools.product(grid, grid):
        other_length = abs(a) + abs(b - a)
        if other_length < length - 0.1 - TURNING_BACK:
            low, high = min(0.0, a, b) - view, max(0.0, a, b) + view
            assert not all(((one - low) % (2 * math.pi)) <= high - low for one in headings), (a, b)


def test_what_is_in_view_needs_no_turn():
    assert turn_to_see(np.array([0.3, 6.1]), 0.0, 2.2) == (0.0, 0.0)
    assert turn_to_see(np.zeros(0), 1.0, 2 * math.pi) == (0.0, 0.0)


def test_the_robot_slows_down_for_a_corner_as_it_can_brake():
    along = np.stack([np.arange(0.0, 3.01, 0.1), np.zeros(31)], axis=1)
    corner = frozen(np.vstack([along, [[3.0, 0.1], [3.0, 0.2], [3.0, 1.0]]]))
    speeds = [follow(corner, frozen([3.0 - d, 0.0, 0.0]), 0.1, 3.0 - d, False, ROBOT).speed for d in (1.0, 0.2)]
    assert speeds[0] == ROBOT.max_speed
    assert 0.2 < speeds[1] < 0.4


def test_a_command_leaves_something_of_the_limits_to_control():
    path = frozen(np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1))
    for heading, aside, speed, turning in itertools.product(
        np.linspace(-np.pi, np.pi, 37), (-0.2, 0.0, 0.2), (0.0, 0.5), (True, False)
    ):
        command = follow(path, frozen([1.0, aside, heading]), speed, 1.0, turning, ROBOT)
        assert abs(command.turn_rate) <= PLANNED_SHARE * ROBOT.max_turn_rate + 1e-9


def test_progress_is_not_lost_where_a_path_comes_back_beside_itself():
    there = np.stack([np.arange(0.0, 3.01, 0.1), np.zeros(31)], axis=1)
    path = frozen(np.vstack([there, np.add(there[::-1], [0.0, 0.1])]))
    for progress, at in ((0.5, [0.5, 0.06, 0.0]), (5.6, [0.5, 0.04, np.pi])):
        assert follow(path, frozen(at), 0.0, progress, False, ROBOT).progress == pytest.approx(progress, abs=0.01)
    assert follow(path, frozen([0.52, 0.0, 0.0]), 0.0, 0.55, False, ROBOT).progress == pytest.approx(0.55)


def test_a_robot_is_at_rest_when_it_neither_drives_nor_turns():
    assert at_rest(0.0, 0.0)
    for moves in ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)):
        assert not at_rest(*moves)

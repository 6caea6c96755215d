"""What the explorer knows, as ROS says it."""

import math

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.star import inside_any
from tfg_drake.hardware.ros import map_messages
from tfg_drake.hardware.ros.preset import Frames
from tfg_drake.messages import replace
from tfg_drake.pictures.layers import of_choice, of_map
from tfg_drake.tfg.graph import empty_map

FRAMES = Frames(map="m", odom="o", base="b")


def cells(grid):
    """The cells (h, w), and the centres of all (h, w, 2), m in the map."""
    info = grid["info"]
    h, w, cell = info["height"], info["width"], info["resolution"]
    x, y = (info["origin"]["position"][axis] for axis in "xy")
    centres = np.stack(np.meshgrid(x + cell * (np.arange(w) + 0.5), y + cell * (np.arange(h) + 0.5)), axis=-1)
    return np.array(grid["data"]).reshape(h, w), centres


def at(grid, x, y):
    """The cell at a point of the map, m."""
    values, _ = cells(grid)
    origin, cell = grid["info"]["origin"]["position"], grid["info"]["resolution"]
    return values[math.floor((y - origin["y"]) / cell), math.floor((x - origin["x"]) / cell)]


def test_the_grid_of_a_room(room):
    grid = map_messages.tfg_grid(room.tfg(), 5.0, FRAMES)
    assert grid["header"] == {"stamp": 5.0, "frame_id": "m"}
    assert grid["info"]["resolution"] == 0.05
    assert grid["info"]["origin"]["orientation"]["w"] == 1.0
    for place, expected in [
        ((0.0, 0.0), 0),
        ((-1.9, 1.4), 0),
        ((-1.0, -1.52), 100),
        ((-2.02, 0.3), 100),
        ((0.4, 1.52), 100),
        ((0.53, 0.0), -1),
        ((-2.08, -1.58), -1),
    ]:
        assert at(grid, *place) == expected, place
    origin = grid["info"]["origin"]["position"]
    assert np.mod([origin["x"] + 1e-9, origin["y"] + 1e-9], 0.05).max() < 1e-6


def test_the_grid_of_many_stars(room):
    """Against the definitions: free is inside a star, occupied is on a surface."""
    random = np.random.default_rng(1)
    stars, centers = [], random.uniform(-3.0, 3.0, (4, 2))
    for center in centers:
        angles = np.sort(random.uniform(-math.pi, math.pi, 40))
        stars.append(center + random.uniform(0.5, 3.0, (40, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    tfg = replace(
        room.tfg(),
        segments=np.vstack([random.uniform(-4.0, 4.0, (5, 4)), np.tile(random.uniform(-4.0, 4.0, 2), (1, 2))]),
        segment_kind=np.zeros(6, dtype=int),
        star_offsets=np.arange(0, 161, 40),
        star_vertices=np.vstack(stars),
        star_centers=centers,
    )
    values, centres = cells(map_messages.tfg_grid(tfg, 0.0, FRAMES, cell=0.1))
    points = centres.reshape(-1, 2)
    occupied = values.ravel() == 100
    free = inside_any(points, tfg.star_offsets, tfg.star_vertices)
    np.testing.assert_array_equal(values.ravel()[~occupied] == 0, free[~occupied])
    away = clearance(np.hstack([points, points]), tfg.segments, 1.0)
    assert away[occupied].max() <= 0.1 * math.sqrt(0.5) + 1e-9
    # A segment that passes a centre this near goes through more than a corner of its cell.
    assert occupied[away < 0.03].all()
    assert (values[0] == -1).all()
    assert (values[:, -1] == -1).all()


def test_nothing_mapped_yet():
    grid = map_messages.tfg_grid(empty_map(), 0.0, FRAMES)
    assert (grid["info"]["width"], grid["info"]["height"], len(grid["data"])) == (0, 0, 0)
    assert len(map_messages.markers(0.0, FRAMES, [])["markers"]) == 1


def test_the_grid_of_a_grid(room):
    grid = map_messages.grid_of_cells(room.grid(), 5.0, FRAMES)
    assert list(grid["data"]) == [100, 0, -1, 0, 0, 100]
    assert (grid["info"]["width"], grid["info"]["height"], grid["info"]["resolution"]) == (3, 2, 0.1)
    assert grid["info"]["origin"]["position"] == {"x": -1.0, "y": 2.0, "z": 0.0}


def test_markers(room):
    shown = [*of_map(room.estimate(), room.tfg(), None), *of_choice(room.goal(), room.roadmap())]
    found = map_messages.markers(5.0, FRAMES, shown)["markers"]
    assert found[0]["action"] == map_messages.DELETE_ALL
    assert {one["header"]["frame_id"] for one in found} == {"m"}
    assert len({(one["ns"], one["id"]) for one in found[1:]}) == len(found) - 1
    by_name = {one["ns"]: one for one in found[1:]}

    def places(name):
        return [(one["x"], one["y"]) for one in by_name[name]["points"]]

    assert places("landmark") == [(-1.0, -1.52), (-2.02, 0.5)]
    assert [one["text"] for one in found[1:] if one["ns"] == "landmark labels"] == ["7", "12"]
    x = [x for x, _ in places("landmark_3sigma")[:48]]
    assert (min(x), max(x)) == pytest.approx((-1.06, -0.94), abs=1e-7)
    assert places("edge") == [(-2.02, -1.52), (0.5, -1.52)]
    assert {"wall_end", "bare_surface"} < set(by_name)
    assert np.mean(places("frontier"), axis=0)[1] == 0.0
    # The more gain the deeper.
    best, other = by_name["gain_5"], by_name["gain_3"]
    assert [one["points"][0]["y"] for one in (best, other)] == [0.0, 1.0]
    assert best["color"]["r"] < other["color"]["r"]
    assert places("goal") == [(0.3, 0.0)]


def test_walls_that_are_landmarks_are_markers(walled_map):
    found = map_messages.markers(5.0, FRAMES, of_map(None, None, walled_map.graph))["markers"]
    line, band = found[1:]
    assert [(one["x"], one["y"]) for one in line["points"]] == [(1.0, 1.0), (4.0, 5.0)]
    assert (line["ns"], band["ns"]) == ("wall_landmark", "wall_landmark_3sigma")
    assert line["color"]["a"] > band["color"]["a"] > 0.0


def test_no_goal_and_a_roadmap_of_another_stage(room):
    no_goal = replace(room.goal(), node=-1)
    found = map_messages.markers(5.0, FRAMES, of_choice(no_goal, replace(room.roadmap(), stage=2)))
    assert len(found["markers"]) == 1


def yaw(orientation):
    return 2.0 * math.atan2(orientation["z"], orientation["w"])


def test_path(room):
    message = map_messages.path(room.path(), 5.0, FRAMES)
    places = [one["pose"]["position"] for one in message["poses"]]
    assert [(p["x"], p["y"]) for p in places] == [(0.0, 0.0), (0.3, 0.0), (0.3, 0.4)]
    turns = [yaw(one["pose"]["orientation"]) for one in message["poses"]]
    assert turns == pytest.approx([0.0, 0.5 * math.pi, 0.5 * math.pi])
    for n in (0, 1):
        assert len(map_messages.path(replace(room.path(), points=np.zeros((n, 2))), 0.0, FRAMES)["poses"]) == n


def test_pose(room):
    pose = room.pose(8.0)
    message = map_messages.pose(pose, FRAMES)
    assert message["header"] == {"stamp": 8.0, "frame_id": "m"}
    assert yaw(message["pose"]["pose"]["orientation"]) == pytest.approx(0.6)
    covariance = np.array(message["pose"]["covariance"]).reshape(6, 6)
    np.testing.assert_array_equal(covariance[np.ix_((0, 1, 5), (0, 1, 5))], pose.covariance)
    assert np.count_nonzero(covariance) == 9


def test_the_transform_makes_the_estimate(room):
    pose, odometry = room.pose(8.0), room.odometry(8.0)
    (one,) = map_messages.map_to_odom(pose, odometry, FRAMES)["transforms"]
    assert (one["header"]["frame_id"], one["child_frame_id"]) == ("m", "o")
    at = one["transform"]
    X_MO = np.array([at["translation"]["x"], at["translation"]["y"], yaw(at["rotation"])])
    np.testing.assert_allclose(se2.compose(X_MO, odometry.X_OB), pose.X_MB, atol=1e-12)


def test_odometry_that_is_newer_than_the_estimate(room):
    """The robot has driven on: the frames stay where they were."""
    pose = replace(room.pose(8.0), speed=np.array([0.3, 0.5]))
    before = room.odometry(8.0)
    moved = np.array([0.3 * math.sin(0.05) / 0.5, 0.3 * (1.0 - math.cos(0.05)) / 0.5, 0.05])
    after = replace(before, stamp=8.1, X_OB=se2.compose(before.X_OB, moved))
    (one,), (other,) = (map_messages.map_to_odom(pose, each, FRAMES)["transforms"] for each in (before, after))
    assert other["header"]["stamp"] == 8.1
    for part, axes in (("translation", "xy"), ("rotation", "zw")):
        for axis in axes:
            assert one["transform"][part][axis] == pytest.approx(other["transform"][part][axis], abs=1e-4)

import dataclasses

import numpy as np
import pytest
import shapely
from scipy.stats import norm

from tests.arrays import frozen
from tfg_drake.config import (
    NODE_MARGIN,
    ExplorerConfig,
    OdometryConfig,
    PlannerConfig,
    RobotConfig,
    TagSensorConfig,
)
from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.polygon import hatched
from tfg_drake.geometry.se2 import compose, transform
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, MapEstimate, Observation, TfgMap, replace
from tfg_drake.planning import path as path_module
from tfg_drake.planning import routes as routes_module
from tfg_drake.planning.chance_constraint import required_clearance
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.path import path_is_free, plan_path, resample, round_corners, shortcut, unmapped_obstacles
from tfg_drake.planning.roadmap import (
    ACCEPTED,
    CHORD,
    DRIVEN_STEP,
    SPACING,
    TIGHT,
    chords,
    components,
    empty_roadmap,
    extend,
    in_free_space,
    passages,
    room_needed,
)
from tfg_drake.planning.routes import node_path, roadmap_message, routes
from tfg_drake.slam.keyframe_graph import empty_map

ROBOT = RobotConfig()
PLANNER = PlannerConfig()
PARAMETERS = PlanningParameters(ROBOT, TagSensorConfig(), OdometryConfig(), ExplorerConfig(), PLANNER, seed=3)


def two_rooms(door=0.8):
    """Walls of two rooms of 6 x 4 m with a door of this width in the wall x = 0 between them, in 0.5 m pieces."""
    half = door / 2
    walls = [(-6, -2, 6, -2), (6, -2, 6, 2), (6, 2, -6, 2), (-6, 2, -6, -2), (0, -2, 0, -half), (0, half, 0, 2)]
    pieces = []
    for x0, y0, x1, y1 in walls:
        t = np.linspace(0, 1, int(np.hypot(x1 - x0, y1 - y0) / 0.5) + 2)[:, None]
        p = (1 - t) * [x0, y0] + t * [x1, y1]
        pieces.append(np.hstack([p[:-1], p[1:]]))
    return np.vstack(pieces)


def observation():
    none = np.zeros((0, 2))
    return Observation(none[:, 0].astype(int), none[:, 0], np.zeros((0, 3)))


def known(segments, views, X_shift=(0.0, 0.0, 0.0)):
    """A map of everything that views at (x, y, heading) saw of these walls, with a tag on each piece; all shifted."""
    views = np.asarray(views, dtype=float)
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    stars = []
    for view in views:
        r = np.minimum(cast_rays(segments, view[:2], angles, 10.0), 10.0)[:, None]
        stars.append(view[:2] + r * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    middle = 0.5 * (segments[:, :2] + segments[:, 2:])
    nearest = views[np.argmin(np.linalg.norm(middle[:, None] - views[None, :, :2], axis=2), axis=1), :2]
    along = segments[:, 2:] - segments[:, :2]
    facing = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    facing *= np.sign(((nearest - middle) * facing).sum(1))[:, None]
    n, k = len(segments), len(views)
    shift = np.asarray(X_shift)
    turn = np.array([0.0, 0.0, shift[2]])
    X_MA = compose(shift, views)
    no_wall = np.zeros((n, 2))
    estimate = MapEstimate(
        k, 0.0, np.arange(n), transform(shift, middle), no_wall, no_wall, X_MA[-1], np.arange(n),
        1e-4 * np.eye(2 * n + 3), np.tile(1e-4 * np.eye(2), (n, 1, 1)), X_MA, observation(), 0.0,
    )  # fmt: skip
    ends = np.hstack([transform(shift, segments[:, :2]), transform(shift, segments[:, 2:])])
    none = np.zeros((0, 2))
    tfg = TfgMap(
        k, ends, np.zeros(n, dtype=int), np.zeros((n, 2), dtype=int), transform(turn, facing), none, none[:, 0], none,
        np.arange(k + 1) * len(angles), transform(shift, np.vstack(stars)), X_MA[:, :2],
    )  # fmt: skip
    return estimate, tfg


def build(segments, views, driven=None):
    """The roadmap of a robot that visited these views, stage by stage."""
    state = empty_roadmap()
    for k in range(1, len(views) + 1):
        estimate, tfg = known(segments, views[:k])
        state = extend(state, tfg, estimate, PARAMETERS, driven=driven if k == len(views) else None)
    return state, estimate, tfg


def nearest(state, place):
    return int(np.argmin(np.hypot(*(state.points - place).T)))


def test_finds_a_door_of_80_cm():
    segments = two_rooms(0.8)
    state, estimate, tfg = build(segments, [(-4, 1, 0)])
    reachable = np.isfinite(routes(state, tfg, estimate.X_MD, PARAMETERS).cost)
    assert reachable[state.points[:, 0] > 1].sum() > 3


def test_does_not_find_a_door_too_narrow():
    state, estimate, tfg = build(two_rooms(0.42), [(-4, 0.1, 0)])
    reachable = np.isfinite(routes(state, tfg, estimate.X_MD, PARAMETERS).cost)
    assert not reachable[state.points[:, 0] > 0.5].any()


def test_edges_keep_their_clearance_and_stay_in_the_free_space():
    state, _, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    nodes = state.edges.nodes[state.edges.usable]
    lines = shapely.linestrings(state.points[nodes])
    walls = shapely.multilinestrings(shapely.linestrings(tfg.segments.reshape(-1, 2, 2)))
    distance = shapely.distance(lines, walls)
    assert distance.min() >= ROBOT.radius + NODE_MARGIN
    need = ROBOT.radius + norm.isf(0.5 * ACCEPTED) * state.sigma[nodes].max(axis=1)
    np.testing.assert_array_less(need, distance + 1e-9)
    free = shapely.union_all([shapely.Polygon(v) for v in np.split(tfg.star_vertices, tfg.star_offsets[1:-1])])
    assert shapely.covers(free.buffer(0.3), lines).all()


def test_nodes_are_spread_evenly():
    state, _, _ = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    left = state.points[state.points[:, 0] < -1]
    gap = np.linalg.norm(left[:, None] - left[None], axis=2) + 9 * np.eye(len(left))
    assert gap.min() > 0.29
    assert np.median(gap.min(axis=1)) > 0.7
    cells = np.stack(np.meshgrid(np.arange(-5.5, -1, 0.5), np.arange(-1.5, 1.6, 0.5)), axis=-1).reshape(-1, 2)
    assert np.linalg.norm(cells[:, None] - left[None], axis=2).min(axis=1).max() < 1.0


def test_is_the_same_every_time():
    first, second = (build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])[0] for _ in range(2))
    for one, other in ((first, second), (first.edges, second.edges)):
        for name, value in vars(one).items():
            if name != "edges":
                np.testing.assert_array_equal(value, getattr(other, name))


def test_moves_with_the_map():
    views = [(-4, 1, 0), (3, 0.5, 1)]
    state, _, _ = build(two_rooms(), views)
    shift = np.array([0.4, -0.3, 0.2])
    moved_estimate, moved_tfg = known(two_rooms(), views, shift)
    moved = extend(state, moved_tfg, moved_estimate, PARAMETERS)
    n = len(state.points)
    np.testing.assert_allclose(moved.points[:n], transform(shift, state.points), atol=1e-9)


def test_a_door_that_is_a_little_too_narrow_is_taken_where_nothing_else_leads_behind_it():
    cautious = dataclasses.replace(PARAMETERS, planner=PlannerConfig(collision_probability=1e-4))
    reached = {}
    for width in (0.44, 0.5, 0.56):
        estimate, tfg = known(two_rooms(width), [(-4, 0, 0)])
        state = extend(empty_roadmap(), tfg, estimate, cautious)
        ways = routes(state, tfg, estimate.X_MD, cautious)
        reached[width] = bool((state.points[np.isfinite(ways.cost), 0] > 0.3).any())
        own = room_needed(cautious, state.sigma, 0.0)[state.edges.nodes].max(axis=1)
        through = np.sign(state.points[state.edges.nodes, 0]).prod(axis=1) < 0
        at_ease = through & state.edges.usable & (state.edges.clearance >= own)
        assert at_ease.any() == (width == 0.56)
    assert reached == {0.44: False, 0.5: True, 0.56: True}


@pytest.mark.parametrize(("tight", "through"), [(1.0, "narrow"), (TIGHT, "wide")])
def test_a_way_that_is_a_little_too_narrow_is_taken_only_where_any_other_is_much_longer(monkeypatch, tight, through):
    """A door of 50 cm straight ahead, and one of 1 m by which the way is 2.4 times as long."""
    walls = np.array(
        [[-3, -4, 3, -4], [3, -4, 3, 2], [3, 2, -3, 2], [-3, 2, -3, -4], [0, 2, 0, 0.25], [0, -0.25, 0, -2.5],
         [0, -3.5, 0, -4]], dtype=float
    )  # fmt: skip
    monkeypatch.setattr(routes_module, "TIGHT", tight)
    cautious = dataclasses.replace(PARAMETERS, planner=PlannerConfig(collision_probability=1e-4))
    estimate, tfg = known(walls, [(-1.2, 0, 0), (-1, -3, 0), (1.2, 0.0, 0)])
    state = extend(empty_roadmap(), tfg, estimate, cautious)
    X_MB = np.array([-2.6, 0.0, 0.0])
    ways = routes(state, tfg, X_MB, cautious)
    way = node_path(state, ways, X_MB, nearest(state, (1.2, 0.0)))
    assert len(way)
    assert ("narrow" if way[:, 1].min() > -1.5 else "wide") == through


def test_no_probability_squeezes_the_robot_through_what_is_hardly_wider_than_itself():
    """By that alone it would be: 2 cm to either side, more than a sure robot strays."""
    estimate, tfg = known(two_rooms(0.45), [(-4, 0, 0)])
    assert required_clearance(ROBOT.radius, np.array(0.0225), ACCEPTED) < 0.225 < ROBOT.radius + NODE_MARGIN
    state = extend(empty_roadmap(), tfg, estimate, PARAMETERS)
    message = roadmap_message(state, routes(state, tfg, estimate.X_MD, PARAMETERS), tfg, PARAMETERS)
    assert not (message.reachable | message.enterable)[message.points[:, 0] > 0.3].any()


def test_a_planner_that_asks_for_less_room_than_to_stand_gets_it():
    bold = dataclasses.replace(PARAMETERS, planner=PlannerConfig(collision_probability=0.15))
    sigma = np.array([0.02, 0.1])
    own = required_clearance(ROBOT.radius, sigma, 0.15)
    assert room_needed(bold, sigma, 0.0).tolist() == own.tolist()
    assert room_needed(bold, sigma, 0.2).tolist() == [own[0], required_clearance(ROBOT.radius, sigma, 0.2)[1]]


def test_what_was_travelled_stays_open_with_little_to_spare():
    segments = two_rooms(0.42)
    driven = resample(np.array([[-4.0, 0.1], [-1, 0], [1, 0], [3, 0]]), 0.1)
    state, estimate, tfg = build(segments, [(-4, 0.1, 0), (3, 0, 0)], driven)
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    assert np.isfinite(ways.cost[nearest(state, (-4, 0.1))])


def test_the_way_driven_goes_on_from_where_it_ended_though_the_map_has_moved():
    """Through a door with 8 cm to either side; the map moves by 20 cm a stage, and what was driven was noted before."""
    segments = two_rooms(0.52)
    views = [(-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    state, shift = empty_roadmap(), np.zeros(3)
    for k in range(1, len(views) + 1):
        driven = None
        if k > 1:
            driven = resample(transform(shift, np.array([views[k - 2][:2], views[k - 1][:2]])), 0.1)
            shift = shift + np.array([0.2, 0.02, 0.0])
        estimate, tfg = known(segments, views[:k], shift)
        state = extend(state, tfg, estimate, PARAMETERS, driven=driven)
    label = components(state.edges.nodes, state.edges.travelled, len(state.points))
    first, last = (nearest(state, X[:2]) for X in estimate.X_MA[[0, -1]])
    assert label[first] == label[last]
    # The way of a kidnapped robot is no way that it has driven.
    estimate, tfg = known(segments, [*views, (-2.0, 1.0, 0.0)], shift)
    state = extend(state, tfg, estimate, PARAMETERS, driven=driven)
    label = components(state.edges.nodes, state.edges.travelled, len(state.points))
    assert label[nearest(state, estimate.X_MA[-1, :2])] != label[last]


def test_a_way_that_the_map_now_finds_too_narrow_stays_open_as_the_robot_has_come_by_it():
    segments = two_rooms(0.37)
    driven = resample(np.array([[-4.0, 0.1], [-1, 0], [1, 0], [3, 0]]), 0.1)
    state, estimate, tfg = build(segments, [(-4, 0.1, 0), (3, 0, 0)], driven)
    assert np.isfinite(routes(state, tfg, estimate.X_MD, PARAMETERS).cost[nearest(state, (-4, 0.1))])
    estimate, tfg = known(segments, [(-4, 0.1, 0), (3, 0, 0), (-4, 1, 0)])
    state = extend(state, tfg, estimate, PARAMETERS)
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    assert np.isfinite(ways.cost[nearest(state, (3, 0))])


def test_a_door_that_shut_is_open_until_the_robot_has_tried_in_vain():
    driven = resample(np.array([[-4.0, 0.1], [-1, 0], [1, 0], [3, 0]]), 0.1)
    state, estimate, tfg = build(two_rooms(0.9), [(-4, 0.1, 0), (3, 0, 0)], driven)
    estimate, tfg = known(two_rooms(0.9), [(-4, 0.1, 0), (3, 0, 0), (2, 0, 0)])
    shut = replace(tfg, segments=np.vstack([tfg.segments, [[0.0, -0.45, 0.0, 0.45]]]))
    far = nearest(state, (-4, 0.1))
    reached, open_once = {}, {}
    for in_vain in (False, True):
        after = extend(state, shut, estimate, PARAMETERS, in_vain=in_vain)
        message = roadmap_message(after, routes(after, shut, estimate.X_MD, PARAMETERS), shut, PARAMETERS)
        reached[in_vain], open_once[in_vain] = bool(message.reachable[far]), bool(message.once_open[far])
    assert (reached, open_once) == ({False: True, True: False}, {False: False, True: True})


def test_a_door_that_is_left_ajar_is_too_narrow_and_has_not_shut():
    state, estimate, tfg = build(two_rooms(0.9), [(3, 0, 0), (-4, 0.1, 0)])
    far, told = nearest(state, (-4, 0.1)), {}
    for gap in (0.0, 0.15):
        ajar = replace(tfg, segments=np.vstack([tfg.segments, [[0.0, -0.45, 0.0, 0.45 - gap]]]))
        estimate, _ = known(two_rooms(0.9), [(3, 0, 0), (-4, 0.1, 0), (2, 0, 0)])
        after = extend(state, ajar, estimate, PARAMETERS)
        message = roadmap_message(after, routes(after, ajar, estimate.X_MD, PARAMETERS), ajar, PARAMETERS)
        told[gap] = bool(message.enterable[far]), bool(message.once_open[far])
    assert told == {0.0: (False, True), 0.15: (False, False)}


def test_an_edge_needs_what_the_robot_needs_at_the_end_where_it_knows_its_place_worse():
    state, estimate, tfg = build(two_rooms(0.8), [(-4, 0, 0)])
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    need = roadmap_message(state, ways, tfg, PARAMETERS).need
    assert (need >= ROBOT.radius + NODE_MARGIN - 1e-9).all()
    np.testing.assert_allclose(need[state.edges.nodes].max(axis=1), state.edges.required)


def test_tight_doors_driven_through_stay_open():
    doors = np.array([[0.0, -2.0, 0.0, -1.21], [0.0, -0.79, 0.0, 0.78], [0.0, 1.22, 0.0, 2.0]])
    walls = two_rooms()
    segments = np.vstack([walls[(walls[:, [0, 2]] != 0).any(axis=1)], doors])
    driven = resample(np.array([[-4.0, -1], [3, -1], [3, 1], [-4, 1]]), 0.1)
    state, _, _ = build(segments, [(-4, -1, 0), (-4, 1, 0)], driven)
    a, b = state.points[state.edges.nodes[state.edges.usable & state.edges.travelled]].transpose(1, 0, 2)
    crossing = a[:, 0] * b[:, 0] < 0
    assert set(np.sign(0.5 * (a + b)[crossing, 1])) == {-1.0, 1.0}


def test_routes_agree_with_their_own_path_and_prefer_room():
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    message = roadmap_message(state, ways, tfg, PARAMETERS)
    assert message.stage == 2
    reachable = message.reachable
    assert (message.enterable >= reachable).all()
    straight = np.hypot(*(state.points - estimate.X_MD[:2]).T)
    assert (ways.length[reachable] >= straight[reachable] - 1e-9).all()
    assert (ways.cost[reachable] >= ways.length[reachable] - 1e-9).all()
    assert (ways.time[reachable] >= ways.length[reachable] / ROBOT.max_speed).all()
    assert np.isinf(message.travel_time[~reachable]).all()


def test_a_lost_robot_may_not_pass_doors_that_it_would_fit_through():
    vague = TagSensorConfig(range_noise=0.5, bearing_noise=0.3)
    seen = {}
    for width in (0.42, 0.5, 0.65):
        estimate, tfg = known(two_rooms(width), [(-4, 0, 0)])
        state = extend(empty_roadmap(), tfg, estimate, dataclasses.replace(PARAMETERS, sensor=vague))
        message = roadmap_message(state, routes(state, tfg, estimate.X_MD, PARAMETERS), tfg, PARAMETERS)
        behind = message.points[:, 0] > 0.3
        seen[width] = [bool(w[behind].any()) for w in (message.reachable, message.enterable, message.entry >= 0)]
        beyond = behind & (message.entry >= 0) & ~message.reachable
        assert message.reachable[message.entry[beyond]].all()
        assert seen[width][0] or (message.points[message.entry[beyond], 0] < 0.3).all()
    assert seen == {0.42: [False, False, False], 0.5: [False, True, True], 0.65: [True, True, True]}


def test_a_robot_too_near_a_wall_is_not_trapped():
    state, _, tfg = build(two_rooms(), [(-4, 1, 0)])
    for place in ([-4, -1.9, 0.0], [-5.95, 1.95, 0.0], [-4, -2.0, 0.0]):
        assert np.isfinite(routes(state, tfg, np.array(place), PARAMETERS).cost).mean() > 0.5


def test_path_goes_through_the_door_with_room_to_spare():
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    node = nearest(state, (-5, -1))
    path = plan_path(state, estimate, tfg, estimate.X_MD, node, PARAMETERS)
    np.testing.assert_allclose(path[[0, -1]], [estimate.X_MD[:2], state.points[node]], atol=1e-9)
    step = np.hypot(*np.diff(path, axis=0).T)
    assert 0.05 < step.min() <= step.max() < 0.11
    walls = shapely.multilinestrings(shapely.linestrings(tfg.segments.reshape(-1, 2, 2)))
    line = shapely.LineString(path)
    assert line.distance(walls) > 0.25
    assert line.length < 1.15 * (np.hypot(3, 0.5) + np.hypot(5, 1))
    heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
    assert np.abs(np.diff(heading)).max() < np.radians(40)


def test_the_path_of_a_robot_that_drives_on_turns_off_where_it_could_stop():
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    X_MB, node = np.array([-4.0, 0.5, np.pi]), nearest(state, (-4, -1.5))
    first = {
        speed: plan_path(state, estimate, tfg, X_MB, node, PARAMETERS, speed=speed)[:4] - X_MB[:2] for speed in (0, 0.5)
    }
    stop = 0.5 * (1 / 16 + 0.25 / ROBOT.max_acceleration)
    assert np.abs(first[0][:, 0]).max() < 0.15
    assert first[0.5][:, 0].min() < -0.5 * stop
    assert abs(first[0.5][1, 1]) < 0.02
    # There is no room ahead, or the goal is nearer than that.
    for place, heading, goal in (((-5.7, 0.5), np.pi, (-4, -1.5)), ((-4.0, 0.5), 0.0, (-4, 0.6))):
        X_MB, node = np.array([*place, heading]), nearest(state, goal)
        paths = [plan_path(state, estimate, tfg, X_MB, node, PARAMETERS, speed=speed) for speed in (0.0, 0.5)]
        np.testing.assert_array_equal(*paths)


def test_a_shortcut_that_is_too_narrow_gives_way_to_the_edges_that_are_not(monkeypatch):
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    node = nearest(state, (-5, -1))
    short = plan_path(state, estimate, tfg, estimate.X_MD, node, PARAMETERS)
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    way = resample(node_path(state, ways, estimate.X_MD, node), 0.1)
    edges = shapely.LineString(way)
    assert edges.length > shapely.LineString(short).length

    def deviation(path, *_):
        off = np.array([edges.distance(shapely.Point(p)) for p in path])
        return np.where(off > 0.02, 2.0, 0.02)

    monkeypatch.setattr(path_module, "deviation_along", deviation)
    np.testing.assert_array_equal(plan_path(state, estimate, tfg, estimate.X_MD, node, PARAMETERS), way)


def test_no_path_to_where_no_edge_leads():
    state, estimate, tfg = build(two_rooms(0.42), [(-4, 0.1, 0)])
    cut_off = replace(state, edges=replace(state.edges, free=np.zeros_like(state.edges.free)))
    assert len(plan_path(cut_off, estimate, tfg, estimate.X_MD, nearest(state, (-0.6, -1)), PARAMETERS)) == 0
    assert len(plan_path(empty_roadmap(), estimate, tfg, estimate.X_MD, 0, PARAMETERS)) == 0


def test_shortcuts_and_rounding_lose_no_clearance():
    _, tfg = known(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    detour = np.array([[-5.0, 1.5], [-4, -1.2], [-3, 1.2], [-0.6, 0], [0.6, 0], [2, -1.4], [5, 0]])
    segments = tfg.segments.copy()
    short = shortcut(detour, tfg, segments, 0.35, 0.0)
    smooth = round_corners(short, segments, 0.35, 0.0)
    walls = shapely.multilinestrings(shapely.linestrings(tfg.segments.reshape(-1, 2, 2)))
    assert shapely.LineString(short).length < 0.8 * shapely.LineString(detour).length
    assert shapely.LineString(short).distance(walls) >= 0.35 - 1e-9
    assert shapely.LineString(smooth).distance(walls) >= 0.35 - 1e-9
    assert in_free_space(np.hstack([short[:-1], short[1:]]), tfg).all()


def scan_of(segments, X_MB):
    angles = np.linspace(-1.08, 1.08, 249)
    return LaserScan(0.0, angles, cast_rays(segments, X_MB[:2], angles + X_MB[2], 10.0), 10.0, 0.015)


@pytest.mark.parametrize(("offset", "free"), [(0.0, False), (0.15, False), (0.45, True)])
def test_an_unmapped_box_on_the_path_blocks_it_and_is_planned_round(offset, free):
    state, estimate, tfg = build(two_rooms(), [(-5, 0, 0)])
    node = nearest(state, (-1.2, 0))
    X_MB = np.array([-5.0, 0.0, 0.0])
    path = plan_path(state, estimate, tfg, X_MB, node, PARAMETERS)
    y = np.interp(-4.0, path[:, 0], path[:, 1]) + offset
    box = np.array([[-4.0, y - 0.15, -4.0, y + 0.15], [-4.0, y + 0.15, -3.7, y + 0.15]])
    X_MB = np.array([*path[0], np.arctan2(*(path[5] - path[0])[::-1])])
    assert path_is_free(path, scan_of(tfg.segments, X_MB), X_MB, ROBOT.radius, tfg.segments)
    scan = scan_of(np.vstack([tfg.segments, box]), X_MB)
    assert path_is_free(path, scan, X_MB, ROBOT.radius, tfg.segments) == free
    if free:
        return
    obstacles = unmapped_obstacles(path, scan, X_MB, ROBOT.radius, tfg.segments)
    around = plan_path(state, estimate, tfg, X_MB, node, PARAMETERS, obstacles)
    assert shapely.LineString(around).distance(shapely.LineString(box[0].reshape(2, 2))) > ROBOT.radius + 0.02
    assert path_is_free(around, scan, X_MB, ROBOT.radius, tfg.segments)


def test_returns_of_a_mapped_wall_do_not_block_a_door():
    _, _, tfg = build(two_rooms(0.5), [(-4, 0, 0)])
    path = resample(np.array([[-1.0, 0], [1, 0]]), 0.1)
    X_MB = np.array([-1.0, 0.0, 0.0])
    assert path_is_free(path, scan_of(two_rooms(0.46), X_MB), X_MB, ROBOT.radius, tfg.segments)
    assert not path_is_free(path, scan_of(two_rooms(0.26), X_MB), X_MB, ROBOT.radius, tfg.segments)


def test_to_a_bold_robot_only_what_it_would_touch_is_in_the_way():
    X_MB = np.array([-1.0, 0.0, 0.0])
    path = np.stack([np.linspace(-1.0, 2.0, 31), np.zeros(31)], axis=1)
    # A door as narrow as the robot and two centimetres, 10 cm from where the map has one.
    for door, free in ((0.38, True), (0.26, False)):
        scan = scan_of(two_rooms(door), X_MB)
        nothing = np.zeros((0, 4))
        assert not path_is_free(path, scan, X_MB, ROBOT.radius, nothing)
        assert path_is_free(path, scan, X_MB, ROBOT.radius, nothing, bold=True) == free


def test_passages_are_the_middle_of_narrow_gaps():
    segments = frozen(two_rooms(0.8))
    found, width = passages(segments, 0.5, 1.5)
    assert np.hypot(*found.T).min() < 1e-9
    assert np.hypot(*(found - [0.5, 0.0]).T).min() < 1e-9
    np.testing.assert_allclose(width[np.hypot(*found.T) < 1e-9], 0.8)
    for none, *limits in ((segments, 0.9, 0.95), (frozen(np.zeros((0, 4))), 0.5, 1.5)):
        found, width = passages(none, *limits)
        assert found.shape == (0, 2)
        assert width.shape == (0,)


def test_a_gap_between_an_end_and_the_side_of_a_wall_is_a_passage_too():
    segments = frozen([[-5.0, 0.0, 5.0, 0.0], [0.0, 0.8, 0.0, 3.0]])
    found, width = passages(segments, 0.5, 1.5)
    np.testing.assert_allclose(found, [[0.5, 0.4], [0.0, 0.4], [-0.5, 0.4]], atol=1e-12)
    np.testing.assert_allclose(width, 0.8)


def test_an_old_node_without_room_keeps_none_from_the_middle_of_a_narrow_door():
    state = replace(
        empty_roadmap(),
        anchor=np.zeros(1, dtype=int),
        p_AN=np.array([[0.0, 0.07]]) - [-4.0, 0.0],
        points=np.array([[0.0, 0.07]]),
        sigma=np.zeros(1),
    )
    estimate, tfg = known(two_rooms(0.5), [(-4, 0, 0)])
    state = extend(state, tfg, estimate, PARAMETERS)
    np.testing.assert_allclose(state.points[nearest(state, (0.0, 0.0))], [0.0, 0.0], atol=0.02)


def test_a_node_beside_the_way_through_a_narrow_door_keeps_none_from_it():
    beside = np.array([[-0.5, 0.2], [0.5, 0.2]])
    state = replace(
        empty_roadmap(),
        anchor=np.zeros(2, dtype=int),
        ids=np.arange(2),
        next_id=2,
        p_AN=beside - [-4.0, 0.0],
        points=beside,
        sigma=np.zeros(2),
    )
    estimate, tfg = known(two_rooms(0.48), [(-4, 0, 0)])
    state = extend(state, tfg, estimate, PARAMETERS)
    for x in (-0.5, 0.0, 0.5):
        np.testing.assert_allclose(state.points[nearest(state, (x, 0.0))], [x, 0.0], atol=0.02)


def test_an_empty_map_has_a_roadmap_of_open_space():
    none = np.zeros((0, 2))
    estimate = replace(empty_map(), stage=1, covariance=np.eye(3), X_MA=np.zeros((1, 3)))
    square = np.array([[-4.0, -4], [4, -4], [4, 4], [-4, 4]])
    tfg = TfgMap(
        1, np.zeros((0, 4)), np.zeros(0, dtype=int), np.zeros((0, 2), dtype=int), none, none, none[:, 0], none,
        np.array([0, 4]), square, np.zeros((1, 2)),
    )  # fmt: skip
    state = extend(empty_roadmap(), tfg, estimate, PARAMETERS)
    assert np.isfinite(routes(state, tfg, np.zeros(3), PARAMETERS).cost).mean() > 0.9


def test_the_way_driven_is_kept_by_chords_that_do_not_cut_its_corners():
    quarter = np.linspace(0.0, np.pi / 2, 40)
    way = np.vstack([np.stack([np.linspace(-2.0, 0.0, 21), np.full(21, -0.5)], axis=1),
                     0.5 * np.stack([np.sin(quarter), -np.cos(quarter)], axis=1)])  # fmt: skip
    way = resample(way, DRIVEN_STEP)
    picks = np.flatnonzero(chords(way))
    assert picks[[0, -1]].tolist() == [0, len(way) - 1]
    ends = way[picks]
    assert point_distance(way, np.hstack([ends[:-1], ends[1:]])).max() <= CHORD + 1e-9
    length = np.hypot(*np.diff(ends, axis=0).T)
    assert length.max() <= SPACING + 1e-9
    assert len(picks) < 12
    assert chords(way[:1]).tolist() == [True]


def test_a_tight_bend_once_driven_can_be_driven_back():
    """A dog-leg with 2 cm to spare: only the way as it was driven fits."""
    walls = np.array(
        [[-4.0, 0.21, -0.21, 0.21], [-0.21, 0.21, -0.21, 3.0], [-4.0, -0.21, 0.21, -0.21], [0.21, -0.21, 0.21, 3.0]]
    )
    corner = np.array([[-3.0, 0.0], [0.0, 0.0], [0.0, 2.5]])
    way = np.vstack([resample(corner[:2], 0.1), resample(corner[1:], 0.1)])
    state, estimate, tfg = build(walls, [(-3.0, 0.0, 0.0), (0.0, 2.5, 1.57)], way)
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    assert np.isfinite(ways.cost[nearest(state, (-3.0, 0.0))])


def test_the_risk_of_a_whole_path_does_not_keep_a_robot_where_it_is_shut_in():
    sure = dataclasses.replace(PARAMETERS, planner=dataclasses.replace(PLANNER, risk="path"))
    # It stands nearer to a wall than its radius and a margin; then in a door driven through that is too narrow by now.
    state, _, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    beside = np.array([-3.0, -2.0 + ROBOT.radius + 0.01, 1.57])
    assert np.isfinite(routes(state, tfg, beside, sure).cost[nearest(state, (-4, 1))])
    driven = resample(np.array([[-4.0, 0], [4, 0]]), 0.1)
    state, estimate, tfg = build(two_rooms(0.42), [(-4, 0, 0), (4, 0, 0)], driven)
    assert np.isfinite(routes(state, tfg, estimate.X_MD, sure).cost[nearest(state, (-4, 0))])


def test_a_path_keeps_the_risk_of_the_whole_by_a_detour_or_stays_away():
    state, estimate, tfg = build(two_rooms(0.8), [(-4, 0, 0), (4, 0, 0)])
    behind = nearest(state, (-3, 0))
    sure = dataclasses.replace(PARAMETERS, planner=dataclasses.replace(PLANNER, risk="path"))
    assert np.isfinite(routes(state, tfg, estimate.X_MD, sure).cost[behind])
    # The same door for a robot whose deviation takes a share of the whole risk at each point of the way through.
    doubtful = replace(state, sigma=np.full(len(state.points), 0.12))
    assert np.isfinite(routes(doubtful, tfg, estimate.X_MD, PARAMETERS).cost[behind])
    ways = routes(doubtful, tfg, estimate.X_MD, sure)
    assert not np.isfinite(ways.cost[behind])
    assert ways.predecessor[behind] == -1
    assert np.isfinite(ways.time[nearest(state, (3, 0))])


@pytest.mark.parametrize("seed", range(6))
def test_neither_roadmap_nor_path_enters_an_area_to_keep_out_of(seed):
    """Whatever its shape, wherever it lies; what was driven before the map moved under it does not lead through."""
    random = np.random.default_rng(seed)
    angles = np.arange(6) + random.uniform(0, 0.9, 6)
    spokes = random.uniform(0.3, 1.2, 6)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = random.uniform([-3, -1], [3, 1]) + spokes
    area, segments, views = shapely.Polygon(corners), two_rooms(), [(-5, 1.5, 0), (5, -1.5, 1)]
    driven = np.linspace(views[0][:2], views[1][:2], 80)
    state = empty_roadmap()
    for k in (1, 2):
        estimate, tfg = known(segments, views[:k])
        tfg = replace(tfg, keep_out=hatched([corners], ROBOT.radius))
        state = extend(state, tfg, estimate, PARAMETERS, driven=driven if k == 2 else None)
    nodes = shapely.distance(shapely.points(state.points), area)
    # Where the robot has driven there are nodes, too, but no way.
    sampled = shapely.distance(shapely.points(state.points), shapely.LineString(driven)) > 0.1
    assert (nodes[sampled] >= ROBOT.radius + NODE_MARGIN - 1e-9).all()
    edges = shapely.linestrings(state.points[state.edges.nodes[state.edges.usable]])
    assert len(edges)
    assert (shapely.distance(edges, area) >= ROBOT.radius).all()
    ways = routes(state, tfg, estimate.X_MD, PARAMETERS)
    reached = random.permutation(np.flatnonzero(np.isfinite(ways.cost)))[:12]
    paths = [plan_path(state, estimate, tfg, estimate.X_MD, node, PARAMETERS) for node in reached]
    paths = [shapely.LineString(points) for points in paths if len(points)]
    assert paths
    assert (shapely.distance(paths, area) >= ROBOT.radius).all()

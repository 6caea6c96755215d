"""The graph in known worlds: what it joins, that it moves with the map, where frontiers live and die."""

import dataclasses
import math

import numpy as np
import pytest

from tests.walls import no_walls
from tfg_drake.config import ExplorerConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry.distance import clearance, point_distance
from tfg_drake.geometry.se2 import transform
from tfg_drake.geometry.star import inside_any
from tfg_drake.messages import TfgMap, replace
from tfg_drake.planning.expected_view import expected_frontiers
from tfg_drake.table import empty, take
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.frontier import (
    PUSH,
    SPACING,
    find_frontiers,
    open_frontiers,
    place_points,
    points_of,
)
from tfg_drake.tfg.graph import (
    FACE_WORTH,
    empty_map,
    expects_tags,
    explored_elsewhere,
    resolve,
    update,
)
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import sample
from tfg_drake.tfg.stars import Stars
from tfg_drake.tfg.surfaces import EDGE, END, LOOSE

# Seven views that see all of the two rooms.
TOUR = np.array(
    [
        [2.0, 3.0, 0.3],
        [5.0, 4.5, 1.0],
        [7.2, 4.7, 2.0],
        [11.0, 5.0, 0.0],
        [10.8, 1.0, 1.0],
        [7.2, 1.0, -2.0],
        [1.0, 1.0, 0.0],
    ]
)


def _pieces(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points every 5 cm on the segments and the length of each."""
    points, _, _, start, stop = sample(
        np.arange(len(segments) + 1) * 2, np.ascontiguousarray(segments).reshape(-1, 2), 0.05
    )
    return points, stop - start


def test_an_empty_graph_resolves_to_an_empty_map(two_rooms) -> None:
    assert empty_map().stage == 0
    assert empty_map().frontier_length.sum() == 0.0
    two_rooms.observe(TOUR[0])
    with pytest.raises(ValueError, match="cannot take stage 1"):
        update(
            two_rooms.graph,
            two_rooms.estimate,
            two_rooms.panorama(TOUR[0]),
            two_rooms.tags,
            two_rooms.robot,
            two_rooms.explorer,
        )


def test_a_landmark_without_a_surface_is_an_obstacle(two_rooms) -> None:
    two_rooms.observe(TOUR[0])
    graph, estimate = two_rooms.graph, two_rooms.estimate
    post = np.array([1.5, 2.0])
    ids, n = np.append(estimate.ids, 10_000), len(estimate.ids)
    moved = replace(estimate, ids=ids, p_ML=np.vstack([estimate.p_ML, post]), **no_walls(n + 1))
    before = resolve(graph, estimate, two_rooms.robot, two_rooms.explorer)
    tfg = resolve(graph, moved, two_rooms.robot, two_rooms.explorer)
    assert len(tfg.facing) == n + 1
    assert len(tfg.segments) == len(before.segments) + 1
    assert (tfg.segments[-1].tolist(), tfg.segment_kind[-1]) == ([*post, *post], END)
    assert tfg.segment_ids[-1].tolist() == [10_000, -1]


def test_a_tour_maps_all_walls_and_nothing_else(two_rooms) -> None:
    for X_WA in TOUR:
        tfg = two_rooms.observe(X_WA)
        assert tfg.stage == two_rooms.estimate.stage
        points, length = _pieces(tfg.segments)
        assert length[point_distance(points, two_rooms.walls) > 0.1].sum() == 0.0
    wall_points, _ = _pieces(two_rooms.walls)
    assert (point_distance(wall_points, tfg.segments) < 0.1).all()
    assert len(tfg.frontiers) == 0
    inside = np.random.default_rng(0).uniform([0.1, 0.1], [11.9, 5.9], (300, 2))
    in_pillar = (np.abs(inside - [9.0, 3.0]) < 0.55).all(axis=1)
    near_wall = np.abs(inside[:, 0] - 6.0) < 0.1
    assert inside_any(inside[~in_pillar & ~near_wall], tfg.star_offsets, tfg.star_vertices).all()


def test_neighbouring_tags_are_joined_and_opposite_faces_never(two_rooms) -> None:
    for X_WA in TOUR:
        tfg = two_rooms.observe(X_WA)
    edges = {tuple(sorted(ids)) for ids in tfg.segment_ids[tfg.segment_kind == EDGE].tolist()}
    for a, b in edges:
        assert two_rooms.normal[a] @ two_rooms.normal[b] > -0.5
    # Every tag has two neighbours but for those at the free ends of the wall between the rooms.
    degree = np.bincount(np.array(list(edges)).ravel(), minlength=len(two_rooms.p_WT))[sorted(two_rooms.mapped)]
    assert (degree == 2).sum() >= len(degree) - 8
    assert (degree >= 1).all()
    assert degree.max() == 2


def test_surfaces_name_the_tags_that_they_join(two_rooms) -> None:
    tfg = two_rooms.observe(TOUR[0])
    assert {EDGE, END} <= set(tfg.segment_kind.tolist())
    known = tfg.segment_ids >= 0
    np.testing.assert_array_equal(known.sum(axis=1), 2 - tfg.segment_kind)
    assert (tfg.segment_ids[~known] == -1).all()


def test_facing_is_the_normal_of_the_tags_surface(two_rooms) -> None:
    for X_WA in TOUR:
        tfg = two_rooms.observe(X_WA)
    normal = two_rooms.normal[two_rooms.estimate.ids]
    assert (np.sum(tfg.facing * normal, axis=1) > np.cos(0.1)).all()


def test_surfaces_without_a_landmark_are_kept(two_rooms) -> None:
    two_rooms.tags = dataclasses.replace(two_rooms.tags, range=0.0)
    tfg = two_rooms.observe(TOUR[0])
    assert set(tfg.segment_kind.tolist()) == {LOOSE}
    assert (tfg.segment_ids == -1).all()
    points, _ = _pieces(tfg.segments)
    assert point_distance(points, two_rooms.walls).max() < 0.1


def test_everything_moves_with_the_map(two_rooms) -> None:
    for X_WA in TOUR[:3]:
        tfg = two_rooms.observe(X_WA)
    X_NM = np.array([3.0, -2.0, 2.5])
    moved = resolve(two_rooms.graph, two_rooms.moved(X_NM), two_rooms.robot, two_rooms.explorer)
    np.testing.assert_allclose(moved.segments[:, :2], transform(X_NM, tfg.segments[:, :2]), atol=1e-9)
    np.testing.assert_allclose(moved.segments[:, 2:], transform(X_NM, tfg.segments[:, 2:]), atol=1e-9)
    np.testing.assert_allclose(moved.star_vertices, transform(X_NM, tfg.star_vertices), atol=1e-9)
    turn = np.array([0.0, 0.0, X_NM[2]])
    np.testing.assert_allclose(moved.facing, transform(turn, tfg.facing), atol=1e-9)
    np.testing.assert_allclose(moved.frontiers, transform(X_NM, tfg.frontiers), atol=1e-6)
    np.testing.assert_allclose(moved.frontier_normal, transform(turn, tfg.frontier_normal), atol=1e-6)


def test_what_is_seen_on_a_wall_is_a_piece_of_it_and_follows_it(two_rooms) -> None:
    two_rooms.landmarks = np.array([[2.0, 0.0, 4.0, 0.0]])
    tfg = two_rooms.observe(TOUR[0])
    (on_wall,) = np.flatnonzero(tfg.segment_ids[:, 0] < -1)
    first = two_rooms.estimate.ids[0]
    assert (tfg.segment_ids[on_wall].tolist(), tfg.segment_kind[on_wall]) == ([first, first], EDGE)
    # As much as is seen of it, from its left, straight whatever the noise.
    np.testing.assert_allclose(tfg.segments[on_wall], [0.0, 0.0, 6.0, 0.0], atol=0.1)
    assert tfg.segments[on_wall, [1, 3]].tolist() == pytest.approx([0.0, 0.0], abs=1e-12)
    e = two_rooms.estimate
    # It turns about (2, 0).
    p_ML, turn = e.p_ML.copy(), math.atan(0.01)
    off = np.array([2.0, 0.0]) - e.anchor[0]
    angle = p_ML[0, 0] + turn
    p_ML[0] = angle, off @ [math.cos(angle), math.sin(angle)]
    moved = resolve(two_rooms.graph, dataclasses.replace(e, p_ML=p_ML), two_rooms.robot, two_rooms.explorer)
    x = moved.segments[on_wall, ::2]
    np.testing.assert_allclose(x, tfg.segments[on_wall, ::2], atol=2e-3)
    np.testing.assert_allclose(moved.segments[on_wall, 1::2], 0.01 * (x - 2.0), atol=1e-9)
    np.testing.assert_array_equal(
        moved.segments[tfg.segment_ids[:, 0] >= -1], tfg.segments[tfg.segment_ids[:, 0] >= -1]
    )


def test_pieces_of_one_wall_become_one_and_cover_what_was_seen_before(two_rooms) -> None:
    before = two_rooms.observe(TOUR[0])
    assert (before.segment_ids >= -1).all()
    two_rooms.landmarks = np.array([[2.0, 0.0, 4.0, 0.0]])
    for X_WA in TOUR[1:]:
        tfg = two_rooms.observe(X_WA)
    on_wall = tfg.segment_ids[:, 0] < -1
    # The door is in another wall; the lower walls of both rooms are one.
    np.testing.assert_allclose(tfg.segments[on_wall], [[0.0, 0.0, 12.0, 0.0]], atol=0.1)
    middle = 0.5 * (tfg.segments[~on_wall, :2] + tfg.segments[~on_wall, 2:])
    left = tfg.segments[~on_wall][middle[:, 1] < 0.05]
    assert (np.hypot(*(left[:, 2:] - left[:, :2]).T) < 0.1).all()


def test_a_tag_found_later_splits_the_edge_it_lies_on(simulate) -> None:
    world = simulate([[-3.0, 2.0, 3.0, 2.0]], spacing=2.0)
    middle = int(np.argmin(np.hypot(*(world.p_WT - [0.0, 1.99]).T)))
    hidden = world.normal[middle].copy()
    world.normal[middle] = -hidden
    before = world.observe(np.array([0.0, 0.0, 0.0]))
    world.normal[middle] = hidden
    after = world.observe(np.array([0.5, 0.0, 1.0]))
    assert middle not in before.segment_ids
    edges = {tuple(sorted(ids)) for ids in after.segment_ids[after.segment_kind == EDGE].tolist()}
    outer = sorted({i for pair in edges for i in pair} - {middle})
    assert edges == {tuple(sorted((outer[0], middle))), tuple(sorted((outer[1], middle)))}


def test_frontiers_lie_at_the_unexplored_door(two_rooms) -> None:
    tfg = two_rooms.observe(TOUR[0])
    assert tfg.frontier_length.sum() > 0.0
    in_next_room = tfg.frontiers[:, 0] > 6.0
    assert in_next_room.sum() > 5
    assert (tfg.frontiers[~in_next_room, 0] > 5.5).all()
    free_space = take(two_rooms.graph.frontiers, ~two_rooms.graph.frontiers.on_face)
    points = place_points(free_space, two_rooms.estimate.X_MA).p
    assert not inside_any(points, tfg.star_offsets, tfg.star_vertices).any()
    np.testing.assert_allclose(np.hypot(*tfg.frontier_normal.T), 1.0)


def test_the_back_of_a_thin_wall_must_be_looked_at(simulate) -> None:
    """From straight beside a wall's end neither face shows; from one side only one does."""
    world = simulate([[0.0, 0.0, 10.0, 0.0], [10.0, 0.0, 10.0, 6.0], [10.0, 6.0, 0.0, 6.0], [0.0, 6.0, 0.0, 0.0],
                      [4.0, 3.0, 8.0, 3.0]])  # fmt: skip
    world.observe(np.array([6.0, 1.0, 0.0]))
    world.observe(np.array([2.0, 3.0, 0.0]))
    tfg = world.observe(np.array([9.0, 3.0, 0.0]))
    behind = np.abs(tfg.frontiers - [6.0, 3.3]).max(axis=1) < 2.0
    assert tfg.frontier_length[behind].sum() > 2.0
    assert (tfg.frontier_normal[behind, 1] > 0.9).sum() > 5
    tfg = world.observe(np.array([6.0, 5.0, 0.0]))
    assert len(tfg.frontiers) == 0


def test_surface_seen_at_grazing_incidence_stays_a_frontier(simulate) -> None:
    """A corridor 9 m long: the far part of its sides shows no tag from the near end."""
    world = simulate([[0.0, 0.0, 9.0, 0.0], [9.0, 0.0, 9.0, 1.2], [9.0, 1.2, 0.0, 1.2], [0.0, 1.2, 0.0, 0.0]])
    tfg = world.observe(np.array([0.6, 0.6, 0.0]))
    assert (tfg.frontiers[:, 0] > 2.0).all()
    assert tfg.frontier_length.sum() > 6.0
    # In front of the sides, looking away from them; the last metre or two may be too slanted to be a surface at all.
    for y, side in ((0.3, 1.0), (0.9, -1.0)):
        ahead = (np.abs(tfg.frontiers[:, 1] - y) < 0.05) & (tfg.frontier_normal[:, 1] * side > 0.9)
        assert tfg.frontier_length[ahead].sum() > 3.0
    # A tag that could just be read may have been missed: how the side runs is not known as exactly.
    last_read = 0.6 + 0.6 * np.tan(TagSensorConfig().max_incidence)
    assert 2.0 < tfg.frontiers[:, 0].min() < last_read
    for x in (3.0, 6.0, 8.5):
        tfg = world.observe(np.array([x, 0.6, 0.0]))
    assert len(tfg.frontiers) == 0


def test_both_faces_of_a_thin_wall_seen_at_grazing_incidence_stay_frontiers(simulate) -> None:
    """Two corridors 9 m long, side by side, and their near ends joined."""
    world = simulate([[0.0, 0.0, 9.0, 0.0], [9.0, 0.0, 9.0, 2.4], [9.0, 2.4, 0.0, 2.4], [0.0, 2.4, 0.0, 0.0],
                      [1.2, 1.2, 9.0, 1.2]])  # fmt: skip
    world.observe(np.array([0.6, 0.6, 0.0]))
    tfg = world.observe(np.array([0.6, 1.8, 0.0]))
    for side in (1.0, -1.0):
        ahead = (np.abs(tfg.frontiers[:, 1] - 1.2 - 0.3 * side) < 0.05) & (tfg.frontier_normal[:, 1] * side > 0.9)
        assert tfg.frontier_length[ahead].sum() > 3.0


def test_the_sides_of_a_narrow_alley_can_be_inspected_from_its_middle(simulate) -> None:
    """An alley 4 m long and 0.5 m wide: what its sides show is seen from nowhere else."""
    sensor = TagSensorConfig()
    world = simulate([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 0.5], [4.0, 0.5, 0.0, 0.5], [0.0, 0.5, 0.0, 0.0]])
    tfg = world.observe(np.array([0.3, 0.25, 0.0]))
    assert tfg.frontier_length.sum() > 2.0
    middle = np.stack([np.arange(0.3, 3.8, 0.1), np.full(35, 0.25)], axis=1)
    assert set(expected_frontiers(middle, tfg, sensor).index) == set(range(len(tfg.frontiers)))
    for x in (1.1, 1.9, 2.7, 3.5):
        tfg = world.observe(np.array([x, 0.25, 0.0]))
    assert len(tfg.frontiers) == 0


def test_what_a_turn_sees_past_is_taken_out(two_rooms) -> None:
    """A box that is gone at the next goal leaves no surface behind."""
    walls = two_rooms.walls
    box = np.array([[2.0, 4.0, 3.0, 4.0], [3.0, 4.0, 3.0, 5.0], [3.0, 5.0, 2.0, 5.0], [2.0, 5.0, 2.0, 4.0]])
    two_rooms.walls = np.concatenate([walls, box])
    points, _ = _pieces(two_rooms.observe(TOUR[0]).segments)
    assert (point_distance(points, box) < 0.05).any()
    two_rooms.walls = walls
    points, _ = _pieces(two_rooms.observe(np.array([2.2, 2.6, 0.0])).segments)
    assert not (point_distance(points, box) < 0.05).any()


def test_the_graph_is_the_same_to_the_bit(two_rooms) -> None:
    first = [two_rooms.observe(X) for X in TOUR[:3]]
    two_rooms.rng, two_rooms.graph = np.random.default_rng(1), empty(TfgGraph)
    two_rooms.X_MA.clear()
    two_rooms.mapped.clear()
    second = [two_rooms.observe(X) for X in TOUR[:3]]
    for a, b in zip(first, second, strict=True):
        for field in dataclasses.fields(a):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))


def test_an_edge_that_a_turn_sees_through_is_broken(simulate) -> None:
    """A door opens in a wall whose two tags were joined: what is left are wall ends."""
    world = simulate([[-3.0, 2.0, 3.0, 2.0]], spacing=3.0)
    before = world.observe(np.array([0.0, 0.0, 0.0]))
    assert EDGE in before.segment_kind
    world.walls = np.array([[-3.0, 2.0, -0.5, 2.0], [0.5, 2.0, 3.0, 2.0]])
    after = world.observe(np.array([0.1, 0.0, 1.0]))
    assert EDGE not in after.segment_kind
    points, _ = _pieces(after.segments)
    assert point_distance(points, world.walls).max() < 0.15
    wall_points, _ = _pieces(world.walls)
    assert (point_distance(wall_points, after.segments) < 0.15).all()


def test_a_face_that_drifted_is_neither_refuted_nor_in_the_way(simulate) -> None:
    """A wall mapped from both sides, its far face 0.5 m too near: an error that the map holds possible."""
    world = simulate([[-4.0, 2.0, 4.0, 2.0]], spacing=1.0)
    world.observe(np.array([0.0, 5.0, 0.0]))
    far = world.normal[:, 1] > 0.0
    error = np.where(far, -0.5, 0.0)[:, None] * [[0.0, 1.0]]

    def far_face(tfg) -> float:
        """Length of what faces away from the second view within 0.1 m of where the far face is mapped, m."""
        along = tfg.segments[:, 2:] - tfg.segments[:, :2]
        y = world.p_WT[far][0, 1] + (0.0 if world.error is None else -0.5)
        which = (np.abs(tfg.segments[:, [1, 3]] - y).max(axis=1) < 0.1) & (along[:, 0] > 0.0)
        return float(np.hypot(*along[which].T).sum())

    for sigma, held in ((0.2, True), (1e-3, False)):
        world.error, world.sigma = error, np.where(far, sigma, 1e-3)
        graph, views = world.graph, list(world.X_MA)
        world.X_MA[0] = views[0] + [0.0, -0.5, 0.0]
        tfg = world.observe(np.array([0.0, 0.0, 0.0]))
        # It stands in what is seen free, so there is nothing there now ...
        assert far_face(tfg) == 0.0
        # ... until the map is corrected.
        world.error = None
        corrected = replace(world.estimate, p_ML=world.p_WT[world.estimate.ids], X_MA=np.array([*views, np.zeros(3)]))
        later = resolve(world.graph, corrected, RobotConfig(), ExplorerConfig())
        assert (far_face(later) > 6.0) == held
        world.graph, world.X_MA = graph, views


@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_lost_rays_free_nothing_behind_a_wall_of_the_map(two_rooms, lost) -> None:
    """All but one of the glances lose rays; what they see to be free is inside of the rooms."""
    rng, cast = np.random.default_rng(5), two_rooms.turn

    def losing(X_WA):
        scans, stamps, X_AB = cast(X_WA)
        share = lost if len(two_rooms.X_MA) > 1 else 0.0
        gone = [np.where(rng.random(len(scan.ranges)) < share, np.inf, scan.ranges) for scan in scans]
        return [replace(scan, ranges=ranges) for scan, ranges in zip(scans, gone, strict=True)], stamps, X_AB

    two_rooms.turn = losing
    two_rooms.observe(TOUR[0])
    for heading in np.arange(0.0, 6.0, 0.7):
        tfg = two_rooms.observe(np.array([2.0, 3.0, heading]), glance=True)
    low, high = two_rooms.walls.reshape(-1, 2).min(axis=0), two_rooms.walls.reshape(-1, 2).max(axis=0)
    assert (tfg.star_vertices > low - 0.05).all()
    assert (tfg.star_vertices < high + 0.05).all()
    assert (tfg.frontiers > low - PUSH - 0.05).all()
    assert (tfg.frontiers < high + PUSH + 0.05).all()


@pytest.mark.parametrize(
    ("wall", "is_open"),
    [
        ((0.1, -1.0, 0.1, 1.0), True),
        ((-0.1, 1.0, -0.1, -1.0), False),
        ((-0.3, 1.0, -0.3, -1.0), False),
        ((-0.4, -1.0, -0.4, 1.0), False),
    ],
    ids=["across the gap", "behind the edge", "near the point", "behind the point"],
)
def test_what_is_seen_through_a_gap_is_open_but_for_a_wall_between(wall, is_open) -> None:
    """The edge of the view is x = 0, and what is free begins on its right."""
    shadow = points_of(0, np.array([[-PUSH, 0.0]]), np.array([[1.0, 0.0]]), np.ones(1))
    assert open_frontiers(shadow, np.array([wall])).tolist() == [is_open]


@pytest.mark.parametrize("here", [0, 1])
def test_of_two_rooms_that_have_drifted_into_each_other_the_wall_of_the_nearer_stands(simulate, here) -> None:
    """One wall, 0.1 m thick, between y = -0.05 and 0.05, the lower room drifted by 0.4 m into the upper one."""
    rooms = [[(-4.0, -5.0), (4.0, -0.05)], [(-4.0, 0.05), (4.0, 5.0)]]
    walls = []
    for (x0, y0), (x1, y1) in rooms:
        walls += [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]
    world = simulate(walls, spacing=1.0)
    views = [np.array([0.0, -2.5, 0.0]), np.array([0.0, 2.5, 0.0])]
    for view in views if here == 1 else views[::-1]:
        world.observe(view)
    estimate = world.estimate
    p_ML, X_MA = estimate.p_ML.copy(), estimate.X_MA.copy()
    p_ML[p_ML[:, 1] < 0.0, 1] += 0.4
    X_MA[X_MA[:, 1] < 0.0, 1] += 0.4
    tfg = resolve(world.graph, replace(estimate, p_ML=p_ML, X_MA=X_MA), RobotConfig(), ExplorerConfig())
    along = tfg.segments[:, 2:] - tfg.segments[:, :2]
    length, faces = [], []
    for sign, y in ((-1.0, 0.35), (1.0, 0.05)):
        at = np.abs(tfg.segments[:, [1, 3]] - y).max(axis=1) < 0.05
        assert along[at].any(axis=1).all(), "no landmark of a wall is left as a post"
        length.append(float(np.hypot(*along[at & (sign * along[:, 0] > 0.0)].T).sum()))
        faces.append(tfg.facing[(np.abs(p_ML[:, 1] - y) < 0.05) & (np.abs(p_ML[:, 0]) < 3.0)].any(axis=1).mean())
    assert length[here] > 7.5
    assert length[1 - here] < 4.0
    assert faces[here] == 1.0
    assert faces[1 - here] < 0.5


@pytest.mark.parametrize("closed", [False, True])
def test_when_a_loop_closes_its_arms_settle_what_was_open(simulate, closed) -> None:
    """A passage whose second part is mapped when the first is taken to lie 50 m away; a view ends at 10 m. Then both
    are put where they are, known jointly or not."""
    world = simulate([[-30.0, 1.0, 30.0, 1.0], [30.0, -1.0, -30.0, -1.0]], noise=0.0)
    world.tags = dataclasses.replace(world.tags, range=5.0)
    world.observe(np.array([-6.0, 0.0, 0.0]))
    first = np.isin(np.arange(len(world.p_WT)), sorted(world.mapped))
    world.error = np.where(first, 50.0, 0.0)[:, None] * [[0.0, 1.0]]
    world.X_MA[0] = np.array([-6.0, 50.0, 0.0])
    world.observe(np.array([6.0, 0.0, 0.0]))
    world.error, world.X_MA[0] = None, np.array([-6.0, 0.0, 0.0])
    before = world.graph
    world.observe(np.array([18.0, 0.0, 0.0]))
    estimate = world.estimate
    if not closed:
        known = np.flatnonzero(estimate.p_ML[:, 0] > 6.0)
        keep = np.append(np.repeat(estimate.p_ML[:, 0] > 6.0, 2), np.ones(3, dtype=bool))
        estimate = replace(estimate, local=known, covariance=estimate.covariance[np.ix_(keep, keep)])
    settings = world.tags, world.robot, world.explorer
    graph = update(before, estimate, world.last_panorama, *settings)
    tfg = resolve(graph, estimate, world.robot, world.explorer)
    at = {round(float(x)) for x, y in tfg.frontiers if abs(y) < 0.8}
    assert {-16, 28} <= at
    assert 16 not in at
    assert at & {-4, 4} == (set() if closed else {-4, 4})


def test_a_frontier_is_explored_half_a_metre_inside_of_what_another_arm_saw(two_rooms) -> None:
    two_rooms.observe(np.array([3.0, 3.0, 0.0]))
    square = np.array([[1.0, 1.0], [5.0, 1.0], [5.0, 5.0], [1.0, 5.0]])
    p, outward = np.array([[4.6, 3.0], [4.4, 3.0], [5.2, 3.0]]), np.tile([-1.0, 0.0], (3, 1))
    points = place_points(points_of(0, p, outward, np.ones(3)), np.zeros((1, 3)))
    stars = Stars(np.array([0, 4]), square, np.array([[3.0, 3.0]]))
    assert explored_elsewhere(points, stars, two_rooms.estimate).tolist() == [False, True, False]


def test_where_a_glance_did_not_look_may_be_anything(two_rooms) -> None:
    """In the middle of the left room, to the right: the room goes on behind the borders of the view."""
    tfg = two_rooms.observe(np.array([3.0, 3.0, 0.0]), glance=True)
    half = 62.0 * np.pi / 180.0
    for side in (1.0, -1.0):
        border = np.array([np.cos(half), side * np.sin(half)])
        beyond = side * np.array([-border[1], border[0]])
        d = tfg.frontiers - [3.0, 3.0]
        on_border = (np.abs(d @ beyond - PUSH) < 0.02) & (d @ border > 0.0) & (d @ border < 3.2)
        assert tfg.frontier_length[on_border].sum() > 2.0
    assert not two_rooms.graph.frontiers.tries.any()
    # A look all round leaves only the door.
    assert (two_rooms.observe(np.array([3.0, 3.0, 0.0])).frontiers[:, 0] > 6.0).all()


def test_a_glance_is_no_attempt_at_what_it_did_not_settle(two_rooms) -> None:
    two_rooms.scan = ScanConfig(range=1.5)
    start = np.array([2.0, 3.0, 0.0])
    two_rooms.observe(start)
    two_rooms.put_frontiers(np.array([[1.7, 0.0]]))
    tried = two_rooms.graph.frontiers.tries.sum()
    two_rooms.observe(start, glance=True)
    assert two_rooms.graph.frontiers.tries.sum() == tried
    two_rooms.observe(start)
    assert two_rooms.graph.frontiers.tries.sum() > tried


def test_where_the_view_ends_in_the_open_is_a_frontier(simulate) -> None:
    """One wall and nothing else within range: the frontier is the arc at the end of the view."""
    tfg = simulate([[-3.0, 2.0, 3.0, 2.0]]).observe(np.array([0.0, 0.0, 0.5]))
    distance = np.hypot(*tfg.frontiers.T)
    far = distance > 10.0
    np.testing.assert_allclose(distance[far], 10.0 + PUSH, atol=1e-9)
    np.testing.assert_allclose(tfg.frontier_normal[far], -tfg.frontiers[far] / distance[far, None], atol=1e-9)
    behind_wall = 2.0 * np.arctan2(3.0, 2.0)
    np.testing.assert_allclose(tfg.frontier_length[far].sum(), (2.0 * np.pi - behind_wall) * 10.0, rtol=0.01)
    assert tfg.frontier_length[far].max() < 0.5


def test_a_shadow_is_as_long_as_it_is_and_lies_behind_the_nearer_surface() -> None:
    """A wall round the robot, 2 m off in front of it, from bearing 0 to pi, and 5 m off behind it."""
    angles = (np.arange(720) + 0.5) * np.pi / 360.0
    ranges = np.where(angles < np.pi, 2.0, 5.0)
    links = ranges == np.roll(ranges, -1)
    p, normal, length = find_frontiers(Panorama(angles, ranges, 10.0, 0.01), links, 2.9)
    np.testing.assert_allclose([length[p[:, 0] < 0.0].sum(), length[p[:, 0] > 0.0].sum()], 3.0, atol=0.01)
    np.testing.assert_allclose(p[:, 1], PUSH, atol=0.05)
    np.testing.assert_allclose(normal, np.tile([0.0, -1.0], (len(p), 1)), atol=0.02)
    assert len(find_frontiers(Panorama(angles, ranges, 10.0, 0.01), links, 3.1)[0]) == 0


def test_a_wall_farther_off_than_a_tag_is_seen_has_to_be_looked_at(simulate) -> None:
    for reach, missed in ((4.0, True), (8.0, False)):
        world = simulate([[-3.0, 5.0, 3.0, 5.0]])
        world.tags = dataclasses.replace(world.tags, range=reach)
        tfg = world.observe(np.array([0.0, 0.0, 0.0]))
        ahead = (np.abs(tfg.frontiers[:, 1] - 4.7) < 0.05) & (np.abs(tfg.frontiers[:, 0]) < 3.0)
        assert (tfg.frontier_length[ahead].sum() > 5.5) == missed
        assert ahead.any() == missed


def test_round_the_corner_of_a_face_there_is_another_to_look_at(simulate) -> None:
    world = simulate([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 1.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])
    tfg = world.observe(np.array([0.5, -3.0, 0.0]))
    ends = tfg.frontier_length == SPACING
    order = np.argsort(tfg.frontiers[ends, 0])
    np.testing.assert_allclose(tfg.frontiers[ends][order], [[-0.3, 0.15], [1.3, 0.15]], atol=0.1)
    np.testing.assert_allclose(tfg.frontier_normal[ends][order], [[-1.0, 0.0], [1.0, 0.0]], atol=0.1)
    tfg = world.observe(np.array([4.0, 0.5, 0.0]))
    ends = tfg.frontiers[tfg.frontier_length == SPACING]
    assert not (np.hypot(*(ends - [1.3, 0.15]).T) < 0.2).any()


def test_a_view_is_an_attempt_at_what_it_could_have_seen_and_each_makes_it_worth_less(simulate) -> None:
    """Frontiers in the open, out of the sensor's range and behind a wall, all farther off than the scanner sees."""
    world = simulate([[-3.0, 2.0, 3.0, 2.0]], scan=ScanConfig(range=2.5))
    at = np.array([[2.7, 0.0], [14.7, 0.0], [0.2, 4.0]])

    def length(tfg) -> list[float]:
        distance = np.hypot(*(tfg.frontiers[:, None] - at).transpose(2, 0, 1))
        assert (distance.min(axis=0) < 1e-9).all()
        return tfg.frontier_length[distance.argmin(axis=0)].tolist()

    world.observe(np.zeros(3))
    tfg = world.put_frontiers(at)
    assert not world.graph.frontiers.tries.any()
    np.testing.assert_allclose(length(tfg), [1.0, 1.0, 1.0])
    np.testing.assert_allclose(length(world.observe(np.zeros(3))), [4 / 9, 1.0, 1.0])
    np.testing.assert_allclose(length(world.observe(np.zeros(3))), [1 / 9, 1.0, 1.0])


def test_a_look_past_one_end_of_a_wall_is_no_attempt_but_through_a_slit_it_is(simulate) -> None:
    """A frontier 4 m ahead, farther than the scanner sees, just behind the end of a wall that the line of sight passes
    at this distance; with a second wall, between the ends of both."""

    def length(walls: list[list[float]]) -> float:
        world = simulate(walls, scan=ScanConfig(range=3.8))
        world.observe(np.zeros(3))
        world.put_frontiers(np.array([[4.0, 0.0]]))
        tfg = world.observe(np.zeros(3))
        return float(tfg.frontier_length[np.hypot(*(tfg.frontiers - [4.0, 0.0]).T).argmin()])

    for gap, expected in ((0.02, 1.0), (0.15, 4 / 9)):
        assert length([[3.7, gap, 3.7, 2.0]]) == pytest.approx(expected)
        assert length([[3.7, gap, 3.7, 2.0], [3.7, -2.0, 3.7, -gap]]) == pytest.approx(4 / 9)


def test_only_openings_that_the_robot_fits_through_and_that_were_tried_often_enough_are_given_up(simulate) -> None:
    world = simulate([[-3.0, 2.0, 3.0, 2.0]])
    world.observe(np.zeros(3))
    # A wide one, a narrow one, and another wide one that was tried less often.
    p = np.array([[0.0, -5.0], [0.4, -5.0], [4.0, -5.0], [-5.0, 0.0], [-5.0, 0.4]])
    n = len(p)
    points = points_of(0, p, np.tile([0.0, 1.0], (n, 1)), np.full(n, 0.3))
    graph = replace(world.graph, frontiers=replace(points, tries=np.array([3, 3, 3, 2, 2])))
    tfg = resolve(graph, world.estimate, RobotConfig(), ExplorerConfig(frontier_attempts=3))
    np.testing.assert_allclose(tfg.given_up, p[:2], atol=1e-9)
    np.testing.assert_allclose(tfg.given_up_length, 0.3)


def test_what_is_seen_twice_is_mapped_once(two_rooms) -> None:
    two_rooms.tags = dataclasses.replace(two_rooms.tags, range=0.0)
    totals = []
    for X_WA in ([2.0, 3.0, 0.3], [2.1, 3.0, 0.3], [2.0, 3.1, 2.0]):
        segments = two_rooms.observe(np.array(X_WA)).segments
        totals.append(np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum())
    assert max(totals) < 1.1 * totals[0]


def test_of_two_views_of_a_wall_without_tags_the_nearer_stands(simulate) -> None:
    far, near = np.array([0.0, 0.0, 0.0]), np.array([0.3, 1.5, 0.0])
    for order in ((far, near), (near, far)):
        world = simulate([[-1.5, 3.0, 1.5, 3.0]])
        world.tags = dataclasses.replace(world.tags, range=0.0)
        for X_WA in order:
            # From far it seems to be 6 cm nearer than it is.
            y = 2.94 if X_WA is far else 3.0
            world.walls = np.array([[-1.5, y, 1.5, y]])
            segments = world.observe(X_WA).segments
        np.testing.assert_allclose(segments[:, 1::2], 3.0, atol=0.04)


def test_a_wall_that_a_turn_sees_through_is_two_pieces_of_it(simulate) -> None:
    """A door opens in a wall."""
    world = simulate([[-3.0, 2.0, 3.0, 2.0]], landmarks=np.array([[1.0, 2.0, -1.0, 2.0]]))
    world.observe(np.array([0.0, 0.0, 0.0]))
    world.walls = np.array([[-3.0, 2.0, -0.5, 2.0], [0.5, 2.0, 3.0, 2.0]])
    tfg = world.observe(np.array([0.1, 0.0, 1.0]))
    assert (tfg.segment_ids < -1).all()
    ends = np.sort(tfg.segments[:, ::2], axis=None)
    np.testing.assert_allclose(ends, [-3.0, -0.5, 0.5, 3.0], atol=0.15)


def test_a_post_in_line_with_a_wall_is_no_piece_of_it(simulate) -> None:
    """Its front, 12 cm wide, stands on the wall's line, a metre beyond its end."""
    post = [[2.0, 2.0, 1.88, 2.0], [1.88, 2.0, 1.88, 2.12], [1.88, 2.12, 2.0, 2.12], [2.0, 2.12, 2.0, 2.0]]
    world = simulate([[-3.0, 2.0, 1.0, 2.0], *post], landmarks=np.array([[0.5, 2.0, -2.5, 2.0]]), noise=0.0)
    tfg = world.observe(np.array([1.0, 0.5, 1.0]))
    on_wall = tfg.segment_ids[:, 0] < -1
    assert (tfg.segments[on_wall, ::2] < 1.1).all()
    assert point_distance(np.array([[1.94, 2.0]]), tfg.segments[~on_wall])[0] < 0.05


def test_what_shows_of_the_far_face_of_a_hollow_wall_is_kept(simulate) -> None:
    """A door in a wall of two faces 13 cm apart, with nothing between them at its ends; one face is a landmark."""
    faces = [[-3.0, 0.0, -0.5, 0.0], [0.5, 0.0, 3.0, 0.0], [-3.0, -0.13, -0.5, -0.13], [0.5, -0.13, 3.0, -0.13]]
    world = simulate(faces, landmarks=np.array([[0.5, 0.0, 3.0, 0.0], [-3.0, 0.0, -0.5, 0.0]]))
    for x, y in ((0.0, 1.0), (0.0, 0.3)):
        tfg = world.observe(np.array([x, y, 0.0]))
    assert point_distance(np.array([[0.52, -0.13], [-0.52, -0.13]]), tfg.segments).max() < 0.05


def test_a_tag_without_a_surface_faces_where_it_was_seen_from(simulate) -> None:
    world = simulate([[-3.0, 2.0, 3.0, 2.0]])
    world.p_WT, world.normal = np.vstack([world.p_WT, [1.0, -3.0]]), np.vstack([world.normal, [0.0, 1.0]])
    tfg = world.observe(np.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(tfg.facing[-1], np.array([-1.0, 3.0]) / np.sqrt(10.0), atol=1e-9)


def test_surface_inspected_is_what_was_seen_well_enough_to_find_a_tag(simulate) -> None:
    """A corridor 9 m long from its near end: of its sides the near parts."""
    world = simulate([[0.0, 0.0, 9.0, 0.0], [9.0, 0.0, 9.0, 1.2], [9.0, 1.2, 0.0, 1.2], [0.0, 1.2, 0.0, 0.0]])
    near = world.observe(np.array([0.6, 0.6, 0.0])).inspected
    # Both ends, and of either side as far as a tag could be read for certain.
    read = 0.6 + 0.6 * np.tan(TagSensorConfig().max_incidence)
    assert 2.4 + 2.0 * 2.0 < near < 2.4 + 2.0 * read + 0.3
    for x in (3.0, 6.0, 8.5):
        tfg = world.observe(np.array([x, 0.6, 0.0]))
    assert tfg.inspected == pytest.approx(20.4, abs=0.5)


@pytest.mark.parametrize(
    ("inspected", "tags", "landmarks", "expects"),
    [
        (29.0, 0, "both", True),
        (31.0, 0, "both", False),
        (31.0, 1, "both", True),
        (31.0, 0, "tags", True),
        (1.0, 0, "walls", False),
    ],
)
def test_no_tag_is_expected_where_the_building_has_shown_none(inspected, tags, landmarks, expects) -> None:
    assert expects_tags(inspected, tags, landmarks) == expects


def test_surface_is_looked_at_for_tags_until_there_seem_to_be_none_and_again_when_one_turns_up(simulate) -> None:
    """A hall of 18 x 9 m without tags, seen from its west end, and in it a thin wall."""
    hall = [[0.0, 0.0, 18.0, 0.0], [18.0, 0.0, 18.0, 9.0], [18.0, 9.0, 0.0, 9.0], [0.0, 9.0, 0.0, 0.0],
            [10.0, 4.0, 10.0, 5.0]]  # fmt: skip
    world = simulate(hall)
    world.p_WT, world.normal, world.tags = np.zeros((0, 2)), np.zeros((0, 2)), TagSensorConfig(range=5.0)

    def for_tags(tfg: TfgMap) -> tuple[float, float]:
        """Length of frontier along the north wall and behind the thin one."""
        north = np.abs(tfg.frontiers[:, 1] - 8.7) < 0.05
        behind = (np.abs(tfg.frontiers - [10.2, 4.5]) < [0.2, 0.5]).all(axis=1)
        return tfg.frontier_length[north].sum(), tfg.frontier_length[behind].sum()

    few = world.observe(np.array([4.0, 4.5, 0.0]))
    assert few.inspected < 30.0
    assert for_tags(few)[0] > 1.0
    walls_only = dataclasses.replace(world.explorer, landmarks="walls")
    assert for_tags(resolve(world.graph, world.estimate, world.robot, walls_only))[0] == 0.0
    for x, y in ((4.0, 2.0), (4.0, 7.0), (8.0, 2.0), (8.0, 7.0), (9.9, 1.0), (9.9, 8.0)):
        none = world.observe(np.array([x, y, 0.0]))
    assert none.inspected > 30.0
    assert for_tags(none)[0] == 0.0
    # A face that nobody has seen is looked at nevertheless, for less.
    assert for_tags(none)[1] > 0.9 * FACE_WORTH
    world.p_WT, world.normal = np.array([[8.0, 9.0]]), np.array([[0.0, -1.0]])
    again = world.observe(np.array([8.0, 6.0, 0.0]))
    assert for_tags(again)[0] > 2.0
    assert for_tags(again)[1] > 0.5


@pytest.mark.parametrize("by_walls", [False, True])
def test_an_opening_that_was_seen_through_stays_open_at_grazing_incidence(simulate, by_walls) -> None:
    corridor = [[0, 0, 20, 0], [20, 0, 20, 2], [20, 2, 10.3, 2], [9.7, 2, 0, 2], [0, 2, 0, 0]]
    world = simulate([*corridor, [9.7, 2, 9.7, 5], [9.7, 5, 10.3, 5], [10.3, 5, 10.3, 2]])
    if by_walls:
        # Both sides of the door are on one line, and one landmark.
        world.landmarks = np.array([[20.0, 2.0, 0.0, 2.0], [0.0, 0.0, 20.0, 0.0]])
        world.p_WT, world.normal = np.zeros((2, 0, 2))
    through = np.array([[10.0, 1.5, 10.0, 2.5]])
    world.observe(np.array([10.0, 1.0, 0.5]))
    for x in np.arange(3.0, 17.5, 0.5):
        far = world.observe(np.array([x, 1.5, 0.0]))
        assert clearance(through, far.segments, 1.0)[0] > 0.2


def test_a_face_that_is_open_moves_with_the_view_that_saw_its_surface(simulate) -> None:
    # A room, and a passage next door, from which the room's walls are nearer than from within.
    room = [[-3.0, 0.2, 12.0, 0.2], [12.0, 0.2, 12.0, 3.0], [12.0, 3.0, -3.0, 3.0], [-3.0, 3.0, -3.0, 0.2]]
    world = simulate([*room, [-8.0, 0.0, 18.0, 0.0], [18.0, 0.0, 18.0, -1.0], [18.0, -1.0, -8.0, -1.0]])
    world.observe(np.array([-2.0, 1.6, 0.0]))
    world.observe(np.array([6.0, -0.5, 0.0]))
    faces = take(world.graph.frontiers, world.graph.frontiers.on_face)
    in_room = place_points(faces, np.array(world.X_MA)).p[:, 1] > 0.3
    assert in_room.any()
    assert set(faces.view[in_room].tolist()) == {0}

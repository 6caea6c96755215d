"""A roadmap split into submaps and merged again is the roadmap."""

import numpy as np
import pytest

from tests.planning.test_roadmap import PARAMETERS, PLANNER, ROBOT, build, known
from tfg_drake.messages import LaserScan, MissionStatus, PoseEstimate, WorkingMap, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.planner import grow, initial_state, step
from tfg_drake.planning.roadmap import extend
from tfg_drake.planning.roadmap_parts import empty_roadmaps, merged, split, whole_roadmap
from tfg_drake.planning.routes import routes
from tfg_drake.tfg.submaps import extended, rearranged, to_activate

CORRIDOR = np.array([[x, y, x + 1, y] for x in range(80) for y in (-1.0, 1.0)], dtype=float)
VIEWS = [(x, 0, 0) for x in range(3, 78, 4)]
FIELDS = ("ids", "anchor", "p_AN", "points", "sigma", "known_jointly")
COLUMNS = ("nodes", "travelled", "free", "clearance", "required", "usable")


@pytest.fixture(scope="module")
def roadmap():
    return build(CORRIDOR, VIEWS)


def same(a, b):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(a.edges, name), getattr(b.edges, name), err_msg=name)
    assert len(a.links) == len(b.links)
    assert a.next_id == b.next_id


def test_cut_and_joined_in_any_order_it_is_the_same(roadmap):
    state, _, _ = roadmap
    views = np.arange(len(VIEWS))
    first, middle = split(state, views, (views < 4) | (views > 12))
    assert len(first.links) > 0
    assert len(middle.links) == 0
    assert len(first.points) + len(middle.points) == len(state.points)
    some, rest = split(first, views[(views < 4) | (views > 12)], np.repeat([True, False], [4, 6]))
    # The links of either end stay with that end.
    assert len(some.links) > 0
    assert len(rest.links) > 0
    for parts in ((some, rest, middle), (middle, some, rest), (rest, middle, some)):
        same(state, merged(parts, []))
    partly = merged((rest, some), [])
    same(first, partly)


def test_a_part_knows_the_ways_within_it_and_the_whole_all(roadmap):
    state, _, tfg = roadmap
    views = np.arange(len(VIEWS))
    near, _ = split(state, views, views >= 12)
    X_MB = np.array([*VIEWS[-1][:2], 0.0], dtype=float)
    of_all, of_part = (routes(each, tfg, X_MB, ROBOT, PLANNER) for each in (state, near))
    at = np.searchsorted(state.ids, near.ids)
    reached = np.isfinite(of_part.cost)
    assert reached.mean() > 0.9
    np.testing.assert_allclose(of_part.cost[reached], of_all.cost[at][reached])
    assert np.isfinite(of_all.cost).mean() > 0.9


def test_what_rests_comes_back_where_the_map_has_moved_it():
    """Along the corridor and back, worked on within 20 m, a bar across it put up meanwhile where the robot began."""
    way = [*VIEWS, *VIEWS[::-1]]
    parts, bar = empty_roadmaps(), np.array([[5.5, -1.0, 5.5, 1.0]])
    sizes = []
    for k in range(1, len(way) + 1):
        walls = np.vstack([CORRIDOR, bar]) if k > len(VIEWS) else CORRIDOR
        estimate, tfg = known(walls, way[:k])
        active = to_activate(parts.submap, estimate.X_MA, 20.0)
        parts = rearranged(parts, active, split, merged)
        parts = extended(parts, extend(parts.active, tfg, estimate, PARAMETERS, views=np.flatnonzero(active)), k)
        sizes.append(len(parts.active.points))
        if k == len(VIEWS):
            far = whole_roadmap(parts, estimate.X_MA)
    names, count = np.unique(far.ids, return_counts=True)
    assert (count == 1).all()
    np.testing.assert_array_equal(names, np.arange(len(far.points)))
    assert max(sizes[: len(VIEWS)]) < 0.75 * len(far.points)

    def across(state):
        x = state.points[state.edges.nodes, 0]
        return (x.min(axis=1) < 5.5) & (x.max(axis=1) > 5.5)

    # Nobody could know of the bar from the far end; at its foot everybody does.
    assert far.edges.usable[across(far)].any()
    end = whole_roadmap(parts, estimate.X_MA)
    assert not end.edges.usable[across(end)].any()
    assert len(end.ids) == end.next_id
    moved = whole_roadmap(parts, np.add(estimate.X_MA, [3.0, 0.0, 0.0]))
    np.testing.assert_allclose(moved.points, np.add(end.points, [3.0, 0.0]), atol=1e-9)


@pytest.fixture(scope="module")
def far_end():
    """Planner's state, map, TFG and the active views at the far end of the corridor; the other views are inactive."""
    state = initial_state()
    for k in range(1, len(VIEWS) + 1):
        estimate, tfg = known(CORRIDOR, VIEWS[:k])
        active = to_activate(state.parts.submap, estimate.X_MA, 20.0)
        # These maps come without frontiers, though there is more of the corridor at every view.
        state = grow(replace(state, open_length=np.inf), WorkingMap(estimate, tfg, active), PARAMETERS)
    return state, estimate, tfg, active


def planned_to(node, far_end, reach=np.inf):
    """The state after the way to a node was planned, and how often all of the map was asked for."""
    state, estimate, tfg, active = far_end
    stage = len(estimate.X_MA)
    pose = PoseEstimate(0.0, estimate.X_MD, np.eye(3), np.zeros(2), stage, np.zeros(0, dtype=int), np.zeros((0, 2)))
    goal = replace(empty_choice(), stage=stage, node=int(node))
    mission, scan = MissionStatus("plan", stage, 0.0), LaserScan(0.0, np.zeros(0), np.zeros(0), 10.0, 0.01)
    working = WorkingMap(estimate, tfg, active, reach)
    asked = []
    planned = step(state, working, lambda: asked.append(1) or (estimate, tfg), pose, goal, scan, mission, PARAMETERS)
    return planned, len(asked)


def test_a_path_leads_to_a_goal_where_the_roadmap_is_inactive(far_end):
    state, estimate, _, _ = far_end
    everything = whole_roadmap(state.parts, estimate.X_MA)
    inactive = ~np.isin(everything.ids, state.nodes.ids)
    assert inactive.sum() > 30
    node = int(np.argmin(np.where(inactive, np.hypot(*(everything.points - [5.0, 0.0]).T), np.inf)))
    assert state.roadmap.nodes(everything.ids[[node]]) == [-1]
    planned, asked = planned_to(everything.ids[node], far_end)
    assert asked == 1
    np.testing.assert_allclose(planned.path.points[-1], everything.points[node], atol=1e-9)
    assert np.hypot(*np.diff(planned.path.points, axis=0).T).sum() < 80.0


def test_a_way_longer_than_the_working_map_reaches_is_planned_on_all_of_the_map(far_end):
    state, *_ = far_end
    node = int(np.argmin(np.abs(np.where(state.roadmap.reachable, state.roadmap.travel_length, np.inf) - 10.0)))
    name = state.roadmap.node_ids(np.array([node]))[0]
    (short, asked), (_, asked_far) = (planned_to(name, far_end, reach) for reach in (12.0, 8.0))
    assert (asked, asked_far) == (0, 1)
    np.testing.assert_allclose(short.path.points[-1], state.roadmap.points[node], atol=1e-9)

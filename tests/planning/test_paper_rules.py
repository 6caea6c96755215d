"""The paper's rules as printed."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from tests.arrays import frozen
from tests.walls import no_walls
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.messages import Roadmap
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.paper_rules import PaperRules, cost_of_edge, frontiers_between_landmarks, neighbours
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.graph import empty_map as empty_tfg

# A corridor along x, seen from its middle: three tags on either wall, ids 1 to 6, joined along it.
PLACES = np.array([[0.0, -1.0], [2.0, -1.0], [4.0, -1.0], [4.0, 1.0], [2.0, 1.0], [0.0, 1.0]])
FACING = np.repeat([[0.0, 1.0], [0.0, -1.0]], 3, axis=0)
JOINS = ((1, 2), (2, 3), (4, 5), (5, 6))


def tfg_of(joins, places=PLACES, facing=FACING):
    """Straight surfaces between landmarks; a landmark of id -1 is a corner at (6, -1)."""
    at = {i + 1: place for i, place in enumerate(places)} | {-1: np.array([6.0, -1.0])}
    segments = frozen([[*at[a], *at[b]] for a, b in joins])
    kind = np.zeros(len(joins), dtype=np.int64)
    return replace(
        empty_tfg(), segments=segments, segment_kind=kind, segment_ids=np.array(joins), facing=frozen(facing)
    )


def seen_from(p, tfg, places=PLACES):
    """Middles and sizes of the frontiers at p, m in M."""
    ids = np.arange(1, len(places) + 1)
    estimate = replace(
        empty_map(),
        ids=ids,
        p_ML=frozen(places),
        **no_walls(len(places)),
        local=np.arange(len(places)),
        X_MD=np.array([9.0, 9.0, 0.0]),
    )
    one, number = np.ones(1, dtype=bool), np.zeros(1, dtype=np.int64)
    roadmap = Roadmap(1, frozen([p]), np.zeros((0, 2), dtype=np.int64), one, one, number, np.zeros(1), np.zeros(1))
    parameters = PlanningParameters()
    now = frontiers_between_landmarks(Situation(estimate, tfg, roadmap, parameters))
    assert now.roadmap.frontier_offsets.tolist() == [0, len(now.tfg.frontiers)]
    np.testing.assert_allclose(np.hypot(*now.tfg.frontier_normal.T), 1.0)
    return sorted(zip(now.tfg.frontiers.tolist(), now.tfg.frontier_length.tolist(), strict=True))


def test_landmarks_at_the_ends_of_surfaces_border_frontiers():
    joined, borders = neighbours(tfg_of(JOINS), np.arange(1, 7), PLACES)
    assert sorted(zip(*np.nonzero(joined), strict=True)) == sorted(
        pair for a, b in JOINS for pair in ((a - 1, b - 1), (b - 1, a - 1))
    )
    assert borders.tolist() == [True, False, True, True, False, True]


def test_a_surface_that_goes_on_round_a_corner_joins():
    places, facing = np.vstack([PLACES[:3], [6.0, 1.0]]), np.vstack([FACING[:3], [-1.0, 0.0]])
    tfg = tfg_of([(1, 2), (2, 3), (3, -1), (-1, 4)], places, facing)
    joined, borders = neighbours(tfg, np.arange(1, 5), places)
    assert joined[2, 3]
    assert borders.tolist() == [True, False, False, True]


def test_the_open_ends_of_a_corridor_are_frontiers():
    assert seen_from([2.0, 0.0], tfg_of(JOINS)) == [([0.0, 0.0], 2.0), ([4.0, 0.0], 2.0)]


def test_what_is_joined_and_what_is_hidden_is_no_frontier():
    # A wall shuts the right end: its surface joins the tags there.
    shut = tfg_of([*JOINS, (3, 4)])
    assert seen_from([2.0, 0.0], shut) == [([0.0, 0.0], 2.0)]
    # A partition hides the tags of the left end; those that are next to each other then border none.
    hidden = replace(shut, segments=frozen([*shut.segments, [0.5, -1.0, 0.5, 1.0]]))
    hidden = replace(hidden, segment_kind=np.zeros(6, dtype=int), segment_ids=np.vstack([shut.segment_ids, [-1, -1]]))
    assert seen_from([2.0, 0.0], hidden) == []


def test_two_landmarks_are_the_ends_of_one_frontier_and_one_of_none():
    two = tfg_of([(1, -1), (2, -1)], PLACES[[2, 3]], FACING[[2, 3]])
    assert len(seen_from([2.0, 0.0], tfg_of([(1, 2)], PLACES[[2, 3]], FACING[[2, 3]]), PLACES[[2, 3]])) == 0
    two = replace(two, segment_ids=np.array([[-1, -1], [-1, -1]]))
    assert seen_from([2.0, 0.0], two, PLACES[[2, 3]]) == [([4.0, 0.0], 2.0)]
    assert seen_from([2.0, 0.0], tfg_of([(-1, -1)], PLACES[:1], FACING[:1]), PLACES[:1]) == []


def test_an_edge_costs_its_length_and_more_the_nearer_it_is_to_obstacles():
    cost = cost_of_edge(np.full(4, 2.0), np.array([0.2, 0.5, 1.0, 3.0]))
    assert cost == pytest.approx([2.96, 2.75, 2.0, 2.0])


def test_each_rule_that_is_left_out_leaves_the_scenario_as_it_was():
    scenario, changed = Scenario(), {}
    for rule in (field.name for field in dataclasses.fields(PaperRules)):
        only = ApplySettings(scenario, dataclasses.replace(PaperRules(*7 * [False]), **{rule: True}).settings())
        names = vars(only.explorer)
        changed[rule] = [name for name in names if names[name] != getattr(scenario.explorer, name)]
    assert changed == {
        "argmax": ["goal"],
        "theorem": ["gain"],
        "frontiers": [],
        "path_cost": [],
        "only_at_goals": ["glance_period", "path_keyframe_period"],
        "one_turn": ["first_look"],
        "only_landmarks": ["landmarks"],
    }

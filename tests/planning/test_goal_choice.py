import numpy as np
import pytest

from tests.walls import no_walls
from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.goal_choice import (
    _homewards,
    choose,
    choose_near,
    empty_choice,
    more_first_turns,
    pick,
    preferred,
)
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import with_frontiers
from tfg_drake.slam import keyframe_graph
from tfg_drake.tfg.graph import empty_map


def best(value, worth, time=None):
    time = np.arange(len(value)) if time is None else np.array(time)
    return pick(np.asarray(value, dtype=float), np.asarray(worth, dtype=bool), time)


def test_the_most_value_wins_and_the_soonest_reached_of_equals():
    assert best([3, 2, 4, 4], [1, 1, 1, 1]) == 2
    assert best([3, 4, 4, 4], [1, 1, 1, 0], time=[1, 9, 2, 1]) == 2


def test_only_what_is_worth_going_to_is_picked():
    assert best([9, 1], [0, 1]) == 1
    assert best([9, 1], [0, 0]) == -1
    assert best([], []) == -1


def test_places_that_see_enough_known_tags_are_preferred_where_there_are_any():
    open_to, tags = np.array([True, True, True, False]), np.array([7, 8, -1, 9])
    np.testing.assert_array_equal(preferred(open_to, tags, 8), [False, True, True, False])
    np.testing.assert_array_equal(preferred(open_to, tags, 0), open_to)
    np.testing.assert_array_equal(preferred(open_to, np.array([7, 3, 2, 9]), 8), open_to)


def test_a_place_that_the_rule_does_not_want_is_picked_only_where_no_other_is_left():
    assert best([-np.inf, -5], [1, 1]) == 1
    assert best([-np.inf, -5], [1, 0]) == 0
    assert best([-5, -np.inf], [0, 1]) == 1


def homewards(reachable, entry, looked=()):
    """What ends a complete mission at home, (0, 0), for a robot 2 m away on a line of nodes a metre apart."""
    points, reachable = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array(reachable, dtype=bool)
    names, no_edges = np.array([4, 7, 9]), np.zeros((0, 2), dtype=np.int64)
    roadmap = Roadmap(1, points, no_edges, reachable, reachable, np.array(entry), *2 * [np.zeros(3)], ids=names)
    estimate = replace(keyframe_graph.empty_map(), X_MA=np.zeros((1, 3)), X_MD=np.array([2.0, 0.0, 0.0]))
    parameters = PlanningParameters(explorer=ExplorerConfig(return_home=True))
    now = Situation(estimate, empty_map(), roadmap, parameters)
    node, verdict, reason, after = _homewards(now, "complete", "Done.", np.array(looked, dtype=int))
    return node, verdict, reason, after.tolist()


def test_a_mission_ends_at_home():
    assert homewards([1, 1, 1], [0, 1, 2]) == (0, "complete", "Done.", [])


def test_where_the_way_home_is_too_narrow_the_robot_looks_at_it_once_more_and_is_stuck_then():
    again = "The way home is too narrow: it looks once more."
    assert homewards([0, 1, 1], [1, 1, 2]) == (1, "goal", again, [7])
    stuck = "Done. But the robot cannot get back to where it began."
    assert homewards([0, 1, 1], [1, 1, 2], [7]) == (-1, "stuck", stuck, [7])
    assert homewards([0, 1, 1], [-1, 1, 2]) == (-1, "stuck", stuck, [])


def test_the_first_look_has_more_turns_the_less_a_frame_tells_up_to_twice_as_many():
    assert [more_first_turns(worth, ExplorerConfig(first_turns=3)) for worth in (1.0, 0.5, 0.25, 0.05)] == [0, 1, 3, 3]


def alcoves(lengths, at=0.0, known_badly=(), is_large=False, unreachable=(), stamp=0.0, **options):
    """A robot at (at, 0) on a way along y = 0, with a place before each of some alcoves, whose middles are keys of
    `lengths`: so many metres of frontier are open at the back of each, which is seen from no other place.

    known_badly: alcoves with a tag at the back whose place is known to 10 m.
    """
    x, tags = np.array(sorted({*lengths, at})), np.array(sorted(known_badly), dtype=float)
    n = len(tags)
    estimate = replace(
        keyframe_graph.empty_map(),
        stage=1,
        stamp=stamp,
        ids=np.arange(n),
        p_ML=np.column_stack([tags, np.full(n, 6.0)]),
        **no_walls(n),
        local=np.arange(n),
        covariance=np.diag([100.0] * 2 * n + [1e-8] * 3),
        landmark_covariance=np.tile(100.0 * np.eye(2), (n, 1, 1)),
        X_MA=np.array([[at, 0.0, 0.0]]),
        X_MD=np.array([at, 0.0, 0.0]),
    )
    sides = (-0.6, -0.2, 0.2, 0.6)
    opened = [(middle + side, length) for middle, length in lengths.items() for side in sides if length]
    places = np.array([[x, 6.0] for x, _ in opened]).reshape(-1, 2)
    tfg = replace(
        empty_map(),
        stage=1,
        segments=np.array([[x + side, 1.0, x + side, 9.0] for x in lengths for side in (-1.5, 1.5)]),
        facing=np.tile([0.0, -1.0], (n, 1)),
        frontiers=places,
        frontier_length=np.array([length / 4 for _, length in opened]),
        frontier_normal=np.tile([0.0, -1.0], (len(places), 1)),
    )
    distance, reachable = np.abs(x - at), ~np.isin(x, unreachable)
    edges = np.stack([np.arange(len(x) - 1), np.arange(1, len(x))], axis=1)
    entry = np.where(reachable, np.arange(len(x)), -1)
    way = np.where(reachable, distance, np.inf)
    everywhere = np.ones(len(x), dtype=bool)
    points = np.column_stack([x, np.zeros(len(x))])
    roadmap = Roadmap(1, points, edges, reachable, everywhere, entry, way / 0.5, way, ids=10 * np.arange(1, len(x) + 1))
    parameters = PlanningParameters(explorer=ExplorerConfig(**options))
    roadmap = with_frontiers(roadmap, estimate, tfg, parameters)
    return Situation(estimate, tfg, roadmap, parameters, is_large)


def place_of(node, now):
    """Where the node of this id is, m along the way."""
    return float(now.roadmap.points[now.roadmap.nodes(np.array([node]))[0], 0])


@pytest.mark.parametrize(
    ("rule", "goal"),
    # 1 m is open 4 m to the left, 4 m are 5 m to the right. By gain, and by gain over time, the right is worth more;
    # a tour ends at what is farthest from the robot, and the left is nearer.
    [("argmax", 5.0), ("gain_per_time", 5.0), ("nearest_frontier", -4.0), ("tour", -4.0)],
)
def test_a_rule_chooses_the_goal_that_it_is_named_for(rule, goal):
    now = alcoves({-4.0: 1.0, 5.0: 4.0}, goal=rule)
    choice = choose(now, empty_choice())
    assert (choice.verdict, place_of(choice.node, now)) == ("goal", goal)
    np.testing.assert_array_equal(choice.p_MG, [goal, 0.0])
    # It looks to the back of the alcove.
    assert len(choice.look) == 4
    assert np.abs(choice.look - 0.5 * np.pi).max() < 0.11
    # The robot's own place is no candidate.
    assert len(choice.candidates) == 2
    assert not choice.is_explored


def test_a_tour_visits_all_that_is_open_and_ends_at_what_is_farthest():
    # Left, right, far right: back and forth once only. The other way round it would drive 8 m more.
    now = alcoves({-4.0: 1.0, 5.0: 1.0, 9.0: 1.0})
    choice = choose(now, empty_choice())
    assert [place_of(node, now) for node in choice.tour] == [-4.0, 5.0, 9.0]
    stay = -choice.value[choice.candidates == choice.node][0] - 4.0 / 0.5
    np.testing.assert_allclose(np.sort(-choice.value), [8.0 + stay, 8.0 + 18.0 + 2 * stay, 26.0 + 8.0 + 3 * stay])


def test_a_tour_does_not_turn_round_on_a_large_map_before_it_is_done_with_what_is_near():
    # What came into sight at -8 is the end of the tour now: first right, then left.
    lengths = {-8.0: 1.0, -4.0: 1.0, 5.0: 1.0}
    before = replace(empty_choice(), node=20)
    for is_large, goal in ((False, 5.0), (True, -4.0)):
        now = alcoves(lengths, is_large=is_large)
        assert place_of(before.node, now) == -4.0
        assert place_of(choose(now, before).node, now) == goal


@pytest.mark.parametrize(("length", "verdict"), [(0.4, "complete"), (0.5, "goal")])
def test_a_sliver_is_left(length, verdict):
    # Of what is 6 m off the view goes on behind it for 4 m of the 5 m that count in full.
    assert choose(alcoves({-4.0: length}), empty_choice()).verdict == verdict


def test_what_cannot_be_reached_leaves_the_mission_stuck():
    choice = choose(alcoves({-4.0: 3.0, 4.0: 0.0}, unreachable=[-4.0]), empty_choice())
    assert (choice.verdict, choice.node) == ("stuck", -1)
    assert choice.reason == "Frontier is left behind passages too narrow for the uncertainty of the map."


@pytest.mark.parametrize(
    ("metres", "verdict", "goal"),
    # 3 m are kept in reserve.
    [(50.0, "goal", 9.0), (10.0, "goal", -4.0), (5.0, "budget", None)],
)
def test_a_goal_is_chosen_within_the_budget(metres, verdict, goal):
    now = alcoves({-4.0: 1.0, 9.0: 9.0}, goal="argmax", budget_distance=metres)
    choice = choose(now, empty_choice())
    assert choice.verdict == verdict
    assert goal is None or place_of(choice.node, now) == goal


def test_where_nothing_is_open_the_robot_looks_again_where_a_tag_is_known_badly():
    # A turn before the tag to the right takes nearly all of the error off; before the others it takes nothing.
    now = alcoves({-4.0: 0.0, 3.0: 0.0, 5.0: 0.0}, known_badly=[5.0], stamp=100.0)
    choice = choose(now, empty_choice())
    assert (choice.verdict, place_of(choice.node, now)) == ("goal", 5.0)
    assert choice.reason == "All is explored, but the map grows more accurate yet: it looks round once more."
    assert choice.explored == 100.0
    # The error falls by all of it but a hundredth in the time of the way and a turn: that share of the error over that
    # of the time.
    sensor, explorer = now.parameters.sensor, now.parameters.explorer
    time = 10.0 + (2.0 * np.pi - sensor.field_of_view) / explorer.turn_rate + 1.0
    np.testing.assert_allclose(choice.value, 0.99 * (100.0 + time) / time, rtol=2e-3)
    # Looks that have given none of it are no longer believed.
    assert choose(now, empty_choice(), kept=0.1).verdict != "goal"
    # What is open comes first.
    assert place_of(choose(alcoves({-4.0: 1.0, 3.0: 0.0, 5.0: 0.0}), empty_choice()).node, now) == -4.0


def test_of_a_large_map_it_is_known_after_one_look_more_where_that_is():
    now = alcoves({-4.0: 0.0, 3.0: 0.0, 5.0: 0.0}, known_badly=[5.0], stamp=100.0, is_large=True)
    first = choose(now, replace(empty_choice(), looked_again=np.array([7])))
    assert (first.verdict, first.node, first.explored, first.looked_again.tolist()) == ("look", -1, 100.0, [7])
    assert first.is_explored
    assert place_of(choose(now, first).node, now) == 5.0
    # By what is near alone it is not asked.
    assert choose_near(alcoves({-4.0: 0.0}, is_large=True), empty_choice(), 20.0) is None

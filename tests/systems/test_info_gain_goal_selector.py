import dataclasses

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from scipy.linalg import block_diag

from tests.walls import known_at_their_ends, no_walls, walls_between
from tfg_drake.config import ExplorerConfig, TagSensorConfig
from tfg_drake.messages import WALLS_BELOW, MissionStatus, Roadmap, TfgMap
from tfg_drake.planning.budget import MARGIN, RESERVE_TIME
from tfg_drake.planning.candidates import time_all_round, time_at_goal
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import with_frontiers
from tfg_drake.planning.requested_goal import RequestedGoal
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector

NONE = np.zeros((0, 2))
IDS = np.zeros(0, dtype=np.int64)
HALF_TURN = time_at_goal(TagSensorConfig(), ExplorerConfig())
WHOLE_TURN = time_all_round(TagSensorConfig(), ExplorerConfig())


def empty_tfg():
    return TfgMap(0, np.zeros((0, 4)), IDS, IDS.reshape(0, 2), NONE, NONE, NONE[:, 0], NONE, np.zeros(1, dtype=int),
                  NONE, NONE)  # fmt: skip


def half_known_room():
    """Three tagged walls round the origin; the west is unknown."""
    estimate = dataclasses.replace(
        empty_map(), stage=1, ids=np.arange(3), p_ML=np.array([[0.0, -4], [4, 0], [0, 4]]),
        **no_walls(3), local=np.arange(3), covariance=1e-2 * np.eye(9), X_MA=np.zeros((1, 3)),
    )  # fmt: skip
    tfg = dataclasses.replace(
        empty_tfg(),
        stage=1,
        segments=np.array([[-4.0, -4, 4, -4], [4, -4, 4, 4], [4, 4, -4, 4]]),
        facing=np.array([[0.0, 1], [-1, 0], [0, -1]]),
        frontiers=np.stack([np.full(15, -4.35), np.linspace(-3.5, 3.5, 15)], axis=1),
        frontier_length=np.full(15, 0.5),
        frontier_normal=np.tile([1.0, 0.0], (15, 1)),
    )
    return estimate, tfg


def roadmap(stage=1):
    points = np.stack(np.meshgrid(np.arange(-3.0, 4), np.arange(-3.0, 4)), axis=-1).reshape(-1, 2)
    if stage == 0:
        points = NONE
    reachable = points[:, 1] <= 1.0
    time = np.where(reachable, np.hypot(*points.T) / 0.5, np.inf)
    entry = np.where(reachable, np.arange(len(points)), -1)
    return Roadmap(stage, points, IDS.reshape(0, 2), reachable, reachable, entry, time, time)


class Selector:
    def __init__(self, **explorer):
        config = ExplorerConfig(**explorer)
        self.system = InfoGainGoalSelector(PlanningParameters(explorer=config))
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.now = {}
        self.set(map=empty_map(), tfg=empty_tfg(), roadmap=roadmap(0),
                 mission=MissionStatus("observe", 0, 0.0))  # fmt: skip

    def set(self, **messages):
        """All of the map is near."""
        self.now |= messages
        self.fix(**messages, local_roadmap=self.now["roadmap"])

    def fix(self, **messages):
        for name, value in messages.items():
            self.system.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))

    def goal(self):
        self.simulator.AdvanceTo(self.context.get_time() + 0.25)
        return self.system.GetOutputPort("goal").Eval(self.context)

    def ready(self, **changes):
        estimate, tfg = half_known_room()
        now = {"map": estimate, "tfg": tfg, "roadmap": roadmap(), "mission": MissionStatus("choose", 1, 0.0), **changes}
        now["roadmap"] = with_frontiers(now["roadmap"], now["map"], now["tfg"], PlanningParameters())
        self.set(**now)


def test_chooses_nothing_before_everything_is_ready():
    selector = Selector()
    assert selector.goal().stage == 0
    selector.ready(roadmap=roadmap(0))
    assert selector.goal().stage == 0
    selector.ready(mission=MissionStatus("map", 0, 0.0))
    assert selector.goal().stage == 0


def test_chooses_the_best_reachable_node_once():
    selector = Selector()
    selector.ready()
    goal = selector.goal()
    assert (goal.stage, goal.verdict) == (1, "goal")
    points = roadmap().points
    np.testing.assert_array_equal(goal.p_MG, points[goal.node])
    np.testing.assert_array_equal(goal.gain, goal.exploitation + goal.exploration)
    best = int(np.argmax(goal.value))
    assert goal.candidates[best] == goal.node
    assert goal.exploration[best] > 50
    assert goal.pose_price[best] > 0
    assert roadmap().reachable[goal.candidates].all()
    assert np.hypot(*points[goal.candidates].T).min() >= 0.3
    assert selector.goal() is goal


def test_somebody_sends_the_robot_to_another_place():
    alone, selector = Selector(), Selector()
    points = roadmap().points
    reachable = np.flatnonzero(roadmap().reachable)
    alone.ready()
    node = int(reachable[reachable != alone.goal().node][0])
    selector.ready(requested_goal=RequestedGoal(1, points[node] + 0.01))
    goal = selector.goal()
    assert (goal.node, goal.verdict, goal.reason) == (node, "goal", "Somebody has sent the robot there.")
    np.testing.assert_array_equal(goal.gain, alone.goal().gain)


def test_where_frames_tell_less_than_they_seem_the_first_look_goes_on():
    estimate, _ = half_known_room()
    selector = Selector()
    selector.ready(map=dataclasses.replace(estimate, frame_worth=0.25))
    assert (selector.goal().verdict, selector.goal().node) == ("look", -1)


def test_a_closed_and_certain_map_is_complete():
    estimate, tfg = half_known_room()
    selector = Selector()
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    selector.ready(map=dataclasses.replace(estimate, covariance=1e-6 * np.eye(9)), tfg=closed)
    goal = selector.goal()
    assert (goal.verdict, goal.node) == ("complete", -1)


@pytest.mark.parametrize(
    ("variance", "settings", "verdict"),
    [
        (1e-3, {}, "goal"),
        (1e-6, {}, "complete"),
        (1e-3, {"revisit": False}, "complete"),
        (1e-3, {"goal": "nearest_frontier"}, "complete"),
        (1e-3, {"budget_time": 110.0}, "complete"),
        # The nearest places are 2 s away; a second look takes a whole turn, not half of one.
        (1e-3, {"budget_time": 100.1 + 2 * MARGIN + RESERVE_TIME + HALF_TURN}, "complete"),
        (1e-3, {"budget_time": 100.1 + 2 * MARGIN + RESERVE_TIME + WHOLE_TURN}, "goal"),
    ],
)
def test_when_all_is_explored_the_robot_looks_again_where_that_makes_the_map_more_accurate(variance, settings, verdict):
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, stamp=100.0, covariance=variance * np.eye(9))
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    selector = Selector(**settings)
    selector.ready(map=estimate, tfg=closed)
    goal = selector.goal()
    assert goal.verdict == verdict
    assert goal.explored == 100.0
    assert goal.gain.max() < ExplorerConfig().stop_gain
    if verdict == "goal":
        assert goal.candidates.tolist() == [goal.node]
        assert goal.value[0] > 1.0
        assert len(goal.look) == 0


@pytest.mark.parametrize(("revisit", "by_nats"), [(True, False), (False, True)])
def test_where_nothing_is_open_accuracy_comes_before_nats(revisit, by_nats):
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, stamp=100.0, covariance=1e-3 * np.eye(9))
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    selector = Selector(revisit=revisit, stop_gain=0.1)
    selector.ready(map=estimate, tfg=closed)
    goal = selector.goal()
    assert goal.verdict == "goal"
    assert ("nats are expected" in goal.reason) == by_nats
    assert (len(goal.candidates) > 1) == by_nats
    # What is still open comes first.
    selector = Selector(revisit=revisit, stop_gain=0.1)
    selector.ready(map=estimate)
    assert "nats are expected" in selector.goal().reason


def test_what_was_explored_stays_so_until_something_opens():
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, covariance=1e-3 * np.eye(9))
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    selector, explored = Selector(), []
    for stage, seen in enumerate((closed, closed, tfg, closed), 1):
        now = {"map": dataclasses.replace(estimate, stage=stage, stamp=100.0 * stage)}
        now |= {"tfg": dataclasses.replace(seen, stage=stage), "roadmap": roadmap(stage)}
        selector.ready(**now, mission=MissionStatus("choose", stage, 0.0))
        explored.append(selector.goal().explored)
    assert explored == [100.0, 100.0, np.inf, 400.0]


@pytest.mark.parametrize(("variance", "verdict"), [(1e-3, "goal"), (1e-6, "complete")])
def test_of_a_large_map_the_robot_looks_once_before_it_knows_where_to_look_again(variance, verdict):
    estimate, tfg = half_known_room()
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    # Not all of it is known jointly.
    estimate = dataclasses.replace(estimate, local=np.arange(2), covariance=variance * np.eye(7))
    selector, goals = Selector(), []
    for stage in (1, 2):
        now = {"map": dataclasses.replace(estimate, stage=stage, stamp=100.0 * stage), "roadmap": roadmap(stage)}
        selector.ready(**now, tfg=dataclasses.replace(closed, stage=stage), mission=MissionStatus("choose", stage, 0.0))
        goals.append(selector.goal())
    assert [goal.verdict for goal in goals] == ["look", verdict]
    assert [goal.explored for goal in goals] == [100.0, 100.0]
    if verdict == "goal":
        assert goals[1].value[0] > 1.0


def test_an_empty_world_has_no_goal_but_a_verdict():
    estimate, tfg = (dataclasses.replace(message, stage=1) for message in (empty_map(), empty_tfg()))
    selector = Selector()
    selector.ready(map=dataclasses.replace(estimate, covariance=np.eye(3) * 1e-4, X_MA=np.zeros((1, 3))), tfg=tfg)
    goal = selector.goal()
    assert (goal.verdict, goal.gain.max()) == ("complete", 0.0)


@pytest.mark.parametrize(("driven", "verdict"), [(11.0, "complete"), (49.0, "complete"), (51.0, "stuck")])
def test_where_nothing_was_seen_on_a_long_way_the_mission_ends(driven, verdict):
    """However many views there were of it: most are glances on the way."""
    estimate, tfg = (dataclasses.replace(message, stage=9) for message in (empty_map(), empty_tfg()))
    selector = Selector()
    estimate = dataclasses.replace(estimate, covariance=np.eye(3) * 1e-4, X_MA=np.zeros((9, 3)))
    mission, there = MissionStatus(phase="choose", stage=9, since=0.0), dataclasses.replace(roadmap(9), driven=driven)
    selector.ready(map=estimate, tfg=tfg, roadmap=there, mission=mission)
    goal = selector.goal()
    assert (goal.verdict, goal.node) == (verdict, -1)
    nothing = "Neither a landmark nor a surface was seen on 51 m of way: there is nothing to map."
    assert (goal.reason == nothing) == (verdict == "stuck")


def test_where_nothing_was_ever_seen_the_robot_comes_home_all_the_same():
    selector, X_MD = Selector(return_home=True), np.array([2.0, 0.0, 0.0])
    estimate, tfg = (dataclasses.replace(message, stage=5) for message in (empty_map(), empty_tfg()))
    estimate = dataclasses.replace(estimate, covariance=np.eye(3) * 1e-4, X_MA=np.zeros((5, 3)), X_MD=X_MD)
    selector.ready(map=estimate, tfg=tfg, roadmap=dataclasses.replace(roadmap(5), driven=60.0),
                   mission=MissionStatus("choose", 5, 0.0))  # fmt: skip
    goal = selector.goal()
    assert (goal.verdict, goal.node >= 0) == ("stuck", True)
    np.testing.assert_array_equal(goal.p_MG, [0.0, 0.0])


def test_no_goal_is_chosen_where_the_robot_has_turned_before():
    _, tfg = half_known_room()
    first = Selector()
    first.ready()
    best = first.goal()
    square = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    assert best.node in best.candidates
    # A look all round, a glance that shows hardly anything to one side, and the same glance again and again.
    for nearest, times, candidate in ((1.0, 1, False), (0.01, 1, True), (0.01, 5, True), (0.01, 6, False)):
        star = best.p_MG + square * np.array([1.0, 1.0, 1.0, nearest])[:, None]
        looked = dataclasses.replace(
            tfg,
            star_offsets=4 * np.arange(times + 1),
            star_vertices=np.tile(star, (times, 1)),
            star_centers=np.tile(best.p_MG, (times, 1)),
        )
        again = Selector()
        again.ready(tfg=looked)
        assert (best.node in again.goal().candidates) == candidate


def test_on_its_way_the_robot_is_not_turned_round_by_what_comes_into_sight_far_away():
    estimate, tfg = half_known_room()
    # A large map: not all of it is known jointly.
    estimate = dataclasses.replace(estimate, local=np.arange(2), covariance=1e-2 * np.eye(7))
    # Three corridors side by side, open in the west, in the east and, the one in the middle, in the south.
    x, y = np.full(15, 4.35), np.linspace(-3.5, 3.5, 15)
    sides = np.array([[-1.0, -4, -1, 4], [1.0, -4, 1, 4]])
    frontiers = {"west": np.stack([-x, y], axis=1), "east": np.stack([x, y], axis=1)}
    frontiers["south"] = np.stack([np.linspace(-0.5, 0.5, 15), -x], axis=1)
    normals = {"west": [1.0, 0.0], "east": [-1.0, 0.0], "south": [0.0, 1.0]}

    def corridors(stage, *names):
        return dataclasses.replace(
            tfg,
            stage=stage,
            segments=np.vstack([tfg.segments[2:], sides]),
            frontiers=np.vstack([frontiers[name] for name in names]),
            frontier_length=np.full(15 * len(names), 0.5),
            frontier_normal=np.repeat([normals[name] for name in names], 15, axis=0),
        )

    there = roadmap()
    column = np.select([there.points[:, 0] < -1.0, there.points[:, 0] > 1.0], ["west", "east"], "south")
    time = np.select([column == "west", column == "east"], [20.0, 40.0], 200.0)
    for still_open, goes_on in ((["west"], True), ([], False)):
        of_all = dataclasses.replace(there, travel_time=np.where(there.reachable, time, np.inf))
        selector = Selector()
        selector.ready(map=estimate, tfg=corridors(1, "west"), roadmap=of_all)
        before = selector.goal().node
        assert column[before] == "west"
        # A tour that ends in the south, the farthest of all, may well begin in the east.
        selector.ready(
            map=dataclasses.replace(estimate, stage=2),
            tfg=corridors(2, *still_open, "east", "south"),
            roadmap=dataclasses.replace(of_all, stage=2),
            mission=MissionStatus("choose", 2, 1.0),
        )
        goal = selector.goal()
        assert (goal.node == before) == goes_on
        assert column[goal.node] == ("west" if goes_on else "east")
        assert (np.cos(goal.look) < 0.0 if goes_on else np.cos(goal.look) > 0.0).all()


def test_a_goal_by_a_way_longer_than_to_what_is_not_near_is_weighed_against_all_of_the_map():
    there = roadmap()
    # By what is near alone the robot would go elsewhere.
    other = dataclasses.replace(there, travel_time=np.where(there.reachable, 40.0 - there.travel_time, np.inf))
    chosen = []
    for length in (19.0, 21.0):
        selector = Selector(goal="nearest_frontier")
        selector.ready(map=large_room()[0])
        here = dataclasses.replace(other, travel_length=np.full(len(there.points), length))
        selector.fix(local_roadmap=with_frontiers(here, *large_room(), PlanningParameters()))
        chosen.append(selector.goal().node)
    alone = Selector(goal="nearest_frontier")
    alone.ready()
    assert chosen[1] == alone.goal().node
    assert chosen[0] != chosen[1]


def test_a_tour_is_planned_over_the_places_that_see_enough_known_tags():
    _, tfg = half_known_room()
    behind_a_wall = dataclasses.replace(tfg, segments=np.vstack([tfg.segments, [[-1.5, -4.0, -1.5, 0.5]]]))
    for least_tags in range(4):
        selector = Selector(goal="tour", least_tags=least_tags)
        selector.ready(tfg=behind_a_wall)
        goal = selector.goal()
        value = goal.value[goal.candidates == goal.node]
        assert -np.inf < value == goal.value.max()


def test_a_pose_is_paid_for_by_the_length_of_the_way_there_too():
    prices = []
    for longer in (1.0, 20.0):
        there = roadmap()
        selector = Selector()
        selector.ready(roadmap=dataclasses.replace(there, travel_length=longer * there.travel_length))
        prices.append(selector.goal().pose_price)
    # Where a bound tells that a candidate cannot be the best, its price is not asked for.
    judged = (prices[0] > 0.0) & (prices[1] > 0.0)
    assert judged.any()
    assert (prices[1] > prices[0])[judged].all()


def test_no_goal_is_chosen_where_the_robot_is():
    estimate, _ = half_known_room()
    first = Selector()
    first.ready()
    best = first.goal()
    again = Selector()
    again.ready(map=dataclasses.replace(estimate, X_MD=np.append(best.p_MG, 0.0)))
    assert best.node not in again.goal().candidates


def test_a_goal_says_where_to_look_for_what_is_open():
    _, tfg = half_known_room()
    selector = Selector()
    selector.ready()
    goal = selector.goal()
    towards = tfg.frontiers - goal.p_MG
    bearings = np.arctan2(towards[:, 1], towards[:, 0])
    assert len(goal.look)
    assert np.abs(goal.look[:, None] - bearings).min(axis=1).max() < 1e-9


def test_an_opening_tried_in_vain_counts_only_where_the_robot_can_come_up_to_it():
    estimate, tfg = half_known_room()
    tfg = dataclasses.replace(
        tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE, given_up_length=np.array([0.8]),
        given_up_normal=np.array([[1.0, 0.0]]),
    )  # fmt: skip
    crack = np.array([[-3.4, -4.0, -3.4, -0.15], [-3.4, 0.15, -3.4, 4.0]])
    cracked = np.vstack([tfg.segments, crack])
    for place, segments, verdict in (
        ([-4.35, 0.0], tfg.segments, "stuck"),
        ([-4.35, 0.0], cracked, "complete"),
        ([-9.0, 0.0], tfg.segments, "complete"),
    ):
        selector = Selector()
        known = dataclasses.replace(estimate, covariance=1e-6 * np.eye(9))
        selector.ready(map=known, tfg=dataclasses.replace(tfg, segments=segments, given_up=np.array([place])))
        assert selector.goal().verdict == verdict


def test_a_sliver_of_frontier_is_not_worth_a_visit():
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, covariance=1e-6 * np.eye(9))
    for total, verdict in ((0.3, "complete"), (0.4, "goal")):
        selector = Selector()
        selector.ready(map=estimate, tfg=dataclasses.replace(tfg, frontier_length=np.full(15, total / 15)))
        assert selector.goal().verdict == verdict


def test_a_sliver_far_off_promises_more_than_nothing_as_the_robot_finds_its_place_again_on_its_way():
    estimate, tfg = half_known_room()
    sliver = dataclasses.replace(tfg, frontier_length=np.full(15, 0.03))
    far = np.array([100.0, 80.0, 2.0])
    estimate = dataclasses.replace(
        estimate, X_MD=far, local=np.zeros(0, dtype=np.int64), covariance=np.diag([1.0, 1.0, 0.01])
    )
    there = roadmap()
    selector = Selector()
    selector.ready(map=estimate, tfg=sliver, roadmap=dataclasses.replace(there, travel_time=there.travel_time + 250.0))
    goal = selector.goal()
    assert goal.verdict == "goal"
    assert len(goal.gain) > 10
    assert goal.gain.min() > 0.0
    assert (goal.pose_price == 0.0).all()
    assert (goal.exploitation == 0.0).all()


def large_room(stage=1):
    """The room as a part of a large map: not all of it is known jointly. What is known is known well."""
    estimate, tfg = (dataclasses.replace(message, stage=stage) for message in half_known_room())
    return dataclasses.replace(estimate, local=np.arange(2), covariance=1e-6 * np.eye(7)), tfg


def western_nodes(stage=1, sees=True):
    """A third of the roadmap's nodes; they see what is open, or nothing."""
    part = named(roadmap(stage), np.flatnonzero(roadmap().points[:, 0] < -1.0))
    if sees:
        return with_frontiers(part, *large_room(stage), PlanningParameters())
    return dataclasses.replace(part, frontier_offsets=np.zeros(len(part.points) + 1, dtype=np.int64))


def named(of, nodes):
    """Some nodes of a roadmap, by the names they have in it."""
    fields = ("points", "reachable", "enterable", "entry", "travel_time", "travel_length")
    return dataclasses.replace(of, **{name: getattr(of, name)[nodes] for name in fields}, ids=nodes)


def at_stage(stage):
    """All that a selector is given at a stage of a large map."""
    estimate, tfg = large_room(stage)
    return {"map": estimate, "tfg": tfg, "roadmap": roadmap(stage), "mission": MissionStatus("choose", stage, 1.0)}


def test_where_nothing_near_is_worth_going_to_all_of_the_map_is_looked_at():
    selector, alone = Selector(), Selector()
    for each in (selector, alone):
        each.ready(**at_stage(1))
    selector.fix(local_roadmap=western_nodes(sees=False))
    goal, without = selector.goal(), alone.goal()
    assert (goal.verdict, goal.node) == ("goal", without.node)
    np.testing.assert_array_equal(goal.p_MG, without.p_MG)


def test_what_is_worth_going_to_nearby_is_gone_to_first():
    selector = Selector()
    selector.ready(**at_stage(1))
    selector.fix(local_roadmap=western_nodes())
    goal = selector.goal()
    assert goal.verdict == "goal"
    assert (roadmap().points[goal.candidates][:, 0] < -1.0).all()
    np.testing.assert_array_equal(goal.p_MG, roadmap().points[goal.node])


@pytest.mark.parametrize("settings", [{"goal": "argmax"}, {"goal": "random"}, {"return_home": True}])
def test_where_all_of_the_map_is_asked_at_every_stage_what_is_near_does_not_come_first(settings):
    selector = Selector(**settings)
    selector.ready(**at_stage(1))
    selector.fix(local_roadmap=western_nodes())
    assert (roadmap().points[selector.goal().candidates][:, 0] >= -1.0).any()


def test_on_the_way_to_a_far_goal_all_of_the_map_is_weighed():
    selector = Selector(goal="nearest_frontier")
    eastern = roadmap().points[:, 0] > 0.0
    selector.ready(**at_stage(1) | {"roadmap": dataclasses.replace(roadmap(), reachable=roadmap().reachable & eastern)})
    selector.fix(local_roadmap=western_nodes(sees=False))
    assert eastern[selector.goal().node]
    selector.ready(**at_stage(2))
    selector.fix(local_roadmap=western_nodes(2))
    assert eastern[selector.goal().candidates].any()


def test_on_a_long_way_to_a_goal_nearby_all_of_the_map_is_weighed():
    near = roadmap().points[:, 0] < -1.0
    weighed = []
    for length in (19.0, 21.0):
        selector = Selector()
        selector.ready(**at_stage(1))
        before = selector.goal().node
        selector.ready(**at_stage(2))
        part = named(roadmap(2), np.union1d(np.flatnonzero(near), [before]))
        part = dataclasses.replace(part, travel_length=np.where(part.ids == before, length, 1.0))
        selector.fix(local_roadmap=with_frontiers(part, *large_room(2), PlanningParameters()))
        weighed.append(selector.goal().candidates)
    assert (near[weighed[0]] | (weighed[0] == before)).all()
    assert (~near[weighed[1]]).sum() > 1


STAY = time_at_goal(TagSensorConfig(), ExplorerConfig())


def test_the_rules_without_a_tour_value_what_they_are_named_for():
    for rule, pays in (("argmax", True), ("gain_per_time", True), ("argmax", False), ("gain_per_time", False)):
        selector = Selector(goal=rule, pose_price=pays)
        selector.ready()
        goal = selector.goal()
        gain = goal.gain if pays else goal.gain + goal.pose_price
        time = roadmap().travel_time[goal.candidates] + STAY if rule == "gain_per_time" else 1.0
        np.testing.assert_allclose(goal.value, gain / time)
        assert goal.candidates[np.argmax(goal.value)] == goal.node


def test_a_goal_drawn_at_random_is_driven_to_all_the_way():
    selector = Selector(goal="random")
    nodes = []
    for stage in (1, 2, 3, 4):
        estimate, tfg = (dataclasses.replace(message, stage=stage) for message in half_known_room())
        selector.ready(map=estimate, tfg=tfg, roadmap=roadmap(stage), mission=MissionStatus("choose", stage, 1.0))
        nodes.append(selector.goal().node)
    assert len(set(nodes)) == 1


def test_what_the_budget_does_not_allow_is_no_goal_and_the_way_leads_home():
    estimate, _ = half_known_room()
    aside = dataclasses.replace(estimate, X_MD=np.array([2.0, 0.0, 0.0]))
    selector = Selector(budget_time=30.0)
    selector.ready()
    goal = selector.goal()
    assert goal.verdict == "goal"
    assert MARGIN * roadmap().travel_time[goal.node] + STAY + RESERVE_TIME <= 30.0
    assert (MARGIN * roadmap().travel_time[goal.candidates] + STAY + RESERVE_TIME > 30.0).any()
    assert goal.latest_arrival == pytest.approx(30.0 - STAY - RESERVE_TIME)
    for return_home in (True, False):
        selector = Selector(budget_time=20.0, return_home=return_home)
        selector.ready(map=aside)
        goal = selector.goal()
        assert goal.verdict == "budget"
        assert goal.node == (int(np.argmin(np.hypot(*roadmap().points.T))) if return_home else -1)
        assert goal.latest_arrival == np.inf


@pytest.mark.parametrize("return_home", [True, False])
def test_a_robot_that_is_called_back_goes_home_or_ends_where_it_stands(return_home):
    estimate, _ = half_known_room()
    aside = dataclasses.replace(estimate, X_MD=np.array([2.0, 0.0, 0.0]))
    selector = Selector(return_home=return_home)
    recall = selector.system.GetInputPort("recall")
    recall.FixValue(selector.context, [0.0])
    selector.ready(map=aside)
    assert selector.goal().verdict == "goal"
    recall.FixValue(selector.context, [1.0])
    estimate, tfg = (dataclasses.replace(message, stage=2) for message in (aside, half_known_room()[1]))
    selector.ready(map=estimate, tfg=tfg, roadmap=roadmap(2), mission=MissionStatus("choose", 2, 1.0))
    goal = selector.goal()
    assert goal.verdict == "budget"
    assert goal.node == (int(np.argmin(np.hypot(*roadmap().points.T))) if return_home else -1)
    assert goal.reason.startswith("The robot was called back")


def test_a_called_back_robot_does_not_look_again_for_accuracy():
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, stamp=100.0, covariance=1e-3 * np.eye(9))
    closed = dataclasses.replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    selector = Selector()
    selector.system.GetInputPort("recall").FixValue(selector.context, [1.0])
    selector.ready(map=estimate, tfg=closed)
    assert selector.goal().verdict == "complete"


def test_denser_landmarks_are_expected_to_bring_more():
    gains = []
    for density in (0.5, 2.0):
        selector = Selector(density=density)
        selector.ready()
        gains.append(selector.goal().exploration)
    assert (gains[1] > 1.5 * gains[0]).all()


def with_walls():
    """The half-known room with its three walls as landmarks, too, all known as badly as the tags."""
    estimate, tfg = half_known_room()
    walls, anchor, reach = walls_between([[4.0, 4, -4, 4], [4, -4, 4, 4], [-4, -4, 4, -4]])
    none, own = np.zeros((3, 2)), known_at_their_ends(reach, 0.1)
    return dataclasses.replace(
        estimate, ids=np.append(WALLS_BELOW - np.array([3, 2, 1]), estimate.ids),
        p_ML=np.vstack([walls, estimate.p_ML]), anchor=np.vstack([anchor, none]), reach=np.vstack([reach, none]),
        local=np.arange(6), covariance=block_diag(*own, 1e-2 * np.eye(9)), landmark_covariance=np.zeros((6, 2, 2)),
    ), dataclasses.replace(tfg, inspected=24.0)  # fmt: skip


def said(goal):
    return [goal.node, goal.reason, goal.candidates, goal.exploitation, goal.exploration, goal.pose_price, goal.value]


@pytest.mark.parametrize("goal", ["tour", "argmax"])
def test_landmarks_that_are_tags_alone_change_nothing(goal):
    with_port, without = Selector(goal=goal), Selector(goal=goal)
    without.ready()
    with_port.ready(landmarks=half_known_room()[0])
    for one, other in zip(said(with_port.goal()), said(without.goal()), strict=True):
        np.testing.assert_array_equal(one, other)


def test_walls_count_beside_tags():
    tags, both = Selector(goal="argmax"), Selector(goal="argmax")
    landmarks, tfg = with_walls()
    tags.ready(map=landmarks.of_tags, tfg=tfg)
    both.ready(map=landmarks.of_tags, tfg=tfg, landmarks=landmarks)
    np.testing.assert_array_equal(both.goal().candidates, tags.goal().candidates)
    best = int(np.argmax(both.goal().value))
    assert both.goal().exploitation[best] > tags.goal().exploitation[best] + 5.0
    # The building has shown fewer tags than were expected, and walls.
    assert 0.3 < both.goal().exploration[best] / tags.goal().exploration[best] < 1.0


def test_a_building_without_tags_is_explored_by_its_walls():
    landmarks, tfg = with_walls()
    tagless = landmarks.of_landmarks(landmarks.ids < WALLS_BELOW)
    tfg = dataclasses.replace(tfg, facing=NONE)
    selector = Selector()
    selector.ready(map=tagless.of_tags, landmarks=tagless, tfg=tfg)
    goal = selector.goal()
    best = int(np.argmax(goal.value))
    assert goal.verdict == "goal"
    assert goal.exploitation[best] > 5.0
    assert goal.exploration[best] > 5.0


@pytest.mark.parametrize("gain", ["limit", "paper", "authors"])
def test_the_published_formulas_count_tags_alone(gain):
    tags, both = Selector(gain=gain), Selector(gain=gain)
    landmarks, tfg = with_walls()
    tags.ready(map=landmarks.of_tags, tfg=tfg)
    both.ready(map=landmarks.of_tags, tfg=tfg, landmarks=landmarks)
    for one, other in zip(said(both.goal()), said(tags.goal()), strict=True):
        np.testing.assert_array_equal(one, other)

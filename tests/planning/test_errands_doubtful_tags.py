import numpy as np
import pytest

from tests.walls import no_walls
from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.goal_choice import choose, choose_near, empty_choice
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import with_frontiers
from tfg_drake.slam import keyframe_graph
from tfg_drake.tfg.graph import empty_map

PARAMETERS = PlanningParameters()
# Two walls, one behind the other; a tag was hardly seen on either, another behind both.
WALLS = np.array([[-10.0, 2.0, 10.0, 2.0], [-10.0, 5.0, 10.0, 5.0]])
TAGS, PLACES = np.array([7, 9, 12]), np.array([[6.0, 2.0], [-2.0, 2.03], [0.0, 5.0]])
# The robot may stand anywhere on this line.
NODES = np.column_stack([np.arange(-8.0, 9.0), np.zeros(17)])


def explored(at, tags=TAGS, places=PLACES):
    """All is explored, and the robot stands at (at, 0)."""
    nothing = keyframe_graph.empty_map()
    X_MD = np.array([at, 0.0, 0.0])
    estimate = replace(nothing, stage=1, covariance=1e-4 * np.eye(3), X_MA=np.zeros((1, 3)), X_MD=X_MD)
    estimate = replace(estimate, doubtful=tags, doubtful_places=places)
    tfg = replace(empty_map(), stage=1, segments=WALLS)
    everywhere, distance = np.ones(17, dtype=bool), np.abs(NODES[:, 0] - at)
    edges = np.zeros((0, 2), dtype=np.int64)
    roadmap = Roadmap(1, NODES, edges, everywhere, everywhere, np.arange(17), distance / 0.5, distance)
    return estimate, tfg, with_frontiers(roadmap, estimate, tfg, PARAMETERS)


def test_the_robot_looks_once_more_from_straight_before_each_tag_in_sight_the_nearest_first():
    choice, at, order = empty_choice(), 0.0, []
    while (choice := choose(Situation(*explored(at), PARAMETERS), choice)).verdict == "goal":
        at = choice.p_MG[0] + 0.2
        order.append((choice.p_MG.tolist(), choice.reason))
    reason = "Tag {} is doubtful: it looks at it once more."
    assert order == [([-2.0, 0.0], reason.format(9)), ([6.0, 0.0], reason.format(7))]
    assert choice.verdict == "complete"


def test_on_the_way_there_it_stays_the_goal():
    first = choose(Situation(*explored(0.0), PARAMETERS), empty_choice())
    assert choose(Situation(*explored(-1.0), PARAMETERS), first).node == first.node


@pytest.mark.parametrize("tags", [[], [12]])
def test_where_no_tag_is_doubtful_or_in_sight_the_mission_ends(tags):
    rows = np.isin(TAGS, tags)
    now = Situation(*explored(0.0, TAGS[rows], PLACES[rows]), PARAMETERS)
    assert choose(now, empty_choice()).verdict == "complete"


def test_what_was_seen_where_another_tag_hangs_was_misread():
    estimate, tfg, roadmap = explored(0.0, TAGS[:1], PLACES[:1])
    estimate = replace(estimate, ids=np.array([3]), p_ML=PLACES[:1] + 0.1, local=np.zeros(1, dtype=np.int64))
    estimate = replace(estimate, **no_walls(1), covariance=1e-4 * np.eye(5), landmark_covariance=1e-4 * np.eye(2)[None])
    tfg = replace(tfg, facing=np.array([[0.0, -1.0]]))
    assert choose(Situation(estimate, tfg, roadmap, PARAMETERS), empty_choice()).verdict == "complete"


def test_by_what_is_near_alone_no_tag_is_looked_at_again():
    assert choose_near(Situation(*explored(0.0), PARAMETERS), empty_choice(), 20.0) is None


def test_the_robot_looks_again_where_the_budget_allows_it():
    parameters = replace(PARAMETERS, explorer=ExplorerConfig(budget_distance=3.0))
    before = choose(Situation(*explored(-2.0), parameters), empty_choice())
    choice = choose(Situation(*explored(0.0), parameters), before)
    assert choice.verdict == "complete"

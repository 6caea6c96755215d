"""Which of two drifted surfaces stands is told by what ties them to the newest view."""

import numpy as np
import pytest

from tests.arrays import frozen
from tests.walls import no_walls
from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.messages import replace
from tfg_drake.slam.keyframe_graph import empty_map, no_observation
from tfg_drake.slam.map_solver import solve
from tfg_drake.tfg.drift import MOST_DRIFT
from tfg_drake.tfg.graph import resolve
from tfg_drake.tfg.overlap import SWING, distance_along_map, known_badly, standing, weakly_tied
from tfg_drake.tfg.stars import Stars
from tfg_drake.tfg.surfaces import Surfaces

# Views on the corners of a square of 4 m and a fifth beyond the first; landmarks in the middle and beside the fifth.
X_MA = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0], [0.0, -1.0, 0.0]])
MAP = replace(empty_map(), X_MA=X_MA, ids=np.array([3, 7]), p_ML=np.array([[2.0, 2.0], [0.0, -2.0]]), **no_walls(2))
HALF = 2.0 * np.sqrt(2.0)


@pytest.mark.parametrize(
    ("seen", "views", "expected"),
    [
        ([], [0, 1, 2, 3], [12.0, 8.0, 4.0, 0.0, np.inf]),
        ([(0, 3), (3, 3), (0, 3)], [0, 1, 2, 3], [2 * HALF, 8.0, 4.0, 0.0, np.inf]),
        ([(0, 3), (3, 3)], [0, 3], [2 * HALF, np.inf, np.inf, 0.0, np.inf]),
        ([(0, 7), (4, 7)], [0, 1, 2, 3, 4], [3.0, 7.0, 9.0, 5.0, 0.0]),
    ],
    ids=["one after the other", "across the square", "not one after the other", "round and across"],
)
def test_views_are_as_far_as_what_ties_them_is_long(seen, views, expected):
    view, ids = np.array(seen, dtype=np.int64).reshape(-1, 2).T
    np.testing.assert_allclose(distance_along_map(view, ids, np.array(views), MAP), expected, rtol=1e-12)


def test_a_view_where_another_ended_is_tied_to_it():
    twice = replace(MAP, X_MA=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 0.0]]))
    none = np.zeros(0, dtype=np.int64)
    np.testing.assert_allclose(distance_along_map(none, none, np.arange(3), twice), [3.0, 3.0, 0.0], atol=1e-8)


@pytest.mark.parametrize(("seen_by_newest", "expected"), [(3, [True, False]), (7, [False, True])])
def test_of_two_surfaces_in_each_others_way_that_stands_whose_view_is_tied_more_closely(seen_by_newest, expected):
    """The views 0 and 2 face each other through a surface of either, and share landmark 7; the newest, 4, has seen 3 as
    the view 0 has, or 7. It stands beside the view 2, which is newer than 0. The other views are inactive."""
    X_MA = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [2.0, 0.0, 0.0], [50.0, 0.0, 0.0], [2.0, 1.5, 0.0]])
    estimate = replace(MAP, p_ML=np.array([[0.0, 1.5], [10.0, 0.0]]))
    far = np.array([[20.0, 0.0], [21.0, 0.0]])
    polylines = [np.array([[1.0, -0.5], [1.0, 0.5]]), np.array([[0.8, 0.5], [0.8, -0.5]]), far, far]
    ids = np.array([[-1, -1], [-1, -1], [3, 7], [seen_by_newest, -1]])
    surfaces = Surfaces(
        ids=ids,
        view=np.array([0, 2, 0, 4]),
        range=np.ones(4),
        offsets=2 * np.arange(5),
        vertices=np.vstack(polylines),
    )
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    star_view = np.array([0, 2, 4])
    centers = X_MA[star_view, :2]
    vertices = np.vstack([centers[0] + 2.0 * square, centers[1] + 2.0 * square, centers[2] + 0.1 * square])
    stars = Stars(frozen(4 * np.arange(4), np.int64), vertices, centers)
    stand = standing(surfaces, surfaces.vertices.copy(), np.array([7]), np.array([2]), stars, star_view, estimate)
    np.testing.assert_array_equal(stand, [*expected, True, True])


@pytest.mark.parametrize("robots", [0.0, 0.7])
@pytest.mark.parametrize("share", [0.98, 1.02])
def test_what_is_known_worse_than_the_way_can_have_made_it_is_weakly_tied(share, robots):
    """Landmark 1 before the robot, 2 and 3 so uncertain 4 m away, along either axis, 4 not known jointly with it, all
    by so much more as the robot is; views 0 and 1 saw one of each kind, 2 the uncertain ones only, 3 none known."""
    p_MD = np.array([20.0, 10.0])
    p_ML = p_MD + np.array([[1.0, 0.0], [0.0, 4.0], [4.0, 0.0], [4.0, 4.0]])
    uncertain = share * (MOST_DRIFT + 4.0 * SWING)
    own = np.array([0.01, 0.01, 0.0, uncertain, uncertain, 0.0, robots, robots, 0.0])
    seen = replace(empty_map().observation, ids=np.array([1, 9]))
    estimate = replace(
        empty_map(),
        ids=np.array([1, 2, 3, 4]),
        p_ML=p_ML,
        **no_walls(4),
        local=np.arange(3),
        X_MD=np.append(p_MD, 0.3),
        covariance=np.diag(own**2),
        X_MA=np.zeros((5, 3)),
        observation=seen,
    )
    surfaces = Surfaces(
        ids=np.array([[1, 2], [1, -1], [2, 3], [-1, -1], [-1, -1]]),
        view=np.array([0, 1, 2, 2, 3]),
        range=np.ones(5),
        offsets=2 * np.arange(6),
        vertices=np.zeros((10, 2)),
    )

    def tied(estimate):
        return weakly_tied(surfaces, np.array([3, 4]), np.array([1, 3]), estimate, known_badly(estimate))

    told = tied(estimate)
    weak = share > 1.0
    assert known_badly(estimate).tolist() == [False, weak, weak, False]
    assert told.views.tolist() == [False, False, weak, False, False]
    assert told.surfaces.tolist() == [weak, False, weak, weak, False]
    # What is in view is here, however badly it is known ...
    seen = replace(seen, ids=np.array([1, 2, 3]))
    assert not tied(replace(estimate, observation=seen)).views.any()
    # ... and a look that sees nothing changes nothing.
    blind = replace(estimate, observation=empty_map().observation)
    assert tied(blind).views.tolist() == told.views.tolist()


def test_what_a_lost_robot_mapped_before_says_nothing_of_where_it_is(small_map):
    """It has seen one of the tags since it was carried off, and two surfaces hang on others, or on a view of those."""
    graph, (_, estimate) = small_map.tfg_graph, solve(small_map.graph, 20.25, no_observation())
    seen = replace(estimate.observation, ids=estimate.ids[-1:])
    carried = estimate.covariance.copy()
    carried[-3:-1, -3:-1] += 50.0**2 * np.eye(2)
    n = len(estimate.ids) - 1
    carried[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] += 50.0**2 * np.eye(2)
    carried[2 * n : 2 * n + 2, -3:-1] += 50.0**2 * np.eye(2)
    carried[-3:-1, 2 * n : 2 * n + 2] += 50.0**2 * np.eye(2)
    estimate = replace(estimate, observation=seen)
    lost = replace(estimate, covariance=carried)
    assert (estimate.is_adrift, lost.is_adrift) == (False, True)
    before, after = (resolve(graph, one, RobotConfig(), ExplorerConfig()) for one in (estimate, lost))
    assert len(before.segments) > len(after.segments)
    assert set(map(tuple, after.segment_ids.tolist())) < set(map(tuple, before.segment_ids.tolist()))
    np.testing.assert_array_equal(after.star_vertices, before.star_vertices)

"""Messages as layers of flat shapes."""

import itertools

import numpy as np

from tests.systems.test_visualizer import make_map, make_messages
from tfg_drake.messages import replace
from tfg_drake.pictures import scene, tables


def choice_of(values, gains, node=0):
    message = make_messages(len(values))["goal"]
    values, gains = np.array(values, dtype=float), np.array(gains, dtype=float)
    return replace(message, value=values, gain=gains, exploitation=0.25 * gains, exploration=0.75 * gains, node=node)


def roadmap_of(count):
    messages = make_messages(count)
    return replace(messages["roadmap"], travel_time=np.arange(count) + 0.5, ids=np.arange(count))


def test_the_chosen_goal_is_explained_beside_the_three_next_best():
    told = scene.explained(choice_of([-3.0, -1.0, -np.inf, -2.0, -np.inf], [4, 10, 7, 2, 9], node=1), roadmap_of(5))
    assert [row["gain"] for row in told] == [10, 2, 4, 9]
    assert [row["chosen"] for row in told] == [True, False, False, False]
    first = told[0]
    assert (first["exploitation"], first["exploration"]) == (2.5, 7.5)
    assert first["time"] == 1.5
    assert first["rate"] == round(10 / 1.5, 4)
    assert first["at"] == [2.0, 3.0]


def test_what_the_tour_visits_later_is_not_among_what_was_not_taken():
    choice = choice_of([-3.0, -1.0, -np.inf, -2.5, -np.inf], [4, 10, 7, 2, 9], node=1)
    told = scene.explained(replace(choice, tour=np.array([1, 3, 0])), roadmap_of(5))
    assert [row["gain"] for row in told] == [10, 9, 7]


def test_a_tour_has_its_stops_and_when_each_is_done_with():
    choice, roadmap = choice_of([-3.0, -1.0, -np.inf, -2.5], [4, 10, 7, 2], node=1), roadmap_of(4)
    layer = scene.tour(replace(choice, tour=np.array([1, 3, 0])), roadmap)
    np.testing.assert_array_equal(layer["tour"], roadmap.points[[1, 3, 0]])
    np.testing.assert_array_equal(layer["done"], np.float32([1.0, 2.5, 3.0]))
    # A stop that the roadmap does not have any more is left out.
    fewer = replace(roadmap, points=roadmap.points[:3], ids=roadmap.ids[:3])
    np.testing.assert_array_equal(scene.tour(replace(choice, tour=np.array([1, 3, 0])), fewer)["done"], [1.0, 3.0])
    assert [len(array) for array in scene.tour(choice, roadmap).values()] == [0, 0, 0]


def test_a_tour_goes_by_the_roadmap_and_straight_where_that_has_no_way():
    """Round a wall between two stops, past a node that is a detour, and to a place that no edge leads to."""
    points = np.array([[0.0, 0.0], [0.0, 2.0], [1.0, 2.0], [1.0, 0.0], [0.2, 1.0], [5.0, 5.0]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [0, 4], [4, 1]])
    roadmap = replace(roadmap_of(6), points=points, edges=edges)
    choice = replace(choice_of([-3.0, -1.0, -2.0], [4, 10, 7], node=3), tour=np.array([3, 0, 5]))
    choice = replace(choice, candidates=np.array([0, 3, 5]))
    expected = [np.hstack([points[a], points[b]]) for a, b in itertools.pairwise([3, 2, 1, 0, 5])]
    np.testing.assert_array_equal(scene.tour(choice, roadmap)["legs"], expected)


def test_there_is_nothing_to_explain_where_nothing_was_chosen():
    assert scene.explained(choice_of([], [], node=-1), roadmap_of(0)) == []


def test_gains_are_shares_of_the_most_and_only_of_places_that_the_roadmap_has():
    choice, roadmap = choice_of([1, 1, 1], [2, 8, -1]), roadmap_of(3)
    told = tables.gains(choice, roadmap)
    np.testing.assert_allclose(told.values[:, 2] * tables.SHARE, [0.25, 1.0, 0.0])
    told = tables.gains(choice, replace(roadmap, points=roadmap.points[1:], ids=roadmap.ids[1:]))
    np.testing.assert_allclose(told.values[:, 2] * tables.SHARE, [1.0, 0.0])
    np.testing.assert_allclose(told.arrays["points"], roadmap.points[1:])


def test_a_frontier_is_a_bar_across_its_normal():
    """On the border of what is known, or on the surface that it lies in front of."""
    tfg = make_messages()["tfg"]
    normal = np.array([[0.6, 0.8], [0.0, -1.0]])
    # The second lies in free space, a quarter of a metre in front of a surface: whichever of its sides was seen.
    star = np.array([[1.0, 2.0], [3.0, 2.0], [3.0, 3.24], [1.0, 3.24]])
    free = {"star_vertices": star, "star_offsets": np.array([0, 4]), "star_centers": np.array([[2.0, 2.5]])}
    frontiers = replace(tfg, frontier_normal=normal, frontier_length=np.array([0.2, 7.0]), **free)
    surface = np.array([[0.0, 3.25, 4.0, 3.25]])
    bars = tables.frontiers(replace(frontiers, segments=surface)).arrays["segments"]
    along = bars[:, 2:] - bars[:, :2]
    np.testing.assert_allclose(np.sum(along * normal, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), [0.2, 0.4])
    middles = 0.5 * (bars[:, 2:] + bars[:, :2])
    np.testing.assert_allclose(middles, [tfg.frontiers[0] + 0.35 * normal[0], [2.0, 3.25]])
    bare = tables.frontiers(replace(frontiers, segments=surface[:0])).arrays["segments"][1]
    np.testing.assert_allclose(0.5 * (bare[:2] + bare[2:]), tfg.frontiers[1])


def test_free_space_is_told_again_only_where_it_has_moved():
    tfg = make_messages()["tfg"]
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [5.0, 5.0], [6.0, 5.0], [6.0, 6.0]])
    tfg = replace(
        tfg,
        star_offsets=np.array([0, 3, 6]),
        star_vertices=corners,
        star_centers=np.array([[0.5, 0.2], [5.5, 5.2]]),
    )
    before = scene.free_space(tfg)
    assert list(scene.changed_stars({}, before)) == [0, 1]
    moved = replace(tfg, star_vertices=corners + np.array([[0.009, 0]] * 3 + [[0.05, 0]] * 3))
    now = scene.free_space(moved)
    assert list(scene.changed_stars(dict(enumerate(before)), now)) == [1]
    packed = scene.packed_stars(now, np.array([1]))
    assert list(packed["count"]) == [4]
    np.testing.assert_allclose(packed["points"], [[5.5, 5.2], [5.05, 5.0], [6.05, 5.0], [6.05, 6.0]])


def test_a_landmarks_covariance_is_told_by_its_three_numbers():
    estimate = replace(make_map(1), landmark_covariance=np.array([[[4.0, 1.0], [1.0, 9.0]]]))
    np.testing.assert_allclose(tables.landmarks(estimate).arrays["covariance"], [[4.0, 1.0, 9.0]])


def test_a_scan_shows_its_rays_and_which_of_them_met_something():
    messages = make_messages()
    pose = replace(messages["pose"], X_MB=np.array([1.0, 2.0, 0.0]))
    layer = scene.scan_rays(messages["scan"], pose)
    ends = [[0, 0], [np.cos(1), -np.sin(1)], [10, 0], [2 * np.cos(1), 2 * np.sin(1)]]
    np.testing.assert_allclose(layer["rays"], np.array([1.0, 2.0]) + ends)
    assert layer["met"].tolist() == [True, False, True]
    blind = scene.scan_rays(replace(messages["scan"], ranges=np.array([np.nan, 1.0, np.inf])), pose)
    np.testing.assert_allclose(blind["rays"], [[1, 2], [2, 2], [1 + 10 * np.cos(1), 2 + 10 * np.sin(1)]])
    assert blind["met"].tolist() == [True, False]

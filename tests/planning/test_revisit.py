import dataclasses

import numpy as np
import pytest

from tests.planning.test_information_gain import problem, whitened
from tests.walls import no_walls
from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import Roadmap, TfgMap
from tfg_drake.planning import revisit
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.exact_gain import Known
from tfg_drake.planning.expected_view import Targets, Visibility
from tfg_drake.planning.information_gain import turn_noise
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.revisit import error_removed, known_jointly, known_together, worth_revisiting
from tfg_drake.slam.keyframe_graph import empty_map


def brute_force(point, Q, seen, p_ML, X_MD, covariance, noise, wall):
    """How much the landmarks' variances fall, all together, by the information of landmarks, departure and arrival."""
    n = 2 * len(p_ML)
    information = np.zeros((n + 6, n + 6))
    information[: n + 3, : n + 3] = np.linalg.inv(covariance)
    F = np.eye(3)
    F[:2, 2] = [-(point[1] - X_MD[1]), point[0] - X_MD[0]]
    odometry = np.hstack([-F, np.eye(3)])
    information[n:, n:] += odometry.T @ np.linalg.inv(Q) @ odometry
    for i in seen:
        d = p_ML[i] - point
        of_wall = wall[i].any()
        J = np.zeros((1 if of_wall else 2, n + 6))
        J[:, 2 * i : 2 * i + 2] = wall[i] if of_wall else whitened(d, noise)
        J[:, n + 3 : n + 5] = -J[:, 2 * i : 2 * i + 2]
        # The derivative by the heading: the bearing's, and a distance's along the normal.
        J[-1, n + 5] = wall[i] @ [d[1], -d[0]] if of_wall else -1 / noise[3]
        information += J.T @ J
    return np.trace(covariance[:n, :n]) - np.trace(np.linalg.inv(information)[:n, :n])


NOISE = turn_noise(TagSensorConfig(), 20.0)


def walls_among(rng, count, share=0.5):
    """(n, 2) as of `exact_gain.Known`: a share of the landmarks are points of walls, known to some millimetres."""
    angle = rng.uniform(-np.pi, np.pi, count)
    wall = np.stack([np.cos(angle), np.sin(angle)], axis=1) / rng.uniform(0.001, 0.01, (count, 1))
    return wall * (rng.uniform(size=(count, 1)) < share)


def known_of(visible, p_ML, wall, covariance):
    """Landmarks that are their own targets, of which each point sees some."""
    n = len(p_ML)
    return Known(visible.offsets, visible.index, p_ML, np.arange(n), np.tile(np.eye(2), (n, 1, 1)), wall, covariance)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("seen", [1, 2, 5, 9])
def test_what_a_turn_takes_off_the_error_equals_brute_force(seed, seen):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    rows = np.sort(rng.permutation(len(p_ML))[:seen])
    wall = walls_among(rng, len(p_ML))
    known = known_of(Visibility(np.array([0, seen]), rows), p_ML, wall, covariance)
    removed = error_removed(point[None], Q, X_MD, known, covariance[:, :-3] @ covariance[:-3], NOISE)
    expected = brute_force(point, Q[0], rows, p_ML, X_MD, covariance, NOISE, wall)
    assert removed[0] == pytest.approx(expected, rel=1e-4)
    assert 0.0 < removed[0] < np.trace(covariance[:-3, :-3])


@pytest.mark.parametrize("seed", range(5))
def test_places_judged_together_are_worth_what_each_is_by_itself(seed):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    squared = covariance[:, :-3] @ covariance[:-3]
    seen = [np.sort(rng.permutation(len(p_ML))[:k]) for k in (3, 0, 7, 1)]
    visible = Visibility(np.cumsum([0, 3, 0, 7, 1]), np.concatenate(seen))
    points, Q = point + rng.normal(0.0, 1.0, (4, 2)), np.repeat(Q, 4, axis=0) * np.arange(1, 5)[:, None, None]
    none = np.zeros_like(p_ML)
    together = error_removed(points, Q, X_MD, known_of(visible, p_ML, none, covariance), squared, NOISE)
    of = p_ML, X_MD, covariance, NOISE, none
    apart = [brute_force(p, q, rows, *of) for p, q, rows in zip(points, Q, seen, strict=True)]
    np.testing.assert_allclose(together, apart, atol=1e-9)
    assert together[1] == 0.0


def test_some_of_the_tags_in_view_find_the_place_that_all_tell(monkeypatch):
    rng = np.random.default_rng(0)
    along, on = np.linspace(-4.8, 4.8, 20), np.full(20, 5.0)
    p_ML = np.vstack([np.stack(wall, axis=1) for wall in ((along, -on), (on, along), (along, on), (-on, along))])
    bent = rng.normal(0.0, 0.01, (len(p_ML) * 2 + 3, 30))
    estimate = dataclasses.replace(
        empty_map(), stage=1, stamp=100.0, ids=np.arange(80), p_ML=p_ML, **no_walls(80), local=np.arange(80),
        covariance=bent @ bent.T + 1e-5 * np.eye(len(bent)), X_MA=np.zeros((1, 3)),
        shared=np.zeros(0), with_shared=np.zeros((0, 0)),
    )  # fmt: skip
    corners = np.array([[-5.0, -5], [5, -5], [5, 5], [-5, 5]])
    tfg = TfgMap(
        1, np.hstack([corners, np.roll(corners, -1, axis=0)]), np.zeros(0, dtype=int), np.zeros((0, 2), dtype=int),
        np.repeat([[0.0, 1], [-1, 0], [0, -1], [1, 0]], 20, axis=0), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)),
        np.zeros(1, dtype=int), np.zeros((0, 2)), np.zeros((0, 2)),
    )  # fmt: skip
    points = rng.uniform(-4.0, 4.0, (60, 2))
    nodes, reachable = np.arange(60), np.ones(60, dtype=bool)
    time = np.hypot(*points.T) / 0.5
    roadmap = Roadmap(1, points, np.zeros((0, 2), dtype=int), reachable, reachable, nodes, time, time)
    parameters = PlanningParameters()
    monkeypatch.setattr(revisit, "SEEN", 8)
    screened = worth_revisiting(nodes, Situation(estimate, tfg, roadmap, parameters))
    monkeypatch.setattr(revisit, "SEEN", 80)
    by_all = worth_revisiting(nodes, Situation(estimate, tfg, roadmap, parameters))
    best = np.argsort(-screened)[0]
    assert by_all[best] > 0.95 * by_all.max()
    # Fewer tags never tell more, and here they tell less.
    assert (screened <= by_all * (1 + 1e-9)).all()
    assert (screened < by_all * 0.99).any()


def test_a_tag_before_its_wall_by_the_error_of_a_long_way_is_no_promise():
    rng = np.random.default_rng(1)
    # Ten tags known together to a centimetre though all are 0.2 m off, one off by as much by another way.
    own, common = np.full((11, 2), 0.005), np.tile(np.eye(2), (11, 1)) * 0.2
    common[20:] = 0.0
    own[10] = 0.2
    covariance = np.zeros((25, 25))
    covariance[:22, :22] = common @ common.T + np.diag(own.ravel() ** 2)
    covariance[22:, 22:] = 1e-4 * np.eye(3)
    seen = [np.arange(11), np.array([10]), rng.permutation(10)[:3], np.zeros(0, dtype=int)]
    tags = Visibility(np.cumsum([0, *map(len, seen)]), np.concatenate(seen))
    assert known_together(tags, covariance).tolist() == [True] * 10 + [False] + [True] * 4


@pytest.mark.parametrize("seed", range(3))
def test_the_places_of_targets_have_the_covariance_that_their_landmarks_give_them(seed):
    rng = np.random.default_rng(seed)
    entry, by_landmark = np.array([1, 1, -1, 0]), rng.normal(size=(4, 2, 2))
    root = rng.normal(size=(7, 7))
    of = Targets(rng.normal(size=(4, 2)), np.ones((4, 2)), entry, by_landmark, np.zeros((4, 2)))
    joint, covariance = known_jointly(of, root @ root.T)
    J = np.zeros((9, 7))
    for row, t in enumerate([0, 1, 3]):
        J[2 * row : 2 * row + 2, 2 * entry[t] : 2 * entry[t] + 2] = by_landmark[t]
    J[6:, 4:] = np.eye(3)
    np.testing.assert_allclose(covariance, J @ root @ root.T @ J.T)
    np.testing.assert_array_equal(joint.p_MT, of.p_MT[[0, 1, 3]])

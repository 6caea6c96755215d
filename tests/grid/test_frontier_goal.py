import numpy as np
import pytest

from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.grid.frontier_goal import TriedPlaces, choose, is_spent, no_tries
from tfg_drake.messages import GridMap, PoseEstimate

ROBOT, EXPLORER = RobotConfig(), ExplorerConfig()
RES = 0.05


def pose_at(x, y):
    X_MB = np.array([x, y, 0.0])
    return PoseEstimate(0.0, X_MB, 1e-4 * np.eye(3), np.zeros(2), 1, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def grid_of(width, height, free=(), occupied=(), unknown=()):
    """Unknown all over, then free, occupied, unknown boxes x0, y0, x1, y1, m; its corner is the origin."""
    probability = np.full((round(height / RES), round(width / RES)), 0.5, dtype=np.float32)
    for boxes, value in ((free, 0.1), (occupied, 0.9), (unknown, 0.5)):
        for x0, y0, x1, y1 in boxes:
            probability[round(y0 / RES) : round(y1 / RES), round(x0 / RES) : round(x1 / RES)] = value
    return GridMap(3, 0.0, RES, np.zeros(2), probability)


def walled(x0, y0, x1, y1):
    t = 2 * RES
    return [(x0, y0, x1, y0 + t), (x0, y1 - t, x1, y1), (x0, y0, x0 + t, y1), (x1 - t, y0, x1, y1)]


def room(gaps=(), extra_free=()):
    """A room of 6 m by 3 m in 8 m by 5 m of unknown, with free gaps in its walls."""
    full = grid_of(8, 5, [(1, 1, 7, 4)], walled(1, 1, 7, 4)).probability.copy()
    for x0, y0, x1, y1 in (*gaps, *extra_free):
        full[round(y0 / RES) : round(y1 / RES), round(x0 / RES) : round(x1 / RES)] = 0.1
    return GridMap(3, 0.0, RES, np.zeros(2), full)


def told(grid, x=2.0, y=2.5, tried=None):
    choice, tried = choose(grid, pose_at(x, y), no_tries() if tried is None else tried, ROBOT, EXPLORER)
    return choice, tried


DOORS = [(6.9, 2.0, 7.0, 3.0), (2.0, 1.0, 3.0, 1.1)]


def test_the_nearest_of_two_doors():
    choice, tried = told(room(DOORS))
    assert (choice.verdict, choice.stage, len(choice.candidates)) == ("goal", 3, 2)
    assert choice.p_MG[1] < 1.2
    assert choice.value[0] == choice.value.max()
    assert np.hypot(*(tried.p_MF[-1] - choice.p_MG)) <= 1.0
    row, column = divmod(choice.node, 160)
    np.testing.assert_allclose(choice.p_MG, [(column + 0.5) * RES, (row + 0.5) * RES])
    choice, _ = told(room(DOORS), 6.0, 2.5)
    assert choice.p_MG[0] > 6.5
    assert choice.reason.startswith("The nearest of 2 frontiers is ")


def test_all_seen_is_complete():
    choice, tried = told(room())
    assert (choice.verdict, choice.reason, choice.node) == ("complete", "No frontier is left.", -1)
    assert len(tried.p_MF) == 0


def test_a_crack_does_not_matter():
    choice, _ = told(room([(6.9, 2.0, 7.0, 2.2)]))
    assert choice.reason == "No frontier is left."


def test_a_frontier_beyond_a_gap_too_narrow_for_the_robot_is_left():
    behind = [(6.9, 2.0, 7.0, 2.25), (7.0, 1.5, 7.9, 2.8)]
    grid, tried = room(behind), no_tries()
    for _ in range(100):
        choice, tried = told(grid, tried=tried)
        if choice.verdict != "goal":
            break
    assert choice.verdict == "complete"
    assert choice.reason.startswith("No frontier is left but ")
    assert choice.reason.endswith(" m too narrow for the robot.")


def test_a_frontier_that_only_lacks_the_margin_is_out_of_reach():
    # The gap of 0.45 m would take the robot, 0.36 m wide, but not its margin of 5 cm on either side.
    grid, tried = room([(6.9, 2.0, 7.0, 2.45), (7.0, 1.0, 7.9, 4.0)]), no_tries()
    for _ in range(100):
        choice, tried = told(grid, tried=tried)
        if choice.verdict != "goal":
            break
    assert choice.verdict == "stuck"
    assert choice.reason.endswith(" m of frontier lie behind a passage too narrow for the robot and its margin.")


def test_a_frontier_that_does_not_go_away_is_given_up():
    grid, tried, goals = room(DOORS[:1]), no_tries(), 0
    while True:
        choice, tried = told(grid, tried=tried)
        if choice.verdict != "goal":
            break
        goals += 1
    # As often as allowed at each end of a door a metre wide and in its middle, at most; the robot fits in 0.6 m of it.
    assert EXPLORER.frontier_attempts <= goals <= 3 * EXPLORER.frontier_attempts
    assert choice.verdict == "stuck"
    assert choice.reason == "0.6 m of open frontier were tried again and again in vain."


def test_a_robot_without_any_way_is_stuck():
    grid = grid_of(3, 3, [(1, 1, 1.4, 2.0)], [(0.9, 1, 1.0, 2.0), (1.4, 1, 1.5, 2.0)])
    choice, _ = told(grid, 1.2, 1.5)
    assert (choice.verdict, choice.reason) == ("stuck", "The robot cannot reach any other place.")


def test_a_goal_is_spent_when_its_frontier_is_gone():
    before = room(DOORS[:1])
    _, tried = told(before)
    assert not is_spent(before, no_tries(), ROBOT)
    assert not is_spent(before, tried, ROBOT)
    beyond = room(DOORS[:1], [(6.9, 1.2, 8.0, 3.8)])
    assert is_spent(beyond, tried, ROBOT)
    assert not is_spent(beyond, TriedPlaces(tried.p_MF, at_frontier=False), ROBOT)


@pytest.mark.parametrize("seed", range(3))
def test_choices_end_on_any_map(seed):
    """On a map that never changes every place is tried a number of times at most."""
    rng = np.random.default_rng(seed)
    coarse = rng.choice([0.1, 0.5, 0.9], size=(8, 12), p=[0.75, 0.15, 0.1]).astype(np.float32)
    coarse[3:5, 5:7] = 0.1
    grid, tried = GridMap(1, 0.0, RES, np.zeros(2), np.kron(coarse, np.ones((10, 10), dtype=np.float32))), no_tries()
    at = np.array([3.0, 2.0])
    for _ in range(400):
        choice, tried = told(grid, *at, tried=tried)
        if choice.verdict != "goal":
            break
        at = choice.p_MG
    assert choice.verdict in ("complete", "stuck")

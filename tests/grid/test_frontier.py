import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.grid.frontier import FREE, OCCUPIED, UNKNOWN, cell_at, center_of, classify, find_frontiers
from tfg_drake.messages import GridMap

SIGN = {".": 0.1, "#": 0.9, " ": 0.5}


def drawn(rows, resolution=0.1, origin=(0.0, 0.0)):
    """The grid of a drawing, its last row the one of least y: free `.`, occupied `#`, unknown blank."""
    probability = np.array([[SIGN[sign] for sign in row] for row in rows[::-1]], dtype=np.float32)
    return GridMap(1, 0.0, resolution, np.array(origin, dtype=float), probability)


def test_cells_by_their_probability():
    cells = classify(GridMap(1, 0.0, 1.0, np.zeros(2), np.array([[0.1, 0.5, 0.9, 0.47]], dtype=np.float32)))
    assert cells.tolist() == [[FREE, UNKNOWN, OCCUPIED, UNKNOWN]]


def test_a_cell_holds_its_centre_and_points_outside_belong_to_the_nearest():
    grid = drawn(["...", "..."], 0.5, (-1.0, 2.0))
    cells = np.argwhere(np.ones((2, 3)))
    np.testing.assert_array_equal(cell_at(grid, center_of(grid, cells)), cells)
    np.testing.assert_allclose(center_of(grid, np.array([0, 2])), [0.25, 2.25])
    np.testing.assert_array_equal(cell_at(grid, np.array([9.0, -9.0])), [0, 2])


def test_the_frontier_of_a_room_with_a_door():
    grid = drawn(["#####  ", "#..... ", "#...#  ", "#####  "])
    cells, of = find_frontiers(grid, classify(grid), np.array([0.15, 0.15]), 0.0)
    assert cells.tolist() == [[2, 5]]
    assert len(of) == 1


def test_what_the_wave_does_not_reach_and_what_is_short_are_none():
    # The cell beyond the wall's corner touches the room at that corner only.
    grid = drawn(["    ", " . #", "####", "...#", "...."])
    at = np.array([0.05, 0.05])
    assert len(find_frontiers(grid, classify(grid), at, 0.0)[0]) == 0
    grid = drawn(["    ", "....", "...#"])
    assert len(find_frontiers(grid, classify(grid), at, 0.3)[0]) == 4
    assert len(find_frontiers(grid, classify(grid), at, 0.5)[0]) == 0


def test_a_robot_in_an_occupied_cell_sends_the_wave_from_the_nearest_free_one():
    grid = drawn(["   ", "...", "##."])
    assert len(np.unique(find_frontiers(grid, classify(grid), np.array([0.05, 0.05]), 0.0)[1])) == 1
    nothing = drawn(["   "])
    assert len(find_frontiers(nothing, classify(nothing), np.zeros(2), 0.0)[0]) == 0


def by_hand(cells, start):
    """The groups of frontier cells, as sets, by the definition."""
    height, width = cells.shape

    def beside(i, j):
        around = [(i, j + 1), (i + 1, j), (i, j - 1), (i - 1, j)]
        return [(a, b) for a, b in around if 0 <= a < height and 0 <= b < width]

    reached, todo = {start}, [start]
    while todo:
        for cell in beside(*todo.pop()):
            if cells[cell] == FREE and cell not in reached:
                reached.add(cell)
                todo.append(cell)
    edge = {cell for cell in reached if any(cells[other] == UNKNOWN for other in beside(*cell))}
    groups = []
    while edge:
        group, todo = set(), [edge.pop()]
        while todo:
            i, j = todo.pop()
            group.add((i, j))
            near = {(a, b) for a, b in edge if abs(a - i) <= 1 and abs(b - j) <= 1}
            edge -= near
            todo += near
        groups.append(frozenset(group))
    return set(groups)


@given(st.integers(0, 10000))
def test_frontiers_are_those_of_brute_force(seed):
    rng = np.random.default_rng(seed)
    probability = rng.choice([0.1, 0.5, 0.9], size=(9, 13), p=[0.6, 0.2, 0.2]).astype(np.float32)
    probability[4, 6] = 0.1
    grid = GridMap(1, 0.0, 0.1, np.zeros(2), probability)
    found, of = find_frontiers(grid, classify(grid), np.array([0.65, 0.45]), 0.0)
    groups = {frozenset(map(tuple, found[of == one].tolist())) for one in np.unique(of)}
    assert groups == by_hand(classify(grid), (4, 6))

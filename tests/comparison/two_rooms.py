"""Two rooms with a door between them, and what a mission has to see of them."""

import numpy as np

from tfg_drake.comparison.best_tour import to_see
from tfg_drake.config import RobotConfig
from tfg_drake.world.reachability import make_grid, reachable_cells, reachable_tags
from tfg_drake.world.world import World

ROBOT = RobotConfig()
# Two rooms, a door of 1 m between them, and a box in the second.
WALLS = np.array(
    [[0.0, 0, 7, 0], [7, 0, 7, 4], [7, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5], [3, 3.5, 3, 4], [5, 1, 5, 2]]
)
START = np.array([1.0, 1.0, 0.0])


def world(tags=0):
    """The two rooms with a few tags."""
    p = np.array([[0.01, 3.0], [6.99, 0.5], [5.01, 1.5], [2.99, 0.4]])[:tags]
    facing = np.array([0.0, np.pi, 0.0, np.pi])[:tags]
    return World(WALLS, np.arange(tags), p, facing, START)


def cells_and_see(one, scan, eyes, share=0.99):
    grid = make_grid(one)
    reachable = reachable_cells(grid, one, ROBOT.radius)
    thinned = np.zeros_like(reachable)
    thinned[::4, ::4] = reachable[::4, ::4]
    tags = reachable_tags(one, grid, reachable, eyes.range, eyes.max_incidence)
    return grid.centers(reachable), to_see(grid.centers(thinned), one, tags, share, scan, eyes)

"""The nearest frontier as the next goal, and why a mission on a grid ends.

Yamauchi's rule (CIRA 1997): drive to the nearest frontier that can be reached, look round, and again until none is
left. A frontier that is no more when the robot is on its way there is left at once for the next.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.grid.frontier import FREE, OCCUPIED, cell_at, center_of, classify, find_frontiers, next_to_unknown
from tfg_drake.grid.path import Ways, find_ways, in_cells, sees
from tfg_drake.messages import BoolArray, FloatArray, GoalChoice, GridMap, IntArray, PoseEstimate, message, replace
from tfg_drake.planning.goal_choice import empty_choice

# A frontier is observed from the nearest place with room for the robot within this distance, m.
AT_HAND = 1.0
# The robot does not turn again within this distance of where it stands, m, as it would see the same.
APART = 0.3
# Goals within this distance of each other, m, are attempts at one place of a frontier; the frontier that remains within
# it of the goal is the goal's.
SAME_PLACE = 0.5


@message
class TriedPlaces:
    """For which places goals were chosen, in order. p_MF: (n, 2), m in M. at_frontier: the newest is on a frontier."""

    p_MF: FloatArray
    at_frontier: bool = True


def no_tries() -> TriedPlaces:
    """Before the first goal."""
    return TriedPlaces(np.zeros((0, 2)))


@dataclasses.dataclass(frozen=True)
class Access:
    """The cells of all frontiers, and from where the robot would look at them.

    p_MF: (f, 2) centres of the frontiers' cells, m in M. frontier: (f,) to which frontier each belongs. live: (f,) not
    tried as often as allowed yet. open: (f,) the robot would fit there and, were it willing to pass so near to
    obstacles that it all but touches them, could get there. stand: (f, 2) cells to look from. cost: (f,) m to the
    frontier's cell by way of it, weighted by clearance, inf where there is no such cell.
    """

    p_MF: FloatArray
    frontier: IntArray
    live: BoolArray
    open: BoolArray
    stand: IntArray
    cost: FloatArray

    @property
    def worth(self) -> BoolArray:
        """The cells (f,) to set out for."""
        return np.asarray(self.live & np.isfinite(self.cost))


def find_access(
    grid: GridMap, ways: Ways, p_MB: FloatArray, tried: TriedPlaces, robot: RobotConfig, attempts: int
) -> Access:
    """How the frontiers of a grid can be looked at by a robot at p_MB (2,), m in M; attempts: tries at one place."""
    cells, of = find_frontiers(grid, ways.cells, p_MB, 2.0 * robot.radius)
    p_MF = center_of(grid, cells)
    live = np.ones(len(cells), dtype=np.bool_)
    if len(tried.p_MF):
        live = cKDTree(tried.p_MF).query_ball_point(p_MF, SAME_PLACE, return_length=True) < attempts
    stand, cost = cells.copy(), np.full(len(cells), np.inf)
    standing = ways.reachable & ~_disc(grid, p_MB, APART)
    if standing.any():
        _, nearest = ndimage.distance_transform_edt(~standing, return_indices=True)
        stand = np.ascontiguousarray(nearest[:, cells[:, 0], cells[:, 1]].T).astype(np.int64)
        away = grid.resolution * np.hypot(*(stand - cells).T)
        at_hand = (away <= AT_HAND) & sees(
            ways.cells == OCCUPIED, in_cells(grid, center_of(grid, stand)), in_cells(grid, p_MF)
        )
        cost = np.where(at_hand, ways.cost[tuple(stand.T)] + away, np.inf)
    return Access(p_MF, of, live, _enterable(ways, robot.radius)[tuple(cells.T)], stand, cost)


def _disc(grid: GridMap, center: FloatArray, radius: float) -> BoolArray:
    """The cells (h, w) with their centre within a radius (m) of a point (2,), m in M."""
    row, column = in_cells(grid, center[None])[0] - 0.5
    height, width = grid.probability.shape
    square = (np.arange(height)[:, None] - row) ** 2 + (np.arange(width)[None] - column) ** 2
    return np.asarray(square <= (radius / grid.resolution) ** 2)


def _enterable(ways: Ways, radius: float) -> BoolArray:
    """The cells (h, w) that a robot of this radius (m) could get to if it kept no margin."""
    label, _ = ndimage.label((ways.cells == FREE) & (ways.room >= radius))
    return np.asarray((label > 0) & np.isin(label, np.unique(label[ways.reachable])))


def why_end(access: Access, shut_in: bool, resolution: float, least_length: float) -> tuple[str, str]:
    """Verdict and reason where no frontier is worth a goal, by the rule of `planning.mission_end`.

    What is too narrow for the robot, or beyond a passage that is, does not keep the mission from being complete: less
    than least_length (m) in which the robot would fit. shut_in: there is no place that it could reach. resolution: a
    cell's side, m.
    """
    if shut_in and len(access.live):
        return "stuck", "The robot cannot reach any other place."
    barred, in_vain = (resolution * int((access.open & which).sum()) for which in (access.live, ~access.live))
    left = resolution * len(access.live)
    if barred + in_vain >= least_length and barred >= in_vain:
        return "stuck", f"{barred:.1f} m of frontier lie behind a passage too narrow for the robot and its margin."
    if barred + in_vain >= least_length:
        return "stuck", f"{in_vain:.1f} m of open frontier were tried again and again in vain."
    return "complete", f"No frontier is left{f' but {left:.1f} m too narrow for the robot' if left else ''}."


def choose(
    grid: GridMap, pose: PoseEstimate, tried: TriedPlaces, robot: RobotConfig, explorer: ExplorerConfig
) -> tuple[GoalChoice, TriedPlaces]:
    """The nearest frontier's goal, or how the mission ends, and the tries with this one.

    The robot has just looked round at pose.X_MB. Candidates are the nearest cell of each frontier that is worth a
    goal; their value is minus the cost of the way, m weighted by clearance. GoalChoice.node and candidates are flat
    indices of grid cells.
    """
    p_MB = pose.X_MB[:2]
    ways = find_ways(grid, p_MB, robot)
    access = find_access(grid, ways, p_MB, tried, robot, explorer.frontier_attempts)
    rows = np.flatnonzero(access.worth)
    if len(rows) == 0:
        return no_goal(grid, access, ways, p_MB, robot), tried
    by_cost = rows[np.argsort(access.cost[rows], kind="stable")]
    # The nearest cell of each frontier, the nearest frontier first.
    _, first = np.unique(access.frontier[by_cost], return_index=True)
    nearest = by_cost[np.sort(first)]
    cost = access.cost[nearest]
    reason = f"The nearest of {len(nearest)} frontiers is {cost[0]:.1f} m away, counted by clearance."
    choice = goal_among(grid, access.stand[nearest], 0, -cost, reason)
    return choice, TriedPlaces(np.vstack([tried.p_MF, access.p_MF[nearest[:1]]]))


def goal_among(
    grid: GridMap,
    stand: IntArray,
    best: int,
    value: FloatArray,
    reason: str,
    exploration: FloatArray | float = 0.0,
    exploitation: FloatArray | float = 0.0,
) -> GoalChoice:
    """The choice of the best of some cells (c, 2). The other arguments are as in GoalChoice."""
    candidates, zeros = np.ravel_multi_index(tuple(stand.T), grid.probability.shape), np.zeros(len(stand))
    exploration, exploitation = zeros + exploration, zeros + exploitation
    return GoalChoice(
        stage=grid.stage,
        node=int(candidates[best]),
        p_MG=center_of(grid, stand[best]),
        candidates=candidates,
        exploitation=exploitation,
        exploration=exploration,
        pose_price=zeros,
        gain=exploration + exploitation,
        value=value,
        verdict="goal",
        reason=reason,
    )


def no_goal(grid: GridMap, access: Access, ways: Ways, p_MB: FloatArray, robot: RobotConfig) -> GoalChoice:
    """The choice where no frontier is worth a goal to the robot at p_MB (2,), m in M."""
    shut_in = not (ways.reachable & ~_disc(grid, p_MB, APART)).any()
    verdict, reason = why_end(access, shut_in, grid.resolution, 2.0 * robot.radius)
    return replace(empty_choice(), stage=grid.stage, verdict=verdict, reason=reason)


def is_spent(grid: GridMap, tried: TriedPlaces, robot: RobotConfig) -> bool:
    """Whether in the newest grid there is hardly any frontier left where the robot is driving for one.

    Then it need not go there, nor look round: the next goal can be chosen at once.
    """
    if len(tried.p_MF) == 0 or not tried.at_frontier:
        return False
    p_MF = tried.p_MF[-1]
    low, high = cell_at(grid, p_MF - SAME_PLACE), cell_at(grid, p_MF + SAME_PLACE)
    # One more cell round it, whose neighbours the edge of the box needs.
    rows, columns = (slice(max(low[k] - 1, 0), high[k] + 2) for k in range(2))
    box = replace(
        grid,
        origin=grid.origin + grid.resolution * np.array([columns.start, rows.start]),
        probability=grid.probability[rows, columns],
    )
    left = np.argwhere(next_to_unknown(classify(box)))
    near = np.hypot(*(center_of(box, left) - p_MF).T) <= SAME_PLACE
    return bool(near.sum() * grid.resolution < 2.0 * robot.radius)

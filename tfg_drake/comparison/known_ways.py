"""The shortest ways of a round robot past walls that are known: a visibility graph of the corners it turns round.

Round every wall's end lies a ring of nodes; a shortest way is a chain of straight pieces from place to node to place.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tfg_drake.geometry.distance import clearance, point_distance
from tfg_drake.messages import FloatArray, IntArray

# Number of nodes of a ring; a way around a corner is less than a hundredth longer than along its circle.
RING = 12
# Rounding of a clearance, m, and number of lines that are checked at a time.
_ROUNDING, _AT_ONCE = 1e-6, 500_000


@dataclasses.dataclass(frozen=True)
class KnownWays:
    """The shortest ways between places.

    points: (n, 2) places, then nodes, m. length: (p, p) m from place to place, inf where there is no way. before:
    (p, n) the point before each on the way from a place.
    """

    points: FloatArray
    length: FloatArray
    before: IntArray

    def way(self, i: int, j: int) -> FloatArray:
        """The corners (k, 2) of the way from place i to place j, both of them included, m."""
        rows = [j]
        while rows[-1] != i:
            rows.append(int(self.before[i, rows[-1]]))
        return self.points[rows[::-1]]


def known_ways(walls: FloatArray, places: FloatArray, room: float) -> KnownWays:
    """The ways between places (p, 2) on which a robot keeps room (m) from all walls (m, 4).

    From a place that is nearer to a wall than that, it keeps as much as it has there.
    """
    points, graph = way_graph(walls, places, room / math.cos(math.pi / RING), room)
    length, before = dijkstra(graph, indices=np.arange(len(places)), return_predecessors=True)
    return KnownWays(points, length[:, : len(places)], before)


def way_graph(walls: FloatArray, places: FloatArray, ring: float, room: float) -> tuple[FloatArray, csr_array]:
    """Places (p, 2) and nodes on rings of this radius (m) as points (n, 2), and the straight ways between them that
    keep room (m) from all walls (m, 4): a graph (n, n) of their lengths, m."""
    ends = np.unique(walls.reshape(-1, 2), axis=0)
    angles = 2.0 * math.pi / RING * np.arange(RING)
    nodes = (ends[:, None] + ring * np.stack([np.cos(angles), np.sin(angles)], axis=-1)).reshape(-1, 2)
    nodes = nodes[point_distance(nodes, walls) >= room - _ROUNDING]
    points = np.vstack([places, nodes])
    enough = np.minimum(point_distance(points, walls), room) - _ROUNDING
    a, b = np.triu_indices(len(points), 1)
    free = np.empty(len(a), dtype=np.bool_)
    for some in np.array_split(np.arange(len(a)), 1 + len(a) // _AT_ONCE):
        lines = np.hstack([points[a[some]], points[b[some]]])
        free[some] = clearance(lines, walls, room) >= np.minimum(enough[a[some]], enough[b[some]])
    # Places in one spot are joined by next to nothing: a graph has no edges of length 0.
    a, b = a[free], b[free]
    length = np.maximum(np.hypot(*(points[a] - points[b]).T), 1e-9)
    graph = csr_array((np.tile(length, 2), (np.append(a, b), np.append(b, a))), shape=(len(points), len(points)))
    return points, graph

"""A probabilistic roadmap that persists from stage to stage and moves with the map (the paper's Sec. III-E).

Every node is stored in the frame of a view's arrival pose, so it moves when a loop closes; every stage checks the edges
near the robot against the current surfaces. The robot's path stays in the roadmap, so that a narrow door once passed is
not lost to bad luck in sampling.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numba import njit

from tfg_drake.config import NODE_MARGIN
from tfg_drake.geometry import se2
from tfg_drake.geometry.connected import component_labels, connect
from tfg_drake.geometry.distance import clearance, nearest_on_segment, room_beside
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import rows_in_box, segment_grid
from tfg_drake.geometry.star import in_a_star, lines_in_stars, star_index
from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap, message, replace
from tfg_drake.planning.chance_constraint import predicted_deviation, required_clearance
from tfg_drake.planning.parameters import COMFORT, PlanningParameters
from tfg_drake.table import concat, empty, put, take
from tfg_drake.tfg.near import within
from tfg_drake.tfg.segmentation import find_corners

# Least distance between nodes in the open, near frontiers and in narrow passages, m.
SPACING = 0.75
FRONTIER_SPACING = 0.5
PASSAGE_SPACING = 0.3
# Greatest number of neighbours that a new node is connected to, and their greatest distance, m.
NEIGHBOURS = 10
EDGE_LENGTH = 3.0
# Number of samples in the newest star, in older ones and at each frontier point.
NEWEST_DARTS = 700
OLDER_DARTS = 300
FRONTIER_DARTS = 5
# Surfaces are at least this share of a gap's width away from its middle, rounding included.
HALF_GAP = 0.475
# Spacing at which the driven way is recorded, m.
DRIVEN_STEP = 0.1
# Greatest deviation of the driven way's chords from it, m. A new node on it within a distance of an old one that grows
# with the room, from CLOSEST to SAME_NODE, m, is replaced by the old one.
CHORD = 0.01
CLOSEST, SAME_NODE = 0.02, 0.15
# Probability of a collision, if it is more than planner.collision_probability, that is accepted where there is no other
# way, as the scan watches every path; and the detour, m, that is preferred to an edge for each NODE_MARGIN, begun, of
# the clearance that the edge lacks.
ACCEPTED, TIGHT = 0.2, 10.0
# Greatest distance of a scan point from its surface, m: one that no mapped surface is nearer to is of an unmapped
# obstacle; an obstacle that a scan sees past by more is gone; others are passed at this distance.
RETURN_OFF = 0.08


@message
class Edges:
    """Edges of a roadmap at their last check.

    nodes: (e, 2) their ends. travelled: (e,) the robot has driven it. free: (e,) known to lie in free space. clearance:
    (e,) m, measured up to COMFORT or, if that is more, up to the greatest clearance that any edge needs. required:
    (e,) m, the clearance that it needs: 0 where the robot has driven, whatever the newest map shows.
    """

    nodes: Annotated[IntArray, "e", 2]
    travelled: Annotated[BoolArray, "e"]
    free: Annotated[BoolArray, "e"]
    clearance: Annotated[FloatArray, "e"]
    required: Annotated[FloatArray, "e"]

    def __len__(self) -> int:
        return len(self.nodes)

    def between(self, nodes: BoolArray) -> IntArray:
        """Return the rows (k,) of the edges between some of the nodes (n,)."""
        return np.flatnonzero(nodes[self.nodes].all(axis=1))

    @property
    def usable(self) -> BoolArray:
        """Mask of the edges (e,) that lie in free space and have the required clearance."""
        return self.with_room(self.required)

    def with_room(self, need: FloatArray) -> BoolArray:
        """Return a mask of the edges (e,) that lie in free space with a clearance, m, (e,) or one number for all."""
        return np.asarray(self.free & (self.clearance >= need))


@message
class RoadmapState:
    """The roadmap and its edges, checked at one stage.

    stage. ids: (n,) of the nodes, ascending, next_id: that of the next new node. anchor: (n,) the view in whose arrival
    frame A each node is stored, p_AN: (n, 2), m. points: (n, 2) the nodes in M at this stage, m. sigma: (n,) m, the
    deviation of the robot there relative to the surfaces. edges: all ever proposed, between rows of the nodes, smaller
    node first, in the order of the nodes. way_end: id of the node where the robot's path ends, -1 for none.
    """

    stage: int
    ids: Annotated[IntArray, "n"]
    next_id: int
    anchor: Annotated[IntArray, "n"]
    p_AN: Annotated[FloatArray, "n", 2]
    points: Annotated[FloatArray, "n", 2]
    sigma: Annotated[FloatArray, "n"]
    edges: Annotated[Edges, "e"]
    way_end: int


def unchecked(nodes: IntArray, travelled: BoolArray) -> Edges:
    """Return new edges between nodes (e, 2), of which the robot has driven some (e,)."""
    no, zero = np.zeros(len(nodes), dtype=np.bool_), np.zeros(len(nodes))
    return Edges(nodes, travelled, no, zero, zero)


def empty_roadmap() -> RoadmapState:
    """The roadmap before the first view."""
    return empty(RoadmapState, way_end=-1)


@njit(cache=True)
def fitting(
    proposals: FloatArray,
    spacing: FloatArray,
    is_free: BoolArray,
    nodes: FloatArray,
    star_offsets: IntArray,
    star_vertices: FloatArray,
    segments: FloatArray,
    room: float,
) -> BoolArray:
    """Return the proposals (p, 2) to keep. They are tested in order; one is kept if it lies in free space, has `room`,
    m, to all segments (m, 4), and its spacing (p,), m, to those kept before it and to the nodes (n, 2).

    Nodes without enough room in the newest map are ignored, as they must not exclude better ones from the middle of a
    passage. is_free: (p,) known to lie in free space. Star polygons as in `tfg_drake.geometry.star.inside_any`.
    """
    keep, kept = np.zeros(len(proposals), dtype=np.bool_), np.empty((len(proposals), 2))
    grid, node_grid = segment_grid(segments), segment_grid(np.hstack((nodes, nodes)))
    stars = star_index(star_offsets, star_vertices)
    near, in_stars = np.empty(len(nodes), dtype=np.int64), np.empty(len(stars[1][4]), dtype=np.int64)
    node_room = np.full(len(nodes), -1.0)
    count = 0
    for i in range(len(proposals)):
        x, y, d = proposals[i, 0], proposals[i, 1], spacing[i]
        ok = True
        for j in range(count):
            if (kept[j, 0] - x) ** 2 + (kept[j, 1] - y) ** 2 < d * d:
                ok = False
                break
        for k in range(rows_in_box(node_grid, x - d, x + d, y - d, y + d, near) if ok else 0):
            n = near[k]
            px, py = nodes[n, 0], nodes[n, 1]
            if (px - x) ** 2 + (py - y) ** 2 < d * d:
                if node_room[n] < 0.0:
                    node_room[n] = room_beside(px, py, px, py, segments, grid, room)
                if node_room[n] >= room:
                    ok = False
                    break
        # Most are too near to others: where they lie is looked at last.
        ok = ok and (is_free[i] or in_a_star(x, y, star_offsets, star_vertices, stars, in_stars))
        if ok and room_beside(x, y, x, y, segments, grid, room) >= room:
            kept[count] = proposals[i]
            count += 1
            keep[i] = True
    return keep


@njit(cache=True)
def _gaps(ends: FloatArray, segments: FloatArray, narrowest: float, widest: float) -> FloatArray:
    """Shortest connections (g, 4) of ends (n, 2) with segments (m, 4), those from narrowest to widest (m) long with
    nothing nearer to their middles than their two sides."""
    grid = segment_grid(segments)
    rows = np.empty(len(grid[4]), dtype=np.int64)
    found, count = np.empty((64, 4)), 0
    for i in range(len(ends)):
        x, y = ends[i, 0], ends[i, 1]
        near = rows_in_box(grid, x - widest, x + widest, y - widest, y + widest, rows)
        for j in np.unique(rows[:near]):
            qx, qy = nearest_on_segment(x, y, segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3])
            width, mx, my = math.hypot(qx - x, qy - y), 0.5 * (x + qx), 0.5 * (y + qy)
            half = HALF_GAP * width
            if narrowest <= width <= widest and room_beside(mx, my, mx, my, segments, grid, half) >= half:
                if count == len(found):
                    found = np.vstack((found, np.empty_like(found)))
                found[count, 0], found[count, 1], found[count, 2], found[count, 3] = x, y, qx, qy
                count += 1
    return found[:count].copy()


def passages(segments: FloatArray, narrowest: float, widest: float) -> tuple[FloatArray, FloatArray]:
    """Return places in narrow gaps, (p, 2), m: the middle of each gap and 0.5 m on either side along the passage; and
    the width of the gap of each (p,), m.

    A gap joins an end of one of the segments (m, 4) with the nearest point of another, is between narrowest and widest
    (m) wide, and nothing is nearer to its middle than its two sides.
    """
    ends = segments.reshape(-1, 2)
    ends = ends[np.lexsort(ends.T[::-1])]
    ends = ends[np.append(True, (ends[1:] != ends[:-1]).any(axis=1))[: len(ends)]]
    gaps = _gaps(ends, segments, narrowest, widest)
    middle, across = 0.5 * (gaps[:, :2] + gaps[:, 2:]), gaps[:, 2:] - gaps[:, :2]
    width = np.hypot(*across.T)
    along = 0.5 * np.stack([-across[:, 1], across[:, 0]], axis=1) / width[:, None]
    return np.stack([middle + along, middle, middle - along], axis=1).reshape(-1, 2), np.repeat(width, 3)


def in_free_space(edges: FloatArray, tfg: TfgMap) -> BoolArray:
    """Return a mask (e,) of the edges (e, 4), m in M, that lie in the free space of past views."""
    return np.asarray(lines_in_stars(edges, tfg.star_offsets, tfg.star_vertices))


def _darts_in_stars(rng: np.random.Generator, tfg: TfgMap, first: int, stop: int, count: int) -> FloatArray:
    """Points (count, 2), m in M, spread evenly over the areas of stars first:stop; where two overlap, twice as many."""
    start, end = tfg.star_offsets[first], tfg.star_offsets[stop]
    if start == end:
        return np.zeros((0, 2))
    # A star is a fan of triangles round its centre.
    vertex = np.arange(start, end)
    star = np.searchsorted(tfg.star_offsets, vertex, side="right") - 1
    following = np.where(vertex + 1 == tfg.star_offsets[star + 1], tfg.star_offsets[star], vertex + 1)
    a = tfg.star_vertices[vertex] - tfg.star_centers[star]
    b = tfg.star_vertices[following] - tfg.star_centers[star]
    area = np.cumsum(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    which = np.searchsorted(area, rng.random(count) * area[-1], side="right").clip(max=len(area) - 1)
    r, t = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return np.asarray(tfg.star_centers[star[which]] + r * ((1 - t) * a[which] + t * b[which]))


def _proposals(rng: np.random.Generator, tfg: TfgMap, radius: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Places for new nodes (p, 2), m in M, the most wanted first, with the spacing (p,) that each must keep, and
    whether they lie in free space for sure (p,)."""
    gaps, width = passages(tfg.obstacles, 2 * (radius + NODE_MARGIN), 2 * SPACING)
    # Another node stands for one in a gap only where there is room for that.
    apart = np.clip(0.5 * width - radius - NODE_MARGIN, CLOSEST, PASSAGE_SPACING)
    normal = np.repeat(tfg.frontier_normal, FRONTIER_DARTS, axis=0)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    back, aside = rng.uniform(0.45, 1.6, (len(normal), 1)), rng.uniform(-0.6, 0.6, (len(normal), 1))
    fringe = np.repeat(tfg.frontiers, FRONTIER_DARTS, axis=0) + back * normal + aside * tangent
    stars = len(tfg.star_centers)
    newest = _darts_in_stars(rng, tfg, stars - 1, stars, NEWEST_DARTS)
    older = _darts_in_stars(rng, tfg, 0, stars - 1, OLDER_DARTS)
    groups = [gaps, fringe, newest, older]
    sizes = [len(group) for group in groups]
    spacing = np.append(apart, np.repeat([FRONTIER_SPACING, SPACING, SPACING], sizes[1:]))
    return np.concatenate(groups), spacing, np.repeat([False, False, True, True], sizes)


def chords(way: FloatArray) -> BoolArray:
    """Return a mask (d,) of the points of a path (d, 2), m, recorded every DRIVEN_STEP, that are ends of chords which
    deviate from it by CHORD at most and are about SPACING long at most."""
    ends = find_corners(way, CHORD)
    ends[:: int(SPACING / DRIVEN_STEP)] = True
    return ends


def _travelled_nodes(
    nodes: FloatArray, driven: FloatArray, estimate: MapEstimate, segments: FloatArray, radius: float, way_end: int
) -> tuple[FloatArray, IntArray, int]:
    """New nodes along the way driven (d, 2) to the last view, the chain of edges (e, 2), smaller node first, between
    them and existing nodes, and the node where it ends.

    It begins at the node where the way ended before, way_end, however the map has moved since, and ends where the robot
    drove on from there; of a robot that was kidnapped since, the view's place alone is new. An old node nearby stands
    for a new one where there is room for that.
    """
    view = estimate.X_MA[-1, :2]
    chain = view[None]
    if len(driven) and np.hypot(*(driven[-1] - estimate.X_MD[:2])) < 0.5:
        chain = np.vstack([driven, view])
        chain = chain[chords(chain)]
    room = clearance(np.hstack([chain, chain]), segments, 1.0)
    near_enough = np.clip(room - radius - 2.0 * NODE_MARGIN, CLOSEST, SAME_NODE)
    way = _standing_for(chain, near_enough, nodes)
    new = way > np.maximum.accumulate(np.append(len(nodes) - 1, way))[:-1]
    end = int(way[-1])
    if way_end >= 0 and len(chain) > 1:
        way = np.append(way_end, way)
    edges = np.sort(np.stack([way[:-1], way[1:]], axis=1), axis=1)
    return chain[new], edges[edges[:, 0] < edges[:, 1]], end


def _standing_for(chain: FloatArray, near_enough: FloatArray, nodes: FloatArray) -> IntArray:
    """The node (c,) that stands for each point of a chain (c, 2): the nearest of the nodes (n, 2) or of those made
    before it, if it is near enough (c,), m, or a new one, n, n + 1, ..."""
    stand = np.empty(len(chain), dtype=np.int64)
    for i, p in enumerate(chain):
        square = (nodes[:, 0] - p[0]) ** 2 + (nodes[:, 1] - p[1]) ** 2
        stand[i] = int(np.argmin(square)) if len(nodes) else 0
        if math.sqrt(square.min(initial=np.inf)) >= near_enough[i]:
            stand[i], nodes = len(nodes), np.vstack([nodes, p])
    return stand


def _nearest_edges(points: FloatArray, first_new: int, near: BoolArray) -> IntArray:
    """Edges (e, 2), smaller node first, from each node first_new... to its nearest neighbours among those of all points
    (n, 2) that are near (n,)."""
    edges = [np.zeros((0, 2), dtype=np.int64)]
    for i in range(first_new, len(points)):
        square = (points[:, 0] - points[i, 0]) ** 2 + (points[:, 1] - points[i, 1]) ** 2
        square[i], square[~near] = np.inf, np.inf
        nearest = np.flatnonzero(square < EDGE_LENGTH * EDGE_LENGTH)
        nearest = nearest[np.argsort(square[nearest], kind="stable")[:NEIGHBOURS]]
        edges.append(np.stack([np.minimum(i, nearest), np.maximum(i, nearest)], axis=1))
    return np.concatenate(edges)


def extend(
    state: RoadmapState,
    tfg: TfgMap,
    estimate: MapEstimate,
    parameters: PlanningParameters,
    *,
    driven: FloatArray | None = None,
    radius: float = np.inf,
    in_vain: bool = False,
) -> RoadmapState:
    """Return the roadmap moved with the map to estimate.stage, with new nodes and newly checked edges.

    driven: (d, 2) m in M, the robot's path to the last view. radius: m around the newest view, within which the map is
    complete; by default everywhere. Farther away nodes move, and nothing else changes. in_vain: goals could not be
    reached, so driven edges near the robot that a surface crosses now are closed. Equal arguments give equal roadmaps.
    """
    views = np.flatnonzero(within(estimate.X_MA, estimate.X_MA[-1], radius))
    points, chain, way_end = _with_new_nodes(state, tfg, estimate, parameters, driven, radius)
    first_new = len(state.anchor)
    fresh = len(points) - first_new
    apart = points[first_new:, None] - estimate.X_MA[views, :2]
    anchor = np.append(state.anchor, views[np.square(apart).sum(axis=2).argmin(axis=1)])
    p_AN = np.vstack([state.p_AN, _to_anchor(points[first_new:], anchor[first_new:], estimate.X_MA)])

    near = within(points, estimate.X_MA[-1], radius)
    near[first_new:] = True
    sigma = np.append(state.sigma, np.full(fresh, np.inf))
    sigma[near] = predicted_deviation(points[near], estimate, tfg, parameters, sigma[near])
    proposed = np.vstack([chain, _nearest_edges(points, first_new, near)])
    was_driven = np.arange(len(proposed)) < len(chain)
    all_edges = _distinct(state.edges, unchecked(proposed, was_driven), len(points))
    rows = all_edges.between(near)
    edges = _checked(take(all_edges, rows), points, sigma, tfg, parameters)
    if len(tfg.keep_out):
        # The map may have moved a way that was driven into an area to keep out of.
        body = parameters.robot.radius
        outside = clearance(points[edges.nodes].reshape(-1, 4), tfg.keep_out, body) >= body
        edges = replace(edges, travelled=edges.travelled & outside)
    if in_vain:
        here = within(points, estimate.X_MD, EDGE_LENGTH)[edges.nodes].any(axis=1)
        edges = replace(edges, travelled=edges.travelled & ~(here & (edges.clearance == 0.0)))
    edges = replace(edges, required=np.where(edges.travelled, 0.0, edges.required))
    ids = np.append(state.ids, state.next_id + np.arange(fresh))
    return replace(
        state,
        stage=estimate.stage,
        ids=ids,
        next_id=state.next_id + fresh,
        anchor=anchor,
        p_AN=p_AN,
        points=points,
        sigma=sigma,
        edges=put(all_edges, rows, edges),
        way_end=int(ids[way_end]),
    )


def _with_new_nodes(
    state: RoadmapState,
    tfg: TfgMap,
    estimate: MapEstimate,
    parameters: PlanningParameters,
    driven: FloatArray | None,
    radius: float,
) -> tuple[FloatArray, IntArray, int]:
    """The nodes (n, 2), m in M, the old ones first, then those of the way driven (d, 2), then samples; the chain of
    edges (e, 2), smaller node first, along that way; and the node where it ends. Further arguments as of `extend`."""
    body = parameters.robot.radius
    nodes = place_in_map(state.anchor, state.p_AN, estimate.X_MA)
    way_end = int(np.append(np.flatnonzero(state.ids == state.way_end), -1)[0])
    chain = np.zeros((0, 2), dtype=np.int64)
    if estimate.stage > state.stage:
        driven = np.zeros((0, 2)) if driven is None else driven
        travelled, chain, way_end = _travelled_nodes(nodes, driven, estimate, tfg.obstacles, body, way_end)
        nodes = np.vstack([nodes, travelled])
    rng = np.random.default_rng((parameters.seed, estimate.stage))
    proposals, spacing, is_free = _proposals(rng, tfg, body)
    if np.isfinite(radius):
        inside = within(proposals, estimate.X_MA[-1], radius - EDGE_LENGTH)
        proposals, spacing, is_free = proposals[inside], spacing[inside], is_free[inside]
    stars, room = (tfg.star_offsets, tfg.star_vertices), body + NODE_MARGIN
    points = np.vstack([nodes, proposals[fitting(proposals, spacing, is_free, nodes, *stars, tfg.obstacles, room)]])
    return points, chain, way_end


def _distinct(edges: Edges, proposed: Edges, count: int) -> Edges:
    """The edges, distinct and in the order of the nodes, and those proposed: one for each pair of count nodes; a
    travelled one stands for its twin."""
    if not len(proposed):
        return edges
    both = concat(edges, proposed)
    pair = both.nodes[:, 0] * count + both.nodes[:, 1]
    order = np.argsort(2 * pair + ~both.travelled, kind="stable")
    pair = pair[order]
    return take(both, order[np.append(True, pair[1:] > pair[:-1])])


def _checked(
    edges: Edges,
    points: FloatArray,
    sigma: FloatArray,
    tfg: TfgMap,
    parameters: PlanningParameters,
) -> Edges:
    """The edges between points (n, 2), checked against the map.

    An edge is usable where it lies in free space and has the room that it needs. How much that is follows from the
    deviations sigma (n,), m, and the probability of a collision: ACCEPTED, or the planner's if that is more.
    """
    node_need = room_needed(parameters, sigma, ACCEPTED)
    has, need = _measure(edges.nodes, points, node_need, tfg.obstacles)
    free = edges.free | edges.travelled
    ask = np.flatnonzero(~free & (has >= parameters.robot.radius))
    free[ask] = in_free_space(points[edges.nodes[ask]].reshape(-1, 4), tfg)
    return replace(edges, clearance=has, required=need, free=free)


@njit(cache=True)
def _measure(
    edges: IntArray, points: FloatArray, node_need: FloatArray, segments: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The clearance (e,) of edges (e, 2) between points (n, 2) from segments (m, 4), m, as far as it is less than
    COMFORT or than what any of them needs; and the clearance (e,) that they need, m, the greater of both ends'
    node_need (n,)."""
    has, need, reach = np.empty(len(edges)), np.empty(len(edges)), COMFORT
    for e in range(len(edges)):
        need[e] = max(node_need[edges[e, 0]], node_need[edges[e, 1]])
        reach = max(reach, need[e])
    grid, room = segment_grid(segments), np.empty(len(points))
    for n in range(len(points)):
        room[n] = room_beside(points[n, 0], points[n, 1], points[n, 0], points[n, 1], segments, grid, reach)
    for e in range(len(edges)):
        # No edge has more room than its ends.
        a, b = edges[e, 0], edges[e, 1]
        most = min(room[a], room[b])
        has[e] = room_beside(points[a, 0], points[a, 1], points[b, 0], points[b, 1], segments, grid, most)
    return has, need


def room_needed(parameters: PlanningParameters, sigma: FloatArray, accepted: float) -> FloatArray:
    """Return the clearance (e,), m, that a way needs for its deviation sigma (e,), m, and an accepted probability of a
    collision: at most that of the planner's own probability, but always room to stand.

    A wall may extend a few centimetres beyond its end in the map, and a robot that has squeezed into a room without
    landmarks will be less certain of its pose when it comes out.
    """
    radius, probability = parameters.robot.radius, parameters.planner.collision_probability
    own = required_clearance(radius, sigma, probability)
    least = np.maximum(required_clearance(radius, sigma, accepted), radius + NODE_MARGIN)
    return np.asarray(np.minimum(own, least) if accepted > probability else own)


@read_only_arguments
@njit(cache=True)
def components(edges: IntArray, which: BoolArray, count: int) -> IntArray:
    """Return the connected component (count,) of each node, as its first node, under some (e,) of the edges (e, 2)."""
    first = np.arange(count)
    for e in range(len(edges)):
        if which[e]:
            connect(first, edges[e, 0], edges[e, 1])
    component_labels(first)
    return first


def place_in_map(anchor: IntArray, p_AN: FloatArray, X_MA: FloatArray) -> FloatArray:
    """Return p_MN (n, 2), m, of points p_AN (n, 2), each in the arrival frame of the view anchor (n,); X_MA: (k, 3)."""
    return se2.transform(X_MA.take(anchor, axis=0), p_AN)


def _to_anchor(p_MN: FloatArray, anchor: IntArray, X_MA: FloatArray) -> FloatArray:
    return turned(p_MN - X_MA[anchor, :2], -X_MA[anchor, 2])

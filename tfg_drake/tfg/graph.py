"""The topological feature graph: its extension by every view, and its placement by the current map estimate.

Sec. III-A of Mu et al. (CDC 2016): landmarks are vertices, and an edge joins two landmarks if an obstacle surface runs
from one to the other. Beyond the paper, surfaces with one landmark or none and free star polygons are stored, all
anchored to walls or views, so that they move with the map when a loop closes.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN, ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.geometry.star import inside_any, lines_in_one_star
from tfg_drake.geometry.turned import turned
from tfg_drake.geometry.visibility import cast_rays, surely_visible
from tfg_drake.messages import (
    BoolArray,
    FloatArray,
    IntArray,
    MapEstimate,
    TfgMap,
    is_tag,
    replace,
)
from tfg_drake.table import concat, empty, take
from tfg_drake.tfg.drift import MOST_DRIFT, known_jointly
from tfg_drake.tfg.feature_graph import TfgGraph, behind, part_of, seen_nearest, with_part
from tfg_drake.tfg.frontier import (
    GRAZE,
    POORLY_SEEN,
    PUSH,
    FrontierPoints,
    far_from,
    find_faces,
    find_frontiers,
    open_frontiers,
    place_points,
    points_of,
    tried_like,
)
from tfg_drake.tfg.near import within
from tfg_drake.tfg.overlap import WeaklyTied, known_badly, standing, weakly_tied
from tfg_drake.tfg.panorama import MOST_LOST, Panorama
from tfg_drake.tfg.passing import SAME_PLACE, STAYS, seen_past, without_bodies, without_dynamic
from tfg_drake.tfg.polyline import segments_of
from tfg_drake.tfg.segmentation import JOIN_REACH, panorama_links, segment
from tfg_drake.tfg.star_polygon import star_polygon
from tfg_drake.tfg.stars import Stars, placed_stars, some_stars
from tfg_drake.tfg.surfaces import (
    END,
    ON_SURFACE,
    REFUTED_DEPTH,
    Surfaces,
    add_observation,
    place,
    without_doubles,
)

# Frontier points within this distance, m, are connected; a new one inherits the attempts at an old one within it.
TOGETHER = 0.5
# A view is an attempt at a face only within this share of the sensor's range, as it may miss a small face from farther.
NEAR_SHARE = 0.5
# Greatest distance, m, by which a loop closure may separate two adjacent places.
TORN = 1.0
# After this length of inspected surface without a tag, m, none is expected in the building.
WITHOUT_TAGS = 30.0
# Then a metre of unseen face counts as this much frontier, as no room lies behind it.
FACE_WORTH = 1.0 / 3.0


def update(
    graph: TfgGraph,
    estimate: MapEstimate,
    panorama: Panorama,
    tags: TagSensorConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    *,
    glance: bool = False,
) -> TfgGraph:
    """Return the graph with the newest view of the estimate added. On a large map only the part near it changes.

    estimate: the map of tags and walls at stage graph.stage + 1. panorama: of that view, in its arrival frame. glance:
    the view is a glance, which does not count as an attempt.

    Raises ValueError if the estimate is of another stage.
    """
    if estimate.stage != graph.stage + 1:
        raise ValueError(f"The graph holds {graph.stage} views: it cannot take stage {estimate.stage} of the map next.")
    # As far as the view may have seen, as mapped now.
    seen = panorama.range_max + TORN
    scene = _Scene(estimate, panorama, tags, robot, explorer, glance)
    if estimate.is_joint:
        return _with_view(graph, np.arange(graph.stage), scene)
    # Places that the view may have seen were seen by views within twice that distance.
    part = part_of(graph, estimate, 2.0 * seen)
    scene = dataclasses.replace(scene, estimate=part.estimate, radius=seen)
    return with_part(graph, part, _with_view(part.graph, np.flatnonzero(part.rows["k"]), scene))


@dataclasses.dataclass(frozen=True)
class _Scene:
    """The newest view, see `update`. radius: m, around it, within which the graph changes."""

    estimate: MapEstimate
    panorama: Panorama
    tags: TagSensorConfig
    robot: RobotConfig
    explorer: ExplorerConfig
    glance: bool
    radius: float = math.inf


def _with_view(graph: TfgGraph, views: IntArray, scene: _Scene) -> TfgGraph:
    """Return the graph, or a part of it, with the newest view added; views: (k,) those whose stars it holds."""
    estimate = scene.estimate
    view, X_MA = estimate.stage - 1, estimate.X_MA
    graph, panorama = _without_dynamic(graph, scene.panorama, estimate, X_MA[views])
    badly = _known_badly(estimate, is_large=math.isfinite(scene.radius))
    then = weakly_tied(graph.surfaces, graph.tag_ids, graph.tag_view, estimate, badly)
    stars_then = some_stars(placed_stars(graph.star_offsets, graph.star_vertices, X_MA[views]), ~then.views[views])
    links = panorama_links(panorama)
    links &= ~_seen_through(panorama, links, stars_then, X_MA[view])
    components = segment(panorama, links)

    surfaces, seen_ids, seen_normal = add_observation(
        graph.surfaces, estimate, components, panorama, graph.tag_ids, _facing(graph, X_MA)
    )
    placed = place(surfaces, estimate)
    with_tags = _with_facing(graph, estimate, seen_ids, seen_normal)
    # Where the map overlaps itself, weakly tied views say nothing of the robot's surroundings, and the newest view says
    # nothing of theirs.
    weak = weakly_tied(surfaces, with_tags.tag_ids, with_tags.tag_view, estimate, badly)
    segments, surface = segments_of(surfaces.offsets, placed)
    free = _up_to_surfaces(panorama, segments[~weak.surfaces[surface]], X_MA[view])
    star = star_polygon(free)
    star_offsets = np.append(graph.star_offsets, graph.star_offsets[-1] + len(star))
    star_vertices = np.concatenate([graph.star_vertices, star])
    views_now = np.append(views, view)
    stars = some_stars(placed_stars(star_offsets, star_vertices, X_MA[views_now]), ~weak.views[views_now])
    found = points_of(view, *find_frontiers(free, links, 2.0 * scene.robot.radius))
    free_space = _free_space_frontiers(
        take(graph.frontiers, ~graph.frontiers.on_face),
        found,
        estimate,
        placed_stars(np.array([0, len(star)]), star, X_MA[view:]),
        stars,
        weak.views,
    )
    faces = _faces(
        take(graph.frontiers, graph.frontiers.on_face), replace(surfaces, vertices=placed), stars, weak, scene
    )
    updated = replace(
        with_tags,
        stage=estimate.stage,
        surfaces=surfaces,
        star_offsets=star_offsets,
        star_vertices=star_vertices,
        frontiers=concat(free_space, faces),
    )
    return updated if scene.glance else _count_attempts(updated, views_now, badly, scene)


def _seen_through(panorama: Panorama, links: BoolArray, stars: Stars, X_MA: FloatArray) -> BoolArray:
    """The links (b,) of a panorama over gaps that some earlier view saw through: an opening that this one sees at too
    grazing an incidence to tell it from the wall. stars: theirs, in M; X_MA: (3,) the pose of the panorama."""
    bins = np.flatnonzero(links)
    a, b = panorama.points[bins], np.roll(panorama.points, -1, axis=0)[bins]
    along, gap = b - a, np.hypot(*(b - a).T)
    wide = gap > JOIN_REACH
    bins, a, b, along = bins[wide], a[wide], b[wide], along[wide] / gap[wide, None]
    # The robot is to the left of the way from one bin to the next.
    behind = np.stack([along[:, 1], -along[:, 0]], axis=1)
    middle = 0.5 * (a + b)
    lines = np.hstack([transform(X_MA, middle + to * behind) for to in (-REFUTED_DEPTH, 2.0 * REFUTED_DEPTH)])
    through = np.zeros(len(links), dtype=np.bool_)
    if len(bins):
        through[bins[lines_in_one_star(lines, *stars.polygons)]] = True
    return through


def _known_badly(estimate: MapEstimate, *, is_large: bool = False) -> BoolArray:
    """The landmarks (n,) of unknown place relative to the robot, as of `known_badly`: a small map has none unless the
    robot is lost."""
    return known_badly(estimate) if is_large or estimate.is_adrift else np.zeros(len(estimate.ids), dtype=np.bool_)


def _free_space_frontiers(
    old: FrontierPoints, new: FrontierPoints, estimate: MapEstimate, star: Stars, stars: Stars, weak: BoolArray
) -> FrontierPoints:
    """The old frontiers of free space that the newest view has not covered, and those that it found. Those of weakly
    tied views, weak: (k,), stay, and stand for no new ones.

    star: the newest view's, stars: of all views that say something of the robot's surroundings, both in M.
    """
    then, now = place_points(old, estimate.X_MA), place_points(new, estimate.X_MA)
    explored = inside_any(then.p, *star.polygons) | explored_elsewhere(then, stars, estimate)
    theirs = weak[old.view]
    is_new = far_from(now.p, then.p[~theirs & ~explored], PUSH)
    is_new &= ~inside_any(now.p, *stars.polygons)
    new = replace(new, tries=tried_like(now, then, TOGETHER).tries)
    return concat(take(old, theirs | ~explored), take(new, is_new))


def _faces(old: FrontierPoints, surfaces: Surfaces, stars: Stars, weak: WeaklyTied, scene: _Scene) -> FrontierPoints:
    """The frontier points before faces: those found now near the newest view, where it is known how far two faces may
    have drifted apart; elsewhere, and of weakly tied views, the old ones.

    surfaces: placed in M. stars: as of `_free_space_frontiers`. Each point is kept in the frame of the
    view that saw its surface, and moves with it.
    """
    X_MA = scene.estimate.X_MA

    def here(p_MF: FloatArray) -> BoolArray:
        return within(p_MF, X_MA[-1], scene.radius) & known_jointly(p_MF, scene.estimate)

    firm = take(surfaces, s=~weak.surfaces)
    then = place_points(old, X_MA)
    found = tried_like(find_faces(firm.view, firm.offsets, firm.vertices, stars, scene.tags), then, TOGETHER)
    stays = weak.views[old.view] | ~here(then.p)
    return concat(take(old, stays), anchored(take(found, here(found.p)), X_MA))


def _up_to_surfaces(panorama: Panorama, segments: FloatArray, X_MA: FloatArray) -> Panorama:
    """The panorama, seen from X_MA (3,), of which no single ray that met nothing frees what lies behind a surface (s,
    4) of the map, m in M: it was lost there."""
    nothing = np.flatnonzero(np.isinf(panorama.ranges))
    wall = cast_rays(segments, X_MA[:2], panorama.angles[nothing] + X_MA[2], panorama.range_max)
    # Where all beside it go farther, a door was opened or the map has drifted.
    beside = minimum_filter1d(np.nan_to_num(panorama.ranges, nan=math.inf), 2 * MOST_LOST + 1, mode="wrap")[nothing]
    ranges = panorama.ranges.copy()
    ranges[nothing] = np.where(beside < wall + REFUTED_DEPTH, wall, math.inf)
    return replace(panorama, ranges=ranges)


def _without_dynamic(
    graph: TfgGraph, panorama: Panorama, estimate: MapEstimate, earlier: FloatArray
) -> tuple[TfgGraph, Panorama]:
    """The graph before the newest view with the dynamic obstacles that this view met, and the view's panorama without
    them.

    earlier: (k, 3) poses in M of the views that the graph holds the stars of.
    """
    stars, X_MA = placed_stars(graph.star_offsets, graph.star_vertices, earlier), estimate.X_MA
    before = place_points(graph.met, X_MA).p
    static = without_dynamic(panorama, stars, estimate, before[graph.met_stamp <= estimate.stamp - STAYS])
    if not (len(before) or len(static.left_out)):
        return graph, static.panorama
    stays = ~seen_past(transform(inverse(X_MA[-1]), before), static.panorama)
    # An obstacle that still stands where it was met keeps its stamp.
    new = static.left_out[far_from(transform(X_MA[-1], static.left_out), before[stays], SAME_PLACE)]
    nothing, graph = np.zeros(len(new)), take(graph, p=stays)
    met = concat(graph.met, points_of(estimate.stage - 1, new, np.zeros_like(new), nothing))
    graph = replace(graph, met=met, met_stamp=np.append(graph.met_stamp, nothing + estimate.stamp))
    if static.bodies:
        bodies = [transform(X_MA[-1], body) for body in static.bodies]
        offsets, vertices = without_bodies(graph.star_offsets, graph.star_vertices, earlier, bodies)
        graph = replace(graph, star_offsets=offsets, star_vertices=vertices)
    return graph, static.panorama


def joined(first: TfgGraph, second: TfgGraph, estimate: MapEstimate, tags: TagSensorConfig) -> TfgGraph:
    """Return two graphs of one map as one, with the second's views after the first's and the frontiers that neither has
    covered.

    estimate: of tags, walls and all views. tags: sensor whose range and incidence define well-seen surface.
    """
    graph, X_MA = behind(first, second), estimate.X_MA
    surfaces = without_doubles(graph.surfaces, len(first.surfaces.view), estimate)
    placed, stars = place(surfaces, estimate), placed_stars(graph.star_offsets, graph.star_vertices, X_MA)
    free = take(graph.frontiers, ~graph.frontiers.on_face)
    faces = find_faces(surfaces.view, surfaces.offsets, placed, stars, tags)
    faces = tried_like(faces, place_points(graph.frontiers, X_MA), TOGETHER)
    p, k = place_points(free, X_MA).p, np.count_nonzero(~first.frontiers.on_face)
    is_open = ~inside_any(p, *stars.polygons)
    is_open[k:] &= far_from(p[k:], p[:k][is_open[:k]], PUSH)
    frontiers = concat(take(free, is_open), anchored(faces, X_MA))
    return replace(graph, surfaces=surfaces, frontiers=frontiers)


def resolve(graph: TfgGraph, estimate: MapEstimate, robot: RobotConfig, explorer: ExplorerConfig) -> TfgMap:
    """Return the graph in the map frame, with the estimate's tags, walls and views; both have the same stage.

    Surfaces that have drifted into free space are omitted until they fit again (see `tfg_drake.tfg.overlap`). Tags that
    no other surface joins get no facing, so they count as invisible. Frontiers that explorer.frontier_attempts views
    have tried in vain are given up. Fewer attempts reduce the weight: a sliver gets one try, a doorway two, and only a
    wide opening all of them.
    """
    tags = is_tag(estimate.ids)
    tag_ids, p_ML = estimate.ids[tags], estimate.p_ML[tags]
    placed = _placed(graph, np.arange(graph.stage), estimate, _known_badly(estimate))
    surface = np.hypot(*(placed.segments[:, 2:] - placed.segments[:, :2]).T).sum()
    poorly = graph.frontiers.kind == POORLY_SEEN
    inspected = max(0.0, float(surface) - float(graph.frontiers.length[poorly].sum()))
    tagless = not expects_tags(inspected, len(tag_ids), explorer.landmarks)
    if tagless:
        graph = take(graph, f=~poorly)
    points = place_points(graph.frontiers, estimate.X_MA)
    left, is_open = 1.0 - points.tries / explorer.frontier_attempts, _is_open(points, placed)
    frontier = take(replace(points, length=points.length * left**2), is_open & (left > 0.0))
    worth = np.where(frontier.on_face & tagless, FACE_WORTH, 1.0)
    given_up = _openings(take(points, is_open & ~points.on_face & (left <= 0.0)), robot)
    # A landmark on no surface stands on one that was too small to be seen: no way leads through it.
    bare = clearance(np.hstack([p_ML, p_ML]), placed.pieces, ON_SURFACE) >= ON_SURFACE
    posts = tag_ids[bare]
    kind, ids = graph.surfaces.kind[placed.owner], graph.surfaces.ids[placed.owner]
    facing = np.zeros((len(tag_ids), 2))
    facing[np.searchsorted(tag_ids, graph.tag_ids)] = _facing(graph, estimate.X_MA)
    if not placed.here.all():
        drifted = np.setdiff1d(ids[~placed.here], ids[placed.here])
        facing[np.isin(tag_ids, drifted)] = 0.0
    return TfgMap(
        stage=graph.stage,
        segments=np.vstack([placed.segments, np.hstack([p_ML[bare], p_ML[bare]])]),
        segment_kind=np.append(kind[placed.here], np.full(len(posts), END)),
        segment_ids=np.vstack([ids[placed.here], np.stack([posts, np.full(len(posts), -1)], axis=1)]),
        facing=facing,
        frontiers=frontier.p,
        frontier_length=worth * frontier.length,
        frontier_normal=frontier.normal,
        star_offsets=placed.stars.offsets,
        star_vertices=placed.stars.vertices,
        star_centers=placed.stars.centers,
        given_up=given_up.p,
        given_up_length=given_up.length,
        given_up_normal=given_up.normal,
        inspected=inspected,
    )


def expects_tags(inspected: float, tags: int, landmarks: str) -> bool:
    """Return whether surface that was not seen, or not well enough to find a tag, is worth a look for tags.

    inspected: m of well-seen surface. tags: number of tags seen. landmarks: as in ExplorerConfig.
    """
    return landmarks == "tags" or (landmarks == "both" and (tags > 0 or inspected < WITHOUT_TAGS))


def empty_map() -> TfgMap:
    """Return the TfgMap of the empty graph."""
    return empty(TfgMap)


@dataclasses.dataclass(frozen=True)
class _Placed:
    """The graph's surfaces and stars, placed by the map estimate.

    pieces: (m, 4) of surface in the map frame, m, owner: (m,) the surface of each. stand: (m,) mask of those that have
    not drifted into the free space of the stars. stars: in the map frame. weak: parts weakly tied to the robot's
    surroundings.
    """

    pieces: FloatArray
    owner: IntArray
    stand: BoolArray
    stars: Stars
    weak: WeaklyTied

    @functools.cached_property
    def here(self) -> BoolArray:
        """Mask of the pieces (m,) that are accepted where they are placed."""
        return self.stand & ~self.weak.surfaces[self.owner]

    @functools.cached_property
    def segments(self) -> FloatArray:
        """The pieces (h, 4) that are."""
        return self.pieces[self.here]


def _placed(graph: TfgGraph, views: IntArray, estimate: MapEstimate, badly: BoolArray) -> _Placed:
    """The graph, or a part of it, placed; views: (k,) those whose stars it holds. badly: (n,) landmarks, see
    `known_badly`."""
    stars = placed_stars(graph.star_offsets, graph.star_vertices, estimate.X_MA[views])
    vertices = place(graph.surfaces, estimate)
    pieces, owner = segments_of(graph.surfaces.offsets, vertices)
    stand = standing(graph.surfaces, vertices, graph.tag_ids, graph.tag_view, stars, views, estimate)
    weak = weakly_tied(graph.surfaces, graph.tag_ids, graph.tag_view, estimate, badly)
    return _Placed(pieces, owner, stand[owner], stars, weak)


def _is_open(points: FrontierPoints, placed: _Placed) -> BoolArray:
    """Which of the frontier points (f,) in the map frame are open: without those of free space that a surface explains,
    and those of weakly tied views."""
    is_open = points.on_face | open_frontiers(points, placed.segments)
    return is_open & ~placed.weak.views[points.view]


def explored_elsewhere(points: FrontierPoints, stars: Stars, estimate: MapEstimate) -> BoolArray:
    """Return a mask of the frontier points (f,) that another arm of a closed loop has explored: the point and the place
    MOST_DRIFT behind it lie inside the stars, and the landmarks there are jointly known."""
    explored = inside_any(points.p, *stars.polygons)
    inside = take(points, explored)
    behind = inside.p - MOST_DRIFT * inside.normal
    explored[explored] = inside_any(behind, *stars.polygons) & known_jointly(inside.p, estimate)
    return np.asarray(explored)


def _openings(points: FrontierPoints, robot: RobotConfig) -> FrontierPoints:
    """The frontier points that hang together widely enough for the robot to pass."""
    if not len(points.p):
        return points
    neighbours = cKDTree(points.p).sparse_distance_matrix(cKDTree(points.p), TOGETHER)
    _, label = connected_components(neighbours, directed=False)
    length = np.bincount(label, points.length)
    return take(points, length[label] >= 2.0 * (robot.radius + NODE_MARGIN))


def anchored(points: FrontierPoints, X_MA: FloatArray) -> FrontierPoints:
    """Return points in M, each in the frame of its view; X_MA: (k, 3)."""
    d, theta = points.p - X_MA[points.view, :2], X_MA[points.view, 2]
    return replace(points, p=turned(d, -theta), normal=turned(points.normal, -theta))


def _facing(graph: TfgGraph, X_MA: FloatArray) -> FloatArray:
    """The side each of graph.tag_ids faces, in the map frame (n, 2)."""
    return turned(graph.tag_facing, X_MA[graph.tag_view, 2])


def _with_facing(graph: TfgGraph, estimate: MapEstimate, seen_ids: IntArray, seen_normal: FloatArray) -> TfgGraph:
    """The graph with the sides that its tags face by the newest view's observation, too.

    A tag faces along the normal of its surface as seen from nearest by; without a surface, towards that view.
    """
    bare = np.setdiff1d(estimate.observation.ids, np.append(graph.tag_ids, seen_ids))
    bare = bare[np.isin(bare, estimate.ids)]
    X_AM, new = inverse(estimate.X_MA[-1]), np.append(seen_ids, bare)
    p_AL = transform(X_AM, estimate.p_ML[np.searchsorted(estimate.ids, new)])
    on_surface, distance = len(seen_ids), np.hypot(p_AL[:, 0], p_AL[:, 1])
    towards = -p_AL[on_surface:] / np.maximum(distance[on_surface:], 1e-9)[:, None]
    distance[on_surface:] = np.inf
    both = replace(
        graph,
        tag_ids=np.append(graph.tag_ids, new),
        tag_view=np.append(graph.tag_view, np.full(len(new), estimate.stage - 1)),
        tag_facing=np.vstack([graph.tag_facing, seen_normal, towards]),
        tag_range=np.append(graph.tag_range, distance),
    )
    return seen_nearest(both)


def _count_attempts(graph: TfgGraph, views: IntArray, badly: BoolArray, scene: _Scene) -> TfgGraph:
    """Counts the newest view as an attempt at every frontier point that it should have seen through and that lives on.

    graph: with that view. views: (k,) those whose stars it holds. badly: (n,) landmarks, see `known_badly`.
    """
    estimate, tags = scene.estimate, scene.tags
    points, center = place_points(graph.frontiers, estimate.X_MA), estimate.X_MA[-1, :2]
    towards = center - points.p
    distance = np.hypot(towards[:, 0], towards[:, 1])
    # A surface must be looked at from its front, as a tag on it must; and along the edge of what it sees nobody looks
    # into what lies behind.
    ahead = np.sum(towards * points.normal, axis=1) >= np.cos(tags.max_incidence) * distance
    in_A = transform(inverse(estimate.X_MA[-1]), points.p)
    looked = scene.panorama.looked_at(np.arctan2(in_A[:, 1], in_A[:, 0]))
    reach = np.where(points.on_face, NEAR_SHARE, 1.0) * tags.range
    found_now = ~points.on_face & (points.view == graph.stage - 1)
    asked = (points.tries < scene.explorer.frontier_attempts) & (distance <= reach) & ahead & looked & ~found_now

    def in_view(placed: _Placed) -> BoolArray:
        clear = surely_visible(placed.segments, center, points.p, GRAZE)
        return np.asarray(asked & _is_open(points, placed) & clear)

    placed = _placed(graph, views, estimate, badly)
    failed = in_view(placed)
    # If no other frontier is in view, the robot came for a weakly tied one.
    if not failed.any() and badly.any():
        failed = in_view(_placed(graph, views, estimate, np.zeros_like(badly)))
    return replace(graph, frontiers=replace(graph.frontiers, tries=graph.frontiers.tries + failed))

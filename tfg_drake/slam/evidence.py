"""Evidence for and against the places of tags: impossible sightings, misread ids, outliers, moved and removed tags.

Impossible sightings are removed from their frame. In the others an id may be misread, a range grossly wrong, or a tag
moved. So a place of a tag is accepted when several frames, of one or more keyframes, saw the tag there, and withdrawn
when more frames have seen it elsewhere since. Each frame supports one place and counts against all others. The counts
are limited, as the frames of one keyframe share their errors and old frames lose relevance.

A tag that fell off or was removed is missing at its mapped place although nothing hides it. Where the scan hits a
surface all over a tag's place, not obliquely and from the side that the tag was seen from, the frame should show it.
The share of frames that do, over all tags, determines how many in a row must miss the tag before its place loses its
support.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import (
    BoolArray,
    FloatArray,
    IntArray,
    LaserScan,
    MapEstimate,
    TagDetections,
    is_tag,
    message,
    replace,
)
from tfg_drake.slam.keyframe import Keyframe, linearised, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import KeyframeGraph, taken_back
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.map_update import REJECTED
from tfg_drake.slam.scan_ranges import surface
from tfg_drake.slam.tag_error import LEAST_CHANCE, in_place
from tfg_drake.slam.turn import Source
from tfg_drake.table import concat, empty, take

# A tag is mapped at a place that this number of frames support; a smaller lead over other places makes it doubtful.
CONFIRMATIONS = 3
# Support counts at most MOST_AT_ONCE frames per keyframe and MOST in all, two such keyframes: two are needed against a
# well-known place, and one is enough against a place that was hardly seen.
MOST_AT_ONCE = 10
MOST = 20
# Two sightings agree if the squared Mahalanobis distance between their places is at most SAME (99 %), with deviations
# of at least LEAST_DEVIATION, m, as the map may have moved between them.
SAME = 9.2
LEAST_DEVIATION = 0.1
# Greatest number of sightings removed at the end of a mission; more contradictions have another cause than tags.
MOST_TAKEN_BACK = 10
# The view index of a place that is the mapped one.
MAPPED = -1
# As detectors miss tags elsewhere, one is expected only within NEAR, m, and INSIDE, m and rad, below the greatest range
# and bearing of any sighting, if the tangent of its incidence is at most STEEPEST, and the incidence ASLANT, rad, below
# the data sheet's limit: four deviations of the incidence by a scan.
NEAR = 4.0
INSIDE = 0.1
STEEPEST = 1.2
ASLANT = 0.4
# A tag is expected only within the angle with the cosine NEAR_BY from the mean direction in which it was seen, if that
# direction's cosine with the surface's normal exceeds SAME_SIDE: otherwise the tag is on the other side.
NEAR_BY = math.cos(math.radians(60.0))
SAME_SIDE = math.cos(math.radians(80.0))
# The scanned surface is the tag's if their distances differ by at most SAME_SURFACE, m, at the tag's middle and
# HALF_WIDTH, m, to either side of it, as a partly hidden tag is not detected.
SAME_SURFACE = 0.1
HALF_WIDTH = 0.1
# A tag is missing after LEAST_FRAMES consecutive frames without it, or more if chance alone would explain them with
# more than the probability LEAST_CHANCE.
LEAST_FRAMES = 5


def sanitized(detections: TagDetections) -> tuple[TagDetections, int]:
    """Return the detections without those that are not finite, have no positive range or deviation, or share their id
    with another one of the frame (either may be wrong), and the number of those removed."""
    _, which, count = np.unique(detections.ids, return_inverse=True, return_counts=True)
    good = np.isfinite(detections.bearing) & (count[which] == 1)
    for positive in (detections.range, detections.sigma_range, detections.sigma_bearing):
        good &= (positive > 0.0) & (positive < np.inf)
    if good.all():
        return detections, 0
    return take(detections, good), int(np.count_nonzero(~good))


@message
class Sighted:
    """A keyframe that is not yet in the map. frames: (n,) number of its frames that saw each of its tags. source: its
    frames and parameters, None for a way on which nothing was seen."""

    keyframe: Keyframe
    frames: IntArray = dataclasses.field(default_factory=lambda: np.empty(0, dtype=np.int64))
    source: Source | None = None

    def only(self, tags: BoolArray) -> Sighted:
        """Return it with some of its tags (n,) only."""
        keyframe = without_tags(self.keyframe, self.keyframe.ids[~tags])
        return replace(self, keyframe=keyframe, frames=self.frames[tags])


@message
class Evidence:
    """Places of tags, and the number of frames that support each.

    ids: (h,) of the tags. view: (h,) MAPPED for the mapped place, otherwise the view in whose arrival frame p_AL (h, 2)
    is, m, with variance (h,), m^2. frames: (h,) that support the place, less the number for other places since.
    """

    ids: Annotated[IntArray, "h"]
    view: Annotated[IntArray, "h"]
    p_AL: Annotated[FloatArray, "h", 2]
    variance: Annotated[FloatArray, "h"]
    frames: Annotated[IntArray, "h"]

    @property
    def is_mapped(self) -> BoolArray:
        """Mask (h,) of the mapped places."""
        return np.asarray(self.view == MAPPED)


def believable(evidence: Evidence, seen: Sighted, X_MA: FloatArray, graph: KeyframeGraph) -> BoolArray:
    """Return a mask of the tags (n,) of a keyframe at X_MA (3,) that were seen there often enough to be mapped.

    graph: without it.
    """
    tag, same = _compared(evidence, seen, X_MA, graph)
    return np.asarray(seen.frames + _of_tags(len(seen.frames), tag[same], evidence.frames[same]) >= CONFIRMATIONS)


def weighed(evidence: Evidence, seen: Sighted, agrees: BoolArray, graph: KeyframeGraph) -> Evidence:
    """Return the evidence with one keyframe more, the newest of a graph that has a view.

    agrees: (n,) mask of its tags that were seen at their mapped places.
    """
    X_MA, newest = graph.X_MN[-2], np.array([len(graph.X_AV) - 1])
    tag, same = _compared(evidence, seen, X_MA, graph)
    spoken_of = tag >= 0
    same[evidence.is_mapped & spoken_of] = agrees[tag[evidence.is_mapped & spoken_of]]
    # Support for a place from before it was mapped joins that of the mapped place.
    joins = same & ~evidence.is_mapped & np.append(agrees, False)[tag]
    once = np.minimum(seen.frames, MOST_AT_ONCE)
    gain = once + _of_tags(len(once), tag[joins], evidence.frames[joins])
    change = np.where(same, np.append(gain, 0)[tag], -np.append(once, 0)[tag])
    old = replace(evidence, frames=np.clip(evidence.frames + change, 0, MOST))
    old = take(old, ~joins & (old.is_mapped | (old.frames > 0)))
    new = np.ones(len(once), dtype=bool)
    new[tag[same & ~joins]] = False
    p_AL, variance = _places_and_variance(seen, graph)
    p_AL = se2.transform(se2.between(graph.X_MA[newest], X_MA)[0], p_AL[new])
    view, frames = np.where(agrees[new], MAPPED, newest), np.minimum(gain[new], MOST)
    return concat(old, Evidence(seen.keyframe.ids[new], view, p_AL, variance[new], frames))


def overturned(evidence: Evidence) -> IntArray:
    """Return the ids, ascending, of the tags that have more support at another place than at the mapped one."""
    ids, mapped, elsewhere = _against(evidence)
    return ids[(mapped >= 0) & (elsewhere >= CONFIRMATIONS) & (elsewhere > mapped)]


def forgotten(evidence: Evidence, ids: IntArray) -> Evidence:
    """Return the evidence without the mapped places of some tags."""
    return take(evidence, ~(evidence.is_mapped & np.isin(evidence.ids, ids)))


def disputed(evidence: Evidence, ids: IntArray) -> Evidence:
    """Return the evidence without support for the mapped places of some tags (t,)."""
    return replace(evidence, frames=np.where(evidence.is_mapped & np.isin(evidence.ids, ids), 0, evidence.frames))


def contradicted(graph: KeyframeGraph) -> tuple[int, int] | None:
    """Return the sighting that contradicts a solved graph most, as the landmark's id and the keyframe's index: without
    it the squared error would fall by more than REJECTED. None if there is none.

    This finds sightings that an update accepted while the pose was uncertain or the map bent.
    """
    most, found = REJECTED, None
    for j, one in enumerate(graph.keyframes):
        n = len(one.ids)
        rows, ends = rows_of(one.ids, graph.ids)[0], (graph.X_MN[j], graph.X_MN[j + 1])
        H, g, _ = linearised(one, (graph.p_ML[rows], graph.anchor[rows]), ends, graph.shared.mean)
        own, force = H[: 2 * n, : 2 * n].reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)], g[: 2 * n].reshape(n, 2, 1)
        apart = np.linalg.solve(own, force)
        spread = np.linalg.inv(own) + in_place(graph.p_ML[rows] - ends[0][:2], graph.tag_error)
        falls = (apart * np.linalg.solve(spread, apart)).sum(axis=(1, 2)) * is_tag(one.ids)
        if np.max(falls, initial=0.0) > most:
            most, found = float(np.max(falls)), (int(one.ids[np.argmax(falls)]), j)
    return found


def reconciled(graph: KeyframeGraph, estimate: MapEstimate) -> tuple[KeyframeGraph, MapEstimate, IntArray]:
    """Return a graph, solved as a whole, and its map without the sightings that contradict it, removed worst first; and
    the ids of their tags."""
    wrong: list[int] = []
    while len(wrong) < MOST_TAKEN_BACK and (sighting := contradicted(graph)) is not None:
        graph = taken_back(graph, *sighting)
        graph, estimate = solve(graph, estimate.stamp, estimate.observation, joint=known_jointly(graph))
        wrong.append(sighting[0])
    return graph, estimate, np.array(wrong, dtype=np.int64)


def doubtful(evidence: Evidence) -> IntArray:
    """Return the ids, ascending, of the doubtful tags: seen in too few frames, or elsewhere nearly as often as at the
    mapped place."""
    ids, mapped, elsewhere = _against(evidence)
    return ids[mapped - elsewhere < CONFIRMATIONS]


def with_doubts(estimate: MapEstimate, evidence: Evidence, graph: KeyframeGraph) -> MapEstimate:
    """Return the estimate with the doubtful tags, each at its best supported place. graph: the map's."""
    ids = doubtful(evidence)
    order = np.lexsort((~evidence.is_mapped, -evidence.frames, evidence.ids))
    best = take(evidence, order[np.searchsorted(evidence.ids[order], ids)])
    places, mapped = np.empty((len(ids), 2)), best.is_mapped
    places[mapped] = estimate.p_ML[rows_of(best.ids[mapped], estimate.ids)[0]]
    places[~mapped] = _places(take(best, ~mapped), graph)
    return replace(estimate, doubtful=ids, doubtful_places=places)


def _against(evidence: Evidence) -> tuple[IntArray, IntArray, IntArray]:
    """Return the tags (t,), ascending, the frames (t,) that support the mapped place of each, -1 if it is not mapped,
    and those (t,) for the best other place, 0 without any."""
    ids, tag = np.unique(evidence.ids, return_inverse=True)
    mapped, elsewhere = np.full(len(ids), -1), np.zeros(len(ids), dtype=np.int64)
    mapped[tag[evidence.is_mapped]] = evidence.frames[evidence.is_mapped]
    np.maximum.at(elsewhere, tag[~evidence.is_mapped], evidence.frames[~evidence.is_mapped])
    return ids, mapped, elsewhere


def _compared(evidence: Evidence, seen: Sighted, X_MA: FloatArray, graph: KeyframeGraph) -> tuple[IntArray, BoolArray]:
    """Return the row of each place's tag (h,) in a keyframe at X_MA (3,), -1 if that did not see it, and a mask (h,) of
    the places where it saw the tag, without the mapped ones."""
    row, is_seen = rows_of(evidence.ids, seen.keyframe.ids)
    tag = np.where(is_seen, row, -1)
    same = np.zeros(len(tag), dtype=bool)
    at = np.flatnonzero(is_seen & ~evidence.is_mapped)
    if len(at):
        p_AL, own = _places_and_variance(seen, graph)
        p_ML = se2.transform(X_MA, p_AL[tag[at]])
        before = _places(take(evidence, at), graph)
        variance = evidence.variance[at] + own[tag[at]] + LEAST_DEVIATION**2
        same[at] = np.square(p_ML - before).sum(axis=1) <= SAME * variance
    return tag, same


def _places(evidence: Evidence, graph: KeyframeGraph) -> FloatArray:
    """Return the places (h, 2) in M, m; none is MAPPED."""
    return se2.transform(graph.X_MA[evidence.view], evidence.p_AL)


def _places_and_variance(seen: Sighted, graph: KeyframeGraph) -> tuple[FloatArray, FloatArray]:
    """Return the tags' places (n, 2) in A, m, and their variances (n,), m^2, each the mean over both directions."""
    p_AL, _, covariance = seen.keyframe.given(graph.shared.mean)
    return p_AL, np.asarray(0.5 * np.diag(covariance)[:-3].reshape(-1, 2).sum(axis=1))


def _of_tags(n: int, tag: IntArray, frames: IntArray) -> IntArray:
    """Return the sums (n,) of the frames (h,) of each tag's places; tag: (h,) the row of each place's tag."""
    return np.bincount(tag, weights=frames, minlength=n).astype(np.int64)


@message
class TagWatch:
    """Counts of frames that should have shown a mapped tag and did not.

    ids: (k,) of the map's tags. seen_from: (k, 2) sums of unit vectors from each tag to the camera in the frames that
    showed it, in M. failed: (k,) consecutive frames that missed it. widest, farthest: the greatest bearing, rad, and
    distance, m, of any sighting. all_expected: number of frames that should have shown a tag, summed over tags,
    all_seen: of those that did. steepest: tangent of the incidence up to which tags are expected.
    """

    ids: Annotated[IntArray, "k"]
    seen_from: Annotated[FloatArray, "k", 2]
    failed: Annotated[IntArray, "k"]
    widest: float
    farthest: float
    all_expected: int
    all_seen: int
    steepest: float = STEEPEST


def watch_of(max_incidence: float) -> TagWatch:
    """Return the watch before any tag; max_incidence: by the data sheet, rad."""
    return empty(TagWatch, steepest=min(STEEPEST, math.tan(max(max_incidence - ASLANT, 0.0))))


def watched(
    watch: TagWatch, p_ML: FloatArray, X_MC: FloatArray, yaw: float, frame: TagDetections, scan: LaserScan
) -> TagWatch:
    """Return the watch after one frame of a camera at X_MC (3,), with the scan of that instant.

    p_ML: (k, 2) of the map's tags, m in M. yaw: of the camera in the body frame, rad. A frame without a tag of the map
    is ignored, as the camera may be blind.
    """
    before = watch.ids, watch.seen_from, watch.failed, (watch.widest, watch.farthest, watch.steepest)
    sightings, rays = (frame.ids, frame.bearing, frame.range), (scan.angles, scan.ranges)
    seen_from, failed, widest, farthest, expected, seen = _watched(before, p_ML, X_MC, yaw, sightings, rays)
    expected, seen = watch.all_expected + expected, watch.all_seen + seen
    return TagWatch(watch.ids, seen_from, failed, widest, farthest, expected, seen, watch.steepest)


def missing(watch: TagWatch) -> BoolArray:
    """Return a mask (k,) of the tags that are missing at their mapped places."""
    share = (watch.all_seen + 1.0) / (watch.all_expected + 2.0)
    return np.asarray(watch.failed >= max(LEAST_FRAMES, math.log(LEAST_CHANCE) / math.log1p(-share)))


def renewed(watch: TagWatch, ids: IntArray) -> TagWatch:
    """Return the watch after a new view, for the map's current tags (n,); missing tags start over."""
    rows, known = rows_of(ids, watch.ids)
    seen_from, failed = np.zeros((len(ids), 2)), np.zeros(len(ids), dtype=np.int64)
    seen_from[known] = watch.seen_from[rows[known]]
    failed[known] = np.where(missing(watch), 0, watch.failed)[rows[known]]
    return replace(watch, ids=ids, seen_from=seen_from, failed=failed)


# Limits: widest, farthest and steepest of a watch. Watch: its ids, seen_from and failed, and its limits. Frame: ids,
# bearings and ranges. Rays: bearings and ranges of a scan.
Limits = tuple[float, float, float]
Watch = tuple[IntArray, FloatArray, IntArray, Limits]
Frame = tuple[IntArray, FloatArray, FloatArray]
Rays = tuple[FloatArray, FloatArray]


@njit(cache=True)
def _watched(
    watch: Watch, p_ML: FloatArray, X_MC: FloatArray, yaw: float, frame: Frame, scan: Rays
) -> tuple[FloatArray, IntArray, float, float, int, int]:
    """Return seen_from, failed, widest and farthest of a watch after a frame, by a scan, and the number of mapped tags
    that the frame should have shown, and that of those it has shown."""
    (frame_ids, bearing, ranges), ids, (widest, farthest, steepest) = frame, watch[0], watch[3]
    shown, seen_from, failed = np.zeros(len(ids), dtype=np.bool_), watch[1].copy(), watch[2].copy()
    for row, one, r in zip(np.searchsorted(ids, frame_ids), frame_ids, ranges):  # noqa: B905 numba knows no strict
        if row < len(ids) and ids[row] == one:
            x, y = X_MC[0] - p_ML[row, 0], X_MC[1] - p_ML[row, 1]
            distance = max(math.hypot(x, y), 1e-6)
            seen_from[row, 0] += x / distance
            seen_from[row, 1] += y / distance
            shown[row] = True
            farthest = max(farthest, min(distance, r))  # Neither a gross range nor a misread, distant id counts.
    if not shown.any():
        return seen_from, failed, widest, farthest, 0, 0
    widest = max(widest, np.abs(bearing).max())
    expected, seen = 0, 0
    for i in range(len(ids)):
        if _expected(p_ML[i], seen_from[i], X_MC, yaw, (widest, farthest, steepest), scan):
            expected += 1
            seen += shown[i]
            failed[i] += 1
        if shown[i]:
            failed[i] = 0
    return seen_from, failed, widest, farthest, expected, seen


@njit(cache=True)
def _expected(
    p_ML: FloatArray, seen_from: FloatArray, X_MC: FloatArray, yaw: float, limits: Limits, scan: Rays
) -> bool:
    """Return whether a frame should show a tag at p_ML (2,) that was seen from (2,)."""
    x, y = X_MC[0] - p_ML[0], X_MC[1] - p_ML[1]
    distance, (widest, farthest, steepest) = math.hypot(x, y), limits
    if not 0.0 < distance < min(NEAR, farthest - INSIDE):
        return False
    bearing = math.atan2(-y, -x) - X_MC[2]
    bearing = math.atan2(math.sin(bearing), math.cos(bearing))
    often = math.hypot(seen_from[0], seen_from[1])
    if abs(bearing) > widest - INSIDE or not seen_from[0] * x + seen_from[1] * y > NEAR_BY * often * distance:
        return False
    angles, ranges = scan
    met, slant = surface(bearing + yaw, angles, ranges, math.inf)
    straight = X_MC[2] + bearing + math.atan(slant)
    side = -seen_from[0] * math.cos(straight) - seen_from[1] * math.sin(straight)
    is_there = abs(slant) < steepest and abs(met - distance) < SAME_SURFACE
    if not (is_there and side > SAME_SIDE * often):
        return False
    half = math.atan(HALF_WIDTH / distance)
    left = surface(bearing + half + yaw, angles, ranges, math.inf)[0]
    right = surface(bearing - half + yaw, angles, ranges, math.inf)[0]
    most = SAME_SURFACE + HALF_WIDTH * abs(slant)
    return abs(left - distance) < most and abs(right - distance) < most

"""The evidence for the place of each tag in the map and for other places, to find misread ids, outliers and moved tags.

An id may be misread, a range grossly wrong, and a tag moved elsewhere. So a tag is believed to be at a place when it
was seen there in several frames, of one keyframe or of many, and what was believed is taken back when more has been
seen of it elsewhere since. Each frame speaks for one place and against all others; the frames of one keyframe have
their errors in common, and old ones fade, so neither counts without limit. Where frames should show a tag and do
not, nothing speaks for its place any more (`missing_tags.py`).
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, message, replace
from tfg_drake.slam.keyframe import Keyframe, linearised, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.map_update import REJECTED
from tfg_drake.slam.tag_error import in_place

# A tag is believed to be where it was seen in so many frames.
CONFIRMATIONS = 3
# Frames of one keyframe that count at most, and all that count for one place: two such keyframes. So two must
# contradict what is well known, and one is enough against what was hardly seen.
MOST_AT_ONCE = 10
MOST = 20
# Two sightings say the same when they are apart by no more than this, squared in deviations (99 %), which are at least
# this large, m: the map may have moved between them.
SAME = 9.2
LEAST_DEVIATION = 0.1
# Stands for the view of a place that is the one in the map.
MAPPED = -1


@message
class Sighted:
    """A keyframe, before it is in the map. frames: (n,) in how many of its frames each of its tags was seen."""

    keyframe: Keyframe
    frames: IntArray


@message
class Evidence:
    """Places of tags, and the number of frames that speak for each.

    ids: (h,) the tag's. view: (h,) MAPPED where it is the place that the map has, else the view that the
    place is kept with: p_AL (h, 2) is in its arrival frame, m, with variance (h,), m^2. frames: (h,) that speak for it,
    more than for other places since.
    """

    ids: IntArray
    view: IntArray
    p_AL: FloatArray
    variance: FloatArray
    frames: IntArray

    @property
    def is_mapped(self) -> BoolArray:
        """(h,) which of the places the map has."""
        return np.asarray(self.view == MAPPED)

    def kept(self, rows: BoolArray | IntArray) -> Evidence:
        """The evidence of some of the places (h,), given by rows or by a truth value each."""
        return Evidence(self.ids[rows], self.view[rows], self.p_AL[rows], self.variance[rows], self.frames[rows])


def only(seen: Sighted, tags: BoolArray) -> Sighted:
    """The keyframe with some of its tags (n,) only."""
    if tags.all():
        return seen
    return Sighted(without_tags(seen.keyframe, seen.keyframe.ids[~tags]), seen.frames[tags])


def no_evidence() -> Evidence:
    """The evidence before anything was seen."""
    none = np.empty(0, dtype=np.int64)
    return Evidence(none, none, np.empty((0, 2)), np.empty(0), none)


def believable(evidence: Evidence, seen: Sighted, X_MA: FloatArray, graph: KeyframeGraph) -> BoolArray:
    """Which of the tags (n,) of a keyframe at X_MA (3,) were seen there, in it and before, often enough to be mapped.

    graph: without it.
    """
    tag, same = _compared(evidence, seen, X_MA, graph)
    return np.asarray(seen.frames + _of_tags(len(seen.frames), tag[same], evidence.frames[same]) >= CONFIRMATIONS)


def weighed(evidence: Evidence, seen: Sighted, agrees: BoolArray, graph: KeyframeGraph) -> Evidence:
    """The evidence with one keyframe more, the newest of a graph that has a view.

    agrees: (n,) which of its tags the map has where it saw them.
    """
    X_MA, newest = graph.X_MN[-2], np.array([len(graph.X_AV) - 1])
    tag, same = _compared(evidence, seen, X_MA, graph)
    spoken_of = tag >= 0
    same[evidence.is_mapped & spoken_of] = agrees[tag[evidence.is_mapped & spoken_of]]
    # What spoke for the place that the map has, before it had it, goes to that.
    joins = same & ~evidence.is_mapped & np.append(agrees, False)[tag]
    once = np.minimum(seen.frames, MOST_AT_ONCE)
    gain = once + _of_tags(len(once), tag[joins], evidence.frames[joins])
    change = np.where(same, np.append(gain, 0)[tag], -np.append(once, 0)[tag])
    old = replace(evidence, frames=np.clip(evidence.frames + change, 0, MOST))
    old = old.kept(~joins & (old.is_mapped | (old.frames > 0)))
    new = np.ones(len(once), dtype=bool)
    new[tag[same & ~joins]] = False
    p_AL, variance = _places_and_variance(seen, graph)
    p_AL = se2.transform(se2.between(_of_views(graph, newest), X_MA)[0], p_AL[new])
    return Evidence(
        np.concatenate([old.ids, seen.keyframe.ids[new]]),
        np.concatenate([old.view, np.where(agrees[new], MAPPED, newest)]),
        np.concatenate([old.p_AL, p_AL]),
        np.concatenate([old.variance, variance[new]]),
        np.concatenate([old.frames, np.minimum(gain[new], MOST)]),
    )


def overturned(evidence: Evidence) -> IntArray:
    """Ids, ascending, of the tags that stand elsewhere than the map has them, by what was seen since."""
    ids, mapped, elsewhere = _against(evidence)
    return ids[(mapped >= 0) & (elsewhere >= CONFIRMATIONS) & (elsewhere > mapped)]


def forgotten(evidence: Evidence, ids: IntArray) -> Evidence:
    """The evidence without the places that the map had of some tags."""
    return evidence.kept(~(evidence.is_mapped & np.isin(evidence.ids, ids)))


def disputed(evidence: Evidence, ids: IntArray) -> Evidence:
    """The evidence with nothing left that speaks for where the map has some tags (t,)."""
    return replace(evidence, frames=np.where(evidence.is_mapped & np.isin(evidence.ids, ids), 0, evidence.frames))


def contradicted(graph: KeyframeGraph) -> tuple[int, int] | None:
    """The sighting that contradicts a solved graph most, as the landmark's id and the keyframe's index: without it the
    squared error would fall by more than REJECTED. None where there is no such.

    What an update believed while the pose was hardly known, or the map bent, comes out here.
    """
    most, found = REJECTED, None
    for j, one in enumerate(graph.keyframes):
        n = len(one.ids)
        rows, X_MA, X_MD = rows_of(one.ids, graph.ids)[0], graph.X_MN[j], graph.X_MN[j + 1]
        shared = graph.shared.mean
        H, g, _ = linearised(
            graph.p_ML[rows], one.y_AL, one.y_AD, one.unit, one.information, one.vector, X_MA, X_MD, shared
        )
        own, force = H[: 2 * n, : 2 * n].reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)], g[: 2 * n].reshape(n, 2, 1)
        apart = np.linalg.solve(own, force)
        spread = np.linalg.inv(own) + in_place(graph.p_ML[rows] - X_MA[:2], graph.tag_error)
        falls = (apart * np.linalg.solve(spread, apart)).sum(axis=(1, 2))
        if np.max(falls, initial=0.0) > most:
            most, found = float(np.max(falls)), (int(one.ids[np.argmax(falls)]), j)
    return found


def doubtful(evidence: Evidence) -> IntArray:
    """Ids, ascending, of the tags that were seen but are not known to be at any one place: hardly seen, or seen
    elsewhere nearly as often as where the map has them."""
    ids, mapped, elsewhere = _against(evidence)
    return ids[mapped - elsewhere < CONFIRMATIONS]


def with_doubts(estimate: MapEstimate, evidence: Evidence, graph: KeyframeGraph) -> MapEstimate:
    """The estimate with the tags that are doubtful, each at the place that most frames speak for. graph: the map's."""
    ids = doubtful(evidence)
    order = np.lexsort((~evidence.is_mapped, -evidence.frames, evidence.ids))
    best = evidence.kept(order[np.searchsorted(evidence.ids[order], ids)])
    places, mapped = np.empty((len(ids), 2)), best.is_mapped
    places[mapped] = estimate.p_ML[rows_of(best.ids[mapped], estimate.ids)[0]]
    places[~mapped] = _places(best.kept(~mapped), graph)
    return replace(estimate, doubtful=ids, doubtful_places=places)


def _against(evidence: Evidence) -> tuple[IntArray, IntArray, IntArray]:
    """The tags (t,), ascending, the frames (t,) that speak for where the map has each, -1 where it has it nowhere, and
    those (t,) for the best other place, 0 without any."""
    ids, tag = np.unique(evidence.ids, return_inverse=True)
    mapped, elsewhere = np.full(len(ids), -1), np.zeros(len(ids), dtype=np.int64)
    mapped[tag[evidence.is_mapped]] = evidence.frames[evidence.is_mapped]
    np.maximum.at(elsewhere, tag[~evidence.is_mapped], evidence.frames[~evidence.is_mapped])
    return ids, mapped, elsewhere


def _compared(evidence: Evidence, seen: Sighted, X_MA: FloatArray, graph: KeyframeGraph) -> tuple[IntArray, BoolArray]:
    """Of each place (h,) which of the tags of a keyframe at X_MA (3,) it is one of, -1 for none, and whether that was
    seen there; of places that the map has that is not told."""
    row, is_seen = rows_of(evidence.ids, seen.keyframe.ids)
    tag = np.where(is_seen, row, -1)
    same = np.zeros(len(tag), dtype=bool)
    at = np.flatnonzero(is_seen & ~evidence.is_mapped)
    if len(at):
        p_AL, own = _places_and_variance(seen, graph)
        p_ML = se2.transform(X_MA, p_AL[tag[at]])
        before = _places(evidence.kept(at), graph)
        variance = evidence.variance[at] + own[tag[at]] + LEAST_DEVIATION**2
        same[at] = np.square(p_ML - before).sum(axis=1) <= SAME * variance
    return tag, same


def _of_views(graph: KeyframeGraph, views: IntArray) -> FloatArray:
    """(m, 3) arrival poses of some views (m,)."""
    return se2.compose(graph.X_MN[graph.view_keyframe[views]], graph.X_AV[views])


def _places(evidence: Evidence, graph: KeyframeGraph) -> FloatArray:
    """(h, 2) m in M, of places that the map does not have."""
    in_V = np.zeros((len(evidence.ids), 3))
    in_V[:, :2] = evidence.p_AL
    return se2.compose(_of_views(graph, evidence.view), in_V)[:, :2]


def _places_and_variance(seen: Sighted, graph: KeyframeGraph) -> tuple[FloatArray, FloatArray]:
    """(n, 2) the tags' places in A, m, and (n,) their variances, m^2, as if these were the same in all directions."""
    p_AL, _, covariance = seen.keyframe.given(graph.shared.mean)
    return p_AL, np.asarray(0.5 * np.diag(covariance)[:-3].reshape(-1, 2).sum(axis=1))


def _of_tags(n: int, tag: IntArray, frames: IntArray) -> IntArray:
    """(n,) sums of frames (h,) by the tags (h,) that they are of."""
    return np.bincount(tag, weights=frames, minlength=n).astype(np.int64)

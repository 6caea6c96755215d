"""Submaps: of a large map only the part round the robot is active; no stage of planning touches the inactive rest.

Content that is kept in the frames of views can be split into submaps by its views and merged again. So a stage costs
what the neighbourhood of the robot costs, however large the building is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, message

T = TypeVar("T")

# Active views are deactivated where they are this much farther away, m, than the reach within which views are
# activated, and never fewer than so many at a time.
SLACK = 5.0
LEAST_VIEWS = 8

# (content, its views (a,), which of them stay (a,)) -> the content of those that stay, and of the others.
Split = Callable[[T, IntArray, BoolArray], tuple[T, T]]
# (contents, the views (a,) of each) -> the content of all.
Merge = Callable[[Sequence[T], Sequence[IntArray]], T]


@message
class Submaps(Generic[T]):
    """The content of k views, the active part of it apart from the inactive submaps.

    active: the content that is worked on. submap: (k,) the submap that each view's content is in, named by the first
    view in it; -1 where it is active. inactive: the submaps by name.
    """

    active: T
    submap: IntArray
    inactive: Mapping[int, T]

    @property
    def views(self) -> IntArray:
        """The views (a,) whose content is active."""
        return np.flatnonzero(self.submap < 0)


def undivided(active: T) -> Submaps[T]:
    """The content of no views yet."""
    return Submaps(active, np.zeros(0, dtype=np.int64), {})


def to_activate(submap: IntArray, X_MA: FloatArray, reach: float) -> BoolArray:
    """Which views (k,) are to be active: those within reach (m) of the newest, with their whole submaps, and those that
    are active and at most SLACK farther away, or too few to be deactivated.

    submap: (j,) of the views so far, as in Submaps. X_MA: (k, 3).
    """
    distance = np.hypot(*(X_MA[:, :2] - X_MA[-1, :2]).T)
    was_active = np.append(submap < 0, np.ones(len(X_MA) - len(submap), dtype=np.bool_))
    wanted = distance <= reach
    wanted[: len(submap)] |= np.isin(submap, submap[wanted[: len(submap)] & (submap >= 0)])
    far = was_active & (distance > reach + SLACK)
    return np.asarray(wanted | (was_active if np.count_nonzero(far) < LEAST_VIEWS else was_active & ~far))


def rearranged(submaps: Submaps[T], to_be_active: BoolArray, split: Split[T], merge: Merge[T]) -> Submaps[T]:
    """The same content with that of some views (j,) active; j may be more than the content's views."""
    content, submap, inactive = submaps.active, submaps.submap.copy(), dict(submaps.inactive)
    activated = np.unique(submap[to_be_active[: len(submap)] & (submap >= 0)]).tolist()
    if activated:
        theirs = [np.flatnonzero(submap == name) for name in activated]
        content = merge([content, *(inactive.pop(name) for name in activated)], [submaps.views, *theirs])
        submap[np.concatenate(theirs)] = -1
    views = np.flatnonzero(submap < 0)
    stays = to_be_active[views]
    if not stays.all():
        name = int(views[~stays][0])
        content, inactive[name] = split(content, views, stays)
        submap[views[~stays]] = name
    return Submaps(content, submap, inactive)


def extended(submaps: Submaps[T], active: T, views: int) -> Submaps[T]:
    """The submaps with other active content, which is of so many views in all: the new ones are active."""
    return Submaps(active, np.append(submaps.submap, np.full(views - len(submaps.submap), -1)), submaps.inactive)


def whole(submaps: Submaps[T], merge: Merge[T]) -> T:
    """The content of all submaps merged; the active content itself where there is no other."""
    if not submaps.inactive:
        return submaps.active
    views = [np.flatnonzero(submaps.submap == name) for name in submaps.inactive]
    return merge([submaps.active, *submaps.inactive.values()], [submaps.views, *views])

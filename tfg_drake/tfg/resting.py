"""A large map is worked on round the robot: what lies far off rests, in parts that no stage of planning touches.

Whatever is kept in the frames of goals can be cut into parts by its goals and joined again. A stage then costs what
the neighbourhood of the robot does, however large the building is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, message

T = TypeVar("T")

# Goals this much farther away than those that wake go to rest, m, but never fewer than so many at a time.
SLACK = 5.0
LEAST_GOALS = 8

# (content, its goals (a,), which of them stay (a,)) -> the content of those that stay, and of the others.
Cut = Callable[[T, IntArray, BoolArray], tuple[T, T]]
# (contents, the goals (a,) of each) -> the content of all.
Join = Callable[[Sequence[T], Sequence[IntArray]], T]


@message
class Parted(Generic[T]):
    """Content of k goals: near, that is worked on, and the rest of it.

    part: (k,) the part that each goal's content rests in, named by the first goal in it, -1 where it is near. resting:
    the parts by name.
    """

    near: T
    part: IntArray
    resting: Mapping[int, T]

    @property
    def goals(self) -> IntArray:
        """The goals (a,) whose content is near."""
        return np.flatnonzero(self.part < 0)


def undivided(near: T) -> Parted[T]:
    """Content of no goals yet."""
    return Parted(near, np.zeros(0, dtype=np.int64), {})


def awake(part: IntArray, X_MA: FloatArray, reach: float) -> BoolArray:
    """Which goals (k,) are to be near: those within reach (m) of the newest, and those near already (see Parted.part,
    of the j goals before) that are little farther, or too few to be put to rest. X_MA: (k, 3)."""
    distance = np.hypot(*(X_MA[:, :2] - X_MA[-1, :2]).T)
    was_near = np.append(part < 0, np.ones(len(X_MA) - len(part), dtype=np.bool_))
    woken = distance <= reach
    woken[: len(part)] |= np.isin(part, part[woken[: len(part)] & (part >= 0)])
    far = was_near & (distance > reach + SLACK)
    return np.asarray(woken | (was_near if np.count_nonzero(far) < LEAST_GOALS else was_near & ~far))


def rearranged(parted: Parted[T], near: BoolArray, cut: Cut[T], join: Join[T]) -> Parted[T]:
    """The same content, that of the goals that are to be near (j,) near; j may be more than the content's goals."""
    content, part, resting = parted.near, parted.part.copy(), dict(parted.resting)
    woken = np.unique(part[near[: len(part)] & (part >= 0)]).tolist()
    if woken:
        theirs = [np.flatnonzero(part == name) for name in woken]
        content = join([content, *(resting.pop(name) for name in woken)], [parted.goals, *theirs])
        part[np.concatenate(theirs)] = -1
    goals = np.flatnonzero(part < 0)
    stays = near[goals]
    if not stays.all():
        name = int(goals[~stays][0])
        content, resting[name] = cut(content, goals, stays)
        part[goals[~stays]] = name
    return Parted(content, part, resting)


def extended(parted: Parted[T], near: T, goals: int) -> Parted[T]:
    """The content with what is near changed, and of so many goals in all: the new ones are near."""
    return Parted(near, np.append(parted.part, np.full(goals - len(parted.part), -1)), parted.resting)


def whole(parted: Parted[T], join: Join[T]) -> T:
    """All of the content; that which is near itself if it is all."""
    if not parted.resting:
        return parted.near
    goals = [np.flatnonzero(parted.part == name) for name in parted.resting]
    return join([parted.near, *parted.resting.values()], [parted.goals, *goals])

"""Compares promised with realised gains: a mission does not continue for promises that are not kept."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import GoalChoice, MapEstimate, message, replace
from tfg_drake.planning.budget import THERE

# A promise is broken if less than the share LEAST_KEPT of its nats was gained; after MOST_BROKEN in a row none is
# believed.
LEAST_KEPT, MOST_BROKEN = 0.1, 3


@message
class Promise:
    """The promise of the newest choice: gain (nats), 0 for none, place p_MG (2,), m in M, and number and entropy (nats)
    of the landmarks then. broken: number of consecutive broken promises. is_again: it is of a look after exploration;
    kept: share of the promised gain that these looks gave, with the newest weighted like all before it."""

    gain: float = 0.0
    p_MG: tuple[float, float] = (0.0, 0.0)
    landmarks: int = 0
    entropy: float = 0.0
    broken: int = 0
    is_again: bool = False
    kept: float = 1.0

    @property
    def believed(self) -> bool:
        """Whether promises still count."""
        return self.broken < MOST_BROKEN


def judged(promise: Promise, estimate: MapEstimate, prior_sigma: float) -> Promise:
    """Return the promise, evaluated against the current map of landmarks; `promised` makes the next.

    prior_sigma: m, of an unseen landmark.
    """
    if not promise.gain or math.dist(promise.p_MG, estimate.X_MA[-1, :2].tolist()) > THERE:
        return promise
    new = len(estimate.ids) - promise.landmarks
    gained = promise.entropy - estimate.entropy + new * math.log(2.0 * math.pi * math.e * prior_sigma**2)
    if promise.is_again:
        kept = 0.5 * (promise.kept + min(max(gained / promise.gain, 0.0), 1.0))
        return Promise(broken=promise.broken, kept=kept)
    broken = promise.broken + 1 if gained < LEAST_KEPT * promise.gain else 0
    return Promise(broken=broken, kept=promise.kept)


def promised(goal: GoalChoice, estimate: MapEstimate, before: Promise, stop_gain: float) -> Promise:
    """Return the promise of a goal, if it is more than stop_gain, nats, or of a look after exploration; before: the
    evaluated previous promise."""
    row, again = np.flatnonzero(goal.candidates == goal.node), goal.is_explored
    if goal.verdict != "goal" or not len(row) or goal.gain[row[0]] <= (0.0 if again else stop_gain):
        return Promise(broken=before.broken, kept=before.kept)
    x, y = goal.p_MG.tolist()
    return replace(
        before,
        gain=float(goal.gain[row[0]]),
        p_MG=(x, y),
        landmarks=len(estimate.ids),
        entropy=estimate.entropy,
        is_again=again,
    )

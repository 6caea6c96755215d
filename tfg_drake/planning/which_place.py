"""What a look tells of which of several places of a known map the robot is in.

By each hypothesis the map says what is seen from a place. Where two say different things every metre of surface that is
seen speaks for one of them. The expected information about which is true, nats, is the entropy of the mixture of what
may be seen, by the distances of its components from each other (Kolchinsky and Tracey, "Estimating Mixture Entropy with
Pairwise Distances", Entropy 2017): at most the logarithm of their number, and 0 where they agree. None is believed
before all others are refuted, so they count alike, however unlikely they are.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, Hypotheses
from tfg_drake.slam.place_search import AGAINST, BEARINGS, DEPTH, ON, nearest

# A look is worth going to for it if it tells more than this, nats.
LEAST_TOLD = 0.05


def place_information(points: FloatArray, hypotheses: Hypotheses | None, scan_range: float) -> FloatArray:
    """The information (n,), nats, that a look from each of the points (n, 2), m in M, is expected to bring about which
    of the hypotheses is true. scan_range: m."""
    told = np.zeros(len(points))
    if hypotheses is None or len(hypotheses.X_KM) < 2:
        return told
    turn = np.round(hypotheses.X_KM[:, 2] * BEARINGS / (2.0 * math.pi)).astype(np.int64)
    for i, p in enumerate(points):
        eyes = [se2.transform(X, p[None])[0] for X in hypotheses.X_KM]
        views = [np.roll(nearest(eye, hypotheses.surfaces), -k) for eye, k in zip(eyes, turn, strict=True)]
        view = np.minimum(views, scan_range)
        # Aslant to a surface the next bearing's distance is another one.
        beside = np.array([np.roll(view, k, axis=1) for k in (-1, 0, 1)])
        differ = beside.min(axis=0)[:, None] > beside.max(axis=0)[None] + DEPTH
        nearer = np.minimum(view[:, None], view[None]) * (differ | differ.swapaxes(0, 1))
        apart = (ON - AGAINST) * nearer.sum(axis=2) * (2.0 * math.pi / BEARINGS)
        told[i] = -np.log(np.exp(-apart).mean(axis=1)).mean()
    return told

"""The expected information of a look about the robot's place among several places of a known map.

For each hypothesis the map predicts the view from a place. Where two predictions differ, every metre of observed
surface supports one of them. The expected information about the true one, nats, is the entropy of the mixture of
predicted views, from the pairwise distances of its components (Kolchinsky and Tracey, "Estimating Mixture Entropy with
Pairwise Distances", Entropy 2017): at most the logarithm of their number, and 0 if they agree. A hypothesis is accepted
only after all others are refuted, so all have equal weights, however unlikely they are.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, Hypotheses
from tfg_drake.slam.place_search import AGAINST, BEARINGS, DEPTH, ON, nearest

# Least expected information of a look that distinguishes places, nats.
LEAST_TOLD = 0.05


def place_information(points: FloatArray, hypotheses: Hypotheses | None, scan_range: float) -> FloatArray:
    """Return the expected information (n,), nats, about the true hypothesis from a look at each of the points (n, 2), m
    in M. scan_range: m."""
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

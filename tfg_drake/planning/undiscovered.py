"""The probability that a room which the robot could enter is undiscovered, from the openings of the known free space.

Each opening i hides a region of at least A square metres with a probability p_i(A), independently of the others:

    P(A) = 1 - (1 - q) prod_i (1 - p_i(A))
    logit p_i = b + u log(U_i / A) + w log(width_i) - c    where the map leaves room for it, U_i >= A, else p_i = 0

c applies if the robot cannot pass. U_i is `Openings.unknown`. q accounts for regions that no opening shows, behind a
door that was always shut or a surface that does not exist.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray
from tfg_drake.planning.openings import KEPT_OUT, TOO_NARROW, Openings

# Areas of the rooms in question, m^2.
AREAS = (1.0, 4.0, 10.0)
# The model's b, u and w, the change of b for openings that the robot cannot pass, and the probability without an
# opening, fitted to eight missions in drawn offices by benchmarks/undiscovered.py.
BIAS, BY_UNKNOWN, BY_WIDTH, IMPASSABLE, NO_OPENING = -4.58, 0.746, 2.1, -5.56, 0.00454


def undiscovered(openings: Openings, areas: tuple[float, ...] = AREAS) -> FloatArray:
    """Return the probability (a,) that a room of at least each area (a,), m^2, that the robot could enter is
    undiscovered."""
    logit = BIAS + BY_WIDTH * np.log(openings.width) + IMPASSABLE * is_impassable(openings)
    return np.array([1.0 - (1.0 - NO_OPENING) * np.prod(1.0 - _hides(openings, logit, area)) for area in areas])


def is_impassable(openings: Openings) -> BoolArray:
    """Return a mask of the openings (o,) that the robot can never pass according to the map."""
    return np.isin(openings.why, (KEPT_OUT, TOO_NARROW))


def _hides(openings: Openings, logit: FloatArray, area: float) -> FloatArray:
    """Return the probability (o,) that each opening hides a region of at least an area, m^2."""
    share = openings.unknown / area
    return np.where(share >= 1.0, 1.0 / (1.0 + np.exp(-logit - BY_UNKNOWN * np.log(np.maximum(share, 1.0)))), 0.0)

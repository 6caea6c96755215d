"""Constant errors of tags: each tag's range and bearing have the same errors in all frames that see it.

They come from a wrong print size, a tilted mounting or an imperfect calibration. From one point of view such an error
looks like a displaced tag, whatever the number of frames; only other points of view reveal it. The errors are unknowns
of the keyframe graph, with a deviation common to all tags. It is zero until the gradients of the keyframes on the
errors exceed their noise, and is estimated from the errors from then on (MacKay 1992, "Bayesian interpolation").
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc

from tfg_drake.messages import FloatArray

# Tags are taken to have errors if noise alone would explain the keyframes' gradients on them with less than this
# probability; a test needs LEAST_TAGS tags.
LEAST_CHANCE = 1e-4
LEAST_TAGS = 10
# Initial deviations of range and bearing, m and rad, which count as prior like FIRST_WORTH tags; estimated deviations
# that are both below LEAST are taken as zero.
FIRST = (0.01, 0.003)
FIRST_WORTH = 5.0
LEAST = (4e-3, 1e-3)


def in_place(p: FloatArray, tag_error: FloatArray) -> FloatArray:
    """Return the covariances (n, 2, 2) of the places p (n, 2) of tags seen from the origin, for errors of these
    deviations (2,)."""
    ahead = p / np.maximum(np.hypot(*p.T), 1e-6)[:, None]
    along, across = tag_error[0] * ahead, tag_error[1] * np.stack([-p[:, 1], p[:, 0]], axis=1)
    return np.asarray(along[:, :, None] * along[:, None, :] + across[:, :, None] * across[:, None, :])


def suspected(pull: FloatArray, information: FloatArray) -> FloatArray:
    """Return initial deviations (2,) of the errors, zero if there is no evidence for any.

    pull: (n, 2) gradient of half the squared error on each tag's errors at zero, information: (n, 2) its variance by
    noise.
    """
    if np.count_nonzero(information) < 2 * LEAST_TAGS:
        return np.zeros(2)
    # The most powerful test is the sum of squares weighted by FIRST, approximately chi squared (Satterthwaite 1946).
    by_noise, squared = np.square(FIRST) * information, np.square(FIRST) * pull**2
    freedoms = np.sum(by_noise) ** 2 / np.sum(by_noise**2)
    if gammaincc(0.5 * freedoms, 0.5 * freedoms * np.sum(squared) / np.sum(by_noise)) > LEAST_CHANCE:
        return np.zeros(2)
    return np.array(FIRST)


def learnt(tag_error: FloatArray, errors: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the deviations (2,) estimated from the tags' errors (n, 2) and their variances (n, 2), which were computed
    with the deviations `tag_error`."""
    known = (1.0 - variance / tag_error**2).sum(axis=0)
    squares = (errors**2).sum(axis=0) + FIRST_WORTH * np.square(FIRST)
    found = np.sqrt(squares / (known + FIRST_WORTH))
    return np.zeros(2) if (found < LEAST).all() else found

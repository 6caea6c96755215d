"""How the tags' noise goes on from one frame to the next, learnt from the frames of a robot that stands and looks.

A detector that errs by the same amount in ten frames in a row tells as much in them as in one. With a correlation rho
between frames that follow each other (a first-order Gauss-Markov process), the first of them tells as much as an
independent one, each that follows (1 - rho) / (1 + rho) of that; g frames later, with rho^g for rho. A solution of such
frames takes part of the noise for signal, all the more the shorter it sees a tag: only long runs are made use of, and
what they lose is made up for (Kendall 1954).
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import FloatArray, IntArray, TagDetections, message, replace

# Frames in a row in which a tag must be seen to tell.
LONG_RUN = 50
# A correlation is believed when it is this many standard deviations from none, and no smaller than this.
SIGNIFICANT, LEAST = 5.0, 0.1
MOST = 0.99


@message
class NoiseCorrelation:
    """Sums over pairs of frames that follow each other: of the errors' products and of their squares, in sigmas; how
    many pairs, and the frames of their runs, each counted once a pair."""

    products: float
    squares: float
    pairs: int
    frames: int

    @property
    def value(self) -> float:
        """The correlation rho, 0 where it is not beyond doubt."""
        if not self.pairs:
            return 0.0
        seen = self.products / self.squares
        rho = seen + (1.0 + 3.0 * seen) * self.pairs / self.frames
        return min(rho, MOST) if seen > max(LEAST, SIGNIFICANT / math.sqrt(self.pairs)) else 0.0

    @property
    def frame_worth(self) -> float:
        """What share of an independent frame one of many in a row tells, after the first."""
        return (1.0 - self.value) / (1.0 + self.value)

    def worth(self, tag: IntArray, node: IntArray) -> FloatArray:
        """What share of an independent frame each sighting (m,) tells, of the tags (m,) in the frames (m,): all of one
        tag the same."""
        order = np.lexsort([node, tag])
        first = np.append(True, np.diff(tag[order]) != 0)[: len(tag)]
        left = np.where(first, 0.0, self.value ** np.where(first, 1, np.diff(node[order], prepend=0)))
        told = (1.0 - left) / (1.0 + left)
        _, row, count = np.unique(tag[order], return_inverse=True, return_counts=True)
        share = np.empty(len(tag))
        share[order] = (np.bincount(row, told) / count)[row]
        return share


def no_correlation() -> NoiseCorrelation:
    """Before any frame."""
    return NoiseCorrelation(0.0, 0.0, 0, 0)


def compared(correlation: NoiseCorrelation, errors: FloatArray, tag: IntArray, node: IntArray) -> NoiseCorrelation:
    """The correlation after some sightings with these errors (m, 2), in sigmas, of the tags (m,) at the nodes (m,)."""
    order = np.lexsort([node, tag])
    goes_on = np.append((np.diff(tag[order]) == 0) & (np.diff(node[order]) == 1), False)
    run = np.append(0, np.cumsum(~goes_on)[:-1])
    length = np.bincount(run)[run]
    first = np.flatnonzero(goes_on & (length >= LONG_RUN))
    before, after = errors[order[first]], errors[order[first + 1]]
    return NoiseCorrelation(
        correlation.products + float(np.sum(before * after)),
        correlation.squares + 0.5 * float(np.sum(before**2) + np.sum(after**2)),
        correlation.pairs + 2 * len(first),
        correlation.frames + 2 * int(np.sum(length[first])),
    )


def less_certain(detections: TagDetections, frame_worth: float) -> TagDetections:
    """One of many frames in a row, with the standard deviations that make it count as much as it tells."""
    if frame_worth == 1.0 or not len(detections.ids):
        return detections
    share = frame_worth**-0.5
    return replace(
        detections, sigma_range=share * detections.sigma_range, sigma_bearing=share * detections.sigma_bearing
    )

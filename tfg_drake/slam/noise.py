"""The noise of odometry, tags and looks at walls, learnt during the mission.

Floors, blur and detectors change the noise of wheels, gyro and sightings from that of the data sheets. Levels and
correlation maximise the likelihood of the frames of the newest turns and pieces, with poses, tags and parameters
marginalised out (restricted maximum likelihood, Harville 1977), and a prior around the data sheet. They are estimated
jointly, as gyro drift and noise correlated from frame to frame look alike.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from tfg_drake.messages import FloatArray, TagDetections, message, replace

# The learnt levels: logarithms of the factors on the stated deviations of distance, heading, tags and looks at walls,
# and Fisher's z of the correlation of a tag's noise from frame to frame; their prior deviations and bounds. The lower
# bounds are narrow, as a sensor that errs little within a sample may drift over minutes; the upper bound of looks is
# wide, as furniture may look like walls.
DISTANCE, HEADING, TAGS, CORRELATION, LOOKS = range(5)
PRIOR = np.array([0.35, 0.35, 0.3, 0.7, 0.7])
LEAST = np.array([-0.35, -0.35, -0.35, -0.1, 0.0])
MOST = np.array([1.6, 1.6, 1.6, 1.7, 2.5])
# The newest MOST_SAMPLES samples are kept. The noise is learnt whenever the number of samples seen has grown
# GROWTH-fold.
MOST_SAMPLES = 32
GROWTH = 3
# Greatest number of Newton steps; a step of at most SMALL, in deviations, is the last. DIFFERENCE: step of the
# numerical derivatives.
MOST_STEPS = 6
SMALL = 1.0
DIFFERENCE = 0.01


@message
class Noise:
    """walks: (3,) of `random_walks`. tags: factor on the stated deviations of sightings. correlation: of a tag's noise
    in one frame with that in the previous frame. looks: factor on the deviations of looks at walls computed from their
    rays."""

    walks: FloatArray
    tags: float = 1.0
    correlation: float = 0.0
    looks: float = 1.0

    @property
    def frame_worth(self) -> float:
        """The information of one of many consecutive frames, as a share of that of an independent frame."""
        return (1.0 - self.correlation) / (1.0 + self.correlation)

    @property
    def worth(self) -> float:
        """The information of one of many consecutive frames, as a share of that by the data sheet."""
        return self.frame_worth / self.tags**2

    def in_a_row(self, detections: TagDetections) -> TagDetections:
        """Return one of many consecutive frames with deviations enlarged to its actual information."""
        share = self.worth**-0.5
        if share == 1.0 or not len(detections.ids):
            return detections
        return replace(
            detections, sigma_range=share * detections.sigma_range, sigma_bearing=share * detections.sigma_bearing
        )


class Sample(Protocol):
    """Frames of one turn or piece."""

    def misfit(self, noise: Noise) -> float:
        """Return the negative log likelihood of the frames, up to a constant."""


@message
class LearntNoise:
    """The learnt noise. now: the most likely. sheet: (3,) walks of the data sheet. level, sigma: (5,) logarithmic
    levels and their standard deviations. samples: the newest, seen: number of samples so far, due: their number at
    which the noise is learnt next."""

    now: Noise
    sheet: FloatArray
    level: FloatArray
    sigma: FloatArray
    samples: tuple[Sample, ...] = ()
    seen: int = 0
    due: int = 1

    @property
    def values(self) -> tuple[FloatArray, FloatArray]:
        """Return (5,) the random walks of distance and heading, the factor on the tags' deviations, the correlation and
        the factor on the looks' deviations, and their standard deviations."""
        values = np.array([*self.now.walks[:2], self.now.tags, self.now.correlation, self.now.looks])
        slopes = np.where(np.arange(len(values)) == CORRELATION, 1.0 - values**2, values)
        return values, slopes * self.sigma

    def with_sample(self, sample: Sample | None) -> LearntNoise:
        """Return it with one more sample, before learning from it."""
        if sample is None:
            return self
        return replace(self, samples=(*self.samples, sample)[-MOST_SAMPLES:], seen=self.seen + 1)

    def learnt(self) -> LearntNoise:
        """Return it after learning from the samples, if that is due."""
        if self.seen < self.due:
            return self
        level, cost = self.level, self._cost(self.level)
        for _ in range(MOST_STEPS):
            gradient, curvature = self._differences(level, cost)
            sigma = np.sqrt(np.diag(np.linalg.inv(curvature)))
            # The active set: levels at a bound stay there.
            free = (gradient < 0.0) & (level < MOST) | (gradient > 0.0) & (level > LEAST)
            step = np.zeros(len(level))
            step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], gradient[free])
            there = np.clip(level + step, LEAST, MOST)
            while (lower := self._cost(there)) > cost and np.max(np.abs(there - level) / sigma) > SMALL:
                there = 0.5 * (level + there)
            small = np.max(np.abs(there - level) / sigma) <= SMALL
            if lower <= cost:
                level, cost = there, lower
            if small:
                break
        return replace(self, now=_at(self.sheet, level), level=level, sigma=sigma, due=GROWTH * self.seen)

    def _cost(self, level: FloatArray) -> float:
        noise = _at(self.sheet, level)
        return sum(one.misfit(noise) for one in self.samples) + 0.5 * float(np.sum((level / PRIOR) ** 2))

    def _differences(self, level: FloatArray, cost: float) -> tuple[FloatArray, FloatArray]:
        """Return gradient (5,) and Hessian (5, 5) of the cost. Relative to the prior's information the Hessian's
        eigenvalues are replaced by their absolute values, but at least 1, so that it is definite."""
        n, step = len(level), DIFFERENCE * np.eye(len(level))
        ahead = np.array([self._cost(level + one) for one in step])
        back = np.array([self._cost(level - one) for one in step])
        curvature = np.diag(ahead + back - 2.0 * cost)
        for i in range(n):
            for j in range(i):
                both = self._cost(level + step[i] + step[j])
                curvature[i, j] = curvature[j, i] = both - ahead[i] - ahead[j] + cost
        value, direction = np.linalg.eigh(PRIOR[:, None] * curvature / DIFFERENCE**2 * PRIOR)
        curvature = (direction * np.maximum(np.abs(value), 1.0)) @ direction.T / np.outer(PRIOR, PRIOR)
        return (ahead - back) / (2.0 * DIFFERENCE), curvature


def noise_by_data_sheet(walks: FloatArray) -> LearntNoise:
    """Return the noise of the data sheet, with walks (3,), before the first frame."""
    return LearntNoise(Noise(walks), walks, np.zeros(len(PRIOR)), PRIOR)


def _at(sheet: FloatArray, level: FloatArray) -> Noise:
    """Return the noise at levels (5,), given the walks (3,) of the data sheet."""
    walks = sheet * np.array([math.exp(level[DISTANCE]), math.exp(level[HEADING]), 1.0])
    return Noise(walks, math.exp(level[TAGS]), math.tanh(level[CORRELATION]), math.exp(level[LOOKS]))

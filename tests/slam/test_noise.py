"""The noise that frames are most likely by."""

import dataclasses
import itertools
import types

import numpy as np
import pytest

from tests.slam.oracle import HALF_VIEW, NOISE, PRIOR, REACH, SIGMA, WALKS, Drive, dense, measured
from tfg_drake.messages import TagDetections
from tfg_drake.slam import noise as learning
from tfg_drake.slam.noise import CORRELATION, DISTANCE, HEADING, LOOKS, TAGS, Noise, noise_by_data_sheet
from tfg_drake.slam.odometry_model import arc, predict_increment
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.turn import reduced


def robot_with(seed, factor, tags=1.0, correlation=0.0, gaps=0.05):
    """A drive whose random walks are `factor` (2,) those of the data sheet, whose tags' noise is so many times what is
    stated, goes on from frame to frame, and lets a tag go unseen now and then."""
    rng = np.random.default_rng(seed)
    robot = Drive(rng.uniform(-12.0, 12.0, (100, 2)), SIGMA * rng.normal(size=SHARED), seed)
    robot.walks = WALKS * [*factor, 1.0]
    robot.errors = rng.normal(size=(100, 2))

    def seen(self, twist):
        m = len(self.tags)
        r, b = measured(np.tile(self.X_WB, (m, 1)), self.tags, self.shared, np.tile(twist, (m, 1))).T
        fresh = self.rng.normal(size=(m, 2))
        self.errors = correlation * self.errors + np.sqrt(1.0 - correlation**2) * fresh
        in_view = (r < REACH) & (r > 0.2) & (np.abs(b) < HALF_VIEW) & (self.rng.random(m) >= gaps)
        ids = np.flatnonzero(in_view)
        sigma_r, sigma_b = 0.02 + 0.01 * r[ids], np.full(len(ids), 0.01)
        error = tags * self.errors[ids]
        return TagDetections(
            self.time, ids, r[ids] + sigma_r * error[:, 0], b[ids] + sigma_b * error[:, 1], sigma_r, sigma_b
        )

    robot._seen = types.MethodType(seen, robot)
    return robot


def found(robot, pieces=16):
    """The noise after turns and pieces, in turn."""
    known = noise_by_data_sheet(WALKS)
    for k in range(pieces):
        piece = robot.piece(0.0, 0.6, 8.0) if k % 2 == 0 else robot.piece(0.35, 0.15 * (-1) ** (k // 2), 5.0)
        known = known.with_sample(reduced(known.now, piece, PRIOR).sample)
    return dataclasses.replace(known, due=known.seen).learnt()


@pytest.mark.parametrize(
    ("factor", "tags", "correlation", "seeds", "pieces"),
    [
        pytest.param((1.0, 1.0), 1.0, 0.0, 4, 16, marks=pytest.mark.slow),
        pytest.param((3.0, 3.0), 1.0, 0.0, 4, 16, marks=pytest.mark.slow),
        pytest.param((1.0, 1.0), 1.0, 0.9, 4, 16, marks=pytest.mark.slow),
        pytest.param((1.5, 1.4), 0.8, 0.6, 4, 16, marks=pytest.mark.slow),
        ((1.5, 1.4), 0.8, 0.6, 1, 12),
    ],
)
def test_the_noise_is_found(factor, tags, correlation, seeds, pieces):
    truth = np.array([*np.log(factor), np.log(tags), np.arctanh(correlation)])
    learnt = [DISTANCE, HEADING, TAGS, CORRELATION]
    errors = []
    for seed in range(seeds):
        known = found(robot_with(seed, factor, tags, correlation), pieces)
        errors.append((known.level[learnt] - truth) / known.sigma[learnt])
        assert known.sigma[HEADING] < 0.1
        assert known.sigma[TAGS] < 0.05
    # Squares of 16 errors, three deviations beside one another; of the four of one seed, as few.
    assert np.mean(np.square(errors)) < 2.1
    assert np.abs(errors).max() < 4.0


def test_a_misfit_is_the_logarithm_of_the_marginal_likelihood():
    """By the dense least squares of all frames and the determinant of its information. Ranges have no scale, for it is
    the unit here and none there."""
    no_scale = np.append(np.ones(SHARED - 1), 0.0)
    prior = dataclasses.replace(PRIOR, covariance=np.diag(np.maximum(no_scale * SIGMA, 1e-6) ** 2))
    robot = Drive(np.random.default_rng(2).uniform(-8.0, 8.0, (12, 2)), 0.5 * no_scale * SIGMA, 2)
    seen = robot.piece(0.3, 0.4, 3.0)
    sample = reduced(NOISE, seen, prior).sample
    assert sample is not None
    misfits, expected = [], []
    for factor in (1.0, 1.1, 1.2):
        walks = factor * WALKS
        misfits.append(sample.misfit(dataclasses.replace(NOISE, walks=walks)))
        solution = dense([seen], prior, walks)
        off = solution.shared - prior.mean
        motions = [predict_increment(u, dt, np.zeros(3), walks) for u, dt in zip(*increments(seen), strict=True)]
        odometry = 0.5 * np.sum(np.linalg.slogdet([covariance for _, _, covariance in motions])[1])
        of_prior = 0.5 * off @ np.linalg.solve(prior.covariance, off)
        expected.append(solution.cost + of_prior + odometry + 0.5 * solution.log_information)
    np.testing.assert_allclose(np.diff(misfits), np.diff(expected), rtol=0.02)
    assert np.ptp(expected) > 0.2


def increments(seen):
    begin, frames, _ = seen
    X = np.array([begin.X_OB, *(frame.X_OB for frame in frames)])
    return np.array([arc(a, b) for a, b in itertools.pairwise(X)]), np.full(len(frames), 0.1)


def test_exact_frames_do_not_make_the_noise_vanish():
    robot = Drive(np.random.default_rng(5).uniform(-8.0, 8.0, (25, 2)), np.zeros(SHARED), 5, noise=0.0)
    known = found(robot, pieces=4)
    assert np.all(known.level >= learning.LEAST)
    assert known.now.tags > 0.1


def test_it_is_learnt_as_samples_grow_threefold_and_slips_are_no_samples():
    robot = Drive(np.random.default_rng(6).uniform(-8.0, 8.0, (25, 2)), np.zeros(SHARED), 6)
    sample = reduced(NOISE, robot.piece(0.0, 0.6, 2.0), PRIOR).sample
    known, learnt_at = noise_by_data_sheet(WALKS).with_sample(None), []
    assert known.seen == 0
    for k in range(1, 30):
        before = known.with_sample(sample)
        known = before.learnt()
        if known is not before:
            learnt_at.append(k)
    assert learnt_at == [1, 3, 9, 27]
    assert len(known.samples) <= learning.MOST_SAMPLES


def test_what_a_frame_in_a_row_is_worth():
    """The mean of many correlated numbers is known as well as that many, times the worth, of independent ones."""
    noise = Noise(WALKS, tags=2.0, correlation=0.8)
    k = np.arange(400)
    told = 1.0 / np.mean(0.8 ** np.abs(k[:, None] - k))
    assert told / 400.0 == pytest.approx(noise.frame_worth, rel=0.02)
    one = TagDetections(0.0, np.array([3]), np.array([2.0]), np.array([0.1]), np.array([0.04]), np.array([0.01]))
    many = noise.in_a_row(one)
    assert many.sigma_range[0] == pytest.approx(0.04 * 2.0 * 3.0)
    assert many.sigma_bearing[0] == pytest.approx(0.01 * 2.0 * 3.0)
    assert Noise(WALKS).in_a_row(one) is one


def test_values_are_those_of_the_summary():
    known = dataclasses.replace(noise_by_data_sheet(WALKS), level=np.zeros(5), sigma=np.full(5, 0.1))
    values, deviations = known.values
    np.testing.assert_allclose(values, [WALKS[0], WALKS[1], 1.0, 0.0, 1.0])
    np.testing.assert_allclose(deviations, [0.1 * WALKS[0], 0.1 * WALKS[1], 0.1, 0.1, 0.1])
    assert (DISTANCE, HEADING, TAGS, CORRELATION, LOOKS) == (0, 1, 2, 3, 4)

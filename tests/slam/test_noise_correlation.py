"""How the noise of frames that follow each other is found, and what such frames are worth."""

import numpy as np
import pytest

from tfg_drake.messages import replace
from tfg_drake.simulation.tag_sensor import correlated
from tfg_drake.slam.noise_correlation import LONG_RUN, NoiseCorrelation, compared, less_certain, no_correlation
from tfg_drake.slam.odometry_model import random_walks
from tfg_drake.slam.shared import exactly_known
from tfg_drake.slam.turn import reduced

FRAMES = 200


def in_a_row(rng, rho, tags=8, frames=FRAMES):
    """Errors (m, 2), less their mean as a solution leaves them, tags (m,) and nodes (m,), in no order."""
    time = -0.1 / np.log(rho) if rho else 0.0
    errors = np.empty((frames, tags, 2))
    errors[0] = rng.normal(size=(tags, 2))
    for k in range(1, frames):
        errors[k] = correlated(errors[k - 1], rng.normal(size=(tags, 2)), 0.1, time)
    errors -= errors.mean(axis=0)
    node, tag = np.meshgrid(np.arange(frames), np.arange(tags), indexing="ij")
    order = rng.permutation(frames * tags)
    return errors.reshape(-1, 2)[order], tag.ravel()[order], node.ravel()[order]


@pytest.mark.parametrize("rho", [0.5, 0.72, 0.905])
def test_a_correlation_is_found(rho):
    found = [compared(no_correlation(), *in_a_row(np.random.default_rng(seed), rho)).value for seed in range(20)]
    assert np.mean(found) == pytest.approx(rho, abs=0.01)
    assert np.std(found) < 0.05


def test_independent_frames_are_worth_one_each():
    correlation = no_correlation()
    for seed in range(50):
        correlation = compared(correlation, *in_a_row(np.random.default_rng(seed), 0.0))
        assert correlation.frame_worth == 1.0


def test_short_runs_and_gaps_tell_nothing():
    errors, tag, node = in_a_row(np.random.default_rng(1), 0.9, frames=LONG_RUN - 1)
    assert compared(no_correlation(), errors, tag, node).pairs == 0
    assert compared(no_correlation(), errors, tag, 2 * node).pairs == 0


def test_many_in_a_row_are_worth_what_their_mean_tells():
    rng, rho = np.random.default_rng(2), 0.8
    worth = compared(no_correlation(), *in_a_row(rng, rho, tags=50)).frame_worth
    time = -0.1 / np.log(rho)
    errors, means = rng.normal(size=2000), np.zeros(2000)
    for _ in range(400):
        errors = correlated(errors, rng.normal(size=2000), 0.1, time)
        means += errors / 400.0
    assert 1.0 / 400.0 / np.var(means) == pytest.approx(worth, rel=0.15)


def test_what_frames_are_worth_is_what_their_best_mean_tells():
    """Of a tag seen now and then, and of one seen once."""
    rho = 0.8
    correlation = NoiseCorrelation(rho * 1e9, 1e9, 10**9, 10**18)
    node = np.array([3, 0, 1, 9, 10, 4])
    tag = np.array([7, 7, 7, 7, 7, 2])
    C = rho ** np.abs(node[:5, None] - node[None, :5])
    told = np.linalg.inv(C).sum()
    np.testing.assert_allclose(correlation.worth(tag, node), [told / 5] * 5 + [1.0], rtol=1e-6)
    np.testing.assert_array_equal(no_correlation().worth(tag, node), np.ones(6))


def test_a_turn_of_correlated_frames_is_as_sure_as_it_may_be(drive, nees):
    """The robot stands and looks at the same tags for twenty seconds."""
    values = []
    for seed in range(12):
        robot = drive(np.random.default_rng(seed).uniform(-8.0, 8.0, (60, 2)), seed, 0.0)
        rng, begin = np.random.default_rng(seed), robot.instant()
        frames, noise = [], rng.normal(size=(60, 2))
        for frame in robot.frames(0.0, 0.0, 320):
            seen = frame.detections
            noise = correlated(noise, rng.normal(size=(60, 2)), 0.1, 1.0)
            own = noise[seen.ids - 100]
            bearing, distance = own[:, 0] * seen.sigma_bearing, own[:, 1] * seen.sigma_range
            seen = replace(seen, bearing=seen.bearing + bearing, range=seen.range + distance)
            frames.append(replace(frame, detections=seen))
        known = exactly_known()
        solution = reduced(random_walks(robot.config), begin, tuple(frames), robot.instant(), known)
        p_AL, _, covariance = solution.keyframe.given(known.mean)
        error = (p_AL - robot.p_ML(solution.keyframe.ids)).ravel()
        values.append(nees(error, covariance[:-3, :-3]))
        assert less_certain(frames[0].detections, solution.correlation.frame_worth).sigma_range[0] > 3.0 * 0.02
    assert 0.6 < np.mean(values) < 1.5

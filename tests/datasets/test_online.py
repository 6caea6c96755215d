"""The online estimator on recordings without turns."""

import dataclasses

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.online import run_online
from tfg_drake.datasets.recording import Recording
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, TagDetections, replace

TAGS = np.array([[3.0, 2.0], [5.0, -1.0], [4.0, 4.0], [-1.0, 3.0], [7.0, 1.0]])


def recording(seconds, begin=0.0, rest=0.0):
    """A drive on an arc at 32 Hz among tags seen at 4 Hz, without noise, from a stamp on, s, after a rest, s."""
    odometry, frames = [], []
    for i in range(32 * seconds + 1):
        driven = max(0.0, i / 32.0 - rest)
        X_OB = np.array([2.0 * np.sin(0.2 * driven), 2.0 * (1.0 - np.cos(0.2 * driven)), 0.2 * driven])
        t, at_rest = begin + i / 32.0, driven == 0.0 and rest > 0.0
        odometry.append(Odometry(t, X_OB, (not at_rest) * np.array([0.4, 0.2]), at_rest=at_rest))
        if i % 8 == 4:
            p_BL = se2.transform(se2.inverse(X_OB), TAGS)
            sigma = np.full(len(TAGS), 0.02)
            ids = np.arange(len(TAGS)) + 20
            frames.append(TagDetections(t, ids, np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0]), sigma, sigma))
    return Recording("arc", tuple(odometry), tuple(frames), OdometryConfig(), None)


def test_a_drive_without_noise_is_mapped_exactly():
    run = recording(6)
    shares = []
    online = run_online(run, piece_length=0.5, on_progress=shares.append)
    assert len(online.stamps) == len(run.detections)
    truth = np.array([one.X_OB for one in run.odometry])[
        np.searchsorted([one.stamp for one in run.odometry], online.stamps)
    ]
    np.testing.assert_allclose(online.X_MB, truth, atol=1e-4)
    assert online.map.ids.tolist() == [20, 21, 22, 23, 24]
    np.testing.assert_allclose(online.map.p_ML, TAGS, atol=1e-4)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_recording_with_the_stamps_of_a_computer_and_a_rest_is_mapped_as_exactly():
    """Beside the seconds since 1970 a share of a moment is lost in rounding."""
    run = recording(8, begin=1.248e9, rest=2.0)
    # A camera's frames come soon after one another when its computer was busy.
    again = [replace(frame, stamp=frame.stamp + 1e-3) for frame in run.detections if frame.stamp < 1.248e9 + 2.0]
    frames = sorted((*run.detections, *again), key=lambda frame: frame.stamp)
    online = run_online(dataclasses.replace(run, detections=tuple(frames)), piece_length=0.5)
    np.testing.assert_allclose(online.map.p_ML, TAGS, atol=1e-4)


@pytest.mark.parametrize("seconds", [0, 2])
def test_without_sightings_there_is_no_map(seconds):
    run = recording(seconds)
    online = run_online(Recording("blind", run.odometry, (), run.model, None))
    assert online.map is None
    assert len(online.stamps) == 2 * seconds
    np.testing.assert_allclose(online.X_MB[-1:], np.array([run.odometry[-1].X_OB])[: 2 * seconds], atol=1e-9)


def lifted(seconds, one_each, lift, carry, rng=None):
    """A drive on a circle, frames at 4 Hz that show one tag each, another one every so many seconds; in the middle
    somebody carries the robot for `lift` seconds, in which it sees nothing, by a pose (3,). The recording, and the true
    pose at the end."""
    odometry, frames, X_WB, before = [], [], np.zeros(3), np.zeros(3)
    for i in range(32 * seconds + 1):
        t, middle = i / 32.0, 0.5 * seconds
        driven = min(t, middle) + max(t - middle - lift, 0.0)
        X_OB = np.array([2.0 * np.sin(0.2 * driven), 2.0 * (1.0 - np.cos(0.2 * driven)), 0.2 * driven])
        X_WB, before = se2.compose(X_WB, se2.between(before, X_OB)), X_OB
        if t == middle:
            X_WB = se2.compose(X_WB, carry)
        stands = middle <= t <= middle + lift
        odometry.append(Odometry(t, X_OB, (not stands) * np.array([0.4, 0.2]), at_rest=stands))
        if i % 8 == 4 and not stands:
            tag = int(t / one_each) % len(TAGS)
            p_BL = se2.transform(se2.inverse(X_WB), TAGS[[tag]]) + (0.0 if rng is None else rng.normal(0.0, 0.02, 2))
            sigma = np.full(1, 0.02)
            ids = np.array([tag if rng is None or rng.random() > 0.03 else rng.integers(8)])
            frames.append(TagDetections(t, ids, np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0]), sigma, sigma))
    return Recording("lifted", tuple(odometry), tuple(frames), OdometryConfig(), None), X_WB


@pytest.mark.parametrize("carry", [(0.6, 0.3, 0.5), (-0.5, 0.8, -0.9), (0.0, 0.0, 1.2)])
def test_a_lifted_robot_that_sees_one_tag_at_a_time_finds_itself_and_its_map_stays(carry):
    run, X_WB = lifted(80, 1.0, 10.0, np.array(carry))
    online = run_online(run)
    error = se2.between(X_WB, online.X_MB[-1])
    assert np.hypot(*error[:2]) < 0.05
    assert abs(error[2]) < 0.02
    np.testing.assert_allclose(online.map.p_ML, TAGS, atol=0.05)


@pytest.mark.parametrize("seed", [0, 4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 5))])
def test_whatever_happens_to_a_recording_it_is_run_to_its_end(seed):
    """Carried anywhere, one tag in view for long or never again, ids misread, rows missing."""
    rng = np.random.default_rng(seed)
    carry = rng.uniform(-5.0, 5.0, 3)
    run, _ = lifted(60, float(rng.choice([0.5, 5.0, 40.0])), 10.0, carry, rng)
    hole = rng.uniform(5.0, 50.0) + np.array([0.0, rng.uniform(0.0, 15.0)])
    odometry = tuple(one for one in run.odometry if not hole[0] < one.stamp < hole[1])
    online = run_online(dataclasses.replace(run, odometry=odometry), piece_length=float(rng.choice([0.2, 1.0])))
    assert np.isfinite(online.X_MB).all()
    assert np.isfinite(online.map.covariance).all()

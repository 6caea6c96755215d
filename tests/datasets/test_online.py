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

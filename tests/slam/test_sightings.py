import numpy as np

from tfg_drake.messages import TagDetections
from tfg_drake.slam.sightings import sanitized, select


def frame(ids, distance, bearing=None, sigma=None):
    n = len(ids)
    bearing = np.zeros(n) if bearing is None else np.array(bearing)
    sigma = np.full(n, 0.1) if sigma is None else np.array(sigma)
    return TagDetections(1.0, np.array(ids), np.array(distance, dtype=float), bearing, sigma, np.full(n, 0.01))


def test_a_good_frame_is_left_alone():
    detections = frame([3, 1, 2], [1.0, 2.0, 3.0])
    assert sanitized(detections) == (detections, 0)
    empty = frame(np.zeros(0, dtype=int), [])
    assert sanitized(empty) == (empty, 0)


def test_what_cannot_be_is_left_out():
    detections = frame(
        [1, 2, 3, 4, 5, 6], [1.0, np.nan, np.inf, -1.0, 2.0, 2.0], [0, 0, 0, 0, np.nan, 0], [0.1, 0.1, 0.1, 0.1, 0.1, 0]
    )
    kept, ignored = sanitized(detections)
    assert kept.ids.tolist() == [1]
    assert ignored == 5


def test_of_two_sightings_with_one_id_neither_is_believed():
    kept, ignored = sanitized(frame([7, 8, 7], [1.0, 2.0, 5.0]))
    assert kept.ids.tolist() == [8]
    assert ignored == 2
    assert kept.stamp == 1.0


def test_select_keeps_rows_together():
    kept = select(frame([7, 8, 9], [1.0, 2.0, 3.0]), np.array([True, False, True]))
    assert kept.ids.tolist() == [7, 9]
    assert kept.range.tolist() == [1.0, 3.0]

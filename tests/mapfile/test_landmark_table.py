import csv
import dataclasses
import io
import math

import numpy as np

from tfg_drake.mapfile.landmark_table import HEADER, landmark_csv
from tfg_drake.tfg.graph import empty_map


def test_landmarks_are_in_the_world(small_map):
    rows = list(csv.DictReader(io.StringIO(landmark_csv(small_map))))
    assert [int(row["id"]) for row in rows] == [10, 11, 12, 13]
    p_ML, P = small_map.p_ML, small_map.landmark_covariance
    for i, row in enumerate(rows):
        # M is turned by 90 degrees and lies at (5, 3).
        np.testing.assert_allclose([float(row["x_m"]), float(row["y_m"])], [5.0 - p_ML[i, 1], 3.0 + p_ML[i, 0]])
        found = [float(row[name]) for name in ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2")]
        np.testing.assert_allclose(found, [P[i, 1, 1], -P[i, 0, 1], P[i, 0, 0]], atol=1e-15)
    assert math.isclose(float(rows[0]["facing_rad"]), -0.5 * math.pi)


def test_a_landmark_that_the_tfg_does_not_know_faces_nowhere(small_map):
    behind = dataclasses.replace(small_map, tfg=dataclasses.replace(empty_map(), stage=1))
    lines = landmark_csv(behind).splitlines()
    assert lines[0] == HEADER
    assert all(line.endswith(",") for line in lines[1:])

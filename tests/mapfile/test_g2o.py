import dataclasses

import gtsam
import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.mapfile.g2o import g2o_text, landmark_base


def read(text):
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return {
        tag: [[float(part) for part in line[1:]] for line in lines if line[0] == tag]
        for tag in ("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY", "FIX")
    }


def symmetric(upper, size):
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix + np.triu(matrix, 1).T


def in_metres(graph, keyframe):
    """Tags, end and covariance of a keyframe that depends on the parameters by nothing but its unit of length."""
    n = len(keyframe.ids)
    scale = 1.0 + graph.shared.mean[keyframe.unit]
    metres = np.append(np.full(2 * n + 2, 1.0 / scale), 1.0)
    covariance = np.linalg.inv(keyframe.information[: 2 * n + 3, : 2 * n + 3]) * np.outer(metres, metres)
    return keyframe.y_AL / scale, keyframe.y_AD * metres[-3:], covariance


def test_vertices_and_edges_are_the_graph(small_map):
    graph, found = small_map.graph, read(g2o_text(small_map))
    assert landmark_base(small_map) == 10
    vertices = {int(number): np.array(values) for number, *values in found["VERTEX_SE2"] + found["VERTEX_XY"]}
    assert sorted(vertices) == [0, 1, 2, 3, 20, 21, 22, 23]
    np.testing.assert_allclose(vertices[0], [5.0, 3.0, 0.5 * np.pi])
    np.testing.assert_allclose(vertices[20], [5.0, 3.0] + graph.p_ML[0] @ np.array([[0.0, 1.0], [-1.0, 0.0]]))
    assert [edge[:2] for edge in found["EDGE_SE2"]] == [[0, 1], [1, 2], [2, 3]]
    assert found["FIX"] == [[0.0]]
    tags = [edge[:2] for edge in found["EDGE_SE2_XY"]]
    assert tags == [[0, 20], [0, 21], [0, 22], [2, 20], [2, 21], [2, 23]]
    for start, end, x, y, *information in found["EDGE_SE2_XY"]:
        keyframe = graph.keyframes[int(start)]
        row = int(np.flatnonzero(keyframe.ids == end - 10)[0])
        p_AL, _, covariance = in_metres(graph, keyframe)
        np.testing.assert_allclose([x, y], p_AL[row])
        block = covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        np.testing.assert_allclose(symmetric(information, 2), np.linalg.inv(block))
        # At the map's values it fits as it did there.
        p_AL = se2.transform(se2.inverse(vertices[int(start)]), vertices[int(end)][None])[0]
        assert np.linalg.norm(p_AL - [x, y]) < 0.1


def test_gtsam_reads_it_back(small_map, tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(g2o_text(small_map))
    factors, values = gtsam.readG2o(str(path), False)
    found = read(g2o_text(small_map))
    assert factors.size() == len(found["EDGE_SE2"]) == 3
    X_WN = se2.compose(small_map.X_WM, small_map.graph.X_MN)
    for j in range(4):
        pose = values.atPose2(j)
        np.testing.assert_allclose([pose.x(), pose.y(), pose.theta()], X_WN[j], atol=1e-12)
    # Its errors are those of the map's own keyframes: the covariance is turned into the axes g2o has it in.
    ours = 0.0
    for j, keyframe in enumerate(small_map.graph.keyframes):
        _, X_AD, covariance = in_metres(small_map.graph, keyframe)
        error = se2.between(X_WN[j], X_WN[j + 1]) - X_AD
        ours += 0.5 * error @ np.linalg.solve(covariance[-3:, -3:], error)
    assert factors.error(values) == pytest.approx(ours, rel=1e-3)


def test_landmark_numbers_never_meet_those_of_poses(small_map):
    shifted = dataclasses.replace(small_map.graph, ids=small_map.graph.ids - 60)
    assert landmark_base(dataclasses.replace(small_map, graph=shifted)) == 100

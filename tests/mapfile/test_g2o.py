import dataclasses
import math

import gtsam
import numpy as np
import pytest

from tests.mapfile.test_merge import in_room
from tests.slam.test_place_search import ROOM
from tfg_drake.geometry import se2
from tfg_drake.mapfile.g2o import g2o_text, landmark_base
from tfg_drake.messages import WALLS_BELOW
from tfg_drake.slam.walls import known_walls


def read(text):
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return {
        tag: [[float(part) for part in line[1:]] for line in lines if line[0] == tag]
        for tag in ("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY", "FIX", "VERTEX_LINE2D", "EDGE_SE2_LINE2D")
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


def test_walls_are_lines(tmp_path):
    """Whatever their anchors, each fits the poses that saw it, as well known as there: by points on the line."""
    saved = in_room(ROOM, range(6), np.array([3.5, 1.5, 0.4]), at=0.6)
    found, graph = read(g2o_text(saved)), saved.graph
    vertices = {int(number): np.array(values) for number, *values in found["VERTEX_SE2"]}
    lines = {int(number): np.array(values) for number, *values in found["VERTEX_LINE2D"]}
    poses = len(graph.X_MN)
    assert sorted(lines) == [poses + w for w in range(6)]
    assert found["VERTEX_XY"] == found["EDGE_SE2_XY"] == []
    ids, ends, _ = known_walls(graph)
    for number, pair in zip(ids.tolist(), ends, strict=True):
        angle, distance, *_ = lines[poses + WALLS_BELOW - 1 - number]
        off = se2.transform(saved.X_WM, pair) @ [np.cos(angle), np.sin(angle)] - distance
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
    assert len(found["EDGE_SE2_LINE2D"]) == sum(len(one.ids) for one in graph.keyframes)
    for start, end, angle, distance, *information in found["EDGE_SE2_LINE2D"]:
        keyframe, pose, line = graph.keyframes[int(start)], vertices[int(start)], lines[int(end)]
        # As g2o has its error.
        expected = line[0] - pose[2], line[1] - pose[:2] @ [np.cos(line[0]), np.sin(line[0])]
        assert math.remainder(expected[0] - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
        assert expected[1] == pytest.approx(distance, abs=1e-3)
        row = int(np.flatnonzero(keyframe.ids == poses + WALLS_BELOW - 1 - end)[0])
        own = np.linalg.inv(keyframe.information[:-13, :-13])[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        normal, point = np.array([np.cos(angle), np.sin(angle)]), keyframe.anchor[row]
        along = np.array([-normal[1], normal[0]])
        covariance = np.linalg.inv(symmetric(information, 2))
        for s in (-2.0, 3.0):
            # The variance across of a point on the wall, by its place along from the anchor and from the origin.
            at_origin, at_anchor = np.array([-(s + along @ point), 1.0]), np.array([-s, 1.0])
            assert at_origin @ covariance @ at_origin == pytest.approx(at_anchor @ own @ at_anchor, rel=1e-6)
    path = tmp_path / "map.g2o"
    path.write_text(g2o_text(saved))
    assert gtsam.readG2o(str(path), False)[0].size() == len(found["EDGE_SE2"]) == 3


def test_walls_leave_tags_their_numbers(walled_map):
    found = read(g2o_text(walled_map))
    assert landmark_base(walled_map) == 10
    assert [line[0] for line in found["VERTEX_XY"]] == [20, 21, 22, 23]
    assert [line[0] for line in found["VERTEX_LINE2D"]] == [4]

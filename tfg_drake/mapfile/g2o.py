"""A map as a .g2o file, for other SLAM programs; docs/map_format.md says what is lost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tfg_drake.geometry.se2 import compose, rotation, transform
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray


def g2o_text(saved: SavedMap) -> str:
    """The file's contents: the poses between keyframes as vertices 0 to k, in the world frame W.

    A tag's edge has the inverse of the tag's own marginal covariance: g2o has no edge for a keyframe's joint Gaussian.
    """
    return "\n".join(_lines(saved)) + "\n"


def landmark_base(saved: SavedMap) -> int:
    """What is added to a tag's id to make the number of its vertex: a power of ten beyond all poses."""
    least = len(saved.graph.X_MN) - min(int(np.min(saved.graph.ids, initial=0)), 0)
    base = 10
    while base < least:
        base *= 10
    return base


def _lines(saved: SavedMap) -> Iterator[str]:
    graph, base = saved.graph, landmark_base(saved)
    for j, X_WN in enumerate(compose(saved.X_WM, graph.X_MN)):
        yield f"VERTEX_SE2 {j} {_numbers(X_WN)}"
    for tag, p_WL in zip(graph.ids.tolist(), transform(saved.X_WM, graph.p_ML), strict=True):
        yield f"VERTEX_XY {base + tag} {_numbers(p_WL)}"
    for j, one in enumerate(graph.keyframes):
        p_AL, X_AD, covariance = one.given(graph.shared.mean)
        yield _motion(j, j + 1, X_AD, covariance[-3:, -3:])
        for i, tag in enumerate(one.ids.tolist()):
            block = covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            yield f"EDGE_SE2_XY {j} {base + tag} {_numbers(p_AL[i])} {_information(block)}"
    # At the end: GTSAM's readG2o finds no edge after a line that it does not know.
    yield "FIX 0"
    yield f"# keyframe j leads from vertex j to vertex j + 1; tag i is vertex {base} + i"
    yield "# metres and radians, in the world frame; see docs/map_format.md of tfg-drake"


def _motion(start: int, end: int, X: FloatArray, covariance: FloatArray) -> str:
    """X (3,) between two poses, its covariance (3, 3) in the axes of the first; g2o takes it in those of the second."""
    turn = np.eye(3)
    turn[:2, :2] = rotation(float(X[2])).T
    return f"EDGE_SE2 {start} {end} {_numbers(X)} {_information(turn @ covariance @ turn.T)}"


def _information(covariance: FloatArray) -> str:
    """The upper triangle of the inverse, row by row."""
    information = np.linalg.inv(covariance)
    information = 0.5 * (information + information.T)
    return _numbers(information[np.triu_indices(len(covariance))])


def _numbers(values: FloatArray) -> str:
    return " ".join(repr(value) for value in values.tolist())

"""A map as a .g2o file, for other SLAM programs; docs/map_format.md says what is lost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from tfg_drake.geometry.se2 import compose, rotation, transform
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import WALLS_BELOW, FloatArray
from tfg_drake.slam.keyframe import along_walls, placed


def g2o_text(saved: SavedMap) -> str:
    """The file's contents: the poses between keyframes as vertices 0 to k, in the world frame W.

    A landmark's edge has the inverse of its own marginal covariance: g2o has no edge for a keyframe's joint Gaussian.
    """
    return "\n".join(_lines(saved)) + "\n"


def landmark_base(saved: SavedMap) -> int:
    """Offset from a tag's id to the number of its vertex: a power of ten beyond all poses and walls."""
    walls = WALLS_BELOW - int(np.min(saved.graph.ids, initial=WALLS_BELOW))
    least = len(saved.graph.X_MN) + walls - min(int(np.min(saved.ids, initial=0)), 0)
    base = 10
    while base < least:
        base *= 10
    return base


def _lines(saved: SavedMap) -> Iterator[str]:
    graph, base, tags, poses = saved.graph, landmark_base(saved), saved.is_tag, len(saved.graph.X_MN)
    for j, X_WN in enumerate(compose(saved.X_WM, graph.X_MN)):
        yield g2o_line("VERTEX_SE2", [j], X_WN)
    for tag, p_WL in zip(saved.ids.tolist(), transform(saved.X_WM, saved.p_ML), strict=True):
        yield g2o_line("VERTEX_XY", [base + tag], p_WL)
    of_walls = []
    for j, one in enumerate(graph.keyframes):
        y_AL, X_AD, covariance = one.given(graph.shared.mean)
        yield _motion(j, j + 1, X_AD, covariance[-3:, -3:])
        lines, by_wall = _from_origin(y_AL[: one.walls], one.anchor[: one.walls])
        for i, number in enumerate(one.ids.tolist()):
            block = covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            if i < one.walls:
                block, wall = by_wall[i] @ block @ by_wall[i].T, _wall(number, poses)
                of_walls.append(g2o_line("EDGE_SE2_LINE2D", [j, wall], lines[i], _information(block)))
                continue
            yield g2o_line("EDGE_SE2_XY", [j, base + number], y_AL[i], _information(block))
    # At the end: GTSAM's readG2o finds no edge after a line that it does not know.
    yield "FIX 0"
    walls, anchor = placed(saved.X_WM, graph.ids[~tags], graph.p_ML[~tags], graph.anchor[~tags])
    for number, line in zip(graph.ids[~tags].tolist(), _from_origin(walls, anchor)[0], strict=True):
        yield g2o_line("VERTEX_LINE2D", [_wall(number, poses)], line) + " -1 -1"
    yield from of_walls
    yield f"# keyframe j leads from vertex j to vertex j + 1; tag i is vertex {base} + i"
    if of_walls:
        yield f"# wall w is vertex {poses} + w: the angle of its normal, and its distance from the origin along that"
    yield "# metres and radians, in the world frame; see docs/map_format.md of tfg-drake"


def _wall(number: int, poses: int) -> int:
    """The vertex of a wall: g2o's numbers have 32 bits."""
    return poses + WALLS_BELOW - 1 - number


def _from_origin(walls: FloatArray, anchor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Walls (w, 2) by their distances from the frame's origin instead of their anchors (w, 2); its derivative (w, 2,
    2)."""
    along, lines, by_wall = along_walls(walls), walls.copy(), np.tile(np.eye(2), (len(walls), 1, 1))
    lines[:, 1] += along[:, 1] * anchor[:, 0] - along[:, 0] * anchor[:, 1]
    by_wall[:, 1, 0] = np.sum(along * anchor, axis=1)
    return lines, by_wall


def _motion(start: int, end: int, X: FloatArray, covariance: FloatArray) -> str:
    """X (3,) between two poses, its covariance (3, 3) in the axes of the first; g2o takes it in those of the second."""
    turn = np.eye(3)
    turn[:2, :2] = rotation(float(X[2])).T
    return g2o_line("EDGE_SE2", [start, end], X, _information(turn @ covariance @ turn.T))


def _information(covariance: FloatArray) -> FloatArray:
    """The upper triangle of the inverse, row by row."""
    information = np.linalg.inv(covariance)
    information = 0.5 * (information + information.T)
    return np.asarray(information[np.triu_indices(len(covariance))])


def g2o_line(tag: str, ids: Iterable[int], *numbers: FloatArray) -> str:
    """A line of such a file: its numbers are read again to the bit."""
    return " ".join([tag, *map(str, ids), *(repr(value) for some in numbers for value in some.tolist())])

"""Planar graphs in g2o's text format (Kuemmerle et al., ICRA 2011), read and written.

VERTEX_SE2 id x y theta, VERTEX_XY id x y, FIX id, EDGE_SE2 i j x y theta and the upper triangle of the information,
EDGE_SE2_XY i j x y likewise. LANDMARK2, as GTSAM's own files call it, is EDGE_SE2_XY. Vertices may be missing.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.rows import Rows, ShortRowError, parse_numbers
from tfg_drake.io.files import write_atomic
from tfg_drake.mapfile.g2o import g2o_line
from tfg_drake.messages import FloatArray

# Ids and numbers after each tag.
_FORMAT = {
    "VERTEX_SE2": (1, 3),
    "VERTEX_XY": (1, 2),
    "FIX": (1, 0),
    "EDGE_SE2": (2, 9),
    "EDGE_SE2_XY": (2, 5),
    "LANDMARK2": (2, 5),
}
# GTSAM's keys have 56 bits for an id.
_ID_DIGITS = 16


def read_g2o(path: Path) -> PoseGraph:
    """The graph in a file, which may be gzipped.

    Raises:
        DatasetError: the file cannot be read, a line is broken, or the graph is not planar or holds no edge.
    """
    file = Rows(path)
    rows: dict[str, list[tuple[int, list[int], list[float]]]] = {tag: [] for tag in _FORMAT}
    for number, tag, ids, numbers in file.once(file.read(partial(_parse_line, file)), lambda row: row[1:]):
        rows[tag].append((number, list(ids), list(numbers)))

    poses = {row[1][0]: row[2] for row in rows["VERTEX_SE2"]}
    landmarks = {row[1][0]: row[2] for row in rows["VERTEX_XY"]}
    edges, sightings = rows["EDGE_SE2"], rows["EDGE_SE2_XY"]
    if not edges and not sightings:
        raise DatasetError(f"{path}: no edge in it; a graph without measurements cannot be solved")
    for number, (i, j), _numbers in edges:
        if i == j:
            raise DatasetError(f"{path}, line {number}: an edge from {i} to itself; it ties nothing")
        poses.setdefault(i, [np.nan] * 3)
        poses.setdefault(j, [np.nan] * 3)
    for _, (i, j), _numbers in sightings:
        poses.setdefault(i, [np.nan] * 3)
        landmarks.setdefault(j, [np.nan] * 2)
    both = sorted(poses.keys() & landmarks.keys())
    if both:
        raise DatasetError(f"{path}: {both[0]} is the id of a pose and of a landmark; give one of them another")
    fixed = sorted({row[1][0] for row in rows["FIX"]})
    for i in fixed:
        if i not in poses:
            raise DatasetError(f"{path}: FIX {i} names no pose; only poses can be fixed")
    _check_tied(path, [row[1] for row in edges + sightings], fixed)
    pose_ids, landmark_ids = sorted(poses), sorted(landmarks)
    return PoseGraph(
        pose_ids=np.array(pose_ids, dtype=np.int64),
        X_MB=np.array([poses[i] for i in pose_ids]).reshape(-1, 3),
        landmark_ids=np.array(landmark_ids, dtype=np.int64),
        p_ML=np.array([landmarks[i] for i in landmark_ids]).reshape(-1, 2),
        fixed=np.array(fixed, dtype=np.int64),
        edges=np.array([row[1] for row in edges], dtype=np.int64).reshape(-1, 2),
        X_ij=np.array([row[2][:3] for row in edges]).reshape(-1, 3),
        edge_information=_informations(path, edges, 3),
        sightings=np.array([row[1] for row in sightings], dtype=np.int64).reshape(-1, 2),
        p_BL=np.array([row[2][:2] for row in sightings]).reshape(-1, 2),
        sighting_information=_informations(path, sightings, 2),
        notes=file.notes,
    )


def _check_tied(path: Path, ties: list[list[int]], fixed: list[int]) -> None:
    """Raises DatasetError where a part of the graph (pairs of ids) could lie anywhere."""
    ids, index = np.unique(np.array(ties), return_inverse=True)
    i, j = index.reshape(-1, 2).T
    _, part = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(len(ids), len(ids))), directed=False)
    held = part[np.isin(ids, fixed)] if fixed else part[:1]
    loose = ids[~np.isin(part, held)]
    if len(loose):
        to = "a fixed pose" if fixed else f"vertex {ids[0]}"
        raise DatasetError(f"{path}: nothing ties vertex {loose[0]} to {to}; add an edge, or FIX a pose of its part")


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """Write a graph so that reading it gives the same numbers; vertices without values are left out.

    Raises:
        OSError: the file cannot be written.
    """
    poses, landmarks = zip(graph.pose_ids, graph.X_MB, strict=True), zip(graph.landmark_ids, graph.p_ML, strict=True)
    lines = [g2o_line("VERTEX_SE2", [i], X_MB) for i, X_MB in poses if np.isfinite(X_MB).all()]
    lines += [g2o_line("VERTEX_XY", [i], p_ML) for i, p_ML in landmarks if np.isfinite(p_ML).all()]
    lines += [g2o_line("FIX", [i]) for i in graph.fixed]
    for tag, ids, measured, information in (
        ("EDGE_SE2", graph.edges, graph.X_ij, graph.edge_information),
        ("EDGE_SE2_XY", graph.sightings, graph.p_BL, graph.sighting_information),
    ):
        upper = np.triu_indices(information.shape[-1])
        lines += [g2o_line(tag, *row) for row in zip(ids, measured, information[:, *upper], strict=True)]
    write_atomic(path, "\n".join(lines) + "\n")


def _parse_line(file: Rows, number: int, words: list[str]) -> tuple[int, str, tuple[int, ...], tuple[float, ...]]:
    """The line's number, its tag, and the ids and numbers after it, as many as the tag takes; raises DatasetError."""
    path, tag = file.path, words[0]
    if tag not in _FORMAT:
        known = "VERTEX_SE2, VERTEX_XY, EDGE_SE2, EDGE_SE2_XY and FIX"
        kind = ShortRowError if len(words) == 1 and any(one.startswith(tag) for one in _FORMAT) else DatasetError
        raise kind(f"{path}, line {number}: {tag[:40]} is not supported; planar graphs of {known} are")
    ids, numbers = _FORMAT[tag]
    file.expect(number, words[1:], ids + numbers, f"{tag} takes {ids + numbers} numbers")
    for word in words[1 : 1 + ids]:
        if not word.isdecimal() or len(word) > _ID_DIGITS:
            complaint = f"{word[:40]!r} is not an id; ids are whole numbers of at most {_ID_DIGITS} digits"
            raise DatasetError(f"{path}, line {number}: {complaint}")
    values = parse_numbers(path, number, words[1 + ids :])
    return (
        number,
        "EDGE_SE2_XY" if tag == "LANDMARK2" else tag,
        tuple(int(word) for word in words[1 : 1 + ids]),
        tuple(values),
    )


def _informations(path: Path, rows: list[tuple[int, list[int], list[float]]], size: int) -> FloatArray:
    """(n, size, size) from the upper triangles at the rows' ends."""
    matrices = np.zeros((len(rows), size, size))
    i, j = np.triu_indices(size)
    matrices[:, i, j] = matrices[:, j, i] = np.array([row[2][size:] for row in rows]).reshape(-1, len(i))
    bad = np.flatnonzero(~(np.linalg.eigvalsh(matrices)[:, 0] > 0.0))
    if len(bad):
        complaint = "the information matrix is not positive definite; mend the line"
        raise DatasetError(f"{path}, line {rows[bad[0]][0]}: {complaint}")
    return matrices

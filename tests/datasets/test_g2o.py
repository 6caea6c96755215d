"""g2o files and their solution."""

import gzip
import tracemalloc

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.datasets.g2o import read_g2o, write_g2o
from tfg_drake.datasets.pose_graph import half_chi_square, solve_pose_graph
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.geometry import se2


def loop(tmp_path, noise=0.0, vertices=True, landmark=True):
    """A robot on a square, twice round, its poses tied to the last and to the lap before; and the true poses."""
    random = np.random.default_rng(7)
    step = np.array([1.0, 0.0, np.pi / 2])
    poses = [np.zeros(3)]
    for _ in range(7):
        poses.append(se2.compose(poses[-1], step))
    poses, tree = np.array(poses), np.array([0.3, 2.0])
    lines = []
    information = np.array([[40.0, 3.0, 1.0], [3.0, 30.0, 2.0], [1.0, 2.0, 90.0]])
    upper = " ".join(map(str, information[np.triu_indices(3)]))

    def numbers(values):
        return " ".join(repr(float(value)) for value in values)

    for i, pose in enumerate(poses):
        if vertices:
            lines.append(f"VERTEX_SE2 {i} {numbers(pose + 0.1 * (i > 0))}")
    for i in range(7):
        z = se2.compose(se2.between(poses[i], poses[i + 1]), noise * random.normal(size=3))
        lines.append(f"EDGE_SE2 {i} {i + 1} {numbers(z)} {upper}")
    for i in range(4):
        z = se2.compose(se2.between(poses[i + 4], poses[i]), noise * random.normal(size=3))
        lines.append(f"EDGE_SE2 {i + 4} {i} {numbers(z)} {upper}")
    if landmark:
        if vertices:
            lines.append("VERTEX_XY 100 0 1")
        for i in (0, 3, 6):
            z = se2.transform(se2.inverse(poses[i]), tree) + noise * random.normal(size=2)
            lines.append(f"EDGE_SE2_XY {i} 100 {numbers(z)} 20 1 10")
    path = tmp_path / "loop.g2o"
    path.write_text("\n".join(["# a comment", "", *lines]) + "\n")
    return path, poses, tree


@pytest.mark.parametrize("vertices", [True, False])
def test_a_graph_without_noise_is_solved_exactly(tmp_path, vertices):
    path, poses, tree = loop(tmp_path, vertices=vertices)
    solved = solve_pose_graph(read_g2o(path))
    np.testing.assert_allclose(solved.X_MB[:, :2], poses[:, :2], atol=1e-6)
    np.testing.assert_allclose(se2.wrap_angle(solved.X_MB[:, 2] - poses[:, 2]), 0.0, atol=1e-6)
    np.testing.assert_allclose(solved.p_ML, [tree], atol=1e-6)
    assert half_chi_square(solved) < 1e-9


def test_the_solution_is_the_least_error_there_is(tmp_path):
    graph = read_g2o(loop(tmp_path, noise=0.1)[0])
    solved = solve_pose_graph(graph)
    least = half_chi_square(solved)
    assert 0.1 < least < half_chi_square(graph)
    random = np.random.default_rng(1)
    for _ in range(20):
        moved = read_g2o(loop(tmp_path, noise=0.1)[0])
        object.__setattr__(moved, "X_MB", solved.X_MB + 1e-3 * random.normal(size=solved.X_MB.shape))
        object.__setattr__(moved, "p_ML", solved.p_ML + 1e-3 * random.normal(size=solved.p_ML.shape))
        assert half_chi_square(moved) > least


def test_what_is_written_is_read_again_to_the_bit(tmp_path):
    graph = read_g2o(loop(tmp_path, noise=0.1)[0])
    write_g2o(tmp_path / "copy.g2o", graph)
    copy = read_g2o(tmp_path / "copy.g2o")
    for name in vars(graph):
        np.testing.assert_array_equal(getattr(copy, name), getattr(graph, name))


def test_a_fixed_pose_stays(tmp_path):
    path, _, _ = loop(tmp_path, noise=0.1)
    path.write_text(path.read_text() + "FIX 3\n")
    graph = read_g2o(path)
    solved = solve_pose_graph(graph)
    np.testing.assert_allclose(solved.X_MB[3], graph.X_MB[3], atol=1e-6)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (
            "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1",
            "line 1: VERTEX_SE3:QUAT is not supported; planar graphs of VERTEX_SE2, VERTEX_XY, EDGE_SE2, EDGE_SE2_XY"
            " and FIX are",
        ),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0", "line 1: EDGE_SE2 takes 11 numbers, 10 found; mend the line"),
        ("EDGE_SE2 0 b 1 0 0 1 0 0 1 0 1", "line 1: 'b' is not an id; ids are whole numbers of at most 16 digits"),
        (
            f"EDGE_SE2 0 {10**16} 1 0 0 1 0 0 1 0 1",
            f"line 1: '{10**16}' is not an id; ids are whole numbers of at most 16 digits",
        ),
        ("EDGE_SE2 0 1 inf 0 0 1 0 0 1 0 1", "line 1: 'inf' is not a finite number below 1e+18; mend the line"),
        (
            "EDGE_SE2 0 1 1 0 0 1 0 0 0 0 1",
            "line 1: the information matrix is not positive definite; mend the line",
        ),
        ("EDGE_SE2 1 1 1 0 0 1 0 0 1 0 1", "line 1: an edge from 1 to itself; it ties nothing"),
    ],
)
def test_a_broken_line_is_named(tmp_path, line, complaint):
    path = tmp_path / "broken.g2o"
    path.write_text(line + "\n")
    with pytest.raises(DatasetError) as caught:
        read_g2o(path)
    assert str(caught.value) == f"{path}, {complaint}"


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ("VERTEX_SE2 0 0 0 0", "no edge in it; a graph without measurements cannot be solved"),
        ("EDGE_SE2_XY 0 0 1 0 1 0 1", "0 is the id of a pose and of a landmark; give one of them another"),
        ("EDGE_SE2_XY 0 1 1 0 1 0 1\nFIX 1", "FIX 1 names no pose; only poses can be fixed"),
        (
            "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 2 3 1 0 1 0 1",
            "nothing ties vertex 2 to vertex 0; add an edge, or FIX a pose of its part",
        ),
        (
            "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 2 3 1 0 1 0 1\nFIX 2",
            "nothing ties vertex 0 to a fixed pose; add an edge, or FIX a pose of its part",
        ),
    ],
)
def test_a_graph_that_makes_no_sense_is_named(tmp_path, lines, complaint):
    path = tmp_path / "broken.g2o"
    path.write_text(lines + "\n")
    with pytest.raises(DatasetError) as caught:
        read_g2o(path)
    assert str(caught.value) == f"{path}: {complaint}"


def test_a_loose_pose_cannot_be_placed(tmp_path):
    path = tmp_path / "loose.g2o"
    path.write_text("EDGE_SE2 0 3 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(ValueError, match="pose 2 is tied to no earlier pose"):
        solve_pose_graph(read_g2o(path))


def test_a_mutated_file_is_refused_or_read(tmp_path):
    path, _, _ = loop(tmp_path, noise=0.1)
    assert_refused_or_read(path, lambda: read_g2o(path), DatasetError)
    packed = tmp_path / "loop.g2o.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert_refused_or_read(packed, lambda: read_g2o(packed), DatasetError)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (bytes(3 * 2**20), "more than 1 MiB of text; is it what its name says?"),
        (b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n" * 200_000, "more than 1 MiB of text; is it what its name says?"),
    ],
    ids=["zeros", "a line again and again"],
)
def test_text_that_gzip_made_of_nothing_is_not_unpacked(tmp_path, text, complaint):
    path = tmp_path / "bomb.g2o.gz"
    path.write_bytes(gzip.compress(text, 9, mtime=0))
    del text
    tracemalloc.start()
    with pytest.raises(DatasetError) as caught:
        read_g2o(path)
    assert str(caught.value) == f"{path}: {complaint}"
    assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    tracemalloc.stop()

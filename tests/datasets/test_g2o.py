"""g2o files and their solution."""

import gzip
import tracemalloc

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.mutations import assert_refused_or_read
from tfg_drake.datasets.g2o import read_g2o, write_g2o
from tfg_drake.datasets.pose_graph import PoseGraph, half_chi_square, solve_pose_graph
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.geometry import se2
from tfg_drake.messages import replace


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


def test_the_solution_is_that_of_a_dense_solver(tmp_path):
    """Residuals as g2o defines them, by a solver that knows nothing of sparsity or of where to begin."""
    graph = read_g2o(loop(tmp_path, noise=0.1)[0])
    solved = solve_pose_graph(graph)

    def residual(x):
        poses, tree = np.vstack([graph.X_MB[0], x[:-2].reshape(-1, 3)]), x[-2:]
        rows = []
        for (i, j), X_ij, information in zip(graph.edges, graph.X_ij, graph.edge_information, strict=True):
            error = se2.between(X_ij, se2.between(poses[i], poses[j]))
            rows.append(np.linalg.cholesky(information).T @ error)
        for (i, _), p_BL, information in zip(graph.sightings, graph.p_BL, graph.sighting_information, strict=True):
            error = se2.transform(se2.inverse(poses[i]), tree) - p_BL
            rows.append(np.linalg.cholesky(information).T @ error)
        return np.concatenate(rows)

    found = np.append(solved.X_MB[1:].ravel(), solved.p_ML.ravel())
    dense = least_squares(residual, found + 0.01, xtol=1e-14, ftol=1e-14, gtol=1e-12)
    assert half_chi_square(solved) == pytest.approx(dense.cost, rel=1e-6)
    np.testing.assert_allclose(residual(found), residual(dense.x), atol=1e-5)


def drive(wrong=0.0, noise=1.0):
    """Laps of a robot among trees that it sees in x and y, and the same as it believes them by dead reckoning; loops
    are closed by trees alone. Of the sightings a share names the tree next to the one seen."""
    random = np.random.default_rng(5)
    k, n = 400, 30
    trees = random.uniform(-30.0, 30.0, (n, 2))
    step = np.array([1.0, 0.0, 0.05])
    poses = [np.array([0.0, -20.0, 0.0])]
    for _ in range(k - 1):
        poses.append(se2.compose(poses[-1], step))
    true = np.array(poses)
    X_ij = step + noise * np.array([0.03, 0.03, 0.02]) * random.standard_normal((k - 1, 3))
    reckoned = [true[0]]
    for one in X_ij:
        reckoned.append(se2.compose(reckoned[-1], one))
    i, j = np.nonzero(random.random((k, n)) < 0.05)
    p_BL = np.array([se2.transform(se2.inverse(true[a]), trees[b]) for a, b in zip(i, j, strict=True)])
    p_BL = p_BL + 0.3 * noise * random.standard_normal(p_BL.shape)
    distance = np.linalg.norm(trees[:, None] - trees, axis=2) + 1e3 * np.eye(n)
    named = np.where(random.random(len(j)) < wrong, np.argmin(distance, axis=1)[j], j)
    graph = PoseGraph(
        pose_ids=np.arange(k),
        X_MB=true,
        landmark_ids=np.arange(k, k + n),
        p_ML=trees,
        fixed=np.empty(0, dtype=np.int64),
        edges=np.column_stack([np.arange(k - 1), np.arange(1, k)]),
        X_ij=X_ij,
        edge_information=np.tile(np.diag([1 / 0.03**2, 1 / 0.03**2, 1 / 0.02**2]), (k - 1, 1, 1)),
        sightings=np.column_stack([i, k + named]),
        p_BL=p_BL,
        sighting_information=np.tile(np.eye(2) / 0.3**2, (len(i), 1, 1)),
    )
    first = [int(np.flatnonzero(named == tree)[0]) for tree in range(n)]
    p_ML = np.array([se2.transform(np.array(reckoned)[i[row]], p_BL[row]) for row in first])
    return graph, replace(graph, X_MB=np.array(reckoned), p_ML=p_ML)


@pytest.mark.parametrize("wrong", [0.0, 0.03])
def test_dead_reckoning_leads_to_the_optimum_near_the_truth(wrong):
    true, reckoned = drive(wrong)
    best = half_chi_square(solve_pose_graph(true))
    assert half_chi_square(reckoned) > 30.0 * best
    assert half_chi_square(solve_pose_graph(reckoned)) == pytest.approx(best, rel=1e-6)


def test_a_long_graph_without_noise_is_solved_exactly():
    true, _ = drive(noise=0.0)
    nowhere = replace(true, X_MB=np.full_like(true.X_MB, np.nan), p_ML=np.full_like(true.p_ML, np.nan))
    solved = solve_pose_graph(replace(nowhere, fixed=np.array([0]), X_MB=np.vstack([true.X_MB[:1], nowhere.X_MB[1:]])))
    np.testing.assert_allclose(solved.X_MB[:, :2], true.X_MB[:, :2], atol=1e-6)
    np.testing.assert_allclose(se2.wrap_angle(solved.X_MB[:, 2] - true.X_MB[:, 2]), 0.0, atol=1e-6)
    np.testing.assert_allclose(solved.p_ML, true.p_ML, atol=1e-6)


def test_edges_may_lead_to_earlier_poses(tmp_path):
    path = tmp_path / "back.g2o"
    path.write_text("EDGE_SE2 1 0 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 1 1 0 0 1 0 0 1 0 1\n")
    np.testing.assert_allclose(solve_pose_graph(read_g2o(path)).X_MB[:, 0], [0.0, -1.0, -2.0], atol=1e-9)


def test_where_all_poses_are_fixed_only_landmarks_move(tmp_path):
    path = tmp_path / "fixed.g2o"
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 2 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 0 2 1 1 1 0 1\n"
        "EDGE_SE2_XY 1 2 1 1 1 0 1\nFIX 0\nFIX 1\n"
    )
    solved = solve_pose_graph(read_g2o(path))
    np.testing.assert_allclose(solved.X_MB[:, 0], [0.0, 1.0])
    np.testing.assert_allclose(solved.p_ML, [[1.5, 1.0]], atol=1e-6)


def test_where_all_is_fixed_nothing_moves(tmp_path):
    path = tmp_path / "fixed.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 2 0 0 1 0 0 1 0 1\nFIX 0\nFIX 1\n")
    solved = solve_pose_graph(read_g2o(path))
    np.testing.assert_array_equal(solved.X_MB, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert half_chi_square(solved) == 0.5


def test_what_nothing_determines_stays_near_its_value(tmp_path):
    """A second pose sees the landmark alone, so that it may turn about it; a third pose is tied to nothing."""
    path = tmp_path / "free.g2o"
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 2 0.1 0.5\nVERTEX_SE2 5 7 8 0.9\nVERTEX_XY 2 1 0\n"
        "EDGE_SE2_XY 0 2 1 0 1 0 1\nEDGE_SE2_XY 1 2 -1 0 1 0 1\n"
    )
    solved = solve_pose_graph(read_g2o(path))
    assert half_chi_square(solved) < 1e-12
    np.testing.assert_allclose(solved.p_ML, [[1.0, 0.0]], atol=1e-6)
    assert np.abs(solved.X_MB[1] - [2.0, 0.1, 0.5]).max() < 0.5
    np.testing.assert_allclose(solved.X_MB[2], [7.0, 8.0, 0.9])


def test_progress_runs_from_nothing_to_one():
    shares = []
    solve_pose_graph(drive()[1], shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 5
    assert shares[-1] == 1.0


def test_what_is_written_is_read_again_to_the_bit(tmp_path):
    graph = read_g2o(loop(tmp_path, noise=0.1)[0])
    write_g2o(tmp_path / "copy.g2o", graph)
    copy = read_g2o(tmp_path / "copy.g2o")
    assert copy.notes == ()
    for name in vars(graph).keys() - {"notes"}:
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
        ("EDGE_SE2 0 1 inf 0 0 1 0 0 1 0 1", "line 1: 'inf' is not a finite number below 1e+19; mend the line"),
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

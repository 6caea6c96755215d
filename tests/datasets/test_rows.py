"""Files whose rows are not as they should be: what is mended, and what is said of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.g2o import read_g2o
from tfg_drake.datasets.laser_log import RAYS, load_breezyslam, load_carmen
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.rows import read_table

TABLE = np.array([[1.0, 0.125], [2.0, 0.25], [3.0, 0.375], [4.0, 0.5]])
LINES = [f"{t:.3f} {x:.3f}" for t, x in TABLE]
COLUMNS = ("time", "x")


def read(tmp_path: Path, text: str) -> tuple[np.ndarray, tuple[str, ...]]:
    path = tmp_path / "t.dat"
    path.write_bytes(text.encode())
    return read_table(path, COLUMNS)


@pytest.mark.parametrize(
    ("text", "note"),
    [
        ("# a heading\n" + "\n".join(LINES) + "\n", None),
        ("\n".join(LINES) + "\n\n", None),
        ("\n".join(LINES), None),
        ("\r\n".join(LINES) + "\r\n", "line ends CRLF, read as such"),
        ("\r".join(LINES) + "\r", "line ends CR, read as such"),
        ("\r\n".join(LINES[:2]) + "\r\n" + "\n".join(LINES[2:]), "line ends CRLF and LF, read as such"),
        ("\ufeff" + "\n".join(LINES) + "\n", None),
        ("\n\n".join(LINES) + "\n", "3 blank lines skipped"),
        ("Time [s] x [m]\n" + "\n".join(LINES) + "\n", None),
        ("seconds metres\n" + "\n".join(LINES) + "\n", "1 line of a heading without '#', skipped"),
        ("\n".join([LINES[3], *LINES[:3]]) + "\n", "1 row out of order, sorted"),
        ("\n".join(LINES[::-1]) + "\n", "3 rows out of order, sorted"),
        ("\n".join([*LINES, LINES[0], LINES[3]]) + "\n", "2 rows twice, left out"),
        ("\n".join([*LINES, "5.000"]), "the last row cut off, left out"),
        ("\n".join([*LINES, "5.000 "]) + "\n", "the last row cut off, left out"),
        ("\n".join([*LINES, "5.000 -"]), "the last row cut off, left out"),
        ("\n".join([*LINES, "5.000 1.6e"]), "the last row cut off, left out"),
        ("\n".join([*LINES, "5.000 0.6"]), "the last row cut off, left out"),
        (
            "\r\n".join([LINES[1], LINES[0], *LINES[1:], "5.0"]),
            "line ends CRLF, read as such; the last row cut off, left out; 1 row twice, left out; 1 row out of order,"
            " sorted",
        ),
    ],
)
def test_the_table_is_the_same_and_one_line_says_what_was_mended(tmp_path, text, note):
    table, notes = read(tmp_path, text)
    np.testing.assert_array_equal(table, TABLE)
    assert [one.text for one in notes] == ([] if note is None else [f"t.dat: {note}"])


POSES = [(0.5 * k, 0.1 * k, -0.2 * k, 0.25 * k) for k in range(12)]
LAYOUTS = ("time", "x", "y", "heading"), ("time", "x", "y", "qz", "qw")


@pytest.mark.parametrize(
    ("heading", "separator", "order", "note"),
    [
        ("time,x,y,heading", ",", (0, 1, 2, 3), None),
        ("time;x;y;heading", ";", (0, 1, 2, 3), None),
        ("# time x y heading", " ", (0, 1, 2, 3), None),
        ("#timestamp [ns]\tyaw [rad]\tpx [m]\tpy [m]", "\t", (0, 3, 1, 2), "columns read as time, heading, x, y"),
        ("Yaw, Stamp, Ty, Tx", ", ", (3, 0, 2, 1), "columns read as heading, time, y, x"),
        (None, " ", (0, 1, 2, 3), None),
        ("# wheel odometry, 2 Hz", ";", (0, 1, 2, 3), None),
    ],
)
def test_columns_are_read_by_their_names(tmp_path, heading, separator, order, note):
    rows = [separator.join(f"{row[i]:.3f}" for i in order) for row in POSES]
    (tmp_path / "t.csv").write_text("\n".join([*([heading] if heading else []), *rows]))
    table, notes = read_table(tmp_path / "t.csv", *LAYOUTS)
    np.testing.assert_allclose(table, POSES)
    assert len(notes) == (note is not None)
    assert all(one.text.startswith(f"t.csv: {note}") for one in notes)


def test_other_columns_are_left_alone_and_decimal_commas_read(tmp_path):
    rows = [f"{k};{t:.2f};{y:.2f};{x:.2f};0;1".replace(".", ",") for k, (t, x, y, _) in enumerate(POSES)]
    (tmp_path / "t.csv").write_text("\n".join(["frame;t;ty;tx;qz;qw", *rows]) + "\n")
    table, notes = read_table(tmp_path / "t.csv", *LAYOUTS)
    np.testing.assert_allclose(table[:, :3], np.array(POSES)[:, :3])
    assert table[:, 3:].tolist() == [[0.0, 1.0]] * len(POSES)
    assert notes[0].text.startswith("t.csv: decimal commas read as points; columns read as frame, time, y, x, qz, qw")


@pytest.mark.parametrize("name", ["yaw_deg", "yaw [deg]", "angle"])
def test_a_column_that_is_not_named_is_asked_for(tmp_path, name):
    (tmp_path / "t.csv").write_text(f"time,x,y,{name}\n0,1,2,90\n1,1,2,90\n")
    complaint = f"t.csv, line 1: heading not among the columns time, x, y, {name}; name them there"
    with pytest.raises(DatasetError, match=re.escape(complaint)):
        read_table(tmp_path / "t.csv", *LAYOUTS)


@pytest.mark.slow
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_mutated_table_is_refused_or_read(tmp_path, separator):
    rows = [separator.join(f"{number:.3f}" for number in row) for row in POSES]
    file = tmp_path / "t.csv"
    file.write_text("\n".join([separator.join(LAYOUTS[0]), *rows]) + "\n")
    assert_refused_or_read(file, lambda: read_table(file, *LAYOUTS), DatasetError, count=1000)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1.0 0.1\n2.0 x\n3.0 0.3\n", "line 2: 'x' is not a finite number below 1e+19; mend the line"),
        ("1.0 0.1\n2.0 x", "line 2: 'x' is not a finite number below 1e+19; mend the line"),
        ("1.0 0.1\n2.0 nan", "line 2: 'nan' is not a finite number below 1e+19; mend the line"),
        ("1.0 0.1\n2.0 -\n", "line 2: '-' is not a finite number below 1e+19; mend the line"),
        ("1.0 0.1\n2.0\n3.0 0.3\n", "line 2: 2 numbers expected (time, x), 1 found; mend the line"),
        ("1.0 0.1\n2.0 0.2 0.3", "line 2: 2 numbers expected (time, x), 3 found; mend the line"),
        ("1.0\n", "line 1: 2 numbers expected (time, x), 1 found; mend the line"),
        ("a b\n" * 5, "line 5: 'a' is not a finite number below 1e+19; mend the line"),
    ],
)
def test_what_cannot_be_true_is_refused(tmp_path, text, complaint):
    with pytest.raises(DatasetError) as caught:
        read(tmp_path, text)
    assert str(caught.value) == f"{tmp_path}/t.dat, {complaint}"


def test_of_two_rows_at_one_time_the_order_stays(tmp_path):
    table, _ = read(tmp_path, "2 5\n1 4\n1 3\n")
    assert table.tolist() == [[1.0, 4.0], [1.0, 3.0], [2.0, 5.0]]


def test_a_graph_without_its_end_and_with_edges_twice(tmp_path):
    edges = [f"EDGE_SE2 {i} {i + 1} 1 0 0 1 0 0 1 0 1" for i in range(3)]
    path = tmp_path / "a.g2o"
    for end in ("EDGE", "EDGE_SE2 3", "EDGE_SE2 3 4 1 0 0 1 0\n"):
        path.write_text("\r\n".join([*edges, edges[1], end]))
        graph = read_g2o(path)
        assert graph.edges.tolist() == [[0, 1], [1, 2], [2, 3]]
        assert graph.notes[0].text.endswith("the last row cut off, left out; 1 row twice, left out")
    path.write_text("\n".join([edges[0], "EDGE_SE2 3", edges[1]]))
    with pytest.raises(DatasetError, match="line 2: EDGE_SE2 takes 11 numbers, 1 found; mend the line"):
        read_g2o(path)


def test_scan_logs_that_were_cut_off(tmp_path):
    path = tmp_path / "a.log"
    carmen = [f"FLASER 2 1.0 2.0 {k} 0 0 {k} 0 0 {3 * k}.5 host {3 * k}.5\n" for k in range(3)]
    path.write_text("".join([*carmen, carmen[2], carmen[1][:20]]))
    log = load_carmen(path, OdometryConfig(), 0, scanner={"field_of_view": 1.0})
    assert log.truth.X_WB[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert [one.text for one in log.notes] == ["a.log: the last row cut off, left out; 1 row twice, left out"]

    rover = [" ".join(map(str, [k * 1000, 0, k, k, *[0] * 20, *[1500] * RAYS])) + "\n" for k in range(3)]
    path.write_text("".join([rover[0], rover[2], rover[1], rover[1][:900]]))
    log = load_breezyslam(path)
    np.testing.assert_allclose([one.stamp for one in log.odometry], [0.0, 1e-3, 2e-3])
    assert [one.text for one in log.notes] == ["a.log: the last row cut off, left out; 1 row out of order, sorted"]

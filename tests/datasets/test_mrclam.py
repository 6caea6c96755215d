"""MR.CLAM folders: written here, and the real ones where they are at hand."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tfg_drake.datasets.mrclam import COMMAND_LATENCY, SPEED_SCALE, TURN_SCALE, integrate_commands, load_mrclam
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.geometry import se2

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "mrclam"

BARCODES = "# a comment\n 1 5\n 2 14\n 6 63\n 7 81\n"
ODOMETRY = "# t v w\n10.0 0.105 0.0\n11.0 0.105 0.109\n13.0 0.0 0.0\n14.0 0.0 0.0\n"
MEASUREMENT = "# t code r b\n10.5 63 2.0 0.1\n10.5 81 3.0 -0.2\n10.5 14 1.0 0.3\n12.0 99 1.0 0.0\n12.5 81 2.5 0.0\n"
LANDMARKS = "# s x y sx sy\n7 3.0 4.0 0 0\n6 1.0 2.0 0 0\n"
TRUTH = "# t x y a\n10.0 0.0 0.0 0.0\n14.0 1.0 0.0 0.0\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "Barcodes.dat").write_text(BARCODES)
    (tmp_path / "Robot1_Odometry.dat").write_text(ODOMETRY)
    (tmp_path / "Robot1_Measurement.dat.gz").write_bytes(gzip.compress(MEASUREMENT.encode()))
    (tmp_path / "Landmark_Groundtruth.dat").write_text(LANDMARKS)
    (tmp_path / "Robot1_Groundtruth.dat").write_text(TRUTH)
    return tmp_path


def texts(run):
    return tuple(note.text for note in run.notes)


def test_a_folder_is_read_plain_and_gzipped(folder):
    run = load_mrclam(folder, 1)
    assert run.name == f"{folder.name}-robot1"
    assert [frame.stamp for frame in run.detections] == [10.5, 12.5]
    first = run.detections[0]
    assert first.ids.tolist() == [6, 7]  # not the barcodes, and not robot 2
    np.testing.assert_allclose(first.range, [2.0, 3.0])
    np.testing.assert_allclose(first.bearing, [0.1, -0.2])
    assert texts(run) == ("1 measurements of barcodes that Barcodes.dat does not list were left out",)
    assert run.truth.ids.tolist() == [6, 7]
    np.testing.assert_array_equal(run.truth.p_WL, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(run.truth.X_WB[-1], [1.0, 0.0, 0.0])


def test_rows_out_of_order_are_sorted(folder):
    clean = load_mrclam(folder, 1)
    head, *rows = ODOMETRY.splitlines()
    (folder / "Robot1_Odometry.dat").write_text("\r\n".join([head, *rows[::-1], rows[0], ""]))
    head, *rows = TRUTH.splitlines()
    (folder / "Robot1_Groundtruth.dat").write_text("\n".join([*rows[::-1], "15.0 1.0"]))
    run = load_mrclam(folder, 1)
    assert [one.stamp for one in run.odometry] == [one.stamp for one in clean.odometry]
    np.testing.assert_array_equal([one.X_OB for one in run.odometry], [one.X_OB for one in clean.odometry])
    np.testing.assert_array_equal(run.truth.stamps, clean.truth.stamps)
    odometry = "Robot1_Odometry.dat: line ends CRLF, read as such; 1 row twice, left out; 3 rows out of order, sorted"
    truth = "Robot1_Groundtruth.dat: the last row cut off, left out; 1 row out of order, sorted"
    assert texts(run) == (odometry, *texts(clean), truth)


def test_a_robot_whose_rows_are_missing_has_not_turned_all_the_while(folder):
    (folder / "Robot1_Odometry.dat").write_text("0 0.105 0.109\n0 0.105 0.109\n20 0.105 0\n30 0 0\n")
    (folder / "Robot1_Measurement.dat.gz").write_bytes(gzip.compress(b""))
    run = load_mrclam(folder, 1)
    hole = "no rows for 20.0 s after 0.0, 10.0 s after 20.0; the motion then is a guess"
    assert texts(run) == (f"Robot1_Odometry.dat: {hole}", "Robot1_Odometry.dat: 1 row twice, left out")
    # 2 s on an arc of 0.1 rad/s, then straight ahead at 0.1 m/s.
    expected = [np.sin(0.2) + 2.8 * np.cos(0.2), 1.0 - np.cos(0.2) + 2.8 * np.sin(0.2), 0.2]
    np.testing.assert_allclose(run.odometry[-1].X_OB, expected, atol=1e-9)


def test_stamps_that_count_in_ns(folder):
    clean = load_mrclam(folder, 1)
    for file, text in (("Odometry.dat", ODOMETRY), ("Groundtruth.dat", TRUTH), ("Measurement.dat", MEASUREMENT)):
        head, *rows = text.splitlines()
        cells = [row.split(" ", 1) for row in rows]
        lines = [head, *(f"{1e9 * float(stamp):.0f} {rest}" for stamp, rest in cells)]
        (folder / f"Robot1_{file}").write_text("\n".join(lines))
    run = load_mrclam(folder, 1)
    assert [one.stamp for one in run.odometry] == pytest.approx([one.stamp for one in clean.odometry])
    assert [one.stamp for one in run.detections] == pytest.approx([one.stamp for one in clean.detections])
    assert run.truth.stamps.tolist() == pytest.approx(clean.truth.stamps.tolist())
    assert texts(run) == ("Robot1_Odometry.dat: stamps of all files read as ns", *texts(clean))


def test_commands_are_integrated_exactly_on_arcs(folder):
    run = load_mrclam(folder, 1)
    assert (SPEED_SCALE, TURN_SCALE) == (1.05, 1.09)
    # 1 s straight at 0.1 m/s, 2 s on an arc of 0.1 rad/s, then rest.
    expected = np.array([0.1 + np.sin(0.2), 1.0 - np.cos(0.2), 0.2])
    np.testing.assert_allclose(run.odometry[-1].X_OB, expected, atol=1e-12)
    # Rest until the first command takes effect.
    late = 10.0 + COMMAND_LATENCY
    assert [one.stamp for one in run.odometry] == [10.0, late, late + 1.0, late + 3.0, late + 4.0]
    assert [one.at_rest for one in run.odometry] == [False, True, False, False, True]


def test_rows_that_repeat_a_command_are_one_arc():
    stamps = 0.01 * np.arange(101)
    rows = np.column_stack([stamps, np.full(101, 0.3), np.full(101, 0.5)])
    messages = integrate_commands(rows)
    assert len(messages) <= 6
    for one in messages:
        angle = 0.5 * one.stamp
        np.testing.assert_allclose(one.X_OB, [0.6 * np.sin(angle), 0.6 * (1.0 - np.cos(angle)), angle], atol=1e-12)


def test_of_several_rows_at_one_time_the_last_counts():
    messages = integrate_commands(np.array([[0.0, 1.0, 0.0], [1.0, 5.0, 0.0], [1.0, 2.0, 0.0], [2.0, 0.0, 0.0]]))
    assert [one.stamp for one in messages] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose([one.X_OB[0] for one in messages], [0.0, 1.0, 3.0])
    assert messages[1].V_B.tolist() == [2.0, 0.0]


def test_without_truth_there_is_none(folder):
    (folder / "Landmark_Groundtruth.dat").unlink()
    (folder / "Robot1_Groundtruth.dat").unlink()
    assert load_mrclam(folder, 1).truth is None


@pytest.mark.parametrize(
    ("file", "contents", "complaint"),
    [
        ("Barcodes.dat", None, "{}/Barcodes.dat: no such file, nor with .gz; put it there"),
        ("Robot1_Odometry.dat", None, "{}/Robot1_Odometry.dat: no such file, nor with .gz; put it there"),
        (
            "Robot1_Odometry.dat",
            "# t v w\n1.0 0.1\n",
            "{}/Robot1_Odometry.dat, line 2: 3 numbers expected (time, forward speed, turn rate), 2 found; mend the"
            " line",
        ),
        (
            "Robot1_Odometry.dat",
            "1.0 0.1 x\n",
            "{}/Robot1_Odometry.dat, line 1: 'x' is not a finite number below 1e+19; mend the line",
        ),
        (
            "Robot1_Odometry.dat",
            "1.0 0.1 nan\n",
            "{}/Robot1_Odometry.dat, line 1: 'nan' is not a finite number below 1e+19; mend the line",
        ),
        ("Robot1_Odometry.dat", "# empty\n", "{}/Robot1_Odometry.dat: no odometry in it; copy it again"),
        (
            "Robot1_Odometry.dat",
            "1.0 0 0\n2.0 x 0\n3.0 0 0\n",
            "{}/Robot1_Odometry.dat, line 2: 'x' is not a finite number below 1e+19; mend the line",
        ),
        (
            "Robot1_Odometry.dat",
            "1.0 0 0\n2.0 0\n3.0 0 0\n",
            "{}/Robot1_Odometry.dat, line 2: 3 numbers expected (time, forward speed, turn rate), 2 found; mend the"
            " line",
        ),
        ("Robot1_Odometry.dat", b"\xff\xfe", "{}/Robot1_Odometry.dat: not a text file; is it what its name says?"),
    ],
)
def test_what_cannot_be_used_is_named(folder, file, contents, complaint):
    if contents is None:
        (folder / file).unlink()
    else:
        (folder / file).write_bytes(contents if isinstance(contents, bytes) else contents.encode())
    with pytest.raises(DatasetError) as caught:
        load_mrclam(folder, 1)
    assert str(caught.value) == complaint.format(folder)


def test_a_cut_gzip_file_is_named(folder):
    file = folder / "Robot1_Measurement.dat.gz"
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(DatasetError) as caught:
        load_mrclam(folder, 1)
    assert str(caught.value) == f"{file}: not a whole gzip file; copy it again"


def test_there_are_five_robots(folder):
    with pytest.raises(DatasetError) as caught:
        load_mrclam(folder, 6)
    assert str(caught.value) == "--robot 6: MR.CLAM has robots 1 to 5"


@pytest.mark.skipif(not REAL.is_dir(), reason="the MR.CLAM data are not at hand")
def test_the_real_runs_are_complete():
    run = load_mrclam(REAL / "Dataset6", 1)
    assert sum(len(frame.ids) for frame in run.detections) == 1534
    assert run.truth.ids.tolist() == list(range(6, 21))
    X_OB = np.array([one.X_OB for one in run.odometry])
    steps = se2.between(X_OB[:-1], X_OB[1:])
    assert 40.0 < np.hypot(steps[:, 0], steps[:, 1]).sum() < 55.0


def test_a_broken_gzip_file_is_named(folder):
    file = folder / "Robot1_Measurement.dat.gz"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(DatasetError) as caught:
        load_mrclam(folder, 1)
    assert str(caught.value) == f"{file}: not a whole gzip file; copy it again"


@pytest.mark.parametrize(
    "name",
    ["Barcodes.dat", "Robot1_Odometry.dat", "Robot1_Measurement.dat.gz", "Landmark_Groundtruth.dat"],
)
def test_a_mutated_file_is_refused_or_read(folder, name):
    assert_refused_or_read(folder / name, lambda: load_mrclam(folder, 1), DatasetError)

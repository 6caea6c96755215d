"""Errors of relations: against the formula of the benchmark, in complex numbers, and on the wheels of real logs."""

import cmath
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.relations import read_relations, relation_errors
from tfg_drake.geometry import se2
from tfg_drake.hardware.recordings import load_dataset

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "radish"


def drawn(seed=0, count=30):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.5, 1.0, count)), np.cumsum(rng.normal(size=(count, 3)), axis=0)


def written(path, rows):
    text = "".join(f"{t1:.9f} {t2:.9f} {x} {y} 0.1 0.2 0.3 {yaw}\n" for t1, t2, x, y, yaw in rows)
    path.write_bytes(gzip.compress(text.encode()))
    return read_relations(path)


def relation(a, b):
    """(x, y, yaw) of pose b as seen from a."""
    d = (complex(b[0], b[1]) - complex(a[0], a[1])) * cmath.exp(-1j * a[2])
    return d.real, d.imag, b[2] - a[2]


def test_errors_are_those_of_the_benchmark(tmp_path):
    stamps, X_W = drawn()
    rng = np.random.default_rng(1)
    rows, moves, turns = [], [], []
    for _ in range(20):
        i, j = rng.integers(30, size=2)
        x, y, yaw = relation(X_W[i], X_W[j])
        dx, dy, turn = 0.1 * rng.normal(size=3)
        rows.append((stamps[i], stamps[j], x + dx, y + dy, yaw + turn))
        moves.append(math.hypot(dx, dy))
        turns.append(abs(math.degrees(turn)))
    found = relation_errors(stamps, X_W, written(tmp_path / "r.relations.gz", rows))
    assert found["count"] == 20
    assert found["translation_m"] == {"mean": pytest.approx(np.mean(moves)), "std": pytest.approx(np.std(moves))}
    assert found["rotation_deg"] == {"mean": pytest.approx(np.mean(turns)), "std": pytest.approx(np.std(turns))}
    # Whatever frame the poses are in.
    moved = se2.compose(np.array([3.0, -2.0, 1.0]), X_W)
    again = relation_errors(stamps, moved, read_relations(tmp_path / "r.relations.gz"))
    assert again["translation_m"]["mean"] == pytest.approx(np.mean(moves))


def test_poses_are_interpolated_and_none_is_left_out(tmp_path):
    stamps, X_W = np.arange(10.0), np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    X_W[:, 2] = np.where(np.arange(10) % 2, -3.1, 3.1)  # a mean over the cut of the angle
    rows = [(2.25, 3.0, 0.0, 0.0, 0.0)]
    found = relation_errors(stamps, X_W, written(tmp_path / "r.relations.gz", rows))
    assert found["translation_m"]["mean"] == pytest.approx(0.75)
    assert found["rotation_deg"]["mean"] == pytest.approx(math.degrees(0.75 * (2 * math.pi - 6.2)))
    relations = written(tmp_path / "r.relations.gz", [*rows, (3.0, 9.6, 0.0, 0.0, 0.0)])
    with pytest.raises(DatasetError) as error:
        relation_errors(stamps, X_W, relations)
    assert str(error.value) == (
        f"{tmp_path}/r.relations.gz, relation 2: no pose near 9.600000 s, the nearest is 0.600 s away; are these the "
        "relations of this log?"
    )


def test_times_are_looked_up_by_the_stamps_that_the_log_told(tmp_path):
    _, X_W = drawn()
    told, here = np.random.default_rng(2).permutation(30) + 100.0, np.arange(30.0)
    rows = [(told[i], told[j], *relation(X_W[i], X_W[j])) for i, j in ((3, 20), (7, 1))]
    relations = written(tmp_path / "r.relations.gz", rows)
    found = relation_errors(here, X_W, relations, np.column_stack([told, here]))
    assert found["translation_m"]["mean"] == pytest.approx(0.0, abs=1e-9)
    relations = written(tmp_path / "r.relations.gz", [*rows, (told[3], 131.0, 0.0, 0.0, 0.0)])
    with pytest.raises(DatasetError, match=r"relation 3: no pose near 131.000000 s"):
        relation_errors(here, X_W, relations, np.column_stack([told, here]))


def test_files_that_are_none(tmp_path):
    (tmp_path / "r").write_text("")
    with pytest.raises(DatasetError, match="no relation in it; a line has t1 t2 x y z roll pitch yaw"):
        read_relations(tmp_path / "r")
    (tmp_path / "r").write_text("1 2 3 4 5 6 7 8\n1 2 3\n4 5 6 7 8 9 1 2\n")
    with pytest.raises(DatasetError, match="line 2: 8 numbers expected"):
        read_relations(tmp_path / "r")


@pytest.mark.skipif(not DATA.is_dir(), reason="the raw logs are not at hand")
@pytest.mark.parametrize(
    ("name", "count", "metres"),
    [
        ("aces", 1279, 0.549),
        pytest.param("intel", 2984, 7.4, marks=pytest.mark.slow),
        pytest.param("fr079", 1685, 6.5, marks=pytest.mark.slow),
    ],
)
def test_the_wheels_of_real_logs_are_as_far_off_as_is_known(name, count, metres):
    log = load_dataset(DATA / f"{name}.clf.bz2")
    X_BS = log.X_BS
    X_WS = se2.compose(np.array([one.X_OB for one in log.odometry]), X_BS)
    stamps = np.array([one.stamp for one in log.odometry])
    found = relation_errors(stamps, X_WS, read_relations(DATA / f"{name}.relations.gz"), log.told_stamps)
    assert found["count"] == count
    assert found["translation_m"]["mean"] == pytest.approx(metres, rel=0.01)

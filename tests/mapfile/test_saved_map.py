import contextlib
import dataclasses
import random
import re
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.mapfile.array_names import array_names
from tests.mutations import assert_refused_or_read
from tfg_drake.mapfile.message_arrays import to_arrays
from tfg_drake.mapfile.saved_map import (
    SCHEMA,
    MapFileError,
    SavedMap,
    load_map,
    restored_estimate,
    save_map,
    saved_map,
    state_of_map,
)
from tfg_drake.mapfile.summary import map_rows
from tfg_drake.slam.keyframe import way
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.map_update import updated
from tfg_drake.slam.shared import SHARED, exactly_known
from tfg_drake.table import empty
from tfg_drake.tfg.frontier import FREE, POORLY_SEEN, STANDOFF, UNSEEN

DAMAGED = "FILE: is damaged; copy it again from where it was recorded"
FORMAT = Path(__file__).parents[2] / "docs" / "map_format.md"


def error_of(path):
    with pytest.raises(MapFileError) as caught:
        load_map(path)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(str(path), "FILE")


@pytest.fixture
def path(tmp_path, small_map):
    save_map(tmp_path / "map.npz", small_map)
    return tmp_path / "map.npz"


def same(one, other):
    one, other = to_arrays(one), to_arrays(other)
    assert list(one) == list(other)
    return all(one[name].tobytes() == other[name].tobytes() for name in one)


def test_round_trip_is_exact(path, small_map):
    loaded = load_map(path)
    assert same(loaded, small_map)
    assert [file.name for file in path.parent.iterdir()] == ["map.npz"]
    first = path.read_bytes()
    save_map(path, loaded)
    assert path.read_bytes() == first


def test_the_solver_is_no_part_of_the_map(tmp_path, small_map):
    graph = dataclasses.replace(small_map.graph, solver="gtsam")
    save_map(tmp_path / "map.npz", dataclasses.replace(small_map, graph=graph))
    assert load_map(tmp_path / "map.npz").graph.solver == "dissection"


def test_a_map_without_landmarks_can_be_kept(tmp_path, small_map):
    prior = exactly_known()
    graph, _, _ = updated(empty_graph(prior), empty_map(prior), way(np.zeros(3), 1e-4 * np.eye(3)))
    bare = dataclasses.replace(
        small_map,
        stage=1,
        graph=graph,
        **no_surfaces(small_map, 1),
    )
    save_map(tmp_path / "bare.npz", bare)
    assert same(load_map(tmp_path / "bare.npz"), bare)
    assert restored_estimate(bare).covariance.shape == (3, 3)


def no_surfaces(saved, stage):
    from tfg_drake.tfg.feature_graph import TfgGraph
    from tfg_drake.tfg.graph import empty_map

    offsets = np.zeros(stage + 1, dtype=np.int64)
    return {
        "tfg_graph": empty(TfgGraph, stage=stage, star_offsets=offsets),
        "tfg": dataclasses.replace(empty_map(), stage=stage, star_offsets=offsets, star_centers=np.zeros((stage, 2))),
    }


def test_the_covariance_follows_from_the_keyframes(small_map):
    estimate = restored_estimate(small_map)
    _, solved = solve(small_map.graph, small_map.stamp, empty_map().observation)
    np.testing.assert_allclose(estimate.covariance, solved.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(estimate.p_ML, small_map.p_ML, atol=1e-6)
    for row in range(len(estimate.ids)):
        block = estimate.covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        np.testing.assert_allclose(small_map.landmark_covariance[row], block, rtol=1e-3, atol=1e-9)
    assert (estimate.stage, estimate.stamp) == (2, 20.25)
    assert abs(estimate.entropy - small_map.entropy) < 1e-6


def as_told(estimate, small_map):
    """The map that is kept of an estimator which tells no more than this."""
    return saved_map(small_map.X_WM, state_of_map(estimate), small_map.tfg_graph, small_map.tfg)


def test_an_estimator_may_tell_its_map_only(tmp_path, small_map):
    estimate = restored_estimate(small_map)
    save_map(tmp_path / "map.npz", as_told(estimate, small_map))
    loaded = load_map(tmp_path / "map.npz")
    again = restored_estimate(loaded)
    for name in ("ids", "p_ML", "X_MD", "local", "X_MA"):
        np.testing.assert_allclose(getattr(again, name), getattr(estimate, name), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(again.covariance, estimate.covariance, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(loaded.landmark_covariance, estimate.landmark_covariance)
    assert (again.stage, again.stamp) == (2, 20.25)
    assert again.entropy == pytest.approx(estimate.entropy, abs=1e-3)
    # It has said nothing of the sensors.
    np.testing.assert_array_equal(loaded.graph.shared.mean, np.zeros(SHARED))


def test_landmarks_that_are_not_known_jointly_count_as_independent(small_map):
    whole = restored_estimate(small_map)
    rows = np.array([0, 1, 6, 7, 8, 9, 10])
    estimate = dataclasses.replace(whole, local=np.array([0, 3]), covariance=whole.covariance[np.ix_(rows, rows)])
    again = restored_estimate(as_told(estimate, small_map))
    np.testing.assert_allclose(again.covariance[np.ix_(rows, rows)], estimate.covariance, rtol=1e-3, atol=1e-9)
    for row in (1, 2):
        at = slice(2 * row, 2 * row + 2)
        np.testing.assert_allclose(again.covariance[at, at], whole.landmark_covariance[row], rtol=1e-3)
        np.testing.assert_allclose(np.delete(again.covariance[at], at, axis=1), 0.0, atol=1e-9)


def test_a_tfg_one_stage_behind_is_a_map_too(tmp_path, small_map):
    behind = dataclasses.replace(small_map, **no_surfaces(small_map, 1))
    save_map(tmp_path / "map.npz", behind)
    loaded = load_map(tmp_path / "map.npz")
    assert same(loaded, behind)
    np.testing.assert_array_equal(loaded.facing, np.zeros((4, 2)))


def test_every_truncation_is_an_error_never_a_crash(path):
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        assert error_of(path) == DAMAGED


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_byte_is_found_or_harmless(path, small_map, data):
    save_map(path, small_map)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole)
    with contextlib.suppress(MapFileError):
        assert same(load_map(path), small_map)


def test_a_mutated_map_is_refused_or_read(path):
    assert_refused_or_read(path, lambda: load_map(path), MapFileError)


def test_arrays_of_extremes_are_refused_or_summed_up(path):
    """A good archive of bad numbers: what load_map lets through, map_rows can count."""
    draw = random.Random(0)
    with np.load(path) as file:
        good = {name: file[name] for name in file.files}
    refused = 0
    for _ in range(80):
        name = draw.choice([name for name, array in good.items() if array.size])
        bad = good[name].copy()
        extremes = (0, -1, 10**6, 2**62) if bad.dtype.kind == "i" else (0, -1, 500, 1e5, 1e300, np.inf, np.nan)
        bad.reshape(-1)[draw.randrange(bad.size)] = draw.choice(extremes)
        np.savez(path, **(good | {name: draw.choice((bad, bad, bad.ravel()[:-1], np.array([bad, bad])))}))
        try:
            map_rows(load_map(path), path.stat().st_size)
        except MapFileError:
            refused += 1
    assert 20 < refused < 80


def test_an_array_of_zeros_is_not_unpacked(path):
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez_compressed(path, **(arrays | {"graph.p_ML": np.zeros((5_000_000, 2))}))
    assert path.stat().st_size < 2e5
    tracemalloc.start()
    assert error_of(path) == "FILE holds 76 MiB, at most 64 are read"
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_a_shape_without_numbers_asks_for_no_memory(path):
    shape = np.array([[0, 10**9]] * 3)
    rewrite(path, **{"graph.keyframes.y_AL__shape": shape, "graph.keyframes.y_AL": np.zeros(0)})
    assert error_of(path) == ("FILE is not a whole map: graph.keyframes.y_AL@shape does not fit graph.keyframes.y_AL")


def test_missing_and_foreign_files(tmp_path):
    assert error_of(tmp_path / "none.npz") == "FILE: no such file; name the folder of a run that was recorded"
    foreign = tmp_path / "other.npz"
    np.savez(foreign, a=np.zeros(3))
    assert error_of(foreign) == "FILE is not a map of tfg-drake"
    np.savez(foreign, schema=np.array("3"))
    assert error_of(foreign) == "FILE is not a map of tfg-drake"
    np.save(tmp_path / "array.npy", np.zeros(3))
    assert error_of(tmp_path / "array.npy") == DAMAGED
    text = tmp_path / "text.npz"
    text.write_text("a map\n")
    assert error_of(text) == DAMAGED
    assert error_of(tmp_path) == "FILE/map.npz: no such file; name the folder of a run that was recorded"


def test_a_runs_folder_stands_for_its_map(path, small_map):
    assert same(load_map(path.parent), small_map)


def test_whatever_numpy_raises_of_a_header_is_one_line(path):
    """Its header is Python text: what cannot be split into words raises tokenize.TokenError, no ValueError."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for header in (b"{'descr': '<f8', 'shape': (", b'"""', b"(" * 500, b"\\\n", b"1_"):
        text = header + b" " * (53 - len(header) % 64) + b"\n"
        members["X_WM.npy"] = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        assert error_of(path) == DAMAGED


def test_pickled_objects_are_refused(tmp_path):
    path = tmp_path / "map.npz"
    np.savez(path, schema=np.array([{"a": 1}], dtype=object))
    assert error_of(path) == DAMAGED


def rewrite(path, **changes):
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    assert all(name.replace("__", "@") in arrays for name in changes)
    arrays.update({name.replace("__", "@"): change for name, change in changes.items()})
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"schema": np.int64(17)}, "FILE has map schema 17; this version reads 13 to 16: update tfg-drake"),
        ({"schema": np.int64(1)}, "FILE has map schema 1; this version reads 13 to 16: make the map anew"),
        ({"graph.p_ML": None}, "FILE is not a whole map: graph.p_ML is missing"),
        ({"graph.p_ML": np.zeros((4, 3))}, "FILE is not a whole map: graph.p_ML has the wrong shape"),
        ({"graph.ids": np.zeros(4)}, "FILE is not a whole map: graph.ids holds no integers"),
        ({"X_WM": np.full(3, np.nan)}, "FILE is not a whole map: X_WM holds NaN"),
        ({"X_WM": np.zeros(3, np.float32)}, "FILE is not a whole map: X_WM must be float64, not float32"),
        ({"stage": np.int64(3)}, "FILE is not a whole map: graph.view_keyframe does not fit stage"),
        (
            {"graph.keyframes__count": np.int64(1)},
            "FILE is not a whole map: graph.keyframes.ids@shape has the wrong shape",
        ),
        ({"graph.X_MN": np.zeros((3, 3))}, "FILE is not a whole map: graph.X_MN has the wrong shape"),
        (
            {"graph.view_keyframe": np.array([0, 3])},
            "FILE is not a whole map: graph.view_keyframe does not fit graph.keyframes",
        ),
        ({"graph.ids": np.array([10, 11, 11, 13])}, "FILE is not a whole map: graph.ids is not ascending"),
        (
            {"graph.anchor": np.full((4, 2), 1e6)},
            "FILE is not a whole map: graph.anchor is more than 1000 m from the origin",
        ),
        (
            {"graph.reach": np.full((4, 2), np.inf)},
            "FILE is not a whole map: graph.reach is more than 1000 m from the origin",
        ),
        ({"graph.reach": np.zeros((3, 2))}, "FILE is not a whole map: graph.reach has the wrong shape"),
        (
            {"graph.ids": np.array([10, 11, 12, 14])},
            "FILE is not a whole map: graph.keyframes.ids does not fit graph.ids",
        ),
        ({"tfg_graph.stage": np.int64(3)}, "FILE is not a whole map: tfg_graph.stage does not fit stage"),
        (
            {"tfg.star_centers": np.full((2, 2), 1e6)},
            "FILE is not a whole map: tfg.star_centers is more than 1000 m from the origin",
        ),
        ({"tfg.facing": np.zeros((3, 2))}, "FILE is not a whole map: tfg.facing does not fit graph.ids"),
        (
            {"tfg_graph.met_stamp": np.array([1.0])},
            "FILE is not a whole map: tfg_graph.met_stamp has the wrong shape",
        ),
        (
            {"tfg_graph.surfaces.view": np.array([0, 0, 2])},
            "FILE is not a whole map: tfg_graph.surfaces.view does not fit tfg_graph.stage",
        ),
        (
            {"tfg_graph.frontiers.view": np.array([-1])},
            "FILE is not a whole map: tfg_graph.frontiers.view does not fit tfg_graph.stage",
        ),
        ({"tfg.segment_kind": np.full(4, 3)}, "FILE is not a whole map: tfg.segment_kind is no kind"),
        (
            {"tfg.facing": np.full((4, 2), 1e300)},
            "FILE is not a whole map: tfg.facing or tfg_graph.tag_facing is no direction",
        ),
        (
            {"X_WM": np.array([0.0, 0.0, np.inf])},
            "FILE is not a whole map: X_WM or graph.landmark_covariance is not finite",
        ),
        ({"tfg.segment_ids": np.full((4, 2), 9)}, "FILE is not a whole map: tfg.segment_ids does not fit graph.ids"),
        (
            {"tfg_graph.surfaces.offsets": np.array([0, 2, 4, 8])},
            "FILE is not a whole map: tfg_graph.surfaces.offsets does not fit vertices",
        ),
        (
            {"tfg.star_offsets": np.array([0, 9, 8])},
            "FILE is not a whole map: tfg.star_offsets does not fit star_vertices",
        ),
        (
            {"tfg_graph.star_offsets": np.array([0, 8])},
            "FILE is not a whole map: tfg_graph.star_offsets does not fit tfg.stage",
        ),
    ],
)
def test_other_schemas_and_contradictions(path, changes, complaint):
    rewrite(path, **changes)
    assert error_of(path) == complaint


def test_a_map_of_before_is_read(path, small_map):
    """Without scatter, of walls that could be off by no more than four times, with tags seen on the way, and with a
    table for each kind of frontier."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if not name.startswith("graph.keyframes.scatter")}
    arrays["walls.by_floor"] = np.array([-3.0, 0.0, -1.0, -2.0])
    arrays["schema"], arrays["tfg.viewpoints"] = np.int64(14), np.ones((1, 2))
    arrays["tfg_graph.tried_count"] = np.zeros(0, dtype=np.int64)
    for name in [name for name in arrays if name.startswith("tfg_graph.frontiers.")]:
        array, no_rows = arrays.pop(name), arrays[name.replace("frontiers", "met")][:0]
        lists = {"free_space_frontiers": array, "uninspected": array, "unseen_backs": array, "open_ends": no_rows}
        arrays |= {name.replace("frontiers", one): of for one, of in lists.items()}
    arrays |= {
        name.replace(".met.", f".{of}."): array
        for name, array in arrays.items()
        for of in ("sighted", "viewpoints", "tried")
        if name.startswith("tfg_graph.met.")
    }
    for name in [name for name in arrays if name.endswith(".kind") and name.startswith("tfg_graph.")]:
        kind = arrays.pop(name)
        arrays[name.replace(".kind", ".on_surface")] = np.full(len(kind), "un" in name)
        arrays[name.replace(".kind", ".id")] = arrays.pop(name.replace(".kind", ".tries"))
    np.savez(path, **arrays)
    read = load_map(path)
    assert not any(one.scatter.any() for one in read.graph.keyframes)
    np.testing.assert_array_equal(read.walls.by_floor, [-3.0, 0.0, -1.0, -2.0, -2.0, -2.0, -2.0])
    assert read.graph.X_MN.tobytes() == small_map.graph.X_MN.tobytes()
    frontiers, before = read.tfg_graph.frontiers, small_map.tfg_graph.frontiers
    np.testing.assert_array_equal(frontiers.kind, np.repeat([FREE, POORLY_SEEN, UNSEEN], len(before.p)))
    before_faces = before.p + STANDOFF * before.normal
    np.testing.assert_array_equal(frontiers.p, np.vstack([before.p, before_faces, before_faces]))
    np.savez(path, **{**arrays, "tfg_graph.uninspected.p": np.zeros((1, 3))})
    assert error_of(path).startswith("FILE is not a whole map: its frontiers do not fit together: ")
    del arrays["tfg_graph.open_ends.p"]
    np.savez(path, **arrays)
    assert error_of(path) == "FILE is not a whole map: tfg_graph.open_ends.p is missing"


def test_the_format_is_described(small_map):
    section = FORMAT.read_text().split("## The arrays")[1].split("\n## ")[0]
    lists = re.findall(r"(?<=[-;] )`(\w+)`: ", section)
    rows = re.findall(r"^\| `([^`]+)` \| (.+?) \|", section, re.MULTILINE)
    documented = {name.replace("LIST", one): kind for name, kind in rows for one in lists}
    assert documented.pop("schema") == f"int64, {SCHEMA}"
    assert documented == array_names(SavedMap)


NO_DRAKE = """
import sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "pydrake":
            raise ImportError("no Drake here")
sys.meta_path.insert(0, Finder())
from pathlib import Path
from tfg_drake.mapfile.saved_map import load_map, restored_estimate
print(restored_estimate(load_map(Path(sys.argv[1]))).covariance.shape)
"""


def test_a_map_is_loaded_without_drake(path):
    done = subprocess.run([sys.executable, "-c", NO_DRAKE, path], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("(11, 11)\n", "")

import dataclasses

import numpy as np
import pytest

from tfg_drake.map_file import MapFileError, SavedMap, load_map, save_map


def make_saved(n=3):
    return SavedMap(
        X_WM=np.array([1.0, 2.0, 0.3]),
        stage=2,
        stamp=40.5,
        entropy=-12.25,
        ids=np.arange(n),
        p_ML=np.arange(2.0 * n).reshape(n, 2),
        facing=np.tile([1.0, 0.0], (n, 1)),
        X_MD=np.zeros(3),
        covariance=np.eye(2 * n + 3),
        X_MA=np.zeros((2, 3)),
        segments=np.ones((4, 4)),
        segment_kind=np.zeros(4, dtype=int),
        segment_ids=np.full((4, 2), -1),
        frontiers=np.zeros((0, 2)),
        frontier_length=np.zeros(0),
        frontier_normal=np.zeros((0, 2)),
        star_offsets=np.array([0, 3]),
        star_vertices=np.zeros((3, 2)),
        star_centers=np.zeros((1, 2)),
    )


@pytest.mark.parametrize("n", [0, 3])
def test_round_trip_is_exact(tmp_path, n):
    path, saved = tmp_path / "map.npz", make_saved(n)
    save_map(path, saved)
    loaded = load_map(path)
    for field in dataclasses.fields(SavedMap):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(saved, field.name))
    assert (loaded.stage, loaded.stamp, loaded.entropy) == (2, 40.5, -12.25)
    assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]


def error_of(path):
    with pytest.raises(MapFileError) as caught:
        load_map(path)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(str(path), "FILE")


def test_every_truncation_is_an_error_never_a_crash(tmp_path):
    path = tmp_path / "map.npz"
    save_map(path, make_saved())
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        assert error_of(path) == "FILE is damaged or not a map of tfg-drake"


def test_missing_and_foreign_files(tmp_path):
    assert error_of(tmp_path / "none.npz") == "no such map: FILE"
    foreign = tmp_path / "other.npz"
    np.savez(foreign, a=np.zeros(3))
    assert error_of(foreign) == "FILE is not a map of tfg-drake"
    np.save(tmp_path / "array.npy", np.zeros(3))
    assert error_of(tmp_path / "array.npy") == "FILE is damaged or not a map of tfg-drake"
    text = tmp_path / "text.npz"
    text.write_text("a map\n")
    assert error_of(text) == "FILE is damaged or not a map of tfg-drake"
    assert error_of(tmp_path) == "FILE is damaged or not a map of tfg-drake"


def test_pickled_objects_are_refused(tmp_path):
    path = tmp_path / "map.npz"
    np.savez(path, schema=np.array([{"a": 1}], dtype=object))
    assert error_of(path) == "FILE is damaged or not a map of tfg-drake"


def rewrite(path, **changes):
    save_map(path, make_saved())
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    arrays.update(changes)
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def test_other_schemas_and_contradictions(tmp_path):
    path = tmp_path / "map.npz"
    rewrite(path, schema=np.int64(7))
    assert error_of(path) == "FILE has map schema 7; this version reads schema 1"
    rewrite(path, covariance=None)
    assert error_of(path) == "FILE is not a whole map: covariance is missing"
    rewrite(path, covariance=np.eye(8))
    assert error_of(path) == "FILE is not a whole map: covariance has the wrong shape"
    rewrite(path, ids=np.zeros(3))
    assert error_of(path) == "FILE is not a whole map: ids holds no integers"
    rewrite(path, segments=np.full((4, 4), np.nan))
    assert error_of(path) == "FILE is not a whole map: segments is not finite"
    rewrite(path, star_offsets=np.array([0, 4]))
    assert error_of(path) == "FILE is not a whole map: star_offsets does not fit star_vertices"

"""A saved map as the timeline of one moment."""

import numpy as np

from benchmarks.timelines import read_timeline
from tfg_drake.pictures.tables import write_map_timeline


def test_a_timeline_of_one_moment_has_all_of_the_map(small_map, tmp_path):
    path = tmp_path / "timeline.tfg"
    write_map_timeline(small_map, path, "a <map>")
    records = {record.layer: record for record in read_timeline(path)}
    assert {record.time for record in records.values()} == {round(small_map.stamp, 4)}
    assert records["world"].told["title"] == "a <map>"
    np.testing.assert_allclose(records["frame"].arrays["pose"], [5.0, 3.0, np.pi / 2], rtol=1e-6)
    told = records["map"]
    np.testing.assert_array_equal(told.arrays["ids"], small_map.ids)
    np.testing.assert_allclose(told.arrays["points"], small_map.p_ML, atol=1e-3)
    assert (told.told["stage"], told.told["views"]) == (2, 2)
    np.testing.assert_allclose(records["tfg"].arrays["segments"], small_map.tfg.segments, atol=1e-3)
    assert len(records["frontiers"].arrays["segments"]) == len(small_map.tfg.frontiers) == 1
    np.testing.assert_array_equal(records["facing"].arrays["ids"], small_map.ids)
    count = np.diff(small_map.tfg.star_offsets) + 1
    np.testing.assert_array_equal(records["free"].arrays["count"], count)
    assert len(records["wall_landmarks"].arrays["segments"]) == 0


def test_walls_that_are_landmarks_are_there(walled_map, tmp_path):
    path = tmp_path / "timeline.tfg"
    write_map_timeline(walled_map, path, "walls")
    records = {record.layer: record for record in read_timeline(path)}
    np.testing.assert_allclose(records["wall_landmarks"].arrays["segments"], [[1.0, 1.0, 4.0, 5.0]], atol=1e-3)
    np.testing.assert_allclose(records["wall_landmarks"].arrays["deviation"], [[0.02, 0.3]], rtol=1e-5)
    assert len(records["map"].arrays["ids"]) == 4  # the tags

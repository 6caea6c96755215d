"""A mission's picture over time, written and read again."""

import errno
import io
import time
import tracemalloc
import zlib

import numpy as np
import pytest

from benchmarks import timelines
from benchmarks.timelines import read_timeline
from tests.mutations import assert_refused_or_read
from tfg_drake.io import files
from tfg_drake.pictures.rows import Table
from tfg_drake.storage.timeline import FILE_NAME, MAGIC, TimelineError, TimelineWriter, encoded, write_map_timeline

ARRAYS = {
    "points": np.array([[1.2344, -2.0], [0.0, 3.5]]),
    "covariance": np.array([[1e-4, -2e-5, 3e-4]], dtype=np.float32),
    "doubtful": np.array([True, False, True]),
    "ids": np.array([3, 2**20, -1]),
    "edges": np.array([[0, 65535]]),
    "none": np.zeros((0, 4)),
}


def write(folder, *times):
    with TimelineWriter(folder / FILE_NAME) as writer:
        for time in times:
            writer.write("map", time, ARRAYS, stage=int(time), word="é")
            writer.flush()
    return folder / FILE_NAME


def test_what_is_read_is_what_was_written_to_the_millimetre(tmp_path):
    write(tmp_path, 0.125, 2.5)
    first, second = read_timeline(tmp_path)
    assert (first.time, second.time) == (0.125, 2.5)
    assert first.layer == "map"
    assert dict(second.told) == {"stage": 2, "word": "é"}
    np.testing.assert_allclose(first.arrays["points"], ARRAYS["points"], atol=5e-4)
    np.testing.assert_array_equal(first.arrays["covariance"], ARRAYS["covariance"])
    np.testing.assert_array_equal(first.arrays["doubtful"], ARRAYS["doubtful"])
    for name in ("ids", "edges"):
        np.testing.assert_array_equal(first.arrays[name], ARRAYS[name])
    assert first.arrays["none"].shape == (0, 4)


def test_a_table_is_read_whole_and_lines_of_many_points_to_the_centimetre(tmp_path):
    far = np.array([[-500.0, 0.0, 500.0, 0.25], [500.0, 0.25, -500.0, 0.0]])
    points, ids = np.array([[-1e3, 2.0], [400.004, 3.5], [0.0, 0.0]]), np.array([1, 2, 3])
    with TimelineWriter(tmp_path / FILE_NAME) as writer:
        writer.write_rows("map", 1.0, Table({"points": points, "ids": ids}, points, ids), stage=1)
        points = points[1:] + np.array([[0.5, 0.5], [9.0, 9.0]])
        writer.write_rows("map", 2.0, Table({"points": points, "ids": ids[1:]}, points, ids[1:]), stage=2)
        writer.write_rows("map", 3.0, Table({"points": points[:0], "ids": ids[:0]}, points[:0], ids[:0]))
        writer.write("scan", 3.0, {"points": points})
        writer.write("path", 3.0, {"segments": far})
    one, two, none, scan, path = read_timeline(tmp_path)
    np.testing.assert_allclose(path.arrays["segments"], far)
    np.testing.assert_allclose(one.arrays["points"], [[-1e3, 2.0], [400.004, 3.5], [0.0, 0.0]])
    assert (one.arrays["ids"].tolist(), dict(one.told)) == ([1, 2, 3], {"stage": 1})
    np.testing.assert_allclose(two.arrays["points"], [[400.004, 3.5], [9.0, 9.0]])
    assert two.arrays["ids"].tolist() == [2, 3]
    assert none.arrays["points"].shape == (0, 2)
    np.testing.assert_allclose(scan.arrays["points"], points, atol=5.001e-3)


def test_of_a_program_that_was_killed_all_is_there_but_the_last_block(tmp_path):
    path = write(tmp_path, 1.0, 2.0, 3.0)
    data = path.read_bytes()
    for cut in (1, 5, 60):
        path.write_bytes(data[:-cut])
        assert [record.time for record in read_timeline(path)] == [1.0, 2.0]
    path.write_bytes(MAGIC)
    assert read_timeline(path) == []


def test_it_is_on_the_disk_soon_and_sooner_where_somebody_looks_on(tmp_path, monkeypatch):
    now, watched = [100.0], [False]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with TimelineWriter(tmp_path / FILE_NAME, lambda: watched[0]) as writer:

        def there(passed):
            now[0] += passed
            writer.write("pose", now[0], {})
            writer.flush(all_of_it=False)
            return len(read_timeline(tmp_path))

        assert [there(0.5), there(0.4), there(0.2)] == [0, 0, 3]
        watched[0] = True
        assert [there(0.05), there(0.04)] == [3, 5]


def test_a_large_layer_is_written_seldom(tmp_path):
    with TimelineWriter(tmp_path / FILE_NAME) as writer:
        assert writer.is_due("map", 0.0)
        writer.write("map", 0.0, {"points": np.zeros((4000, 2))})
        assert [writer.is_due("map", time) for time in (1.0, 3.9, 4.1)] == [False, False, True]
        assert writer.is_due("tfg", 1.0)


def test_a_full_disk_ends_the_timeline_and_not_the_mission(tmp_path, caplog):
    writer = TimelineWriter(tmp_path / FILE_NAME)

    class Full(io.BytesIO):
        def write(self, _data):
            raise OSError(errno.ENOSPC, "No space left on device")

    writer._file.close()
    writer._file = Full()
    for instant in (1.0, 2.0):
        writer.write("map", instant, ARRAYS)
        writer.flush()
    writer.close()
    assert writer.failure.errno == errno.ENOSPC
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / FILE_NAME}: cannot be written: No space left on device; the mission goes on"
    ]


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (None, "no such file; name the folder of a run that was recorded"),
        (b"", "is no timeline of this version; name the folder of a run that was recorded"),
        (b"\x89MCAP0\r\n" * 9, "is no timeline of this version; name the folder of a run that was recorded"),
        (MAGIC + b"\x04\0\0\0zlib", "is damaged; copy it again from where it was recorded"),
    ],
)
def test_what_is_no_timeline(tmp_path, data, complaint):
    if data is not None:
        (tmp_path / FILE_NAME).write_bytes(data)
    with pytest.raises(TimelineError) as caught:
        read_timeline(tmp_path)
    assert str(caught.value) == f"{tmp_path / FILE_NAME}: {complaint}"


def bytes_taken(call):
    """What a call that is refused takes of memory at most, bytes."""
    tracemalloc.start()
    try:
        with pytest.raises(TimelineError, match=r"is damaged; copy it again from where it was recorded$"):
            call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("blocks", [1, 3])
def test_a_small_file_is_not_unpacked_without_end(tmp_path, monkeypatch, blocks):
    """A block of zeros, and several that are each small enough."""
    monkeypatch.setattr(files, "_LEAST_UNPACKED", 2**20)
    # A record of one array, so that what there is of it is read.
    record = encoded("scan", 0.0, {"points": np.zeros((200_000 // blocks, 2), dtype=np.float32)}, {})
    block = zlib.compress(record * (100 if blocks == 1 else 1))
    path = tmp_path / FILE_NAME
    path.write_bytes(MAGIC + blocks * (len(block).to_bytes(4, "little") + block))
    assert bytes_taken(lambda: read_timeline(path)) < 20 * 2**20  # of 160


def test_a_table_that_is_told_again_and_again_takes_no_memory_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr(timelines, "_LARGEST", 2**20)
    with TimelineWriter(tmp_path / FILE_NAME) as writer:
        writer.write("map", 0.0, {"ids": np.arange(2**14) + 2**16, "gone": np.zeros(0, dtype=np.int64)})
        for k in range(100):
            writer.write("map", k, {"ids": np.zeros(0, dtype=np.int64), "gone": np.zeros(0, dtype=np.int64)})
    assert bytes_taken(lambda: read_timeline(tmp_path)) < 4 * 2**20


def test_a_mutated_timeline_is_refused_or_read(tmp_path):
    path = write(tmp_path, 1.0, 2.0)
    assert_refused_or_read(path, lambda: read_timeline(path), TimelineError)


@pytest.mark.parametrize("header", [b"[]", b'{"t": 0}', b'{"t": 0, "layer": "a", "arrays": [3]}', b"[" * 50_000])
def test_a_good_block_of_bad_records_is_refused(tmp_path, header):
    header += b" " * (-len(header) % 4)
    block = zlib.compress(len(header).to_bytes(4, "little") + header)
    (tmp_path / FILE_NAME).write_bytes(MAGIC + len(block).to_bytes(4, "little") + block)
    bytes_taken(lambda: read_timeline(tmp_path))


def test_a_timeline_that_has_less_than_a_checkpoint_counts_on_is_refused(tmp_path):
    path = tmp_path / FILE_NAME
    with TimelineWriter(path) as writer:
        writer.write("pose", 1.0, {"pose": np.zeros(3)})
        standing = writer.standing()
    assert standing.size == path.stat().st_size
    with TimelineWriter(path, standing=standing):
        pass
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(TimelineError, match=rf"has {standing.size - 1} of {standing.size} bytes"):
        TimelineWriter(path, standing=standing)


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


def test_a_large_table_is_told_less_often_even_where_nothing_has_changed(tmp_path):
    points = np.zeros((100_000, 2))
    with TimelineWriter(tmp_path / FILE_NAME) as writer:
        for time_now, keys in ((0.0, np.arange(len(points))), (1e3, np.arange(len(points)))):
            writer.write_rows("map", time_now, Table({"points": points}, points, keys))
        assert not writer.is_due("map", 1e3 + 3.9)
        assert writer.is_due("map", 1e3 + 4.1)

"""What is read of a run's files, and what is said of those that are not what they should be."""

import errno
import json

import numpy as np
import pytest

from tfg_drake.io import files
from tfg_drake.io.files import FileError, most_unpacked, of_run, read_arrays, read_object, read_text, reading


def test_a_file_of_a_run_is_named_by_itself_or_by_the_folder(tmp_path):
    assert of_run(tmp_path, "map.npz") == tmp_path / "map.npz"
    assert of_run(tmp_path / "other.npz", "map.npz") == tmp_path / "other.npz"


@pytest.mark.parametrize(
    ("error", "complaint"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file"), "no such file; name the folder of a run that was recorded"),
        (
            PermissionError(errno.EACCES, "Permission denied"),
            "cannot be read: Permission denied; name a file that can be",
        ),
        (KeyError("t"), "is damaged; copy it again from where it was recorded"),
        (RecursionError(), "is damaged; copy it again from where it was recorded"),
    ],
)
def test_whatever_is_raised_is_one_line(tmp_path, error, complaint):
    class OwnError(FileError):
        pass

    with pytest.raises(OwnError) as caught, reading(tmp_path / "a", OwnError):
        raise error
    assert str(caught.value) == f"{tmp_path / 'a'}: {complaint}"


def test_what_is_already_told_stays_as_it_is(tmp_path):
    with pytest.raises(FileError, match=r"^too long$"), reading(tmp_path):
        raise FileError("too long")


@pytest.mark.parametrize("text", ["[1]", "{", "3", "[" * 100_000, "", '{"a": "\xff"}'])
def test_what_is_no_json_object(tmp_path, text):
    path = tmp_path / "summary.json"
    path.write_text(json.dumps({"a": [1]}))
    assert read_object(path) == {"a": [1]}
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileError) as caught:
        read_object(path)
    assert str(caught.value) == f"{path}: is damaged; copy it again from where it was recorded"


def test_text_without_end_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "LARGEST_TEXT", 2**20)
    path = tmp_path / "stages.jsonl"
    path.write_bytes(b" " * 2**20)
    assert len(read_text(path)) == 2**20
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(FileError) as caught:
        read_text(path)
    assert str(caught.value) == f"{path}: has more than 1 MiB; name a file of a run"


def test_a_small_file_may_stand_for_64_mib_a_large_one_for_32_times_its_size(tmp_path):
    (tmp_path / "small").write_bytes(b"0")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10**8)
    assert most_unpacked(tmp_path / "small") == 64 * 2**20
    assert most_unpacked(tmp_path / "large") == 32 * 10**8


def test_arrays_are_read_within_a_bound(tmp_path, monkeypatch):
    path = tmp_path / "grid.npz"
    np.savez_compressed(path, a=np.zeros(1000), b=np.arange(3))
    assert {name: array.shape for name, array in read_arrays(path).items()} == {"a": (1000,), "b": (3,)}
    monkeypatch.setattr(files, "_LARGEST_ARRAYS", 8000)
    with pytest.raises(FileError, match=r"grid\.npz holds 0 MiB, at most 0 are read"):
        read_arrays(path)

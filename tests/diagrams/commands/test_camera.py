"""The commands of camera and tags on rendered images; what is wrong in one line."""

import json
import re

import numpy as np
import pytest
from PIL import Image

from tests.cameras import pinhole
from tests.vision.rendering import cv2, render
from tests.vision.test_chessboard import board_image, poses
from tfg_drake.vision.calibration import load_calibration, save_calibration

CAMERA = pinhole(640, 480, 520.0)
KEYS = ["stamp", "ids", "range", "bearing", "sigma_range", "sigma_bearing"]


@pytest.fixture(autouse=True)
def _compiled():
    """These commands call no kernel, so that nothing waits for the compilation."""


@pytest.fixture
def images(tmp_path):
    """A folder of two images, of one tag and of two that bear one id, a file that is no image, and a calibration."""
    folder = tmp_path / "images"
    folder.mkdir()
    left, right = [-0.3, 0.0, 1.5], [0.3, 0.0, 1.5]
    cv2.imwrite(str(folder / "1.5.png"), render([(7, np.eye(3), left, 0.16)], CAMERA))
    cv2.imwrite(str(folder / "2.5.png"), render([(7, np.eye(3), left, 0.16), (7, np.eye(3), right, 0.16)], CAMERA))
    (folder / "notes.txt").write_text("no image", encoding="utf-8")
    save_calibration(tmp_path / "camera.yaml", CAMERA)
    return folder


def options(images):
    return ["--calibration", images.parent / "camera.yaml", "--tag-size", 0.16, "--out", images.parent / "seen.png"]


def test_check_as_json(call, images):
    code, out, err = call("camera", "check", images, *options(images), "--json")
    first, second = (json.loads(line) for line in out.splitlines())
    assert code == 0
    assert list(first) == list(second) == KEYS
    assert (first["stamp"], first["ids"]) == (1.5, [7])
    assert first["range"] == pytest.approx([np.hypot(0.3, 1.5)], abs=0.01)
    assert first["bearing"] == pytest.approx([np.arctan2(0.3, 1.5)], abs=0.002)
    assert second == {"stamp": 2.5, **{key: [] for key in KEYS[1:]}}
    assert err == "2.5.png: tag 7: 2 times in one image; all are left out, print each id once\n"


def test_check_leaves_nothing_where_no_picture_is_asked_for(call, images, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    code, out, _ = call("camera", "check", images, *options(images)[:-2])
    assert code == 0
    assert re.search(r"^2 frames, 1 tags, \d+ ms a frame$", out, re.MULTILINE)
    assert not any((tmp_path / "here").iterdir())


def test_check_tells_and_draws(call, images):
    code, out, _ = call("camera", "check", images, *options(images), "--mount", "0.1,0,0,0")
    assert code == 0
    assert out.startswith("1.5.png: tag 7 at 1.6")
    assert "2.5.png: no tag" in out
    with Image.open(images.parent / "seen.png") as picture:
        assert picture.size == (640, 480)
    into = images.parent / "pictures"
    assert call("camera", "check", images, *options(images)[:-1], into, "--frames", 1)[0] == 0
    assert [path.name for path in into.iterdir()] == ["1.5.png"]


def test_calibrate_by_a_chessboard(call, tmp_path):
    for number, (R, p) in enumerate(poses(30, tilt=0.45)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), board_image(R, p))
    out = tmp_path / "out.yaml"
    code, printed, _ = call("camera", "calibrate", tmp_path, "--board", "9x6", "--square", 0.025, "--out", out)
    assert code == 0
    assert "focal length" in printed
    found = load_calibration(out)
    assert (found.width, found.height) == (640, 480)
    np.testing.assert_allclose(np.diag(found.matrix)[:2], [520.5, 519.0], atol=4.0)


def test_print_tags(call, tmp_path):
    out = tmp_path / "tags.pdf"
    code, printed, err = call("tags", "print", "--ids", "0-3", "--size", 0.16, "--out", out)
    assert (code, err) == (0, "")
    assert printed == f"4 tags of 160 mm on 4 pages: {out}; print at 100 %, not fitted to the page\n"
    assert out.read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (["--tag-size", -1], "--tag-size -1: must be greater than 0 m"),
        (["--mount", "1,2"], "--mount 1,2: must be X,Y,YAW,PITCH in metres and radians, such as 1.5,2,0,0"),
        (["--mount", "0,0,90,0"], "--mount 0,0,90,0: 90 rad is more than a turn; write radians, not degrees"),
        (["--family", "tag9"], "tag9: unknown family of tags; known are tag36h11, tag16h5"),
        (["--decimation", 0], "1 threads, decimation 0: both must be 1 or more"),
        (
            ["--calibration", "none.yaml"],
            "--calibration none.yaml: cannot be read: No such file or directory; name a calibration's YAML file",
        ),
    ],
)
def test_bad_input_of_check(call, images, change, told):
    assert call("camera", "check", images, *options(images), *change) == (2, "", f"tfg-drake: {told}\n")


def test_bad_input_of_the_others(call, images, tmp_path):
    out = ["--out", tmp_path / "out.yaml"]
    assert call("camera", "calibrate", images, "--board", "9", "--square", 0.02, *out) == (
        2, "", "tfg-drake: --board 9: must be the numbers of inner corners, 3 to 50, such as 9x6\n",
    )  # fmt: skip
    code, _, err = call("camera", "calibrate", images, "--board", "9x6", "--square", 0.02, *out)
    assert code == 2
    assert err.splitlines() == [
        "1.5.png: no board of 9x6 inner corners in sight",
        "2.5.png: no board of 9x6 inner corners in sight",
        f"tfg-drake: {images}: 0 views of the board, at least 8 are needed; show it from more sides",
    ]
    assert call("tags", "print", "--ids", "900", "--out", tmp_path / "t.pdf") == (
        2, "", "tfg-drake: --ids 900: tag36h11 has the ids 0 to 586, a range goes upward\n",
    )  # fmt: skip

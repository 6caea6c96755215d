"""Images of folders, files and videos, in order and with their stamps."""

import re

import numpy as np
import pytest

from tests.vision.rendering import cv2
from tfg_drake.vision.frames import FrameError, frames, is_live


def picture(value):
    image = np.zeros((48, 64, 3), np.uint8)
    image[..., 0] = value  # blue, as OpenCV has it
    return image


def test_a_folder_in_order_without_what_is_no_image(tmp_path):
    for name, value in (("image10", 30), ("image9", 20), ("2.5", 10)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture(value))
    (tmp_path / "notes.txt").write_text("no image", encoding="utf-8")
    (tmp_path / "empty.png").touch()
    (tmp_path / "broken.png").write_bytes((tmp_path / "2.5.png").read_bytes()[:40])
    (tmp_path / "folder.png").mkdir()
    found = list(frames(str(tmp_path)))
    assert [(frame.name, frame.stamp) for frame in found] == [
        ("2.5.png", 2.5),
        ("image9.png", 1.0),
        ("image10.png", 2.0),
    ]
    assert [frame.image[0, 0].tolist() for frame in found] == [[0, 0, 10], [0, 0, 20], [0, 0, 30]]
    assert not is_live(str(tmp_path))


def test_one_image(tmp_path):
    cv2.imwrite(str(tmp_path / "17.25.png"), picture(5))
    (frame,) = frames(str(tmp_path / "17.25.png"))
    assert (frame.stamp, frame.name, frame.image.shape) == (17.25, "17.25.png", (48, 64, 3))


def test_a_video(tmp_path):
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for value in (50, 100, 150):
        writer.write(picture(value))
    writer.release()
    found = list(frames(path))
    assert [frame.name for frame in found] == ["0", "1", "2"]
    assert (np.diff([frame.stamp for frame in found]) > 0.05).all()
    assert np.allclose([frame.image[20, 20, 2] for frame in found], [50, 100, 150], atol=6)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nothing", "no such file; name a folder, an image, a video, a stream's address or a camera"),
        ("empty", "no image in it; name a folder with images that OpenCV reads, as PNG or JPEG"),
        ("text.png", "is no image or video that OpenCV reads"),
    ],
)
def test_a_source_without_images(name, told, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.png").write_text("no image", encoding="utf-8")
    with pytest.raises(FrameError, match="^" + re.escape(f"{tmp_path / name}: {told}") + "$"):
        list(frames(str(tmp_path / name)))


def test_what_is_live():
    assert is_live("0")
    assert is_live("rtsp://camera/stream")

"""Images of folders, files and videos, in order and with their stamps."""

import re
import shutil
import tracemalloc

import numpy as np
import PIL.Image
import pytest

from tests.mutations import assert_refused_or_read, mutations
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


def motion(path, count, shape=(48, 64), duration=100):
    """So many images, each 3 grey levels brighter, in one file."""
    images = [PIL.Image.fromarray(np.full((*shape, 3), 3 * k, np.uint8)) for k in range(count)]
    if path.suffix in (".mjpeg", ".jpg"):
        encoded = [cv2.imencode(".jpg", np.asarray(image))[1].tobytes() for image in images]
        path.write_bytes(b"".join(encoded))
    elif path.suffix == ".tif":
        images[0].save(path, save_all=True, append_images=images[1:])
    else:
        images[0].save(path, save_all=True, append_images=images[1:], duration=duration, lossless=True)
    return path


@pytest.mark.parametrize(
    ("name", "apart", "told"),
    [
        ("a.gif", 0.1, ()),
        ("a.png", 0.1, ()),
        ("a.webp", 0.1, ()),
        ("a.tif", 1.0, ("a.tif: tells no times of its images; taken as 1 s apart",)),
        ("a.mjpeg", 0.04, ("a.mjpeg: tells no times of its images; taken as 25 a second",)),
        ("a.jpg", 0.04, ("a.jpg: tells no times of its images; taken as 25 a second",)),
    ],
)
def test_every_image_of_a_file_is_given(name, apart, told, tmp_path):
    lines = []
    found = list(frames(str(motion(tmp_path / name, 40)), lines.append))
    assert [frame.name for frame in found] == [str(k) for k in range(40)]
    np.testing.assert_allclose([frame.stamp for frame in found], apart * np.arange(40))
    assert np.abs([int(frame.image[20, 20, 0]) - 3 * k for k, frame in enumerate(found)]).max() <= 2
    assert tuple(lines) == told
    # In a folder it is one of several images.
    lines.clear()
    assert len(list(frames(str(tmp_path), lines.append))) == 1
    assert f"{name}: only the first of its images is used; name the file itself for all" in lines


def test_the_gif_found(shared_data):
    found = list(frames(str(shared_data("reports") / "video" / "a.gif")))
    assert len(found) == 60
    assert (np.diff([frame.stamp for frame in found]) > 0.0).all()


@pytest.mark.parametrize("name", ["a.gif", "a.png", "a.tif", "a.mjpeg"])
def test_a_long_file_takes_no_more_memory_than_a_short_one(name, tmp_path):
    def peak(count):
        source = str(motion(tmp_path / name, count, (240, 320)))
        tracemalloc.start()
        assert sum(1 for _ in frames(source)) == count
        taken = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return taken

    peak(10)  # what is imported and kept
    # 30 images have 7 MB.
    assert peak(80) < peak(50) + 2**20


def test_broken_images_of_a_file_are_told(tmp_path):
    data = motion(tmp_path / "a.mjpeg", 5).read_bytes()
    size = len(data) // 5
    (tmp_path / "a.mjpeg").write_bytes(data[: size + 4] + b"\xff\xd9" + data[2 * size :])
    lines = []
    assert len(list(frames(str(tmp_path / "a.mjpeg"), lines.append))) == 4
    assert lines[0] == "a.mjpeg: image 2 is broken, left out"
    data = motion(tmp_path / "a.tif", 5).read_bytes()
    (tmp_path / "a.tif").write_bytes(data[:-3000])
    lines.clear()
    assert len(list(frames(str(tmp_path / "a.tif"), lines.append))) == 4
    assert lines[-1].startswith("a.tif: image 4 of 5 cannot be read")


@pytest.mark.parametrize(
    ("names", "stamps", "told"),
    [
        (["1000000000000000000", "1000000000500000000"], [1e9, 1e9 + 0.5], "numbers of names read as ns"),
        (["left_1690000000123", "left_1690000001123"], [1690000000.123, 1690000001.123], "names read as ms"),
        (["1690000000.25", "1690000000.5"], [1690000000.25, 1690000000.5], None),
        (["0.5", "0.25"], [0.25, 0.5], None),
        ([str(33 * k) for k in range(20)], 0.033 * np.arange(20), "numbers of names read as ms"),
        (["p10", "p9"], [0.0, 1.0], "names tell no time; images taken as 1 s apart"),
    ],
)
def test_stamps_of_names(names, stamps, told, tmp_path):
    for name in names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture(10))
    lines = []
    found = [frame.stamp for frame in frames(str(tmp_path), lines.append)]
    np.testing.assert_allclose(found, stamps, rtol=0.0, atol=1e-6)
    assert len(lines) == (told is not None)
    assert all(line.endswith(told) for line in lines)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_images_of_two_bytes_a_value_keep_their_contrast(bits, suffix, tmp_path):
    ramp = np.tile(np.linspace(0, 2**bits - 1, 64).astype(np.uint16), (48, 1))
    cv2.imwrite(str(tmp_path / f"deep.{suffix}"), ramp)
    (frame,) = frames(str(tmp_path / f"deep.{suffix}"))
    assert (frame.image.dtype, frame.image.shape) == (np.uint8, (48, 64, 3))
    np.testing.assert_allclose(frame.image[20, :, 1], np.linspace(0, 255, 64), atol=1.5)


def test_a_stack_of_two_bytes_a_value(tmp_path):
    stack = [PIL.Image.fromarray(np.full((48, 64), level, np.uint16)) for level in (100, 1023)]
    stack[0].save(tmp_path / "a.tif", save_all=True, append_images=stack[1:])
    assert [frame.image[0, 0].tolist() for frame in frames(str(tmp_path / "a.tif"))] == [[100] * 3, [255] * 3]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.gif", "a.png", "a.webp", "a.tif", "a.mjpeg"])
def test_mutated_files_of_images_are_refused_or_read(name, tmp_path):
    file = motion(tmp_path / name, 4)

    def load():
        lines = []
        found = list(frames(str(file), lines.append))
        if len(found) < 4:
            raise FrameError("fewer")

    assert_refused_or_read(file, load, FrameError, count=1000)


@pytest.mark.slow
@pytest.mark.parametrize("good", ["frame_0012", "1690000000.123456789", "1000000000500000000", "left-1690000000123_7"])
def test_images_of_any_name_are_read(good, tmp_path):
    """Three images whose names are mutated: all are given, in an order, by finite stamps."""
    encoded = cv2.imencode(".png", picture(10))[1].tobytes()
    for names in zip(*3 * [mutations(good.encode(), 999, 0)], strict=True):
        folder = tmp_path / "images"
        folder.mkdir()
        for name in names:
            shown = re.sub("[/\0]", "", name.decode(errors="replace"))[:60]
            (folder / f"{shown}.png").write_bytes(encoded)
        count = len(list(folder.iterdir()))
        found = list(frames(str(folder)))
        assert len(found) == count, names
        assert np.isfinite([frame.stamp for frame in found]).all(), names
        shutil.rmtree(folder)

"""Images from a folder, a file, a video, a stream or a camera."""

from __future__ import annotations

import dataclasses
import math
import re
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.vision.image import Image

# After what silence a stream is given up, s.
SILENT = 3


class FrameError(BadInput, ValueError):
    """A source without images; the message is one line."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """One image. stamp: s, see `frames`. name: of its file, else its number. image: (h, w, 3) RGB."""

    stamp: float
    name: str
    image: Image


def frames(source: str) -> Iterator[Frame]:
    """The images of a source, in order: a folder's or one file's, a video's, a stream's or a camera's, as OpenCV opens
    them; "0" is the first camera.

    Stamps: of a file whose name is a number, that; of others their count; in a video the time since its beginning; of a
    stream or a camera this machine's clock. What is no image in a folder is skipped. Raises FrameError where there is
    nothing, when the first frame is asked for.
    """
    path = Path(source)
    if path.is_dir():
        yield from _folder(path)
        return
    image = _read(path) if path.is_file() else None
    if image is not None:
        yield Frame(_stamp(path, 0), path.name, image)
        return
    if not (path.exists() or source.isdigit() or "://" in source):
        raise FrameError(f"{source}: no such file; name a folder, an image, a video, a stream's address or a camera")
    yield from _video(source, path.is_file())


def open_capture(source: str, size: tuple[int, int] | None = None) -> cv2.VideoCapture:
    """The video, stream or camera as OpenCV opens it, open or not; "0" is the first camera.

    size: (width, height) that a camera is to give, pixels. A stream that falls silent is given up after SILENT s.
    """
    if source.isdigit() or source.startswith("/dev/"):
        capture = cv2.VideoCapture(int(source) if source.isdigit() else source, cv2.CAP_V4L2)
        # Or what is seen is old where looking takes longer than a frame.
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size is not None:
            # Uncompressed, large images come slowly over USB 2.
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        return capture
    if "://" in source:
        within = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 1000 * SILENT, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 1000 * SILENT]
        # One thread: several would hold images back.
        return cv2.VideoCapture(source, cv2.CAP_FFMPEG, [*within, cv2.CAP_PROP_N_THREADS, 1])
    return cv2.VideoCapture(source)


def is_live(source: str) -> bool:
    """Whether frames come when they are taken, not when they are asked for."""
    return not (Path(source).is_dir() or Path(source).is_file())


def _folder(path: Path) -> Iterator[Frame]:
    count = 0
    for file in sorted(path.iterdir(), key=_in_order):
        image = _read(file) if file.is_file() else None
        if image is not None:
            yield Frame(_stamp(file, count), file.name, image)
            count += 1
    if not count:
        raise FrameError(f"{path}: no image in it; name a folder with images that OpenCV reads, as PNG or JPEG")


def _in_order(file: Path) -> list[tuple[int, float, str]]:
    """Numbers in names count as such: image 10 comes after image 9."""
    words = re.split(r"(\d+)", file.name)
    return [(1, float(word[:300]), "") if word.isdigit() else (0, 0.0, word) for word in words]


def _read(file: Path) -> Image | None:
    try:
        data = np.fromfile(file, dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    except (OSError, cv2.error):
        return None
    return None if image is None else rgb(image)


def rgb(image: Image) -> Image:
    """OpenCV's image (h, w, 3) with red first."""
    return np.ascontiguousarray(image[..., ::-1])


def _stamp(file: Path, count: int) -> float:
    try:
        stamp = float(file.stem)
    except ValueError:
        return float(count)
    return stamp if math.isfinite(stamp) else float(count)


def _video(source: str, is_file: bool) -> Iterator[Frame]:
    capture = open_capture(source)
    try:
        count = 0
        while True:
            found, image = capture.read()
            if not found:
                break
            stamp = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC) if is_file else time.time()
            yield Frame(stamp, str(count), rgb(image))
            count += 1
    finally:
        capture.release()
    if not count:
        what = "is no image or video that OpenCV reads" if is_file else "gives no image; is it there, and free?"
        raise FrameError(f"{source}: {what}")

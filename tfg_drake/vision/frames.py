"""Images from a folder, a file, a video, a stream or a camera."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import PIL.Image

from tfg_drake.bad_input import BadInput
from tfg_drake.io.clock_unit import UNITS, clock_unit
from tfg_drake.io.files import read_bytes
from tfg_drake.messages import FloatArray
from tfg_drake.vision.image import NO_IMAGE, Image, eight_bits

# Silence after which a stream has ended, s.
SILENT = 3
# Formats in which Pillow finds several images in one file.
_SEVERAL = ("GIF", "PNG", "TIFF", "WEBP")
# Splitting a stream of JPEGs: greatest size of one, bytes, size of a block, and the mark near the beginning of a
# photograph that contains others for its own use.
_JPEG, _NEXT_JPEG = b"\xff\xd8\xff", re.compile(rb"(?<=\xff\xd9)(?=\xff\xd8\xff)")
_LONGEST_JPEG, _BLOCK, _OWN_USE = 2**27, 2**20, b"MPF\0"
# Default time between two images, s: of a folder or a file of several, and of motion JPEG.
APART, MOTION_APART = 1.0, 0.04
# A stamp in a file name, since 1970: s, ms, us or ns.
_CLOCK = re.compile(r"(?<!\d)[123]\d{9}(\d{3}){0,3}(\.\d+)?(?!\d)")

Tell = Callable[[str], object]


class FrameError(BadInput, ValueError):
    """A source without images; the message is one line."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """One image. stamp: s, see `frames`. name: of its file, else its number. image: (h, w, 3) RGB."""

    stamp: float
    name: str
    image: Image


def frames(source: str, tell: Tell = lambda _line: None) -> Iterator[Frame]:
    """The images of a source, one at a time and in order: a folder's or one file's, a video's, a stream's or a
    camera's, as OpenCV opens them; "0" is the first camera. Of a GIF, APNG, WebP, TIFF or JPEG file all are given.

    Stamps: of a file whose name is a number, or holds a clock's, that, by whatever unit; of others their count; in a
    video the time since its beginning; of a stream or a camera this machine's clock. What is no image in a folder is
    skipped. tell: called with a line for each thing that was assumed or left out. Raises FrameError where there is
    nothing, when the first frame is asked for.
    """
    path = Path(source)
    if path.is_dir():
        yield from _folder(path, tell)
        return
    if not (path.exists() or source.isdigit() or "://" in source):
        raise FrameError(f"{source}: no such file; name a folder, an image, a video, a stream's address or a camera")
    if path.is_file() and cv2.haveImageReader(source):
        yield from _file(path, tell)
    else:
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


def _folder(path: Path, tell: Tell) -> Iterator[Frame]:
    files = [file for file in path.iterdir() if file.is_file() and cv2.haveImageReader(str(file))]
    files.sort(key=_in_order)
    stamps = _stamps(files, tell)
    # Decimals have no order as names.
    order = range(len(files)) if np.isnan(stamps).any() else np.argsort(stamps, kind="stable")
    count = 0
    for i in order:
        begun = list(itertools.islice(_within(files[i], tell), 2))
        if not begun:
            continue
        if len(begun) > 1:
            tell(f"{files[i].name}: only the first of its images is used; name the file itself for all")
        yield Frame(float(count) if math.isnan(stamps[i]) else float(stamps[i]), files[i].name, begun[0][0])
        count += 1
    if not count:
        raise FrameError(f"{path}: no image in it; name a folder with images that OpenCV reads, as PNG or JPEG")
    if count > 1 and np.isnan(stamps).all():
        tell(f"{path}: names tell no time; images taken as {APART:g} s apart")


def _in_order(file: Path) -> list[tuple[int, float, str]]:
    """Numbers in names count as such: image 10 comes after image 9."""
    words = re.split(r"(\d+)", file.name)
    return [(1, float(word[:300]), "") if word.isdigit() else (0, 0.0, word) for word in words]


def _file(path: Path, tell: Tell) -> Iterator[Frame]:
    images = _within(path, tell)
    begun = list(itertools.islice(images, 2))
    if not begun:
        raise FrameError(f"{path}: is no image or video that OpenCV reads")
    if len(begun) == 1:
        (stamp,) = _stamps([path], tell)
        yield Frame(0.0 if math.isnan(stamp) else float(stamp), path.name, begun[0][0])
        return
    stamp = 0.0
    for count, (image, shown) in enumerate(itertools.chain(begun, images)):
        yield Frame(stamp, str(count), image)
        stamp += shown


def _within(path: Path, tell: Tell) -> Iterator[tuple[Image, float]]:
    """The images in an image's file, and how long each is shown, s."""
    if read_bytes(path, len(_JPEG)) == _JPEG:
        yield from _motion_jpeg(path, tell)
        return
    count, several = 0, 1
    try:
        with PIL.Image.open(path, formats=_SEVERAL) as image:
            several = getattr(image, "n_frames", 1)
            while count < several > 1:
                image.seek(count)
                is_deep = image.mode.startswith("I;16")
                pixels = eight_bits(np.asarray(image if is_deep else image.convert("RGB")))
                shown = 1e-3 * float(image.info.get("duration", 0.0)) or APART
                yield np.stack([pixels] * 3, axis=-1) if is_deep else pixels, shown
                count += 1
            if count and "duration" not in image.info:
                tell(f"{path.name}: tells no times of its images; taken as {APART:g} s apart")
    except (*NO_IMAGE, PIL.Image.DecompressionBombError) as error:
        if count:
            tell(f"{path.name}: image {count} of {several} cannot be read, nor those after it: {error}")
    if not count and (one := _decoded(np.fromfile(path, dtype=np.uint8))) is not None:
        yield one, APART


def _motion_jpeg(path: Path, tell: Tell) -> Iterator[tuple[Image, float]]:
    count = 0
    for count, data in enumerate(_jpegs(path), start=1):
        if (image := _decoded(np.frombuffer(data, dtype=np.uint8))) is not None:
            yield image, MOTION_APART
        elif count > 1:
            tell(f"{path.name}: image {count} is broken, left out")
    if count > 1:
        tell(f"{path.name}: tells no times of its images; taken as {1.0 / MOTION_APART:g} a second")


def _jpegs(path: Path) -> Iterator[bytes]:
    """The JPEGs that follow one another in a file; of a photograph the first."""
    kept = b""
    with path.open("rb") as file:
        while (block := file.read(_BLOCK)) and len(kept) < _LONGEST_JPEG:
            if not kept and _OWN_USE in block:
                yield block + file.read(_LONGEST_JPEG)
                return
            *whole, kept = _NEXT_JPEG.split(kept + block)
            yield from whole
    yield kept


def _stamps(files: list[Path], tell: Tell) -> FloatArray:
    """(n,) s, of the names of files, nan where a name tells none."""
    stamps = np.array([_number(file.stem) for file in files])
    unit = clock_unit(stamps[np.isfinite(stamps)])
    if unit != "s":
        tell(f"{files[0].parent}: numbers of names read as {unit}")
    return stamps * UNITS[unit]


def _number(stem: str) -> float:
    clock = _CLOCK.search(stem)
    try:
        stamp = float(clock[0] if clock else stem)
    except ValueError:
        return math.nan
    return stamp if math.isfinite(stamp) else math.nan


def _decoded(data: Image) -> Image | None:
    try:
        image = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH) if len(data) else None
        if image is not None and image.dtype not in (np.uint8, np.uint16):
            image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if image is None else rgb(eight_bits(image))


def rgb(image: Image) -> Image:
    """OpenCV's image (h, w, 3) with red first."""
    return np.ascontiguousarray(image[..., ::-1])


def _video(source: str, is_file: bool) -> Iterator[Frame]:
    capture = open_capture(source)
    try:
        for count in itertools.count():
            found, image = capture.read()
            if not found:
                break
            stamp = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC) if is_file else time.time()
            yield Frame(stamp, str(count), rgb(image))
    finally:
        capture.release()
    if not count:
        what = "is no image or video that OpenCV reads" if is_file else "gives no image; is it there, and free?"
        raise FrameError(f"{source}: {what}")

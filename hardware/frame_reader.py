"""Images of a camera as they come, in a thread: OpenCV waits for each, and for one that is gone for seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import cv2

from tfg_drake.hardware.sensor_reader import stamped
from tfg_drake.vision.camera_sheet import RATE
from tfg_drake.vision.frames import SILENT, Frame, FrameError, frames, is_live, open_capture, rgb


class FrameReader:
    """Reads a source until there are no more images. Frames are stamped with the host's monotonic clock, s.

    error: why there are no images any more, empty while there are.
    """

    def __init__(self, source: str, size: tuple[int, int], latency: float) -> None:
        """source: as tfg_drake.vision.frames.frames has it. size: (width, height) that a camera is to give. latency: of
        images whose camera does not stamp them, s."""
        self.error = ""
        self._source, self._size, self._latency = source, size, latency
        self._newest: Frame | None = None
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
        self._thread.start()

    def take(self, within: float) -> Frame | None:
        """The newest frame that was not taken yet, waited for up to `within` s, or until there are no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self.error, within)
            frame, self._newest = self._newest, None
        return frame

    def close(self) -> None:
        """Lets go of the camera."""
        self._closed.set()
        # A process must not end while OpenCV waits for an image.
        self._thread.join(SILENT + 1.0)

    def _run(self) -> None:
        error = "no image in it"
        try:
            for frame in self._live() if is_live(self._source) else self._recorded():
                self._put(frame, "")
                if self._closed.is_set():
                    return
        except (FrameError, cv2.error, OSError) as raised:
            error = " ".join(str(raised).split()).removeprefix(f"{self._source}: ")
        self._put(None, error)

    def _put(self, frame: Frame | None, error: str) -> None:
        with self._changed:
            self._newest, self.error = frame or self._newest, error
            self._changed.notify()

    def _live(self) -> Iterator[Frame]:
        """Until there are no more."""
        capture = open_capture(self._source, self._size)
        try:
            if not capture.isOpened():
                raise FrameError("cannot be opened; is it there, and free?")
            count = 0
            while capture.grab():
                arrival = time.monotonic()
                # Video4Linux stamps by the monotonic clock; other sources count from their beginning.
                own = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC)
                found, image = capture.retrieve()
                if found:
                    yield Frame(stamped(own, arrival, arrival - self._latency), str(count), rgb(image))
                    count += 1
        finally:
            capture.release()

    def _recorded(self) -> Iterator[Frame]:
        """As if they came now, at the pace they were taken."""
        begin, first = time.monotonic(), None
        for count, frame in enumerate(frames(self._source)):
            # Images of a folder are stamped by their names, or not at all.
            at = count / RATE if frame.name != str(count) else frame.stamp
            first = at if first is None else first
            self._closed.wait(max(0.0, begin + at - first - time.monotonic()))
            yield Frame(time.monotonic(), frame.name, frame.image)

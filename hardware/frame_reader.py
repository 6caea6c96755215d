"""Images of a camera as they come, in a thread: OpenCV waits for each, and for one that is gone for seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import cv2

from tfg_drake.vision.frames import SILENT, Frame, FrameError, frames, is_live, open_capture, rgb

# Between two attempts to open the camera again, s: the first and the last.
BACK_OFF, LONGEST_BACK_OFF = 0.5, 2.0
# Images that a folder gives a second.
FOLDER_RATE = 10.0
# A camera's own stamp is believed where it is that much older than the image's arrival, s.
_OLDEST = 1.0


class FrameReader:
    """Opens a source, and again where it is lost. Frames are stamped with the host's monotonic clock, s.

    error: why there are no images, empty where there are.
    """

    def __init__(self, source: str, size: tuple[int, int], latency: float, tell: Callable[[str], None]) -> None:
        """source: as tfg_drake.vision.frames.frames has it. size: (width, height) that a camera is to give. latency: of
        images whose camera does not stamp them, s. tell: what the operator is to know, from the thread."""
        self.error = ""
        self._source, self._size, self._latency, self._tell = source, size, latency, tell
        self._newest: Frame | None = None
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
        self._thread.start()

    def first(self, within: float) -> Frame | None:
        """The first frame, waited for up to `within` s, or until there is an error."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self.error, within)
        return self._newest

    def take(self, within: float) -> Frame | None:
        """The newest frame that was not taken yet, waited for up to `within` s."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None, within)
            frame, self._newest = self._newest, None
        return frame

    def close(self) -> None:
        """Lets go of the camera."""
        self._closed.set()
        # A process must not end while OpenCV waits for an image.
        self._thread.join(SILENT + 1.0)

    def _run(self) -> None:
        back_off, seen, told = BACK_OFF, False, False
        lost = "no more images: is it plugged in? It is looked for"
        if not is_live(self._source):
            lost = "no more images; they begin again"
        while not self._closed.is_set():
            try:
                for frame in self._live() if is_live(self._source) else self._recorded():
                    if told:
                        self._tell("images come again")
                    back_off, seen, told = BACK_OFF, True, False
                    self._put(frame, "")
                    if self._closed.is_set():
                        return
                error = "no image in it"
            except (FrameError, cv2.error, OSError) as raised:
                error = " ".join(str(raised).split())
            self._put(None, error)
            if seen and not told:
                self._tell(lost)
                told = True
            self._closed.wait(back_off)
            back_off = min(2.0 * back_off, LONGEST_BACK_OFF)

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
                # Video4Linux stamps by this clock; others count from the beginning.
                stamp = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC)
                if not arrival - _OLDEST < stamp <= arrival:
                    stamp = arrival - self._latency
                found, image = capture.retrieve()
                if found:
                    yield Frame(stamp, str(count), rgb(image))
                    count += 1
        finally:
            capture.release()

    def _recorded(self) -> Iterator[Frame]:
        """As if they came now, at the pace they were taken."""
        begin, first = time.monotonic(), None
        for count, frame in enumerate(frames(self._source)):
            # A folder's images are stamped by their names, or not at all.
            at = count / FOLDER_RATE if frame.name != str(count) else frame.stamp
            first = at if first is None else first
            self._closed.wait(max(0.0, begin + at - first - time.monotonic()))
            yield Frame(time.monotonic(), frame.name, frame.image)

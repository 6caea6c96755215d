"""A camera in the network that is not there: images served over HTTP as motion JPEG."""

from __future__ import annotations

import contextlib
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2

from tfg_drake.vision.image import Image

_BOUNDARY = b"image"


class MjpegStream:
    """Serves what it is shown, on this machine only, from start() until stop(); again at the same address.

    url: of the stream. watched: how many look at it.
    """

    def __init__(self) -> None:
        self._server: ThreadingHTTPServer | None = None
        self._changed = threading.Condition()
        self._jpeg, self._number = b"", 0
        self.watched = 0
        self._port = 0
        self.start()
        self.url = f"http://127.0.0.1:{self._port}/"

    def show(self, image: Image) -> None:
        """The next image, (h, w) grey or (h, w, 3) RGB."""
        blue_first = image[..., ::-1] if image.ndim == 3 else image
        _, jpeg = cv2.imencode(".jpg", blue_first)
        with self._changed:
            self._jpeg, self._number = jpeg.tobytes(), self._number + 1
            self._changed.notify_all()

    def start(self) -> None:
        """Begins to serve, where it does not."""
        if self._server is None:
            stream = self

            class Handler(BaseHTTPRequestHandler):
                def do_GET(self) -> None:
                    stream._serve(self)

                def log_message(self, *arguments: object) -> None:
                    """Nothing is logged."""

            self._server = ThreadingHTTPServer(("127.0.0.1", self._port), Handler)
            self._server.daemon_threads = True
            self._port = self._server.server_address[1]
            threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def stop(self) -> None:
        """Lets go of all who look, and listens no more."""
        if self._server is not None:
            server, self._server = self._server, None
            with self._changed:
                self._changed.notify_all()
            server.shutdown()
            server.server_close()

    def _serve(self, request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY.decode()}")
        request.end_headers()
        begun, sent = self._server, 0
        with self._changed:
            self.watched += 1
        with contextlib.suppress(OSError):
            while True:
                with self._changed:
                    while self._number == sent and self._server is begun:
                        self._changed.wait()
                    if self._server is not begun:
                        break
                    jpeg, sent = self._jpeg, self._number
                head = b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % (_BOUNDARY, len(jpeg))
                request.wfile.write(head + jpeg + b"\r\n")
        with self._changed:
            self.watched -= 1

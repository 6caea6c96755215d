"""A camera in the network on an emulated robot: what it would see, rendered in a process of its own.

The process is started with a pipe, as `python -m tfg_drake.diagrams.emulated_camera CONNECTION`. It is told the world
and then poses and when they were; it says the addresses of its streams. It ends when the other end is gone.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from tfg_drake.hardware import process
from tfg_drake.messages import FloatArray
from tfg_drake.vision.mount import CameraMount
from tfg_drake.world.world import World, WorldError

# Image rate, 1/s; size, pixels; horizontal field of view, rad.
RATE, SIZE, FIELD_OF_VIEW = 5.0, (640, 480), math.radians(65.0)
MOUNT = CameraMount(x=0.05, z=0.35)
# Latency: age of an image when it is sent, s, as over a network, independent of the rendering time.
LATENCY = 0.15
# Least time for which the board keeps a pose, s.
_BOARD_EVERY = 0.6


class EmulatedCamera:
    """The camera, from its making until close().

    url: of the stream of what it sees. board: of one in which it is shown a chessboard, to calibrate it.
    """

    def __init__(self, world: World, pose: Callable[[], FloatArray]) -> None:
        """pose: the robot's true X_WB (3,) now. Raises WorldError where the world cannot be drawn."""
        self._pose = pose
        self._connection, theirs = Pipe()
        with theirs:
            self._process = process.start("tfg_drake.diagrams.emulated_camera", theirs.fileno())
        self._connection.send(world)
        told = self._connection.recv()
        if isinstance(told, WorldError):
            self._process.wait()
            raise told
        self.url, self.board = told
        self._stop = threading.Event()
        # Held while something is sent.
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def switch(self, on: bool) -> None:
        """Begins or ends to serve the stream of what it sees."""
        with self._lock:
            self._connection.send(on)

    def close(self) -> None:
        """Ends the process."""
        self._stop.set()
        self._thread.join()
        self._connection.close()
        self._process.wait()

    def _run(self) -> None:
        begin, sent = time.monotonic(), 0
        while not self._stop.wait(max(0.0, begin + sent / RATE - time.monotonic())):
            sent += 1
            with self._lock:
                try:
                    self._connection.send((time.monotonic(), self._pose()))
                except OSError:
                    return  # the process has ended


def serve(connection: Connection) -> None:
    """Renders and serves until the other end is gone."""
    from tfg_drake.hardware.emulation.chessboard import board_view
    from tfg_drake.hardware.emulation.mjpeg_stream import MjpegStream
    from tfg_drake.systems.rendered_world import MakeCameraInfo, WorldView

    stream, board = MjpegStream(), MjpegStream()
    try:
        view = WorldView(connection.recv(), MOUNT, MakeCameraInfo(*SIZE, FIELD_OF_VIEW))
    except WorldError as error:
        connection.send(error)
        return
    connection.send((stream.url, board.url))
    held, number = -math.inf, 0
    while True:
        told = [connection.recv()]
        while connection.poll():
            told.append(connection.recv())
        for switch in (one for one in told if isinstance(one, bool)):
            stream.start() if switch else stream.stop()
        poses = [one for one in told if not isinstance(one, bool)]
        if stream.watched and poses:
            taken, X_WB = poses[-1]
            image = view.image(X_WB)
            time.sleep(max(0.0, taken + LATENCY - time.monotonic()))
            stream.show(image)
        if board.watched and time.monotonic() - held > _BOARD_EVERY:
            board.show(board_view(view.calibration, number))
            held, number = time.monotonic(), number + 1


def main() -> None:
    """The process."""
    with contextlib.suppress(EOFError, OSError):  # the other end is gone
        serve(Connection(int(sys.argv[1])))


if __name__ == "__main__":
    main()

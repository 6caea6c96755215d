"""A mission on an emulated Kobuki whose page is flooded with half requests: STOP, a sensor's process, the files.

    python benchmarks/page_flood.py --descriptors 1024 4096 --connections 2000 --seconds 60

Each connection says half a request and keeps silent; one that is hung up on is opened again at once. Meanwhile the
robot is stopped from the page whenever it drives, enabled again from the terminal, and the process that reads its
sensors is killed. Prints, for each limit of the mission's descriptors (RLIMIT_NOFILE): how many connections were
opened; how often the robot was stopped, how long a STOP took until it was answered and until the wheels were told to
stand (s, median and worst), and the process of the sensors until it was back (s, worst); the stages that were added;
how much of the timeline a page got that was there before, and how often it had to connect; the descriptors and threads
that the mission had at most; and which files of the run were written in the second half.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import selectors
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from picture_faults import asking
from robot_faults import PATIENCE, Explorer, ShownKobuki, drives, moving, travelling

HALF = b"POST /request HTTP/1.1\r\nHost: localhost\r\nContent-Length: 19\r\n\r\n{"
# A process that is started again must be back within so long, and is killed so often, s.
BACK, KILLED_EVERY = 3.0, 15.0
# Files of a run that grow or are written again while it goes on.
FILES = ("stages.jsonl", "map.npz", "timeline.tfg")


def flood(port: int, count: int, seconds: float) -> None:
    """Holds so many connections open with half a request on each; prints how many it opened."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (count + 100, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    selector, opened, end = selectors.DefaultSelector(), 0, time.monotonic() + seconds

    def connect() -> None:
        connection = socket.socket()
        connection.setblocking(False)
        connection.connect_ex(("127.0.0.1", port))
        selector.register(connection, selectors.EVENT_WRITE)

    for _ in range(count):
        connect()
    while time.monotonic() < end:
        for key, events in selector.select(0.1):
            connection = key.fileobj
            assert isinstance(connection, socket.socket)
            try:
                if events & selectors.EVENT_WRITE:
                    connection.send(HALF)
                    opened += 1
                    selector.modify(connection, selectors.EVENT_READ)
                    continue
                if connection.recv(100):
                    continue
            except OSError:
                pass
            selector.unregister(connection)
            connection.close()
            connect()
    print(opened)


class Reader:
    """A page that reads the timeline. read: bytes so far; connections: how often it has begun."""

    def __init__(self, port: int) -> None:
        self.read = self.connections = 0
        self._port = port
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        with contextlib.suppress(ConnectionRefusedError):  # the mission has ended
            while True:
                self.connections += 1
                with socket.create_connection(("127.0.0.1", self._port)) as connection:
                    head = f"GET /timeline?from={self.read} HTTP/1.0\r\nHost: localhost\r\n\r\n"
                    connection.sendall(head.encode())
                    while data := connection.recv(65536):
                        self.read += len(data)
                time.sleep(1.0)


def stop(robot: ShownKobuki, port: int) -> tuple[float, float]:
    """A STOP from the page while the robot drives: until it is answered, until the wheels are told to stand, s."""
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=30.0) as connection:
        connection.sendall(asking("stop", port, "Host: localhost\r\n", ""))
        assert connection.recv(1000).startswith(b"HTTP/1.0 200")
    answered = time.monotonic() - began
    while not (after := [one for one in robot.commands() if one[0] > began and not moving(one)]):
        assert time.monotonic() < began + 30.0, "the wheels were never told to stand"
        time.sleep(0.01)
    return answered, after[0][0] - began


def sensors_away(explorer: Explorer) -> float:
    """How long it takes until the process of the sensors is told to be back after it was killed, s."""
    began = time.monotonic()
    explorer.signal(signal.SIGKILL, "sensors")
    while not any(when > began and "is back" in line for when, line in list(explorer.lines)):
        assert time.monotonic() < began + 60.0, "the process is not back"
        time.sleep(0.02)
    return next(when for when, line in explorer.lines if when > began and "is back" in line) - began


def mission(limit: int, count: int, seconds: float, folder: Path) -> str:
    """The row of a mission with so many descriptors."""
    robot = ShownKobuki()
    explorer = Explorer(robot.arguments, folder / str(limit), shown=True)
    resource.prlimit(explorer.process.pid, resource.RLIMIT_NOFILE, (limit, limit))
    flooding = None
    try:
        reader, pid, end = Reader(explorer.port), explorer.process.pid, time.monotonic() + seconds
        explorer.press("e")
        assert drives(robot, travelling, time.monotonic(), PATIENCE, lambda: not explorer.ended())
        began, before = time.time(), reader.read
        again = [sys.executable, __file__, "--flood", str(explorer.port), "--connections", str(count)]
        flooding = subprocess.Popen([*again, "--seconds", str(seconds)], stdout=subprocess.PIPE, text=True)
        end, killed_at = time.monotonic() + seconds, time.monotonic()
        stops, away, descriptors, threads = list[tuple[float, float]](), list[float](), 0, 0
        stages = _stages(explorer.folder)
        while time.monotonic() < end:
            stops.append(stop(robot, explorer.port))
            if time.monotonic() > killed_at:
                away.append(sensors_away(explorer))
                killed_at = time.monotonic() + KILLED_EVERY
            descriptors = max(descriptors, len(os.listdir(f"/proc/{pid}/fd")))
            threads = max(threads, len(os.listdir(f"/proc/{pid}/task")))
            explorer.press("e")
            drives(robot, moving, time.monotonic(), 10.0, lambda: not explorer.ended())
        opened, _ = flooding.communicate()
        written = [name for name in FILES if (explorer.folder / name).stat().st_mtime > began + 0.5 * seconds]
        answered, stood = zip(*stops, strict=True)
        return (
            f"{limit:>6}{int(opened):>9}{len(stops):>7}{statistics.median(answered):>9.3f}{max(answered):>9.3f}"
            f"{statistics.median(stood):>9.3f}{max(stood):>9.3f}{max(away):>9.2f}{_stages(explorer.folder) - stages:>8}"
            f"{(reader.read - before) / 1000.0:>9.0f}{reader.connections:>6}{descriptors:>8}{threads:>8}  "
            + ", ".join(written)
            + (explorer.ended() and f"  ENDED: {explorer.ended()}")
        )
    finally:
        if flooding is not None:
            flooding.kill()
        explorer.close()
        robot.close()


def _stages(folder: Path) -> int:
    return len((folder / "stages.jsonl").read_text().splitlines())


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--descriptors", type=int, nargs="+", default=[1024, 4096])
    parser.add_argument("--connections", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--flood", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.flood is not None:
        flood(options.flood, options.connections, options.seconds)
        return
    print(
        f"{'limit':>6}{'opened':>9}{'STOPs':>7}{'answered':>9}{'worst':>9}{'stands':>9}{'worst':>9}{'away':>9}"
        f"{'stages':>8}{'kB':>9}{'times':>6}{'descr.':>8}{'threads':>8}  written in the second half"
    )
    with tempfile.TemporaryDirectory() as folder:
        for limit in options.descriptors:
            print(mission(limit, options.connections, options.seconds, Path(folder)), flush=True)


if __name__ == "__main__":
    main()

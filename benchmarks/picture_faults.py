"""A mission whose page gets what any other page or program on the computer may send to it.

    python benchmarks/picture_faults.py --messages 1000

Explores `house` in simulation, and on an emulated Kobuki in real time. To the port of the page go, from a foreign
origin and without the run's token: attempts to enable the wheels before they are enabled, after a STOP and in a pause,
each of which must move nothing; a STOP, which must stop them; requests that are none, headers without end, random
bytes, timelines that nobody reads, while the robot drives. Prints how often the wheels moved when they must not, and
how the missions ended.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.emulation.emulator import Emulator

CLI = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore"]
# What a page might ask for to start the wheels.
STARTING = ("enable", "resume", "step", "rate", "recall", "Start")
FOREIGN = "Host: localhost:{port}\r\nOrigin: http://pages.example\r\n"
# Within so long a command of the wheels is over, and a request has come through, s.
SETTLED = 2.0


def asking(what: str, port: int, headers: str = FOREIGN, token: str = "guess") -> bytes:
    """A request as another page or program sends it."""
    body = json.dumps({"request": what})
    head = (
        f"POST /request HTTP/1.1\r\n{headers.format(port=port)}X-Token: {token}\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return (head + body).encode()


def nonsense(rng: random.Random, port: int) -> tuple[bytes, ...]:
    """What somebody sends instead of a request."""
    some = rng.randbytes(rng.randrange(1, 120))
    return rng.choice(
        (
            (some,),
            (b"GET " + some + b" HTTP/1.1\r\n\r\n",),
            (b"POST /request HTTP/1.1\r\nContent-Length: 100\r\n\r\n", some),
            (b"POST /request HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n", some),
            (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * rng.choice((10, 1000)),),
            (
                b"GET /timeline?from="
                + rng.choice((b"0", b"-1", b"1e9", some))
                + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
            ),
            (asking(rng.choice(STARTING), port),),
            (asking(rng.choice(STARTING), port, "Host: rebound.example\r\n"),),
            (asking(rng.choice(STARTING), port, "Host: localhost\r\n", "x" * rng.randrange(2000)),),
        )
    )


def send(port: int, *data: bytes) -> bool:
    """Connect, send, and leave when there is an answer or after a moment; False where nobody listens."""
    try:
        with socket.create_connection(("localhost", port), timeout=1.0) as connection:
            connection.settimeout(0.1)
            with contextlib.suppress(OSError):
                for part in data:
                    connection.sendall(part)
                    connection.recv(65536)
            return True
    except OSError:
        return False


class Mission:
    """`tfg-drake explore` with a picture; lines: what it has said so far."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [*CLI, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.lines: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def wait_for(self, words: str) -> str:
        """The first line with these words."""
        while True:
            for line in list(self.lines):
                if words in line:
                    return line
            if self.process.poll() is not None:
                raise SystemExit("\n".join(["the mission ended before it said " + words, *self.lines]))
            time.sleep(0.05)

    @property
    def port(self) -> int:
        """Of the picture."""
        return int(re.findall(r":(\d+)/", self.wait_for("page: http"))[0])

    def press(self, key: str) -> None:
        """A key on the terminal."""
        assert self.process.stdin is not None
        self.process.stdin.write(key)
        self.process.stdin.flush()


def pester(mission: Mission, messages: int, seed: int) -> int:
    """Sends nonsense while the mission goes on; how much of it found somebody who listened."""
    rng, port, arrived = random.Random(seed), mission.port, 0
    while arrived < messages and mission.process.poll() is None:
        came = send(port, *nonsense(rng, port))
        arrived += came
        time.sleep(0.01 if came else 0.1)
    return arrived


def report(name: str, mission: Mission, folder: Path, arrived: int) -> None:
    """A line on how a mission ended."""
    summary = json.loads((folder / "summary.json").read_text())
    print(
        f"{name}: {summary['outcome']}, {summary['stages']} stages, {summary['landmarks_mapped']} landmarks, exit"
        f" {mission.process.returncode}; {arrived} messages arrived",
        flush=True,
    )


def simulated(messages: int, folder: Path) -> None:
    """A simulated mission to its end, with nonsense all the way."""
    mission = Mission("house", "--seed", "0", "--realtime-rate", "8", "--out", str(folder))
    mission.wait_for("page: http")
    arrived = pester(mission, messages, 0)
    mission.process.wait()
    report("simulated", mission, folder, arrived)


def moved(emulator: Emulator, since: float) -> bool:
    """Whether the wheels were told to turn after a time, s of time.monotonic()."""
    return any(when > since and one.speed for when, one in list(emulator.commands))


def attempt(emulator: Emulator, port: int, what: str) -> bool:
    """Tries to start the wheels from the page; whether they moved."""
    since = time.monotonic()
    for name in STARTING:
        for headers in (FOREIGN, "Host: localhost:{port}\r\n"):
            send(port, asking(name, port, headers))
    time.sleep(SETTLED)
    started = moved(emulator, since)
    print(f"    {what}: {'THE WHEELS MOVED' if started else 'the wheels stand'}", flush=True)
    return started


def emulated(messages: int, folder: Path) -> None:
    """A mission on an emulated Kobuki: attempts to start the wheels at every chance, then nonsense."""
    with Emulator(MakeWorld(LoadScenario("house").world)) as emulator:
        host, sensors = emulator.sensors
        source = f"socket:{host}:{sensors}"
        links = ("--port", emulator.device, "--tags", source, "--scan", source)
        mission = Mission("--robot", "kobuki", *links, "--max-time", "3600", "--out", str(folder))
        mission.wait_for("nothing moves before")
        port = mission.port
        started = attempt(emulator, port, "before they are enabled")
        mission.press("e")
        _until(lambda: moved(emulator, time.monotonic() - 0.2))
        send(port, asking("stop", port))
        time.sleep(SETTLED)
        stopped = not moved(emulator, time.monotonic() - 0.5)
        print(f"    STOP from the page: {'the wheels stand' if stopped else 'THE WHEELS MOVE'}", flush=True)
        started += attempt(emulator, port, "after the STOP")
        mission.press("e")
        _until(lambda: moved(emulator, time.monotonic() - 0.2))
        mission.press("p")
        time.sleep(2.0 * SETTLED)
        started += attempt(emulator, port, "in a pause")
        mission.press("p")
        _until(lambda: moved(emulator, time.monotonic() - 0.2))
        arrived = pester(mission, messages, 1)
        with contextlib.suppress(BrokenPipeError):  # It may have come to its end by then.
            mission.press("q")
        mission.process.wait()
    report("emulated Kobuki", mission, folder, arrived)
    print(f"wheels started from outside {int(started)} times in 3 attempts; stopped from there: {stopped}")


def _until(condition: Callable[[], bool]) -> None:
    while not condition():
        time.sleep(0.05)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=1000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        simulated(arguments.messages, Path(folder) / "simulated")
        emulated(arguments.messages, Path(folder) / "emulated")


if __name__ == "__main__":
    main()

"""The server of the page: shows a timeline that may still grow, and takes what is asked of its mission.

It listens on this machine alone, unless another address is named. Who only looks needs nothing. A request needs the
run's token, which is part of the printed address and not known to another web page on this machine; only a stop needs
none, and is taken from anybody. A name of this machine that others have made up is not answered (DNS rebinding).
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import math
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.cockpit.clock import Clock
from tfg_drake.cockpit.page import served_page
from tfg_drake.cockpit.page_forks import PageForks
from tfg_drake.cockpit.whole_requests import WholeRequestHandler, WholeRequestServer
from tfg_drake.messages import SaidPose
from tfg_drake.mission.manual_drive import BACK, FORWARD, HALT, LEFT, LOOK, RIGHT, stick
from tfg_drake.mission.operation import Command, Request

# First port that the server tries.
PORT = 7000
LOCAL = "localhost"
# Period at which a stream looks for new data, s.
INTERVAL = 0.04
# Greatest length of a request, bytes.
LONGEST = 4096
# Time that the server waits at the mission's end for pages that still read, s.
FAREWELL = 2.0

# The interpreter's switch interval, s, for which the server's thread waits after each system call while the mission
# computes. With the default, ten times as long, a flood leaves 40 connections a second.
SWITCH = 5e-4
# Greatest time between two messages of a page whose stick is pushed, s; without one the page has gone.
STICK_HELD = 0.6
# x and y, m.
Place = tuple[float, float]
NOWHERE: Place = math.nan, math.nan

# Operator commands of a page. In simulation the clock is held instead of pausing the mission.
_OPERATOR: tuple[Command, ...] = ("enable", "stop", "hold", "resume", "recall", "end")
_log = logging.getLogger("tfg_drake.cockpit")


class Cockpit:
    """The page of one mission, served from threads of its own until it is closed; a context manager.

    clock: what a page wants of a simulation's clock, None where there is none to be set. word: what is done while there
    is nothing to see. watched: whether a page is open. sends: the robot can be sent to places; drives: somebody drives
    it by hand; tells: it can be told where it is.
    """

    def __init__(
        self,
        viewer: str,
        title: str,
        *,
        timeline: Path | None = None,
        live: bool = True,
        controls: bool = True,
        forks: PageForks | None = None,
        recorded: Path | None = None,
        rate: float | None = None,
        host: str = LOCAL,
        port: int | None = None,
    ) -> None:
        """
        Args:
            viewer: the script of Meshcat's viewer that Drake ships.
            title: the page's until the timeline gives another one.
            timeline: the file to show, if there is one yet; see `follow`.
            live: it may still grow.
            controls: the mission can be asked for something.
            forks: makes another future of a run that has ended, None where that cannot be.
            recorded: the timeline of another mission, which is played until there is one to show.
            rate: of a simulation the speed of its clock, times real time, 0 for no limit; None of a real robot.
            host: the address to listen at.
            port: the port; by default 7000 or the next that is free.

        Raises:
            OSError: nobody can listen there.
        """
        self.clock = Clock(rate) if rate is not None else None
        self.word = ""
        self.sends = self.drives = self.tells = False
        self._controls, self._forks = controls, forks
        source = {"live": live, "controls": controls, "forks": forks is not None, "rate": rate}
        self._page = served_page(title, source).encode()
        self._recorded = recorded
        self._waiting_page = served_page(title, {"live": False, "recorded": True}).encode()
        self._viewer = viewer.encode()
        self._timeline = timeline
        self._ended = not live
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._asked: list[Request] = []
        self._keys: list[str] = []
        self._stick_until = math.inf
        self._stepping, self._stage, self._from = False, 0, 0
        self.token = secrets.token_urlsafe(16)
        self._names = {LOCAL, host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}
        self._server = _listen(host, port)
        self._server.cockpit = self
        shown = socket.gethostname() if host in ("0.0.0.0", "::", "") else host
        shown = f"[{shown}]" if ":" in shown else shown
        secret = f"#token={self.token}" if controls or forks is not None else ""
        self.address = f"http://{shown}:{self._server.server_address[1]}/{secret}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(INTERVAL,), daemon=True)
        self._switch_before = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        self._thread.start()

    def __enter__(self) -> Cockpit:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def watched(self) -> bool:
        """True if a page is open."""
        return bool(self._server.answered)

    @property
    def begun(self) -> bool:
        """True once there is a timeline."""
        return self._timeline is not None

    def follow(self, timeline: Path) -> None:
        """Show a file from now on."""
        self.word = ""
        self._timeline = timeline

    def requests(self) -> Sequence[Request]:
        """The operator's requests since the last call."""
        with self._lock:
            taken, self._asked = self._asked, []
        return taken

    def keys(self) -> Sequence[str]:
        """Keys pressed by a driver since the last call, see tfg_drake.mission.manual_drive: also a stick let go where
        the page of one that was held has fallen silent."""
        with self._lock:
            taken, self._keys = self._keys, []
            if time.monotonic() > self._stick_until:
                self._stick_until = math.inf
                taken.append(stick(0.0, 0.0))
        return taken

    def at_stage(self, stage: int) -> None:
        """The mission is in this stage: a step ends here."""
        self._stage = stage
        if self.clock is not None:
            self.clock.at_stage(stage)
        elif self._stepping and stage > self._from:
            self._stepping = False
            self._ask("hold")

    def close(self) -> None:
        """Let the pages read what is left, and end."""
        self._ended = True
        until = time.monotonic() + FAREWELL
        while self.watched and time.monotonic() < until:
            time.sleep(INTERVAL)
        self._closed.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        sys.setswitchinterval(self._switch_before)

    # Requests

    def take(
        self, what: str, rate: float = math.nan, place: Place = NOWHERE, key: str = "", stage: int = 0, yaw: float = 0.0
    ) -> bool:
        """Do what a page asks for; whether that is something to ask for here.

        rate: of the clock. place: (x, y), m in M, where the robot is to go, m in W where a fork of a stage is to go, or
        how far a stick is pushed forward and to the left, of 1. key: of a driver. yaw: of a robot that is said to be at
        a place, m and rad in the world of its map.
        """
        if what == "fork" and self._forks is not None and math.isfinite(math.hypot(*place)):
            return self._forks.start(stage, place)
        if not self._controls:
            return False
        clock = self.clock
        if what in ("hold", "resume", "step") and clock is not None:
            {"hold": clock.hold, "resume": clock.go, "step": clock.step}[what]()
        elif what == "step":
            self._from, self._stepping = self._stage, True
            self._ask("resume")
        elif what == "rate" and clock is not None and math.isfinite(rate) and rate >= 0.0:
            clock.set_rate(rate)
        elif what == "key" and self.drives and key in (FORWARD, BACK, LEFT, RIGHT, HALT, LOOK):
            with self._lock:
                self._keys.append(key)
        elif what == "stick" and self.drives and math.isfinite(math.hypot(*place)):
            with self._lock:
                self._keys.append(stick(*place))
                self._stick_until = time.monotonic() + STICK_HELD if any(place) else math.inf
        elif what == "goal" and self.sends and math.isfinite(math.hypot(*place)):
            self._ask(place)
            if clock is not None:
                clock.go()  # Nobody drives while it stands.
        elif what == "at" and self.tells and math.isfinite(math.hypot(*place, yaw)):
            self._ask(SaidPose(X_WB=np.array([*place, yaw])))
        elif what == "push" and clock is not None:
            self._ask("push")
        elif what in _OPERATOR:
            self._stepping = False
            self._ask(next(request for request in _OPERATOR if request == what))
            if clock is not None and what in ("enable", "recall", "end"):
                clock.go()  # Nothing is done while it stands.
        else:
            return False
        return True

    def _ask(self, request: Request) -> None:
        with self._lock:
            self._asked.append(request)

    def _state(self) -> dict[str, Any]:
        state: dict[str, Any] = {"word": self.word, "begun": self.begun, "send": self.sends, "drive": self.drives}
        if self._forks is not None:
            state["fork"] = self._forks.state()
        if self.clock is not None:
            state |= {"held": self.clock.held, "rate": self.clock.rate}
        return state

    def _is_name(self, host: str) -> bool:
        name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
        name = name.strip("[]").lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True


class _Handler(WholeRequestHandler):
    """Answers what a page asks over HTTP."""

    server: _Server

    @property
    def cockpit(self) -> Cockpit:
        return self.server.cockpit

    def do_GET(self) -> None:
        """The page, its viewer, the timeline as it grows, or what is going on."""
        path, _, query = self.path.partition("?")
        if not self._is_ours():
            return
        if path == "/":
            cockpit = self.cockpit
            page = cockpit._page if cockpit.begun or cockpit._recorded is None else cockpit._waiting_page
            self._answer(200, "text/html; charset=utf-8", page)
        elif path == "/viewer.js":
            self._answer(200, "text/javascript; charset=utf-8", self.cockpit._viewer)
        elif path == "/state":
            self._answer(200, "application/json", json.dumps(self.cockpit._state()).encode())
        elif path == "/timeline":
            self._stream(query, lambda: self.cockpit._timeline, lambda: self.cockpit._ended)
        elif path == "/recorded" and (recorded := self.cockpit._recorded) is not None:
            self._stream(query, lambda: recorded, lambda: True)
        elif path == "/fork" and (forks := self.cockpit._forks) is not None:
            self._stream(query, lambda: forks.timeline, lambda: not forks.is_running)
        else:
            self._answer(404, "text/plain", b"There is nothing here.\n")

    def do_POST(self) -> None:
        """A request of a page."""
        length = self.headers.get("Content-Length", "")
        if self.path != "/request" or not length.isdecimal() or len(length) > 9 or int(length) > LONGEST:
            self._answer(404, "text/plain", b"There is nothing here.\n")
            return
        try:
            asked = json.loads(self.rfile.read(int(length)))
            what, rate = str(asked["request"]), float(asked.get("rate", math.nan))
            key, stage = str(asked.get("key", "")), int(asked.get("stage", 0))
            place = float(asked.get("x", math.nan)), float(asked.get("y", math.nan))
            yaw = float(asked.get("yaw", math.nan))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
            self._answer(400, "text/plain", b"That is no request.\n")
            return
        if what != "stop":
            if not self._is_ours():
                return
            given = self.headers.get("X-Token", "")
            if not secrets.compare_digest(given.encode(), self.cockpit.token.encode()):
                refusal = b"Only who has the whole address that was printed may ask for that; STOP needs none.\n"
                self._answer(403, "text/plain", refusal)
                return
        if self.cockpit.take(what, rate, place, key, stage, yaw):
            self._answer(200, "application/json", json.dumps(self.cockpit._state()).encode())
        else:
            self._answer(400, "text/plain", b"That cannot be asked for here.\n")

    def _is_ours(self) -> bool:
        """True if the request names this machine, and is from no page of another; else answers 403."""
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin")
        if self.cockpit._is_name(host) and origin in (None, f"http://{host}"):
            return True
        self._answer(403, "text/plain", b"Open the address that was printed.\n")
        return False

    def _answer(self, code: int, kind: str, body: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("X-Frame-Options", "DENY")  # No other page may put ours under its own.
            self.end_headers()
            self.wfile.write(body)

    def _stream(self, query: str, timeline: Callable[[], Path | None], has_ended: Callable[[], bool]) -> None:
        """Sends a timeline's bytes from one on, until its mission has ended or the page is closed."""
        start, closed = query.removeprefix("from="), self.cockpit._closed
        with contextlib.suppress(ConnectionError):
            self.send_response(200)
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            while (path := timeline()) is None or not path.exists():
                if closed.is_set() or has_ended() or self._has_gone():
                    return
            with path.open("rb") as file:
                file.seek(int(start) if start.isdecimal() else 0)
                while not closed.is_set():
                    ended = has_ended()
                    data = file.read(2**20)
                    if data:
                        self.wfile.write(data)
                    elif ended or self._has_gone():
                        return

    def _has_gone(self) -> bool:
        """True if the page goes away within INTERVAL: it says nothing more after its request. Raises ConnectionError
        where it goes without a word."""
        return bool(wait([self.connection], INTERVAL)) and not self.connection.recv(1024)

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing."""


class _Server(WholeRequestServer):
    cockpit: Cockpit

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that goes away in the middle is no error; anything else is told to the log."""
        _log.debug("%s", client_address, exc_info=True)


def _listen(host: str, port: int | None) -> _Server:
    """Raises OSError where nobody can listen there."""
    address = "127.0.0.1" if host == LOCAL else host
    if port is not None:
        return _Server((address, port), _Handler)
    for free in range(PORT, PORT + 100):
        with contextlib.suppress(OSError):
            return _Server((address, free), _Handler)
    return _Server((address, 0), _Handler)

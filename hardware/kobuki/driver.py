"""The Kobuki, as the rest of the program sees it: a handle on the process that talks to the base."""

from __future__ import annotations

import dataclasses
import json
import socket
import subprocess
import sys
import time
from types import TracebackType

from tfg_drake.hardware.kobuki.link import (
    KobukiError,
    Report,
    Request,
    decode_report,
    encode_request,
)
from tfg_drake.hardware.watchdog import Limits

# How long the process may take to end before it is killed, s.
_END_WITHIN = 2.0


class KobukiDriver:
    """Drives the base within limits, from the constructor until close() or the end of `with`.

    The base stands until enable(), again after every reconnection, and as soon as the last command() is 0.6 s old.
    A watchdog in a process of its own sees to that, and that a base stops whose program hangs or dies; see
    tfg_drake.hardware.kobuki.watchdog for all that stops it. Not for several threads at once.
    """

    def __init__(self, port: str = "/dev/kobuki", limits: Limits | None = None) -> None:
        """port: path of the serial port. The process starts at once, and connects as soon as it can."""
        self._report = Report()
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setblocking(False)
        arguments = [port, json.dumps(dataclasses.asdict(limits or Limits())), str(theirs.fileno())]
        # A session of its own: Ctrl-C in the terminal is the parent's affair.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tfg_drake.hardware.kobuki.driver_process", *arguments],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
        theirs.close()

    @property
    def process_id(self) -> int:
        """Of the driver's process."""
        return self._process.pid

    def report(self) -> Report:
        """The newest report; never waits. Raises KobukiError where the process has ended.

        Whoever has not asked for seconds may get one that is as old, once: go by its stamps.
        """
        newest = b""
        try:
            while datagram := self._socket.recv(65536):
                newest = datagram
        except BlockingIOError:
            if newest:
                self._report = decode_report(newest)
            return self._report
        except OSError:
            pass
        raise _ended()

    def wait_connected(self, timeout: float = 5.0) -> Report:
        """The first report of a connected base.

        Raises KobukiError as soon as it is known why it cannot be, or where it is not within timeout, s.
        """
        end = time.monotonic() + timeout
        while (report := self.report()).state == "disconnected":
            if report.detail:
                raise KobukiError(report.detail)
            if time.monotonic() > end:
                raise KobukiError(f"the base has not answered within {timeout:g} s; switch it off and on again")
            time.sleep(0.01)
        return report

    def enable(self) -> None:
        """Lets commands from now on move the base, until it is disconnected. Raises KobukiError where it is."""
        report = self.report()
        if report.state == "disconnected":
            raise KobukiError(report.detail or "the base is not connected yet; wait for it")
        self._send(Request(time.monotonic(), enable=report.connection))

    def command(self, speed: float, turn_rate: float) -> None:
        """The velocity to drive at for the next 0.6 s: forward speed, m/s, and turn rate, rad/s."""
        self._send(Request(time.monotonic(), speed=speed, turn_rate=turn_rate))

    def _send(self, request: Request) -> None:
        try:
            self._socket.send(encode_request(request))
        except BlockingIOError:
            pass  # It has not taken up what came before: nothing newer would help.
        except OSError:
            raise _ended() from None

    def close(self) -> None:
        """Stops the base and ends the process."""
        self._socket.close()
        try:
            self._process.wait(_END_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> KobukiDriver:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _ended() -> KobukiError:
    return KobukiError("the Kobuki driver's process has ended; what it said last is on standard error")

"""However many connections there are, few descriptors and threads are taken, and who says all is answered."""

import contextlib
import http.client
import os
import resource
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.cockpit.test_server import ask, get, port, until
from tfg_drake.cockpit import whole_requests
from tfg_drake.cockpit.server import Cockpit

HALF = b"POST /request HTTP/1.1\r\nHost: localhost\r\nContent-Length: 19\r\n\r\n" + b'{"request": '
REST = b'"stop"}'


def connected(number):
    return socket.create_connection(("localhost", number), timeout=30)


def said(number, data):
    connection = connected(number)
    connection.sendall(data)
    return connection


def is_open(connection):
    """Whether nobody has hung up."""
    connection.setblocking(False)
    try:
        return bool(connection.recv(1))
    except BlockingIOError:
        return True
    except OSError:
        return False


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(whole_requests, "WAITING", 3)
    monkeypatch.setattr(whole_requests, "ANSWERED", 2)


@pytest.mark.parametrize("cut", [0, 1, 20, 60, len(HALF), len(HALF + REST) - 1])
def test_the_oldest_that_has_not_said_all_goes(cockpit, few, cut):
    request = HALF + REST
    halves = [said(port(cockpit), request[:cut]) for _ in range(10)]
    until(lambda: not any(map(is_open, halves[:7])))
    assert all(map(is_open, halves[7:]))
    halves[7].settimeout(30)
    halves[7].sendall(request[cut:])
    assert halves[7].recv(65536).startswith(b"HTTP/1.0 200 OK")
    assert cockpit.requests() == ["stop"]
    assert ask(cockpit, "stop")[0] == 200


def said_from(address, number, data):
    """Said on a connection from another address of this machine."""
    connection = socket.create_connection(("127.0.0.1", number), timeout=30, source_address=(address, 0))
    connection.sendall(data)
    return connection


def test_a_flood_from_one_address_keeps_no_other_out(cockpit, few):
    """Half a STOP waits for its other half, however many come meanwhile from elsewhere."""
    half = said(port(cockpit), HALF)
    floods = [said_from("127.0.0.2", port(cockpit), HALF) for _ in range(10)]
    until(lambda: sum(map(is_open, floods)) == 2)
    half.sendall(REST)
    assert half.recv(65536).startswith(b"HTTP/1.0 200 OK")
    assert cockpit.requests() == ["stop"]


def test_a_stop_comes_before_all_that_is_to_be_read(monkeypatch):
    """Also before what was said earlier."""
    handled = []

    class Handler(whole_requests.WholeRequestHandler):
        def do_POST(self):
            handled.append("POST")

        def log_message(self, *_):
            pass

    monkeypatch.setattr(whole_requests, "ANSWERED", 4)
    server = whole_requests.WholeRequestServer(("127.0.0.1", 0), Handler)
    monkeypatch.setattr(server, "_begin_answer", lambda request: handled.append(request[0][:3].decode()))
    number = server.server_address[1]
    others = [said(number, b"GET / HTTP/1.0\r\n\r\n") for _ in range(6)] + [said(number, HALF + REST)]
    server.service_actions()
    # The oldest two are too many.
    assert handled == ["POST", "GET", "GET", "GET", "GET"]
    others += [said(number, b"GET / HTTP/1.0\r\n\r\n") for _ in range(3)]
    begin = lambda request: handled.append("GET") or others.append(said(number, HALF + REST))  # noqa: E731
    monkeypatch.setattr(server, "_begin_answer", begin)
    handled.clear()
    server.service_actions()
    assert handled == ["GET", "POST", "GET", "POST", "GET", "POST"]
    server.server_close()


def test_threads_that_end_are_waited_for_before_there_are_more(cockpit, few, monkeypatch):
    begun = []
    monkeypatch.setattr(cockpit._server, "_begin_answer", begun.append)
    ending = {object(): None for _ in range(4)}
    cockpit._server.answered.update(ending)
    waiting = said(port(cockpit), b"GET /state HTTP/1.0\r\nHost: localhost\r\n\r\n")
    assert ask(cockpit, "stop")[0] == 200
    assert begun == []
    for one in ending:
        del cockpit._server.answered[one]
    until(lambda: len(begun) == 1)
    waiting.close()


def test_the_mission_hands_the_interpreter_over_soon_while_a_page_is_served(mission):
    before = sys.getswitchinterval()
    with Cockpit("", "robot", timeline=mission):
        assert sys.getswitchinterval() == pytest.approx(before / 10.0)
    assert sys.getswitchinterval() == before


def test_half_a_request_takes_no_thread(cockpit):
    before = threading.active_count()
    halves = [said(port(cockpit), HALF) for _ in range(50)]
    assert ask(cockpit, "stop")[0] == 200  # All of them have been let in by then.
    assert threading.active_count() == before
    assert all(map(is_open, halves))


def test_of_those_that_read_without_end_the_oldest_goes(cockpit, few):
    def stream():
        connection = said(port(cockpit), b"GET /timeline?from=0 HTTP/1.0\r\nHost: localhost\r\n\r\n")
        assert connection.recv(10) == b"HTTP/1.0 2"
        return connection

    before = threading.active_count()
    streams = []
    for _ in range(6):
        streams.append(stream())
        # Who comes while the threads of twice as many have not noticed yet is hung up on.
        until(lambda: len(cockpit._server.answered) <= 2)
    until(lambda: threading.active_count() <= before + 2)

    def ended(connection):
        connection.settimeout(30)
        while connection.recv(65536):
            pass
        return True

    assert all(map(ended, streams[:4]))
    assert get(cockpit, "/state")[0] == 200
    assert cockpit.watched


def test_a_request_that_comes_in_pieces_is_answered(cockpit):
    connection = connected(port(cockpit))
    for k in range(0, len(HALF + REST), 7):
        connection.sendall((HALF + REST)[k : k + 7])
        time.sleep(0.002)
    assert connection.recv(65536).startswith(b"HTTP/1.0 200 OK")


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (b"GET /state HTTP/1.0\r\nHost: localhost\r\nX: " + b"y" * 20000, b"200"),
        (b"POST /request HTTP/1.0\r\nContent-Length: 9" + b"9" * 6000 + b"\r\n\r\n{}", b"404"),
        (b"POST /request HTTP/1.0\r\nContent-Length: -7\r\n\r\n{}", b"404"),
        (b"POST /request HTTP/1.0\r\n\r\n", b"404"),
        (b"\xff\x00 nonsense\r\n\r\n", b"400"),
        (b"DELETE / HTTP/1.0\r\n\r\n", b"501"),
    ],
)
def test_what_is_too_long_or_nonsense_is_answered_and_does_not_end_the_server(cockpit, request_, code):
    connection = said(port(cockpit), request_)
    with contextlib.suppress(ConnectionResetError):  # what was not read is thrown away
        assert code in connection.recv(65536)
    connection.close()
    assert ask(cockpit, "stop")[0] == 200


def test_a_process_that_can_have_no_more_threads_takes_a_stop(cockpit, monkeypatch):
    def no_thread(*_):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", no_thread)
        with pytest.raises((http.client.HTTPException, OSError)):
            get(cockpit, "/state")
        assert ask(cockpit, "stop")[0] == 200
    assert get(cockpit, "/state")[0] == 200


# What a mission does besides, in few descriptors: its timeline grows, files are written and processes started.
MISSION = """
import resource, subprocess, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[2]),) * 2)
from pathlib import Path
from tfg_drake.cockpit.server import Cockpit
timeline = Path(sys.argv[1])
timeline.write_bytes(b"begin")
with Cockpit("", "robot", timeline=timeline) as cockpit:
    print(cockpit._server.server_address[1], flush=True)
    while True:
        with timeline.open("ab") as file:
            file.write(b"more")
        subprocess.run(["true"], check=True)
        for request in cockpit.requests():
            print(request, flush=True)
"""


def flood(number, count, until_):
    """Half a request on each of so many connections, again where one was hung up; how many were opened."""
    opened, halves = 0, []
    while time.monotonic() < until_:
        halves = [one for one in halves if is_open(one) or one.close()]
        while len(halves) < count and time.monotonic() < until_:
            with contextlib.suppress(OSError):
                halves.append(said(number, HALF))
                opened += 1
    for one in halves:
        one.close()
    return opened


def stop(number):
    """Say STOP until it is answered, as an operator does: who is slow to say all of it may be hung up on in a flood."""
    for _ in range(20):
        with contextlib.suppress(ConnectionError), said(number, HALF + REST) as connection:
            if answer := connection.recv(65536):
                return answer
    raise AssertionError("a STOP is hung up on every time")


def under_flood(folder, limit, count, seconds):
    """A mission with so few descriptors under a flood for a while: how long each STOP took, s, how many connections
    were opened, and how many descriptors it had at most."""
    timeline = folder / "timeline"
    command = [sys.executable, "-c", MISSION, str(timeline), str(limit)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as mission:
        try:
            number, took, descriptors = int(mission.stdout.readline()), [], []
            page = said(number, b"GET /timeline?from=0 HTTP/1.0\r\nHost: localhost\r\n\r\n")
            end, opened = time.monotonic() + seconds, []
            flooding = threading.Thread(target=lambda: opened.append(flood(number, count, end)))
            flooding.start()
            while time.monotonic() < end:
                began, before = time.monotonic(), timeline.stat().st_size
                assert stop(number).startswith(b"HTTP/1.0 200 OK")
                assert mission.stdout.readline() == "stop\n"
                took.append(time.monotonic() - began)
                descriptors.append(len(os.listdir(f"/proc/{mission.pid}/fd")))
                assert page.recv(65536)  # The page that was there before still reads what comes.
                until(lambda before=before: timeline.stat().st_size > before)
                time.sleep(0.05)
            flooding.join()
            assert mission.poll() is None
            return took, opened[0], max(descriptors)
        finally:
            mission.kill()


@pytest.mark.slow
def test_a_flood_of_half_requests_takes_the_mission_nothing(tmp_path):
    took, opened, descriptors = under_flood(tmp_path, limit=256, count=300, seconds=3.0)
    assert opened > 300
    assert descriptors < 200
    assert sorted(took)[len(took) // 2] < 5.0


def test_more_descriptors_than_select_can_wait_for(tmp_path):
    """The page's stream and the robot's orders, where the process has more than 1024 descriptors already."""
    if resource.getrlimit(resource.RLIMIT_NOFILE)[1] < 2000:
        pytest.skip("the machine allows no more descriptors")
    code = """
import resource, socket, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (2000, 2000))
pairs = [socket.socketpair() for _ in range(600)]
from multiprocessing import Pipe
from pathlib import Path
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.hardware.device import Device
from tfg_drake.hardware.keyboard import Keyboard
with Cockpit("", "robot", timeline=Path(sys.argv[1])) as cockpit:
    page = socket.create_connection(("localhost", cockpit._server.server_address[1]))
    page.sendall(b"GET /timeline?from=0 HTTP/1.0\\r\\nHost: localhost\\r\\n\\r\\n")
    seen = b""
    while b"begin" not in seen:
        seen += page.recv(65536)
    with Path(sys.argv[1]).open("ab") as file:
        file.write(b"more")
    while b"more" not in seen:
        seen += page.recv(65536)
device = Device.__new__(Device)
device.ended = device._full = None
device._connection, other = Pipe()
assert device._connection.fileno() > 1024
device.command(0.1, 0.2)
assert other.recv()[2:] == (0.1, 0.2)
keys, pressed = socket.socketpair()
keyboard = Keyboard({" ": "stop"}, keys.fileno())
pressed.sendall(b" ")
while not keyboard.requests():
    pass
keyboard.close()
"""
    timeline = Path(tmp_path / "timeline")
    timeline.write_bytes(b"begin")
    subprocess.run([sys.executable, "-c", code, str(timeline)], check=True, timeout=60)

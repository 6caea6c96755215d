"""Who may look, who may ask for what, and that nobody who goes away harms anything."""

import http.client
import json
import socket
import threading
import time

import pytest

from tfg_drake.cockpit import server as module
from tfg_drake.cockpit.server import Cockpit


def until(condition):
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def port(cockpit):
    return cockpit._server.server_address[1]


def get(cockpit, path, **headers):
    connection = http.client.HTTPConnection("localhost", port(cockpit), timeout=30)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def ask(cockpit, what, token="", **more):
    headers = more.pop("headers", {})
    body = more.pop("body", None) or json.dumps({"request": what, **more})
    connection = http.client.HTTPConnection("localhost", port(cockpit), timeout=30)
    connection.request("POST", "/request", body, {"X-Token": token, **headers})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


class Stream:
    """A page that reads the timeline as it grows."""

    def __init__(self, cockpit, start=0, path="/timeline"):
        self.socket = socket.create_connection(("localhost", port(cockpit)), timeout=30)
        self.socket.sendall(f"GET {path}?from={start} HTTP/1.0\r\nHost: localhost\r\n\r\n".encode())
        self.data, self.ended = b"", False

    def read(self, count):
        while len(self.data.partition(b"\r\n\r\n")[2]) < count:
            more = self.socket.recv(65536)
            if not more:
                break
            self.data += more
        return self.data.partition(b"\r\n\r\n")[2]


def test_the_address_that_is_printed_has_the_runs_token(cockpit):
    assert cockpit.address == f"http://localhost:{port(cockpit)}/#token={cockpit.token}"
    assert len(cockpit.token) > 20
    with Cockpit("", "other", rate=0.0) as other:
        assert other.token != cockpit.token


def test_who_only_looks_needs_no_token(cockpit, mission):
    status, page = get(cockpit, "/")
    assert status == 200
    assert cockpit.token.encode() not in page
    assert get(cockpit, "/viewer.js") == (200, b"/* viewer */")
    state = {"word": "", "begun": True, "send": False, "drive": False, "held": False, "rate": 8.0}
    assert json.loads(get(cockpit, "/state")[1]) == state
    assert get(cockpit, "/timeline.tfg")[0] == get(cockpit, "/../secret")[0] == 404
    assert Stream(cockpit).read(mission.stat().st_size) == mission.read_bytes()
    assert Stream(cockpit, 100).read(mission.stat().st_size - 100) == mission.read_bytes()[100:]


def test_a_recorded_mission_is_served_until_there_is_one_to_show(mission, tmp_path):
    recorded = tmp_path / "recorded.tfg"
    recorded.write_bytes(b"recorded before")
    with Cockpit("", "room", recorded=recorded, rate=1.0) as cockpit:
        status, page = get(cockpit, "/")
        assert (status, b'"recorded": true' in page, b'"live": false' in page) == (200, True, True)
        assert get(cockpit, "/recorded?from=9") == (200, b"before")
        assert json.loads(get(cockpit, "/state")[1])["begun"] is False
        cockpit.follow(mission)
        _, page = get(cockpit, "/")
        assert (b'"recorded": true' in page, b'"live": true' in page) == (False, True)
        assert json.loads(get(cockpit, "/state")[1])["begun"] is True
    with Cockpit("", "room") as cockpit:
        assert b'"recorded": true' not in get(cockpit, "/")[1]
        assert get(cockpit, "/recorded")[0] == 404


def test_a_stop_needs_no_token_and_all_else_does(cockpit):
    cockpit.sends = cockpit.drives = cockpit.tells = True
    more = {"rate": 1.0, "x": 0.5, "y": 0.5, "key": "forward", "yaw": 0.5}
    for what in ("enable", "hold", "resume", "step", "recall", "end", "rate", "goal", "key", "stick", "at"):
        for token in ("", "guess", cockpit.token[:-1]):
            assert ask(cockpit, what, token, **more)[0] == 403
    assert [*cockpit.requests(), *cockpit.keys()] == []
    assert not cockpit.clock.held
    assert ask(cockpit, "stop")[0] == 200
    assert cockpit.requests() == ["stop"]
    assert cockpit.requests() == []


def test_what_the_operator_is_asked_for(cockpit):
    for what in ("enable", "recall", "stop", "end"):
        assert ask(cockpit, what, cockpit.token)[0] == 200
    assert cockpit.requests() == ["enable", "recall", "stop", "end"]


@pytest.mark.parametrize("origin", ["http://pages.example", "null", "http://localhost:1", "https://localhost"])
def test_no_other_page_can_ask_for_anything_even_if_it_knew_the_token(cockpit, origin):
    answer = ask(cockpit, "enable", cockpit.token, headers={"Origin": origin})
    assert answer == (403, "Open the address that was printed.\n")
    assert get(cockpit, "/state", Origin=origin)[0] == 403
    assert cockpit.requests() == []


def test_a_made_up_name_of_this_machine_is_not_answered(cockpit):
    name = f"rebound.example:{port(cockpit)}"
    assert get(cockpit, "/", Host=name)[0] == 403
    assert ask(cockpit, "enable", cockpit.token, headers={"Host": name, "Origin": f"http://{name}"})[0] == 403
    for name in ("localhost", "127.0.0.1:7000", "[::1]:7000", socket.gethostname()):
        assert get(cockpit, "/state", Host=name, Origin=f"http://{name}")[0] == 200


@pytest.mark.parametrize("body", ["", "{", "[]", "7", '{"request": []}', '{"request": "rate", "rate": "fast"}'])
def test_nonsense_is_refused(cockpit, body):
    status, _ = ask(cockpit, "", cockpit.token, body=body or " ")
    assert status == 400
    assert get(cockpit, "/state")[0] == 200


def test_what_is_too_long_is_not_read(cockpit):
    assert ask(cockpit, "enable", cockpit.token, more="x" * 5000)[0] == 404


def test_a_simulations_clock_is_held_and_goes_on(cockpit):
    assert ask(cockpit, "hold", cockpit.token)[0] == 200
    assert cockpit.clock.held
    assert json.loads(get(cockpit, "/state")[1])["held"]
    ask(cockpit, "resume", cockpit.token)
    assert not cockpit.clock.held
    assert ask(cockpit, "rate", cockpit.token, rate=2.5)[0] == 200
    assert cockpit.clock.rate == 2.5
    for rate in (-1, float("nan")):
        assert ask(cockpit, "rate", cockpit.token, rate=rate)[0] == 400
    cockpit.at_stage(4)
    ask(cockpit, "step", cockpit.token)
    cockpit.at_stage(4)
    assert not cockpit.clock.held
    cockpit.at_stage(5)
    assert cockpit.clock.held
    # A robot that is to come home does not wait for somebody to let the clock go on.
    ask(cockpit, "recall", cockpit.token)
    assert not cockpit.clock.held
    assert cockpit.requests() == ["recall"]


def test_a_robot_is_sent_to_a_place_where_its_explorer_can_be(cockpit):
    assert ask(cockpit, "goal", cockpit.token, x=1.5, y=-2.0)[0] == 400
    cockpit.sends = True
    cockpit.clock.hold()
    assert ask(cockpit, "goal", cockpit.token, x=1.5, y=-2.0)[0] == 200
    assert not cockpit.clock.held
    for nowhere in ({}, {"x": 1.0}, {"x": 1.0, "y": float("nan")}, {"x": 1.0, "y": "here"}):
        assert ask(cockpit, "goal", cockpit.token, **nowhere)[0] == 400
    assert cockpit.requests() == [(1.5, -2.0)]
    assert cockpit.requests() == []


def test_a_robot_is_told_where_it_is_where_its_explorer_takes_that(cockpit):
    there = {"x": 1.5, "y": -2.0, "yaw": 0.5}
    assert ask(cockpit, "at", cockpit.token, **there)[0] == 400
    cockpit.tells = True
    assert ask(cockpit, "at", cockpit.token, **there)[0] == 200
    for nowhere in ({}, {"x": 1.0, "y": 2.0}, there | {"yaw": float("inf")}, there | {"x": "here"}):
        assert ask(cockpit, "at", cockpit.token, **nowhere)[0] == 400
    (said,) = cockpit.requests()
    assert (said.X_WB.tolist(), said.sigma.tolist()) == ([1.5, -2.0, 0.5], [0.5, 0.3])


def test_somebody_drives_by_keys_and_by_a_stick(cockpit, monkeypatch):
    assert ask(cockpit, "key", cockpit.token, key="forward")[0] == 400
    cockpit.drives = True
    for key in ("forward", "left", "look"):
        assert ask(cockpit, "key", cockpit.token, key=key)[0] == 200
    assert ask(cockpit, "key", cockpit.token, key="end")[0] == 400
    assert ask(cockpit, "stick", cockpit.token, x=0.5, y=-2.0)[0] == 200
    assert list(cockpit.keys()) == ["forward", "left", "look", "stick 0.50 -1.00"]
    assert ask(cockpit, "stick", cockpit.token, x=0, y=0)[0] == 200
    # A page that has pushed the stick and says nothing more has gone.
    monkeypatch.setattr(module, "STICK_HELD", -1.0)
    assert ask(cockpit, "stick", cockpit.token, x=1, y=0)[0] == 200
    assert list(cockpit.keys()) == ["stick 0.00 0.00", "stick 1.00 0.00", "stick 0.00 0.00"]
    assert list(cockpit.keys()) == []


class Futures:
    """Other futures of a run."""

    def __init__(self, timeline):
        self.timeline, self.is_running, self.asked = timeline, True, []

    def start(self, stage, goal):
        self.asked.append((stage, goal))
        return len(self.asked) == 1

    def state(self):
        return {"number": len(self.asked)}


def test_a_run_that_has_ended_is_forked_and_its_fork_is_read_as_it_grows(mission, tmp_path):
    forks = Futures(tmp_path / "fork.tfg")
    with Cockpit("", "room", timeline=mission, live=False, controls=False, forks=forks) as cockpit:
        assert cockpit.address.endswith(f"#token={cockpit.token}")
        assert ask(cockpit, "fork", stage=5, x=1.0, y=2.0)[0] == 403
        for nowhere in ({"stage": 5}, {"stage": "last", "x": 1, "y": 2}, {"stage": float("inf"), "x": 1, "y": 2}):
            assert ask(cockpit, "fork", cockpit.token, **nowhere)[0] == 400
        assert ask(cockpit, "fork", cockpit.token, stage=5, x=1.0, y=-2.0)[0] == 200
        assert ask(cockpit, "fork", cockpit.token, stage=6, x=1.0, y=-2.0)[0] == 400  # one at a time
        assert forks.asked == [(5, (1.0, -2.0)), (6, (1.0, -2.0))]
        assert ask(cockpit, "recall", cockpit.token)[0] == 400
        assert json.loads(get(cockpit, "/state")[1])["fork"] == {"number": 2}
        stream = Stream(cockpit, path="/fork")
        forks.timeline.write_bytes(b"what is there")
        assert stream.read(13) == b"what is there"
        with forks.timeline.open("ab") as file:
            file.write(b", and more")
        assert stream.read(23).endswith(b", and more")
        forks.is_running = False
        assert stream.read(24) == b"what is there, and more"
    with Cockpit("", "room", timeline=mission, live=False, controls=False) as other:
        assert "#" not in other.address
        assert get(other, "/fork")[0] == 404
        assert ask(other, "fork", other.token, stage=5, x=1.0, y=2.0)[0] == 400


def test_a_simulated_robot_is_pushed_and_a_real_one_is_not(cockpit, mission):
    for _ in range(2):
        assert ask(cockpit, "push", cockpit.token)[0] == 200
    assert ask(cockpit, "push")[0] == 403
    assert cockpit.requests() == ["push", "push"]
    with Cockpit("", "robot", timeline=mission) as robot:
        assert ask(robot, "push", robot.token)[0] == 400


def test_a_robot_is_paused_by_its_operator(mission):
    with Cockpit("", "robot", timeline=mission) as cockpit:
        cockpit.at_stage(2)
        for what in ("hold", "resume", "step"):
            assert ask(cockpit, what, cockpit.token)[0] == 200
        assert cockpit.requests() == ["hold", "resume", "resume"]
        cockpit.at_stage(2)
        assert cockpit.requests() == []
        cockpit.at_stage(3)
        assert cockpit.requests() == ["hold"]
        assert ask(cockpit, "rate", cockpit.token, rate=1.0)[0] == 400


def test_a_run_that_is_only_looked_at_takes_no_requests(mission):
    with Cockpit("", "run", timeline=mission, live=False, controls=False) as cockpit:
        assert cockpit.address.endswith(f":{port(cockpit)}/")
        assert ask(cockpit, "stop")[0] == ask(cockpit, "enable", cockpit.token)[0] == 400
        assert Stream(cockpit).read(10**9) == mission.read_bytes()  # It ends where the file does.


def test_pages_come_and_go(tmp_path):
    path = tmp_path / "growing"
    with Cockpit("", "run", rate=0.0) as cockpit:
        early = Stream(cockpit)  # before there is anything to see
        until(lambda: cockpit.watched)
        path.write_bytes(b"a" * 100)
        cockpit.follow(path)
        assert early.read(100) == b"a" * 100
        late = Stream(cockpit)
        assert late.read(100) == b"a" * 100
        with path.open("ab") as file:
            file.write(b"b" * 10)
        assert early.read(110)[100:] == late.read(110)[100:] == b"b" * 10
        early.socket.close()
        late.socket.close()
        until(lambda: not cockpit.watched)
        again = Stream(cockpit, 105)
        assert again.read(5) == b"b" * 5


def test_a_page_reads_the_last_of_it_before_the_program_ends(tmp_path, monkeypatch):
    path = tmp_path / "growing"
    path.write_bytes(b"a" * 100)
    cockpit = Cockpit("", "run", rate=0.0, timeline=path)
    page = Stream(cockpit)
    page.read(100)
    with path.open("ab") as file:
        file.write(b"end")
    closing = threading.Thread(target=cockpit.close)
    closing.start()
    assert page.read(10**9)[100:] == b"end"
    closing.join()
    # A page that has hung up in the middle is not waited for.
    monkeypatch.setattr(module, "FAREWELL", 0.05)
    cockpit = Cockpit("", "run", rate=0.0, timeline=path)
    Stream(cockpit).socket.close()
    cockpit.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("localhost", cockpit._server.server_address[1]), timeout=5)


def test_it_listens_on_this_machine_alone_unless_another_address_is_named():
    with Cockpit("", "run", rate=0.0) as cockpit:
        assert cockpit._server.server_address[0] == "127.0.0.1"
    with Cockpit("", "run", rate=0.0, host="0.0.0.0") as cockpit:
        assert cockpit._server.server_address[0] == "0.0.0.0"
        assert cockpit.address.startswith(f"http://{socket.gethostname()}:")


def test_a_port_that_is_taken():
    with Cockpit("", "run", rate=0.0) as cockpit:
        with pytest.raises(OSError, match="in use"):
            Cockpit("", "other", rate=0.0, port=port(cockpit))
        with Cockpit("", "other", rate=0.0) as other:
            assert port(other) != port(cockpit)

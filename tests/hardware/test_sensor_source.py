"""Tags and scans without a base: how sources are named, and what a sensor socket may do to them."""

import errno
import json
import math
import os
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import pytest

from tfg_drake.hardware import sensor_reader, sensor_source, socket_sensors
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.sensor_socket import SensorSocket
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.sensor_source import SourceSpec, open_sources, parse_source
from tfg_drake.hardware.socket_sensors import SocketDriver, message_of, sensor_line
from tfg_drake.messages import LaserScan, TagDetections

PRESET = load_preset("turtlebot2")


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("ros2:/detections", SourceSpec("ros2", topic="/detections")),
        ("ros2:camera/tags", SourceSpec("ros2", topic="/camera/tags")),
        ("rosbridge:robot.local:9091/scan", SourceSpec("rosbridge", "robot.local", 9091, "/scan")),
        ("rosbridge:10.0.0.7/front/scan", SourceSpec("rosbridge", "10.0.0.7", 9090, "/front/scan")),
        ("rosbridge:/scan", SourceSpec("rosbridge", "localhost", 9090, "/scan")),
        ("rosbridge:[::1]:9090/scan", SourceSpec("rosbridge", "::1", 9090, "/scan")),
        ("socket:127.0.0.1:5000", SourceSpec("socket", "127.0.0.1", 5000)),
        ("camera:/dev/video0", SourceSpec("camera", device="/dev/video0")),
        ("camera:http://10.0.0.7:8080/stream", SourceSpec("camera", device="http://10.0.0.7:8080/stream")),
        ("rplidar:/dev/ttyUSB0", SourceSpec("rplidar", device="/dev/ttyUSB0")),
        ("realsense:", SourceSpec("realsense")),
    ],
)
def test_sources(text, spec):
    assert parse_source(text) == spec
    assert text.partition(":")[0] == str(spec).partition(":")[0]


FORMS = "ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, camera:SOURCE, rplidar:DEVICE or realsense:"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("/scan", f"/scan: is no source; name one as {FORMS}"),
        ("mqtt:/scan", f"mqtt:/scan: is no source; name one as {FORMS}"),
        ("ros2:", f"ros2:: is no source; name one as {FORMS}"),
        ("ros2:/", f"ros2:/: names no topic; name the source as {FORMS}"),
        ("rosbridge:host:9090", f"rosbridge:host:9090: names no topic; name the source as {FORMS}"),
        (
            "rosbridge:host:port/scan",
            f"rosbridge:host:port/scan: host:port is no HOST:PORT; name the source as {FORMS}",
        ),
        ("socket:5000", "socket:5000: 5000 is no HOST:PORT; name the source as socket:HOST:PORT"),
        ("socket:host:99999", f"socket:host:99999: host:99999 is no HOST:PORT; name the source as {FORMS}"),
        (
            "camera:",
            "camera:: names no device; name the source as camera:/dev/video0, camera:http://HOST/STREAM or camera:FILE",
        ),
        ("rplidar:", "rplidar:: names no device; name the source as rplidar:/dev/ttyUSB0"),
        ("socket:h:5/scan", "socket:h:5/scan: h:5/scan is no HOST:PORT; name the source as socket:HOST:PORT"),
    ],
)
def test_sources_that_are_none(text, line):
    with pytest.raises(DeviceError) as error:
        parse_source(text)
    assert str(error.value) == line


@pytest.mark.parametrize(
    ("use", "text", "line"),
    [
        ("scan", "camera:0", "camera:0: is a source of tags; give --tags camera:0"),
        ("tags", "rplidar:/dev/ttyUSB0", "rplidar:/dev/ttyUSB0: is a source of scan; give --scan rplidar:/dev/ttyUSB0"),
        ("tags", "realsense:", "realsense:: is a source of scan; give --scan realsense:"),
    ],
)
def test_a_sensor_that_gives_something_else(use, text, line):
    with pytest.raises(DeviceError) as error:
        open_sources({use: text}, PRESET)
    assert str(error.value) == line


def tags(stamp):
    return TagDetections(stamp, np.array([7]), np.array([2.5]), np.array([-0.5]), np.array([0.04]), np.array([0.01]))


def scan(stamp):
    return LaserScan(stamp, np.array([-0.5, 0.0, 0.5]), np.array([1.0, math.inf, math.nan]), 10.0, 0.015)


@pytest.mark.parametrize("message", [tags(3.25), scan(3.25)])
def test_lines_there_and_back(message):
    again = message_of(sensor_line(message))
    assert type(again) is type(message)
    for name, value in vars(message).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def changed(message, **fields):
    return json.dumps(json.loads(sensor_line(message)) | fields).encode()


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"{", "no JSON"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * 100_000, "no JSON"),
        (b"3", "no object with a type"),
        (b'{"type": 3}', "no object with a type"),
        (changed(tags(1.0), stamp=None), "detections: stamp is no number"),
        (changed(tags(1.0), stamp=math.nan), "detections: stamp is no number"),
        (changed(tags(1.0), ids=[1.5]), "detections: ids is no list of whole numbers"),
        (changed(tags(1.0), bearing=[math.inf]), "detections: bearing must hold finite numbers"),
        (changed(tags(1.0), ids=[2**63]), "detections: a number is too large"),
        (changed(tags(1.0), range=["2"]), "detections: range is no list of numbers"),
        (changed(tags(1.0), range=[10**400]), "detections: a number is too large"),
        (changed(scan(1.0), ranges=None), "scan: ranges is no list of numbers"),
        (changed(scan(1.0), ranges=[1.0, None, True]), "scan: ranges is no list of numbers"),
        (changed(scan(1.0), range_max=None), "scan: range_max is no number"),
    ],
)
def test_lines_that_are_refused(line, why):
    with pytest.raises(ValueError, match=r".") as error:
        message_of(line)
    assert str(error.value) == why


def test_types_and_keys_that_are_not_known():
    assert message_of(b'{"type": "battery", "volts": 16}') is None
    assert message_of(changed(tags(1.0), colour="red")).ids.tolist() == [7]


class Server:
    """A sensor socket that sends tags and scans at 50 Hz, from a thread; and whatever lines a test adds."""

    def __init__(self, ahead=0.0):
        self._ahead = ahead
        self._socket = SensorSocket()
        self.address = self._socket.address
        self.sent, self.extra, self._stop = [], [], threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._stop.wait(0.02):
            now = time.monotonic() + self._ahead
            while self.extra:
                self._socket.send(self.extra.pop(0))
            self._socket.send(sensor_line(tags(now)))
            self._socket.send(sensor_line(scan(now)))
            self.sent.append(now)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._stop.set()
        self._thread.join()
        self._socket.close()


@pytest.fixture
def server():
    with Server() as server:
        yield server


def until(condition, driver=None):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "in vain"
        if driver is None:
            time.sleep(0.02)
        else:
            driver.spin(0.02)


def test_tags_and_scans_of_one_socket(server):
    """One connection, in a process of its own: nothing is lost while this one holds the interpreter."""
    name = "socket:{}:{}".format(*server.address)
    sources = open_sources({"tags": name, "scan": name}, PRESET)
    source = sources["tags"]
    try:
        assert sources["scan"] is source
        source.take(TagDetections, math.inf)
        source.take(LaserScan, math.inf)
        began = time.monotonic()
        time.sleep(0.2)
        sum(range(60_000_000))  # a builtin lets no other thread run
        until(lambda: source.newest(TagDetections).stamp > began + 0.3)
        middle = began + 0.1
        early, late = source.take(TagDetections, middle), source.take(TagDetections, math.inf)
        assert early[-1].stamp <= middle < late[0].stamp
        stamps = [one.stamp for one in (*early, *late) if one.stamp > began]
        assert stamps == [stamp for stamp in server.sent if began < stamp <= stamps[-1]]
        seen = source.newest(LaserScan)
        np.testing.assert_array_equal(seen.ranges, [1.0, math.inf, math.nan])
        assert not seen.ranges.flags.writeable
    finally:
        source.close()
        source.close()


def test_a_machine_that_can_start_no_process_for_a_while(server, monkeypatch):
    """Descriptors, memory, processes or threads may be used up when a process must be started again."""
    name = "tags of socket:{}:{}".format(*server.address)
    (source,) = open_sources({"tags": name.removeprefix("tags of ")}, PRESET).values()
    lacking = [errno.EMFILE, errno.EMFILE, errno.ENOMEM, errno.EAGAIN]
    start, popen, started = threading.Thread.start, subprocess.Popen, []

    def poor_popen(*arguments, **options):
        if lacking:
            raise OSError(lacking[0], os.strerror(lacking.pop(0)))
        started.append(popen(*arguments, **options))
        return started[-1]

    threadless = ["_read", "_run", "_read"]

    def poor_start(thread):
        if not lacking and threadless and thread._target.__name__ == threadless[0]:
            raise RuntimeError(f"can't start new thread {threadless.pop(0)}")
        start(thread)

    monkeypatch.setattr(sensor_reader, "LONGEST_BACK_OFF", 0.2)
    monkeypatch.setattr(subprocess, "Popen", poor_popen)
    monkeypatch.setattr(threading.Thread, "start", poor_start)
    try:
        os.kill(source._process.pid, signal.SIGKILL)
        said = []
        until(lambda: said.extend(source.take_remarks()) or any("is back" in line for line in said))
        assert not lacking
        assert not threadless
        process = f"the process that reads {name}"
        assert said[0] == f"{process} has ended; it is started again"
        whys = [line.removeprefix(f"{process} does not begin: no process for it can be started: ") for line in said]
        assert [why.removesuffix("; end other programs") for why in whys[1:-1]] == [
            "Too many open files",
            "Cannot allocate memory",
            "Resource temporarily unavailable",
            "can't start new thread _read",
            "can't start new thread _run",
            "can't start new thread _read",
        ]
        now = time.monotonic()
        until(lambda: any(one.stamp > now for one in source.take(TagDetections, math.inf)))
        until(lambda: all(one.poll() is not None for one in started[:-1]))  # none is left over
    finally:
        source.close()


def test_only_what_is_wanted(server):
    driver = SocketDriver(*server.address, (LaserScan,))
    taken = []
    until(lambda: taken.extend(driver.take()) or len(taken) > 3, driver)
    driver.close()
    assert {type(one) for one in taken} == {LaserScan}


def test_malformed_lines_are_counted_and_said_once(server):
    driver = SocketDriver(*server.address, (TagDetections,))
    driver.take()
    server.extra += [b"nonsense\n", b'{"type": "detections"}\n', b'{"type": "odd"}\n']
    until(lambda: driver.refusals.counts.total() >= 2, driver)
    driver.take()
    until(driver.take, driver)
    assert driver.refusals.counts.total() == 2
    address = "{}:{}".format(*server.address)
    assert driver.remarks() == [f"socket:{address}: lines are not used: no JSON"]
    assert driver.remarks() == []
    driver.close()


def test_a_server_with_another_clock(monkeypatch):
    for waits in (socket_sensors, sensor_reader):
        monkeypatch.setattr(waits, "PATIENCE", 1.0)
    with Server(ahead=86400.0) as server:
        with pytest.raises(DeviceError) as error:
            SocketDriver(*server.address, (TagDetections,))
        name = "socket:{}:{}".format(*server.address)
        assert str(error.value).startswith(f"{name}: no detections in 1 s (stamp ")
        assert str(error.value).endswith(" s ahead of this machine's clock): name what serves them")


def test_a_line_without_end(server, monkeypatch):
    monkeypatch.setattr(socket_sensors, "LONGEST_LINE", 5000)
    driver = SocketDriver(*server.address, (TagDetections,))
    server.extra.append(b"x" * 20_000)
    until(driver.refusals.counts.total, driver)
    driver.take()
    until(driver.take, driver)
    driver.close()


def test_nobody_listens():
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    with pytest.raises(DeviceError) as error:
        open_sources({"tags": f"socket:127.0.0.1:{port}"}, PRESET)
    assert str(error.value) == (
        f"socket:127.0.0.1:{port}: Connection refused: start what serves tags and scans there, or name the "
        "HOST:PORT that it prints"
    )


def test_a_server_of_something_else(monkeypatch):
    for waits in (socket_sensors, sensor_reader):
        monkeypatch.setattr(waits, "PATIENCE", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        host, port = listener.getsockname()
        with pytest.raises(DeviceError) as error:
            SocketDriver(host, port, (TagDetections,))
    assert str(error.value) == f"socket:{host}:{port}: no detections in 1 s: name what serves them"


def test_a_connection_that_is_lost_comes_back(server):
    driver = SocketDriver(*server.address, (TagDetections,))
    for client in list(server._socket._clients):
        client.shutdown(socket.SHUT_RDWR)
    said = []
    until(lambda: said.extend(driver.remarks()) or len(said) == 2, driver)
    driver.take()
    until(driver.take, driver)
    driver.close()
    name = "socket:{}:{}".format(*server.address)
    assert said == [
        f"{name}: the connection is lost; start what serves it again, it is looked for",
        f"{name}: connected again",
    ]


def test_a_process_that_ends_or_hangs_is_started_again(server, monkeypatch):
    """What is told of it, and that tags come again; whoever takes meanwhile waits for nothing."""
    monkeypatch.setattr(sensor_source, "_SILENT_LOOKS", 60)
    name = "tags of socket:{}:{}".format(*server.address)
    (source,) = open_sources({"tags": name.removeprefix("tags of ")}, PRESET).values()
    try:
        for number, what in ((signal.SIGKILL, "has ended"), (signal.SIGSTOP, "hangs")):
            before, said = source._process.pid, []
            os.kill(before, number)
            until(lambda said=said: said.extend(source.take_remarks()) or len(said) >= 2)
            process = f"the process that reads {name}"
            assert said == [f"{process} {what}; it is started again", f"{process} is back"]
            assert source._process.pid != before
            now = time.monotonic()
            until(lambda now=now: any(one.stamp > now for one in source.take(TagDetections, math.inf)))
    finally:
        source.close()

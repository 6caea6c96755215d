"""The emulated base: what it says, how it moves, and its pseudo-terminal."""

import json
import os
import select
import socket
import time

import numpy as np
import pytest

from tfg_drake.hardware.emulation.emulator import DELAY, EmulatedBase, Emulator, empty_plane
from tfg_drake.hardware.emulation.sensor_faults import sensor_fault
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki import odometry as o
from tfg_drake.hardware.kobuki.codec import FEEDBACK, Deframer, decode, encode
from tfg_drake.world.world import World, bare_world

WALL = np.array([[1.0, -1.0, 1.0, 1.0]])


@pytest.fixture
def base():
    return EmulatedBase(empty_plane())


def run(base, steps):
    for _ in range(steps):
        base.step()


def test_a_frame_is_as_long_as_the_vendors(base):
    assert len(encode(*base.feedback())) == 81


def test_it_drives_as_told_and_says_so(base):
    base.obey(o.base_control(0.3, 0.5))
    state = None
    for k in range(500):
        base.step()
        core, inertia = base.feedback()[0], base.feedback()[1]
        received = 7.0 + 0.02 * k
        state = o.first(core, inertia, received) if state is None else o.advanced(state, core, inertia, received)
        if k == 0:
            # The first frame is where dead reckoning begins, 4 mm on.
            start = base.pose.copy()
    assert np.hypot(*(base.pose[:2] - start[:2])) > 0.3
    assert pytest.approx(tuple(base.pose - start), abs=3e-3) == state.X_OB
    assert pytest.approx((0.3, 0.5), abs=5e-3) == state.V_B


def test_it_never_stops_by_itself(base):
    base.obey(p.BaseControl(200, 0))
    run(base, 1000)
    assert base.pose[0] == pytest.approx(0.2 * 20.0, abs=0.1)


def test_it_has_the_bases_top_speed(base):
    base.obey(p.BaseControl(2000, 0))
    run(base, 200)
    assert base.state[4] == pytest.approx(0.7)


def test_a_wall_presses_the_bumper():
    base = EmulatedBase(bare_world(WALL, np.array([0.6, 0.0, 0.0])))
    assert base.feedback()[0].bumper == 0
    base.obey(p.BaseControl(200, 0))
    run(base, 200)
    assert base.feedback()[0].bumper == 2
    assert base.pose[0] == pytest.approx(1.0 - 0.18, abs=1e-6)


def test_answers_come_once(base):
    base.obey(p.RequestExtra(0x0B))
    answers = [p.HardwareVersion(4, 0, 1), p.FirmwareVersion(4, 1, 1), p.UniqueId(1, 2, 3)]
    assert base.feedback()[7:] == answers
    assert base.feedback()[7:] == []


def read_frames(device, seconds, least=0, least_bad=0):
    """Frames that the device says, and how many bytes were none; until there are so many, for a minute at most."""
    port, deframer, frames = os.open(device, os.O_RDWR | os.O_NOCTTY), Deframer(), []
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0 or len(frames) < least or deframer.bad < least_bad:
        assert left > -60.0, "in vain"
        left = max(0.0, left) or 0.1
        if select.select([port], [], [], left)[0]:
            frames += [decode(payload, FEEDBACK) for payload in deframer.feed(os.read(port, 4096))]
    os.close(port)
    return frames, deframer.bad


def test_fifty_frames_a_second_and_faults_on_request():
    with Emulator() as emulator:
        frames, bad = read_frames(emulator.device, 1.0, least=21)
        stamps = np.array([frame[0].stamp for frame in frames])
        assert (np.diff(stamps) == 20).all()
        assert bad == 0
        emulator.corrupt = 0.5
        read_frames(emulator.device, 0.5, least_bad=1)
        emulator.corrupt = 0.0
        emulator.silent = True
        time.sleep(0.5)
        read_frames(emulator.device, 0.1)
        assert read_frames(emulator.device, 0.2) == ([], 0)


def test_a_clock_that_is_set_back(base):
    run(base, 150)
    assert base.feedback()[0].stamp == 3000
    base.clock = -2.0
    assert base.feedback()[0].stamp == 1000


@pytest.mark.parametrize("sensor", ["gyro", "encoders"])
def test_what_is_stuck_says_the_same_and_never_what_it_missed(base, sensor):
    def told():
        core, inertia, *_ = base.feedback()
        return (inertia.angle, inertia.rate), (core.left_encoder, core.right_encoder)

    base.obey(o.base_control(0.3, 0.5))
    run(base, 100)
    before = dict(zip(("gyro", "encoders"), told(), strict=True))
    base.stuck.add(sensor)
    run(base, 100)
    after = dict(zip(("gyro", "encoders"), told(), strict=True))
    assert [name for name in before if after[name] == before[name]] == [sensor]
    base.stuck.clear()
    run(base, 1)
    freed = dict(zip(("gyro", "encoders"), told(), strict=True))
    assert 0 < abs(freed[sensor][0] - before[sensor][0]) < 100


def test_frames_that_are_lost_or_late():
    with Emulator() as emulator:
        emulator.lost = 1.0
        time.sleep(0.1)
        read_frames(emulator.device, 0.1)
        assert read_frames(emulator.device, 0.2) == ([], 0)
        emulator.lost, emulator.late = 0.0, 0.3
        frames, bad = read_frames(emulator.device, 2.0)
        steps = np.diff([frame[0].stamp for frame in frames])
        assert bad == 0
        # A late frame comes with its old stamp, between frames that are newer.
        assert (steps < -100).any()
        assert steps.min() >= -(DELAY * 1000 + 20)


def test_commands_are_remembered_with_their_time():
    with Emulator() as emulator:
        port = os.open(emulator.device, os.O_RDWR | os.O_NOCTTY)
        sent = time.monotonic()
        os.write(port, encode(p.BaseControl(100, 0), p.GeneralOutput(0x1F0)))
        while not emulator.commands:
            time.sleep(0.01)
        os.close(port)
        ((received, command),) = emulator.commands
    assert command == p.BaseControl(100, 0)
    assert received >= sent
    assert emulator.base.outputs == 0x1F0


def lines(emulator, count):
    with socket.create_connection(emulator.sensors, timeout=10.0) as client, client.makefile() as stream:
        return [json.loads(stream.readline()) for _ in range(count)]


def test_the_socket_says_what_the_sensors_see():
    world = World(WALL, np.array([5]), np.array([[1.0, 0.0]]), np.array([np.pi]), np.zeros(3))
    with Emulator(world) as emulator:
        assert emulator.sensors[0] == "127.0.0.1"
        begin = time.monotonic()
        seen = lines(emulator, 10)
        end = time.monotonic()
    tags = [line for line in seen if line["type"] == "detections"]
    scans = [line for line in seen if line["type"] == "scan"]
    assert len(tags) == len(scans) == 5
    assert all(begin - 10.0 <= line["stamp"] <= end for line in seen)
    assert np.diff([line["stamp"] for line in tags]) == pytest.approx(0.1)
    assert tags[0]["ids"] == [5]
    assert tags[0]["range"] == pytest.approx([1.0], abs=0.2)
    assert tags[0]["bearing"] == pytest.approx([0.0], abs=0.06)
    assert tags[0]["sigma_range"] == pytest.approx([0.03], abs=0.002)
    middle = len(scans[0]["angles"]) // 2
    assert scans[0]["ranges"][middle] == pytest.approx(1.0, abs=0.1)
    assert scans[0]["ranges"][0] is None
    assert {key for line in seen for key in line} == {
        *("type", "stamp", "ids", "range", "bearing", "sigma_range", "sigma_bearing"),
        *("angles", "ranges", "range_max", "sigma"),
    }


def test_the_socket_says_what_is_left_of_it():
    with Emulator() as emulator:
        emulator.base.faults = {"scan": sensor_fault("scan", "none"), "tags": sensor_fault("tags", "silent")}
        seen = lines(emulator, 3)
    # The first may have been on its way.
    assert [(line["type"], line["ranges"]) for line in seen[2:]] == [("scan", [])]


def test_an_empty_plane_has_nothing_to_see():
    assert len(empty_plane().walls) == 0
    with Emulator() as emulator:
        seen = lines(emulator, 2)
    assert all(line.get("ids", []) == [] for line in seen)
    assert all(distance is None for line in seen for distance in line.get("ranges", []))

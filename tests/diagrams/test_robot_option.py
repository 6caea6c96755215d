"""`explore --robot`: what is refused before anything is connected, and a run driven through once more."""

import json

import pytest

from tfg_drake.storage.port_recording import PortWriter

ROBOTS = "kobuki, ros2, rosbridge"
SOCKETS = ["--tags", "socket:127.0.0.1:1", "--scan", "socket:127.0.0.1:1"]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--robot", "roomba"], f"--robot roomba: no such robot; name one of sim, {ROBOTS}, replay:RUN_DIR"),
        (["--port", "/dev/x"], f"--port /dev/x: is for a real robot; give --robot {ROBOTS} too"),
        (["--tags", "ros2:/tags"], f"--tags ros2:/tags: is for a real robot; give --robot {ROBOTS} too"),
        (["--robot", "kobuki", "--world", "house"], "--world: is for a simulated robot; leave it out"),
        (["--robot", "ros2", "--realtime-rate", "2"], "--realtime-rate: a real robot's time is real; leave it out"),
        (
            ["--robot", "kobuki"],
            "kobuki: no source of scan, without which no robot drives; give --scan rplidar:DEVICE, realsense:, "
            "socket:HOST:PORT or ros2:/TOPIC",
        ),
        (
            ["--robot", "kobuki", "--tags", "socket:localhost:5"],
            "kobuki: no source of scan, without which no robot drives; give --scan rplidar:DEVICE, realsense:, "
            "socket:HOST:PORT or ros2:/TOPIC",
        ),
        (
            ["--robot", "kobuki", "--scan", "socket:127.0.0.1:1"],
            "/dev/kobuki: no such device; plug the base in and switch it on, or name the port it has under"
            " /dev/serial/by-id",
        ),
        (
            ["--robot", "kobuki", "--tags", "serial:x"],
            "serial:x: is no source; name one as ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, "
            "camera:SOURCE, rplidar:DEVICE or realsense:",
        ),
        (
            ["--robot", "kobuki", *SOCKETS],
            "/dev/kobuki: no such device; plug the base in and switch it on, or name the port it has under"
            " /dev/serial/by-id",
        ),
        (
            ["--robot", "rosbridge", "--bridge", "robot"],
            "rosbridge: robot is no HOST:PORT; name the server such as localhost:9090",
        ),
        (["--robot", "replay:nowhere"], "--robot replay:nowhere: there is no scenario.yaml; name the folder of a run"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_one_line(call, arguments, line):
    assert call("explore", "--headless", *arguments) == (2, "", f"tfg-drake: {line}\n")


@pytest.mark.slow
def test_a_run_is_driven_through_once_more(call, room, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    code, _, _ = call("explore", room, "--tag-spacing", "1", "--headless", "--max-time", "7.8", "--out", str(first))
    assert code == 0
    code, out, _ = call("explore", "--robot", f"replay:{first}", "--headless", "--out", str(second), "--json")
    assert code == 0
    summary = json.loads(out.splitlines()[-1])
    assert (summary["outcome"], summary["reason"]) == ("time_limit", "the recording has ended")
    assert summary["world"] == str(first / "scenario.yaml")
    assert summary["stages"] == 1
    for name in ("map.npz", "trajectory.tum", "stages.jsonl"):
        assert (first / name).read_bytes() == (second / name).read_bytes()
    before = (first / "ports.mcap").read_bytes()
    code, _, err = call("explore", "--robot", f"replay:{first}", "--headless", "--out", str(first / "." / ""))
    assert (code, err) == (2, f"tfg-drake: --out {first}: holds the run that is replayed; name another folder\n")
    assert (first / "ports.mcap").read_bytes() == before
    code, _, err = call("explore", "corridor", "--robot", f"replay:{first}", "--headless", "--out", str(second))
    line = f"that run's world is another; leave the scenario out, or base it on {first / 'scenario.yaml'}"
    assert (code, err) == (2, f"tfg-drake: --robot replay:{first}: {line}\n")
    (first / "ports.mcap").unlink()
    code, _, err = call("explore", "--robot", f"replay:{first}", "--headless", "--out", str(second))
    line = f"{first / 'ports.mcap'}: no such file; name the folder of a run that was recorded"
    assert (code, err) == (2, f"tfg-drake: {line}\n")


def test_what_a_real_robot_recorded_is_not_written_over(call, tmp_path):
    PortWriter(tmp_path / "ports.mcap", "kobuki").close()
    before = (tmp_path / "ports.mcap").read_bytes()
    code, _, err = call("explore", "house", "--headless", "--max-time", "1", "--out", str(tmp_path))
    line = f"--out {tmp_path}: holds the run of a real robot (kobuki), which nothing brings back; name another"
    assert (code, err) == (2, f"tfg-drake: {line}\n")
    assert (tmp_path / "ports.mcap").read_bytes() == before

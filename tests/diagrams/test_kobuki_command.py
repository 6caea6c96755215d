"""tfg-drake kobuki, as a user calls it."""

import signal
import socket
import subprocess
import sys

import pytest


def test_emulate_prints_device_and_address_and_ends_with_ctrl_c():
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "kobuki", "emulate", "--world", "corridor"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        device, address = process.stdout.readline().strip(), process.stdout.readline().strip()
        with open(device, "rb", buffering=0) as port:
            assert b"\xaa\x55" in port.read(300)
        host, port = address.split(":")
        with socket.create_connection((host, int(port)), timeout=10.0) as client:
            assert client.recv(10).startswith(b'{"type":')
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=10.0)
        assert (process.returncode, *rest) == (0, "\n", "")
    finally:
        process.kill()
        process.wait()


def test_an_unknown_world(call):
    code, out, err = call("kobuki", "emulate", "--world", "nowhere")
    assert (code, out) == (2, "")
    assert err.startswith("tfg-drake: nowhere: no such file or scenario; name a YAML file or one of corridor,")


@pytest.mark.parametrize("command", ["emulate"])
def test_help(call, command):
    code, out, _ = call("kobuki", command, "--help")
    assert code == 0
    assert "Usage: tfg-drake kobuki" in out

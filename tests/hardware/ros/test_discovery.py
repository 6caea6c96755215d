"""The emulated robot and who drives it keep to their machine: two machines, made of namespaces of the network."""

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

HERE = Path(__file__).parent
EMULATE = ["-m", "tfg_drake.diagrams.cli", "ros2", "emulate", "corridor"]


def ip(*arguments):
    return subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True).stdout


class Machine:
    """A namespace of the network, named after this process, with an address of its own."""

    def __init__(self, number):
        self.name, self.link, self.number = f"tfg{number}-{os.getpid()}", f"tfg{number}v{os.getpid()}", number
        ip("netns", "add", self.name)

    def connect(self):
        ip("-n", self.name, "address", "add", f"10.99.0.{self.number}/24", "dev", self.link)
        for link in ("lo", self.link):
            ip("-n", self.name, "link", "set", link, "up")

    def connected(self):
        """Whether its end of the cable can be used: ROS looks only when it begins."""
        state = ip("-n", self.name, "address", "show", "dev", self.link)
        return "state UP" in state and "tentative" not in state

    def start(self, stack, *command, **own):
        """A Python process that says what it is asked by a line, while the stack is open."""
        unset = {key: value for key, value in os.environ.items() if key != "ROS_AUTOMATIC_DISCOVERY_RANGE"}
        process = subprocess.Popen(
            ["ip", "netns", "exec", self.name, sys.executable, *map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=unset | {"ROS_DOMAIN_ID": "0"} | own,
        )
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process


@pytest.fixture
def machines():
    """Two machines with a cable between them: `here` and `there`."""
    pytest.importorskip("rclpy", reason="rclpy is not installed")
    with ExitStack() as stack:
        made = []
        try:
            for number in (1, 2):
                made.append(Machine(number))
                stack.callback(ip, "netns", "delete", made[-1].name)
            here, there = made
            ip("link", "add", here.link, "netns", here.name, "type", "veth", "peer", there.link, "netns", there.name)
            here.connect()
            there.connect()
            wait_for(lambda: here.connected() and there.connected())
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"namespaces of the network need root and iproute2: {error}")
        yield SimpleNamespace(here=here, there=there)


def ask(process):
    process.stdin.write("report\n")
    process.stdin.flush()
    line = process.stdout.readline()
    while not line.startswith("{"):
        assert line, "it has ended"
        line = process.stdout.readline()
    return json.loads(line)


def wait_for(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.1)


def driven(machines, stack, **own):
    """A robot on another machine, and one in the same, once an explorer of `own` environment drives the emulator."""
    others = [machine.start(stack, HERE / "bystander.py") for machine in (machines.there, machines.here)]
    emulator = machines.here.start(stack, *EMULATE, **own)
    before = ask(emulator)["pose"]
    machines.here.start(stack, HERE / "driving_parent.py", **own)
    wait_for(lambda: ask(emulator)["pose"] != before)
    # Where everybody looks in the network, the one on the same machine has found them: so could have the other.
    wait_for(lambda: ask(others[1])["commands"] > 50)
    return others[0]


def test_nothing_leaves_the_machine(machines):
    with ExitStack() as stack:
        assert ask(driven(machines, stack)) == {"commands": 0, "published": []}


@pytest.mark.slow
def test_whoever_wants_the_network_has_it(machines):
    with ExitStack() as stack:
        there = driven(machines, stack, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
        wait_for(lambda: ask(there)["commands"] > 50)
        # It finds one after the other.
        wait_for(lambda: ask(there)["published"] == ["/odom", "/scan", "/cmd_vel"])


def test_the_network_is_an_option_of_the_emulator(machines):
    with ExitStack() as stack:
        there = machines.there.start(stack, HERE / "bystander.py")
        machines.here.start(stack, *EMULATE, "--network")
        wait_for(lambda: ask(there)["published"] == ["/odom", "/scan"])

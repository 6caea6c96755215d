"""`tfg-drake explore --robot kobuki` in a process, and what it tells an emulated base's wheels."""

import subprocess
import sys
import threading
import time

import pytest


class Explorer:
    """`tfg-drake explore --robot kobuki` in a process, whose lines are awaited and whose keys are pressed."""

    def __init__(self, emulator, folder, max_time, *options, tags=True):
        """tags: it has a source of them, too."""
        host, port = emulator.sensors
        source = f"socket:{host}:{port}"
        arguments = ["--port", emulator.device, "--scan", source, "--out", str(folder)]
        arguments += ["--tags", source] if tags else []
        arguments += ["--headless", "--max-time", str(max_time)]
        arguments += ["--set", "explorer.first_look=2", "--set", "explorer.first_turns=1", *options]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", "--robot", "kobuki", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines, self._seen = [], 0
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def wait_for(self, words, goes_on=False):
        """Waits for a line that has not been waited for before. goes_on: a base that was locked meanwhile, as a busy
        machine may have it, is enabled anew."""
        while self._listener.is_alive() or self._seen < len(self.lines):
            if self._seen == len(self.lines):
                time.sleep(0.02)
                continue
            line = self.lines[self._seen]
            self._seen += 1
            if words in line:
                return
            if goes_on and "until it is enabled anew" in line:
                self.press("e")
        pytest.fail("\n".join(["the explorer ended before it said " + words, *self.lines]))

    def press(self, key):
        self.process.stdin.write(key)
        self.process.stdin.flush()


def wait_until(condition, complaint, seconds=60.0):
    """How long something takes a busy machine may not matter."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            pytest.fail(complaint)
        time.sleep(0.05)


def moves(emulator, since, seconds=60.0):
    """Waits until the wheels have been told to turn."""
    told = lambda: any(when >= since and one.speed for when, one in list(emulator.commands))  # noqa: E731
    wait_until(told, "the robot does not move", seconds)


def stands(emulator, since):
    """Waits until the wheels have been told to stand for 0.8 s; when they were told so."""
    stop = lambda: max([since, *(when for when, one in list(emulator.commands) if one.speed)])  # noqa: E731
    wait_until(lambda: time.monotonic() - stop() > 0.8, "the robot does not stand")
    return stop()

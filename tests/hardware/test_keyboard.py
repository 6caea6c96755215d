"""The operator's keyboard, on a terminal and on a pipe."""

import os
import termios
import time

import pytest

from tfg_drake.hardware.keyboard import KEYS, Keyboard
from tfg_drake.mission import manual_drive


def requests(keyboard, count):
    """As many requests as are expected, or what came within half a minute."""
    taken, end = [], time.monotonic() + 30.0
    while len(taken) < count and time.monotonic() < end:
        taken += keyboard.requests()
        time.sleep(0.005)
    return taken


def test_keys_on_a_pipe():
    read, write = os.pipe()
    keyboard = Keyboard(KEYS, read)
    os.write(write, b"e\nx P sq")
    assert requests(keyboard, 6) == ["enable", "stop", "pause", "stop", "stop", "end"]
    keyboard.close()
    os.close(write)
    os.close(read)


def test_a_terminal_gives_keys_without_enter_and_is_given_back():
    master, slave = os.openpty()
    before = termios.tcgetattr(slave)
    keyboard = Keyboard(KEYS, slave)
    assert termios.tcgetattr(slave) != before
    os.write(master, b"e")
    assert requests(keyboard, 1) == ["enable"]
    keyboard.close()
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("wait", [0.0, 0.05])
def test_the_end_of_the_input_ends_nothing_else(wait):
    read, write = os.pipe()
    keyboard = Keyboard(KEYS, read)
    os.close(write)
    time.sleep(wait)
    assert keyboard.requests() == []
    keyboard.close()
    os.close(read)


def test_arrows_are_keys_of_three_characters():
    read, write = os.pipe()
    keyboard = Keyboard(manual_drive.KEYS, read)
    os.write(write, b"\x1b[Aw\x1b[D l")
    assert requests(keyboard, 5) == ["forward", "forward", "left", "halt", "look"]
    keyboard.close()
    os.close(write)
    os.close(read)

"""What a command says of itself while it works."""

import re
import time

import numpy as np

from tfg_drake.diagrams import screen


def lines(capsys, count):
    """The first lines that are written, as many as these."""
    written = ""
    while written.count("\n") < count:
        time.sleep(0.01)
        written += capsys.readouterr().out
    return written.splitlines()[:count]


def test_what_takes_long_is_said_again(capsys, monkeypatch):
    monkeypatch.setattr(screen, "INTERVAL", 0.05)
    with screen.Screen() as show:
        show("thinking")
        assert all(re.fullmatch(r"thinking \(\d+ s so far\)", line) for line in lines(capsys, 3)[1:])
        show("writing")
        written = lines(capsys, 1)
        while not re.fullmatch(r"writing \(\d+ s so far\)", written[-1]):
            written += lines(capsys, 1)
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().out == ""


def test_a_line_is_written_whole(monkeypatch):
    """Two writes a line, as print has them, let a line of another thread in."""
    written = []
    monkeypatch.setattr(screen.sys, "stdout", type("Stream", (), {"write": written.append, "flush": lambda: None}))
    screen.say("page: here")
    assert written == ["page: here\n"]


def test_what_is_soon_done_is_not_said(capsys, monkeypatch):
    monkeypatch.setattr(screen, "INTERVAL", 1e6)
    with screen.Screen() as show:
        for share in range(100):
            show(f"{share} %")
    assert capsys.readouterr().out == ""


def test_a_terminal_has_one_line(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    with screen.Screen() as show:
        show("thinking")
        assert show.line() == "thinking"
    assert "\nthinking" not in capsys.readouterr().out


def test_the_seconds_are_those_of_the_work_not_of_how_far_it_is(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    shown = screen.Screen()  # without its thread
    shown("compiling, about 2 min left")
    now[0] = 40.0
    shown("compiling, about 1 min left")
    assert shown.line() == "compiling, about 1 min left (40 s so far)"
    shown("loading")
    assert shown.line() == "loading"


def test_long_work_takes_few_lines(capsys, monkeypatch):
    """Twenty minutes by a clock of the test's own."""
    now = [0.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    shown = screen.Screen()  # without its thread
    times = []
    for now[0] in np.arange(0.0, 1200.0, 0.5).tolist():
        shown(f"{now[0]} s")
        times += [now[0]] * capsys.readouterr().out.count("\n")
    assert 20 < len(times) < 45
    assert times[0] == 2.0
    assert max(np.diff(times)) <= 60.5

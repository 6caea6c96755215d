"""The picture may fail, and any web page may press its buttons: a mission goes on, and no wheel starts."""

import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.systems.web_page import WebPage
from tfg_drake.mission.operation import Operation, requested
from tfg_drake.systems import picture as module
from tfg_drake.systems.meshcat_buttons import MeshcatButtons
from tfg_drake.systems.picture import Picture, open_meshcat
from tfg_drake.systems.visualizer import TfgVisualizer

MALFORMED = b"\xc1"


@pytest.fixture
def picture(monkeypatch):
    monkeypatch.setattr(module, "PAUSE", 0.05)
    return Picture(open_meshcat())


def until(condition):
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def asked(buttons, page, *names):
    """The requests that come of a page's clicks, the last of which is a STOP."""
    for name in names:
        page.click(name)
    requests = []

    def stopped():
        requests.extend(buttons.requests())
        return "stop" in requests

    until(stopped)
    return requests


def test_no_page_starts_the_wheels(picture):
    buttons = MeshcatButtons(picture)
    page = WebPage(picture.meshcat.port())
    assert page.answer.startswith("HTTP/1.1 101")  # Meshcat asks nobody where he comes from.
    names = ["Enable", "Pause", "Pause / resume", "Pause", "Resume", "enable", "STOP"]
    operation = requested(requested(Operation(), "enable"), "pause")
    for request in asked(buttons, page, *names):
        operation = requested(operation, request)
    assert operation.enabling == 0
    assert operation.enablings == 1
    assert operation.paused


def test_pressing_pause_twice_is_not_resuming(picture):
    buttons = MeshcatButtons(picture)
    page = WebPage(picture.meshcat.port())
    requests = asked(buttons, page, "Pause", "Pause", "STOP")
    assert sorted(requests) == ["hold", "hold", "stop"]


def test_a_lost_picture_comes_back_with_its_scene_and_its_buttons(picture, caplog):
    port = picture.meshcat.port()
    buttons = MeshcatButtons(picture)
    simulator = Simulator(TfgVisualizer(picture, None, np.zeros(3), 0.18, "test"))
    simulator.AdvanceTo(0.5)
    page = WebPage(port)
    page.send(MALFORMED)

    def back():
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.25)
        return picture.opened == 2

    until(back)
    assert picture.meshcat.port() == port
    for path in ("caption", "map/robot", "truth"):
        assert picture.meshcat.HasPath(f"/tfg/{path}"), path
    assert buttons.requests() == []  # They are there again before anybody presses them.
    page = WebPage(port)
    assert asked(buttons, page, "Enable", "STOP") == ["stop"]
    remarks = [record.getMessage() for record in caplog.records if record.name == "tfg_drake.picture"]
    reason = "Meshcat's internal websocket thread exited unexpectedly"
    assert remarks == [
        f"the picture is lost: {reason}; the mission goes on, STOP is on the terminal (space)",
        f"the picture is back at http://localhost:{port}",
    ]


def test_whatever_drawing_raises_is_the_pictures_end_and_not_the_missions(picture):
    def fail():
        raise ValueError("no such colour")

    assert picture.attempt(fail, "nothing") == "nothing"
    assert picture.attempt(lambda: "drawn", "nothing") == "nothing"
    until(lambda: picture.attempt(lambda: "drawn", "nothing") == "drawn")
    assert picture.opened == 2


def test_a_port_that_is_taken_meanwhile_is_tried_again_and_again(picture, monkeypatch):
    tried = []

    def fail(port):
        tried.append(port)
        raise RuntimeError("Meshcat failed to open a websocket port.")

    monkeypatch.setattr(module, "open_meshcat", fail)
    port = picture.meshcat.port()
    assert picture.attempt(lambda: 1 // 0, 0) == 0
    until(lambda: picture.attempt(lambda: 1, 0) == 0 and len(tried) == 2)
    assert tried == [port, port]

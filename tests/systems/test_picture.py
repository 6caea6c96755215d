"""The picture in Meshcat may fail: a mission goes on."""

import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.systems.web_page import WebPage
from tfg_drake.systems import picture as module
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


def test_a_lost_picture_comes_back_with_its_scene(picture, caplog):
    port = picture.meshcat.port()
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
    remarks = [record.getMessage() for record in caplog.records if record.name == "tfg_drake.picture"]
    reason = "Meshcat's internal websocket thread exited unexpectedly"
    assert remarks == [
        f"the picture is lost: {reason}; the mission goes on",
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

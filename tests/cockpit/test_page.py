"""The page as a file: whole, and of nothing but itself."""

import base64
import re

import pytest

from benchmarks.timelines import read_timeline
from tfg_drake.cockpit.page import RECORDED, export_page, served_page, whole_page


def test_the_whole_page_holds_viewer_and_timeline(mission, tmp_path):
    out = tmp_path / "mission.html"
    export_page(mission, out, "a <room>", "/* viewer */")
    page = out.read_text()
    assert "/* viewer */" in page
    (data,) = re.findall(r'<script id="data" type="text/plain">([^<]*)</script>', page)
    assert base64.b64decode(data) == mission.read_bytes()
    assert "<title>a &lt;room&gt;</title>" in page


@pytest.mark.parametrize("page", [served_page("room", {"live": True}), whole_page("room", b"", "")])
def test_nothing_is_asked_of_a_network_and_nothing_is_left_out(page):
    assert not re.findall(r"(?:src|href)=[\"'](?!viewer\.js|data:)[^\"']*|https?://|@import", page)
    assert not re.findall(r"{{\w+}}", page)
    for name in ("const COLOURS", "class Timeline", "#slider"):
        assert name in page


def test_without_a_timeline_there_is_no_page(tmp_path):
    file, out = tmp_path / "timeline.tfg", tmp_path / "mission.html"
    with pytest.raises(FileNotFoundError):
        export_page(file, out, "", "")
    assert not out.exists()


def test_the_recorded_mission_is_whole_small_and_of_no_machine():
    records = read_timeline(RECORDED)
    layers = {record.layer for record in records}
    assert {"world", "pose", "truth", "scan", "map", "tfg", "frontiers", "goal", "path", "mission"} <= layers
    assert "end" not in layers  # Its card has the folder, and lies over the picture.
    (world,) = (record for record in records if record.layer == "world")
    assert world.told["title"] == "recorded: house, seed 3"
    last = [record for record in records if record.layer == "mission"][-1]
    assert last.told["outcome"] == "complete"
    assert len([record for record in records if record.layer == "map"][-1].arrays["ids"]) == 120
    assert RECORDED.stat().st_size < 300e3

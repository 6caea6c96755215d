"""A run's page, by the commands view and export."""

import re
import signal
import subprocess
import sys
import urllib.request

import pytest

from tests.cockpit.conftest import write_mission
from tfg_drake.diagrams.commands.view import is_under_way
from tfg_drake.diagrams.missions.run_folder import claimed
from tfg_drake.io.extras import pip_install


@pytest.fixture
def run_dir(tmp_path):
    write_mission(tmp_path / "timeline.tfg")
    return tmp_path


def test_a_run_is_exported_as_one_page(call, run_dir, tmp_path):
    out = tmp_path / "page.html"
    assert call("export", run_dir, out) == (0, "", "")
    page = out.read_text()
    assert "MeshCat" in page  # Drake's viewer is in it.
    assert len(page) < 3e6


def test_without_a_browser_it_says_how_to_get_one(call, run_dir, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    complaint = "chromium or its driver is missing: apt-get install chromium chromium-driver"
    assert call("export", run_dir, run_dir / "page.gif")[::2] == (2, f"tfg-drake: {complaint}\n")
    monkeypatch.setattr("shutil.which", lambda name: name)
    monkeypatch.setitem(sys.modules, "selenium", None)
    complaint = f"the package selenium is missing: {pip_install('film')}"
    assert call("export", run_dir, run_dir / "page.gif")[::2] == (2, f"tfg-drake: {complaint}\n")
    assert not (run_dir / "page.gif").exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("export {0} page.png", "page.png: unknown format; name a file that ends in .html, .gif or .mp4"),
        (
            "export {0}/nowhere page.html",
            "{0}/nowhere: no such file; name the folder of a run that was recorded",
        ),
        ("export {0} {0}/nowhere/page.html", "{0}/nowhere/page.html: cannot be written: no such file or directory"),
        ("export {0}/other page.html", "{0}/other: is no timeline of this version; run the mission again"),
        ("view {0}/other", "{0}/other: is no timeline of this version; run the mission again"),
        ("view {0} --port 0", "port 0: must be between 1 and 65535"),
        ("view {0} --host 203.0.113.9", "203.0.113.9: the page cannot be served there: {1}; name another"),
    ],
)
def test_bad_input(call, run_dir, arguments, complaint):
    (run_dir / "other").write_bytes(b"PNG")
    code, out, err = call(*arguments.format(run_dir).split())
    assert (code, out) == (2, "")
    assert err == f"tfg-drake: {complaint.format(run_dir, 'cannot assign requested address')}\n"


def test_view_serves_a_run_until_nobody_wants_it_any_more(run_dir):
    command = [sys.executable, "-u", "-m", "tfg_drake.diagrams.cli", "view", str(run_dir)]
    with claimed(run_dir):  # As by a mission that is under way.
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            address = re.fullmatch(r"page: (http://localhost:\d+/)\n", process.stdout.readline())[1]
            assert process.stdout.readline() == "The scene stays open until Ctrl-C.\n"
            page = urllib.request.urlopen(address, timeout=30).read().decode()
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
    assert '"live": true, "controls": false' in page


def test_a_run_that_nobody_works_on_has_ended(run_dir):
    assert not is_under_way(run_dir)
    with claimed(run_dir):
        assert is_under_way(run_dir)

"""The reference is built from the docstrings, with the ports of each system and the diagrams."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"


@pytest.fixture
def port_diagram():
    pytest.importorskip("docutils", reason="Sphinx is not installed: pip install 'tfg-drake[docs]'")
    specification = importlib.util.spec_from_file_location("port_diagram", REFERENCE / "port_diagram.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_a_system_is_drawn_with_its_ports(port_diagram):
    table = port_diagram.port_table("name: Mapper\ninput_ports:\n- scan\n- <tags>\noutput_ports:\n- map")
    rows = table.splitlines()[1:-1]
    assert len(rows) == 2
    assert [word in rows[0] for word in ("scan", 'rowspan="2"', "Mapper", "map")] == [True] * 4
    assert "&lt;tags&gt;" in rows[1]


def test_a_system_without_inputs_is_drawn_too(port_diagram):
    assert port_diagram.port_table("name: Source\noutput_ports:\n- y").count("<tr>") == 1


@pytest.mark.slow
def test_the_reference_is_built(tmp_path):
    pytest.importorskip("sphinx", reason="Sphinx is not installed: pip install 'tfg-drake[docs]'")
    command = [sys.executable, str(REFERENCE / "build.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    pages = {path.name: path.read_text() for path in (tmp_path / "html").glob("*.html")}
    assert not [name for name, text in pages.items() if "TypeAliasForwardRef" in text]
    start = re.sub("<[^>]+>", "", pages["index.html"])
    for word in ("tfg-drake explore house", "house.advance(540.0)", "load_run(folder", "fork(run", "By folder"):
        assert word in start
    systems = (tmp_path / "html" / "tfg_drake.systems.html").read_text()
    assert "&rarr; velocity_commanded" in systems or "→ velocity_commanded" in systems
    drawn = sorted(path.name for path in (tmp_path / "html" / "_images").glob("*.svg"))
    if shutil.which("dot") is None:
        assert "the diagrams are left out" in done.stdout
    else:
        assert drawn == ["explorer.svg", "mission.svg", "station.svg"]

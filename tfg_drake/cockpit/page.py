"""The page of a mission as HTML: by itself, with all that it shows, or as the server's, which tells it the rest."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

from tfg_drake.io.files import write_atomic
from tfg_drake.pictures.layers import LOOKS
from tfg_drake.pictures.palette import DARK, GAINS, LIGHT, css

FILE_NAME = "mission.html"
# The mission that is shown until the first one begins: a timeline, made by benchmarks/recorded_mission.py.
RECORDED = Path(__file__).with_name("recorded.tfg")
# The files of the page's script in the order in which they are read.
SCRIPT = """stop timeline scene shapes robot still layers free_space trails series cameras picture
panels plots controls operator driving keep_out fork"""
# Content security policy: only the page's own scripts run, whatever a run's files hold, and nothing else is loaded.
_POLICY = """default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; connect-src 'self'; base-uri 'none';
form-action 'none'; script-src"""


def served_page(title: str, source: dict[str, Any]) -> str:
    """The page that asks its server for viewer and timeline.

    Args:
        title: above it until the timeline gives another one.
        source: "live": whether the mission may still be under way; "rate": of a simulated one the speed of its clock,
            times real time, 0 for no limit; "recorded": it is another mission, played until the server has its own.
    """
    return _page(title, source, '<script src="viewer.js"></script>')


def whole_page(title: str, timeline: bytes, viewer: str) -> str:
    """The page that needs nothing else.

    Args:
        title: above it until the timeline gives another one.
        timeline: the file's bytes, see tfg_drake.storage.timeline.
        viewer: the script of Meshcat's viewer that Drake ships.
    """
    data = base64.b64encode(timeline).decode()
    return _page(title, None, f'<script id="data" type="text/plain">{data}</script><script>{viewer}</script>')


def export_page(timeline: Path, out: Path, title: str, viewer: str) -> None:
    """Write a timeline's page as one file. Raises OSError where it cannot be read, or the page cannot be written."""
    write_atomic(out, whole_page(title, timeline.read_bytes(), viewer), durable=False)


def viewer_script() -> str:
    """Meshcat's viewer, as Drake ships it; Drake is not loaded for it."""
    script = distribution("drake").locate_file("pydrake/share/drake/geometry/meshcat.js")
    return Path(str(script)).read_text(encoding="utf-8")


def _page(title: str, source: dict[str, Any] | None, data: str) -> str:
    folder = files(__package__)
    colours = {
        "light": {name: css(colour) for name, colour in LIGHT._asdict().items()},
        "dark": {name: css(colour) for name, colour in DARK._asdict().items()},
        "gains": [css(colour) for colour in GAINS],
    }
    parts = {
        "TITLE": html.escape(title),
        "STYLE": (folder / "page.css").read_text(encoding="utf-8"),
        "COLOURS": json.dumps(colours),
        "LOOKS": json.dumps({name: {"size": look.size, "high": look.high} for name, look in LOOKS.items()}),
        "SOURCE": json.dumps(source),
        "SCRIPT": "\n".join(
            (folder / "script" / f"{name}.js").read_text(encoding="utf-8") for name in [*SCRIPT.split(), "begin"]
        ),
        "DATA": data,
    }
    empty = (folder / "page.html").read_text(encoding="utf-8")
    page = re.sub("{{(?!POLICY)(\\w+)}}", lambda found: parts[found[1]], empty)
    hashes = [hashlib.sha256(one.encode()).digest() for one in re.findall("<script>(.*?)</script>", page, re.DOTALL)]
    allowed = [f"'sha256-{base64.b64encode(one).decode()}'" for one in hashes] + ["'self'"] * (source is not None)
    return page.replace("{{POLICY}}", " ".join((_POLICY, *allowed)), 1)

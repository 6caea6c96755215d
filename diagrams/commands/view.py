"""Shows and exports a run's folder."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from tfg_drake.cockpit.browser import write_gif, write_mp4
from tfg_drake.cockpit.page import export_page, viewer_script
from tfg_drake.diagrams.commands.command_line import bad_input, wait_for_enter, writing
from tfg_drake.diagrams.commands.fork import PageForks, can_fork
from tfg_drake.diagrams.missions.page import open_page
from tfg_drake.diagrams.missions.run_folder import claimed
from tfg_drake.diagrams.screen import Screen
from tfg_drake.io.files import of_run, read_bytes, reading
from tfg_drake.storage.timeline import FILE_NAME, MAGIC

_FILMS = {".gif": write_gif, ".mp4": write_mp4}


def serve_run(run: Path, host: str, port: int | None) -> None:
    """Serve the page of a run until the user has seen enough. Raises BadInput where there is nothing to serve."""
    live = is_under_way(run)
    forks = PageForks(run) if not live and can_fork(run) else None
    given: dict[str, Any] = {"timeline": _timeline(run), "live": live, "controls": False, "forks": forks}
    with open_page(run.resolve().name, host, port, **given):
        try:
            wait_for_enter()
        finally:
            if forks is not None:
                forks.close()


def export_run(run: Path, out: Path) -> None:
    """Write a run as one page or, in a browser, as a film. Raises BadInput where that cannot be."""
    suffix = out.suffix.lower()
    if suffix not in (".html", *_FILMS):
        bad_input(f"{out}: unknown format; name a file that ends in .html, .gif or .mp4")
    timeline = _timeline(run)
    with writing(out):
        if suffix in _FILMS:
            _film(timeline, out, run.resolve().name)
        else:
            export_page(timeline, out, run.resolve().name, viewer_script())


def _film(timeline: Path, out: Path, title: str) -> None:
    with tempfile.TemporaryDirectory() as folder, Screen() as show:
        page = Path(folder) / "page.html"
        export_page(timeline, page, title, viewer_script())
        _FILMS[out.suffix.lower()](page, out, show)


def _timeline(run: Path) -> Path:
    timeline = of_run(run, FILE_NAME)
    with reading(timeline):
        begins = read_bytes(timeline, len(MAGIC))
    if begins != MAGIC:
        bad_input(f"{timeline}: is no timeline of this version; run the mission again")
    return timeline


def is_under_way(run: Path) -> bool:
    """True while a mission writes the run."""
    try:
        with claimed(run if run.is_dir() else run.parent):
            return False
    except OSError:
        return True

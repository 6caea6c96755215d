"""`tfg-drake view` and `tfg-drake export`: show a run on a page, or write it as a page or a video."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, writing
from tfg_drake.diagrams.missions.run_folder import claimed
from tfg_drake.diagrams.screen import Screen
from tfg_drake.io.files import of_run, read_bytes, reading


def view(run: command.RunArgument, host: command.Host = "localhost", port: command.PagePort = None) -> None:
    """Show a finished or running mission on a page, with a slider for the time."""
    from tfg_drake.cockpit.page_forks import PageForks
    from tfg_drake.diagrams.missions.page import open_page

    live = is_under_way(run)
    forks = PageForks(run) if not live and can_fork(run) else None
    given: dict[str, Any] = {"timeline": _timeline(run), "live": live, "controls": False, "forks": forks}
    with open_page(run.resolve().name, host, port, **given):
        try:
            command.wait_for_enter()
        finally:
            if forks is not None:
                forks.close()


def export(
    run: command.RunArgument, out: Annotated[Path, argument("OUT", "The file to write: .html, .gif, .mp4.")]
) -> None:
    """Write a mission as a self-contained page with a slider for the time, or as a video."""
    from tfg_drake.cockpit.browser import write_gif, write_mp4
    from tfg_drake.cockpit.page import export_page, viewer_script

    films, suffix, title = {".gif": write_gif, ".mp4": write_mp4}, out.suffix.lower(), run.resolve().name
    if suffix not in (".html", *films):
        bad_input(f"{out}: unknown format; name a file that ends in .html, .gif or .mp4")
    timeline = _timeline(run)
    with writing(out):
        if suffix == ".html":
            export_page(timeline, out, title, viewer_script())
            return
        with tempfile.TemporaryDirectory() as folder, Screen() as show:
            page = Path(folder) / "page.html"
            export_page(timeline, page, title, viewer_script())
            films[suffix](page, out, show)


def _timeline(run: Path) -> Path:
    from tfg_drake.storage.timeline import FILE_NAME, MAGIC

    timeline = of_run(run, FILE_NAME)
    with reading(timeline):
        begins = read_bytes(timeline, len(MAGIC))
    if begins != MAGIC:
        bad_input(f"{timeline}: is no timeline of this version; run the mission again")
    return timeline


def is_under_way(run: Path) -> bool:
    """Return True while a mission writes the run."""
    try:
        with claimed(run if run.is_dir() else run.parent):
            return False
    except OSError:
        return True


def can_fork(run: Path) -> bool:
    """Return True if the folder holds a run that can be forked at its first stage; see `forkable`."""
    from tfg_drake.diagrams.missions.fork import forkable

    try:
        forkable(run, 1)
        return True
    except BadInput:
        return False

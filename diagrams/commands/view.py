"""What the commands view and export do with a run's folder."""

from __future__ import annotations

from pathlib import Path

from tfg_drake.cockpit.page import export_page
from tfg_drake.diagrams.commands.command_line import bad_input, wait_for_enter
from tfg_drake.diagrams.commands.page import open_page
from tfg_drake.diagrams.missions.run import viewer_script
from tfg_drake.diagrams.missions.run_folder import claimed
from tfg_drake.storage.timeline import FILE_NAME, MAGIC, TimelineError


def serve_run(run: Path, host: str, port: int | None) -> None:
    """Serve the page of a run until the user has seen enough. Raises BadInput where there is nothing to serve."""
    given = {"timeline": _timeline(run), "live": is_under_way(run), "controls": False}
    with open_page(run.resolve().name, host, port, **given):
        wait_for_enter()


def export_run(run: Path, out: Path) -> None:
    """Write the page of a run as one file. Raises BadInput where that cannot be."""
    if out.suffix.lower() not in (".html", ".htm"):
        bad_input(f"{out}: unknown format; name a file that ends in .html")
    try:
        export_page(_timeline(run), out, run.resolve().name, viewer_script())
    except TimelineError as error:
        bad_input(str(error))
    except OSError as error:
        bad_input(f"{out}: cannot be written: {(error.strerror or str(error)).lower()}")


def _timeline(run: Path) -> Path:
    timeline = run / FILE_NAME if run.is_dir() else run
    try:
        with timeline.open("rb") as file:
            begins = file.read(len(MAGIC))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        bad_input(f"{timeline}: {reason}; name the folder of a mission that this version has recorded")
    if begins != MAGIC:
        bad_input(f"{timeline}: is no timeline of this version; run the mission again")
    return timeline


def is_under_way(run: Path) -> bool:
    """Whether a mission is writing the run."""
    try:
        with claimed(run if run.is_dir() else run.parent):
            return False
    except OSError:
        return True

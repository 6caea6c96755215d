"""`tfg-drake map`: what is in a saved map, a look at it, and other formats. Needs no Drake."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tfg_drake.diagrams.commands.command_line import bad_input, wait_for_enter, writing
from tfg_drake.diagrams.commands.screen import Screen
from tfg_drake.io.files import of_run

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap

SUFFIXES = (".g2o", ".csv", ".png", ".pdf", ".html")


def _map_file(path: Path) -> Path:
    return of_run(path, "map.npz")


MapArgument = Annotated[Path, typer.Argument(metavar="MAP", help="A map or the folder of a run.", callback=_map_file)]

map_app = typer.Typer(add_completion=False, rich_markup_mode=None)


@map_app.callback()
def _commands() -> None:
    """Look at a saved map, or write it in another format."""


@map_app.command()
def info(map_file: MapArgument) -> None:
    """Say what is in a map."""
    from rich.console import Console
    from rich.table import Table

    from tfg_drake.mapfile.summary import map_rows

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in map_rows(_load(map_file), map_file.stat().st_size):
        table.add_row(name, value)
    Console(highlight=False).print(table)


@map_app.command()
def view(map_file: MapArgument) -> None:
    """Show a map in the browser."""
    from tfg_drake.diagrams.commands.page import open_page

    saved = _load(map_file)
    with (
        _timeline(saved, map_file) as timeline,
        open_page(map_file.name, "localhost", None, timeline=timeline, live=False, controls=False),
    ):
        wait_for_enter()


@map_app.command()
def export(
    map_file: MapArgument,
    out: Annotated[Path, typer.Argument(metavar="OUT", help=f"The file to write: {', '.join(SUFFIXES)}.")],
) -> None:
    """Write a map in another format, by the suffix of OUT."""
    from tfg_drake.cockpit.page import export_page, viewer_script
    from tfg_drake.io.files import write_atomic
    from tfg_drake.mapfile.g2o import g2o_text
    from tfg_drake.mapfile.landmark_table import landmark_csv
    from tfg_drake.mapfile.summary import map_rows
    from tfg_drake.pictures.figure import draw_map

    suffix = out.suffix.lower()
    if suffix not in SUFFIXES:
        bad_input(f"{out}: unknown format; name a file that ends in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    saved = _load(map_file)
    with writing(out):
        if suffix == ".g2o":
            write_atomic(out, g2o_text(saved))
        elif suffix == ".csv":
            write_atomic(out, landmark_csv(saved))
        elif suffix == ".html":
            with _timeline(saved, map_file) as timeline:
                export_page(timeline, out, map_file.name, viewer_script())
        else:
            rows = dict(map_rows(saved, map_file.stat().st_size))
            known = "; ".join(rows[name] for name in ("deviation", "walls") if rows.get(name, "-") != "-")
            draw_map(out, f"{map_file}: {rows['landmarks']}, {rows['views']}\n{known}", saved)
    print(f"{out}: {len(saved.ids)} landmarks, {out.stat().st_size / 1e3:.0f} kB")


def _load(path: Path) -> SavedMap:
    with Screen() as show:
        show(f"reading {path}")

        from tfg_drake.mapfile.saved_map import load_map

        return load_map(path)


@contextlib.contextmanager
def _timeline(saved: SavedMap, path: Path) -> Iterator[Path]:
    """A file, deleted afterwards, with the timeline that the page shows of a map."""
    from tfg_drake.pictures.map_timeline import write_map_timeline
    from tfg_drake.storage.timeline import FILE_NAME

    with tempfile.TemporaryDirectory() as folder:
        write_map_timeline(saved, Path(folder) / FILE_NAME, path.name)
        yield Path(folder) / FILE_NAME

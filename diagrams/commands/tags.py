"""`tfg-drake tags`: tags to print. Needs no Drake."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tfg_drake.diagrams.commands.command_line import bad_input

tags_app = typer.Typer(add_completion=False, rich_markup_mode=None)


@tags_app.callback()
def _commands() -> None:
    """Tags to hang up."""


@tags_app.command("print")
def print_tags(
    ids: Annotated[str, typer.Option(metavar="LIST", help="Of the family tag36h11, such as 0-99 or 3,5,10-12.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The PDF to write.")],
    size: Annotated[float, typer.Option(metavar="M", help="Side of the black square.")] = 0.16,
) -> None:
    """Write tags to a PDF of A4 pages, with cut marks. Print it at 100 %, and check the size with a rule."""
    try:
        from tfg_drake.vision import tag_sheets
    except ImportError as error:
        bad_input(f"{error.name} is not installed; get it with pip install -e '.[camera]'")
    try:
        numbers = tag_sheets.parse_ids(ids)
    except tag_sheets.SheetError as error:
        bad_input(f"--ids {error}")
    try:
        pages = tag_sheets.print_tags(numbers, size, out)
    except tag_sheets.SheetError as error:
        bad_input(f"--size {error}")
    except OSError as error:
        bad_input(f"--out {out}: cannot be written: {error.strerror or error}")
    print(
        f"{len(numbers)} tags of {1000.0 * size:g} mm on {pages} pages: {out}; print at 100 %, not fitted to the page"
    )

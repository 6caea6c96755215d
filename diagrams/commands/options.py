"""Arguments and options of the commands, as their help tells them, and those that several commands have."""

from __future__ import annotations

from typing import Annotated, Any

import typer


def option(metavar: str, told: str, *names: str, **given: Any) -> Any:
    """An option with a value, as its help tells it; names: where they are not its parameter's. given: see typer."""
    return typer.Option(*names, metavar=metavar, help=told, **given)


def flag(name: str, told: str, **given: Any) -> Any:
    """An option that is given or not, likewise."""
    return typer.Option(name, help=told, **given)


def argument(metavar: str, told: str, **given: Any) -> Any:
    """An argument, likewise."""
    return typer.Argument(metavar=metavar, help=told, **given)


Settings = Annotated[list[str] | None, option("KEY=VALUE", "Change a key of the scenario; repeatable.", "--set")]
AsJson = Annotated[bool, flag("--json", "Print the summary as the last line, on one line.")]
PagePort = Annotated[int | None, option("N", "The page's port [default: 7000 or the next that is free].")]

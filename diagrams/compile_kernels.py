"""Compiles the kernels that a mission calls before one needs them, once per installation.

    python -m tfg_drake.diagrams.compile_kernels

The package has a list of them with the types that missions call each with, `mission_kernels.txt`, made by
`benchmarks/mission_kernels.py`. Some processes go through it side by side, and each compiles what no other has begun.
What a mission calls besides, numba compiles when it is called.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.warm_up import Listed, listed


def resolved(one: Listed) -> tuple[Any, tuple[Any, ...]]:
    """Its numba dispatcher and the types of its arguments. Raises AttributeError, NameError where it is of another
    version."""
    module = importlib.import_module(f"tfg_drake.{one.module}")
    kernel = inspect.unwrap(getattr(module, one.name), stop=lambda function: hasattr(function, "compile"))
    return kernel, eval(one.types, {**vars(module), **vars(importlib.import_module("numba.types"))})


def _compile(folder: Path) -> None:
    """Compile of the list what no other process has begun, by the files of a folder: NUMBER is one that is begun,
    NUMBER.made one that was compiled, NUMBER.kept one that there was already, or that is of another version."""
    from numba.core.errors import NumbaError

    for number, one in enumerate(listed()[0]):
        begun = folder / str(number)
        try:
            begun.touch(exist_ok=False)
        except FileExistsError:
            continue
        kernel: Any = None
        with contextlib.suppress(AttributeError, NameError, TypeError, NumbaError):
            kernel, types = resolved(one)
            kernel.compile(types)
        begun.rename(begun.with_suffix(".made" if kernel and kernel.stats.cache_misses else ".kept"))


def main() -> None:
    """Compile by the files of a folder, or what is missing and say so."""
    if len(sys.argv) == 2:
        _compile(Path(sys.argv[1]))
        return
    from tfg_drake.diagrams.commands.command_line import wait_for_kernels
    from tfg_drake.diagrams.commands.screen import Screen

    try:
        with Screen() as show:
            wait_for_kernels(show)
    except BadInput as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)
    if not kernels.are_compiled():
        print("not all kernels could be compiled beforehand; the others are when they are called", file=sys.stderr)


if __name__ == "__main__":
    main()

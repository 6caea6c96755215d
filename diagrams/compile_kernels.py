"""Compiles the kernels that a mission calls before one needs them, once per installation.

    python -m tfg_drake.diagrams.compile_kernels

Two processes go through the same half minute of a mission in a small room. Each has numba compile the kernels of its
own folders and leaves those of the other's to the interpreter, which is quick enough in such a room: so none is
compiled twice. What another mission calls besides, numba compiles when it is called.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.warm_up import SHARES

# A mission needs no other kernels while it stands and turns than it has called by then, s; the rest comes until END, s.
LOOKED, END = 1.0, 30.0
ROOM = """
world:
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5]]
  start: [1, 1, 0]
explorer: {first_look: 0, first_turns: 1}
"""


def _import_kernels(folders: tuple[str, ...]) -> None:
    for path in kernels.kernel_files():
        if path.parent.name in folders:
            importlib.import_module(f"tfg_drake.{path.parent.name}.{path.stem}")


def _compile(share: int, looked: Path) -> None:
    """Compile a share of the kernels and make a file, `looked`, when the first look is over; raises what its mission
    raises."""
    numba: Any = importlib.import_module("numba")
    # First those that are compiled, with all that they call.
    _import_kernels(SHARES[share])
    numba.config.DISABLE_JIT = True
    _import_kernels(SHARES[1 - share])
    # numba compiles functions of its own only without it.
    numba.config.DISABLE_JIT = False
    from tfg_drake.diagrams.missions.run import run_mission
    from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario

    room = ApplyWorldFile(LoadScenario(data=ROOM), tag_spacing=1.0)
    with tempfile.TemporaryDirectory(prefix="tfg_drake-") as folder:
        result = run_mission(
            room,
            max_time=END,
            out_dir=Path(folder),
            on_progress=lambda progress: looked.touch() if progress.time >= LOOKED else None,
            interrupted=threading.Event(),
        )
    if result.mission.failure is not None:
        raise result.mission.failure


def main() -> None:
    """Compile a share, or what is missing and say so."""
    if len(sys.argv) == 3:
        _compile(int(sys.argv[1]), Path(sys.argv[2]))
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

"""What the commands call kernels with, as short runs of them tell. The table of kernels is made of it:

    python tests/rehearsal.py --write       what `make kernels` does

Without --write: what was called in this process that the table does not have, a line each.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np
from numba.core.dispatcher import Dispatcher

from tfg_drake import kernels
from tfg_drake.config import GAINS
from tfg_drake.diagrams import cli
from tfg_drake.diagrams.commands.figures import write_figures
from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.mission_runner import MissionRunner
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.kernels import LOOK, MISSION, OTHER, Kernel, read_table, spelled, write_table
from tfg_drake.mapfile.saved_map import load_map, restored_estimate
from tfg_drake.messages import LaserScan
from tfg_drake.safety.scan_watch import no_watch, watched
from tfg_drake.slam import map_solver
from tfg_drake.slam.tag_error import FIRST

# So long after its start a mission still stands and looks, s.
LOOKING = 15.0
# Its first turn is its last, as if much were known already.
AT_ONCE = ["--set", "explorer.first_look=0", "--set", "explorer.first_turns=1"]
HOME = ["--set", "explorer.return_home=true"]
SHORT = ["--headless", "--seed", "5", "--max-time"]
ROOM = """
world:
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5]]
  start: [1, 1, 0]
  tags:
""" + "".join(
    f"  - {{id: {i}, position: [{0.5 + i % 6}, {4 * (i // 6)}], facing: {1.57 - 3.14 * (i // 6)}}}\n" for i in range(12)
)


def dispatchers() -> dict[tuple[str, str], Dispatcher]:
    """All kernels there are, by module and name."""
    found = {}
    for path in kernels.PACKAGE.rglob("*.py"):
        words = path.relative_to(kernels.PACKAGE.parent).with_suffix("").parts
        if words[1] in ("systems", "diagrams", "hardware") or "@njit" not in path.read_text(encoding="utf-8"):
            continue
        module = importlib.import_module(".".join(words))
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__:
                found[module.__name__, name] = value
    return found


def missions(folder: Path) -> Iterator[int]:
    """Runs the commands, and says after those of each need what it was."""
    mission = Mission(LoadScenario("paper"), METHODS["tfg"], None, "")
    MissionRunner(mission, threading.Event(), max_time=LOOKING, on_progress=lambda _progress: None).run()
    yield LOOK
    room, run = folder / "room.yaml", folder / "run"
    room.write_text(ROOM)
    run_commands(folder, ["explore", "paper", *SHORT, "80", "--out", run], ["explore", room, *SHORT, "3600"])
    yield MISSION
    methods = ("tfg-argmax", "tfg-nearest", "random", "scripted", "grid-nearest", "weighted")
    run_commands(
        folder,
        ["explore", *SHORT, "30", "--world", room, "--tag-spacing", "1"],
        ["explore", room, *SHORT, "10", *AT_ONCE, "--set", "reality.people=2"],
        ["explore", "paper_real", *SHORT, "20", *AT_ONCE],
        ["explore", *SHORT, "3600", "--robot", f"replay:{run}"],
        *(["explore", "paper", *SHORT, "40", *AT_ONCE, "--method", name] for name in methods),
        *(["explore", "paper", *SHORT, "20", *AT_ONCE, "--set", f"explorer.gain={name}"] for name in GAINS[1:]),
        ["explore", "corridor_slip", *SHORT, "40", *AT_ONCE, "--set", "planner.risk=path"],
        ["explore", "house", *SHORT, "70", *AT_ONCE, "--set", "explorer.budget_time=50", *HOME],
        ["slam", recording(folder)],
        ["tags", "advise", "--world", room, "--count", "2", "--out", folder / "advised.yaml"],
        ["tags", "advise", run, "--count", "1", "--out", folder / "advised.yaml"],
        ["map", "info", run / "map.npz"],
        *(["map", "export", run / "map.npz", folder / f"map.{suffix}"] for suffix in ("g2o", "csv", "png", "html")),
    )
    # Tags with constant errors, which a mission takes a while to find.
    saved = load_map(run / "map.npz")
    wrong = dataclasses.replace(saved, graph=dataclasses.replace(saved.graph, tag_error=np.array(FIRST)))
    restored_estimate(wrong)
    # A map of more tags than these few is large.
    with mock.patch.object(map_solver, "JOINT", 2):
        restored_estimate(saved)
        restored_estimate(wrong)
    write_figures(folder, lambda stage, _time: stage == 3)
    # A scanner that says the same wherever the robot is, and then that nothing is there.
    scan = LaserScan(0.1, np.linspace(-1.0, 1.0, 9), np.full(9, 2.0), 10.0, 0.01)
    watch = no_watch(dataclasses.replace(scan, stamp=-np.inf))
    for k in range(3):
        watch = watched(watch, dataclasses.replace(scan, stamp=0.1 * k), np.array([0.5 * k, 0.0, 0.0]), False, 0.2, 0.1)
    watched(watch, dataclasses.replace(scan, stamp=0.3, ranges=np.full(9, np.inf)), np.zeros(3), False, 0.2, 0.1)
    yield OTHER


def run_commands(folder: Path, *of: list[object]) -> None:
    """Runs some of the program, which writes to the folder and says nothing."""
    for command in of:
        arguments = [str(word) for word in command]
        if command[0] in ("explore", "slam") and "--out" not in arguments:
            arguments += ["--out", str(folder / "other")]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            cli.main(arguments)


def recording(folder: Path) -> Path:
    """A drive round a circle of 2 m with four landmarks, as a data set."""
    path = folder / "Small"
    path.mkdir()
    p_WL = np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 0.5], [0.0, -3.0]])
    odometry, measurements = [], []
    for k in range(240):
        angle = 0.025 * k
        odometry.append(f"{0.25 * k} 0.2 0.1\n")
        for i, d in enumerate(p_WL - 2.0 * np.array([np.sin(angle), -np.cos(angle)])):
            bearing = (np.arctan2(d[1], d[0]) - angle + np.pi) % (2 * np.pi) - np.pi
            measurements.append(f"{0.25 * k} {i + 56} {np.hypot(*d)} {bearing}\n")
    (path / "Barcodes.dat").write_text("".join(f"{i} {i + 50}\n" for i in (1, 6, 7, 8, 9)))
    (path / "Landmark_Groundtruth.dat").write_text("".join(f"{i + 6} {x} {y} 0 0\n" for i, (x, y) in enumerate(p_WL)))
    (path / "Robot1_Odometry.dat").write_text("".join(odometry))
    (path / "Robot1_Measurement.dat").write_text("".join(measurements))
    return path


def called() -> tuple[list[Kernel], bool]:
    """What the commands call, and whether none of it had to be compiled: then what other kernels call is not in it."""
    found, known = [], set()
    with tempfile.TemporaryDirectory() as folder:
        for need in missions(Path(folder)):
            for (module, name), dispatcher in dispatchers().items():
                for signature in set(dispatcher.overloads) - {types for of, types in known if of is dispatcher}:
                    known.add((dispatcher, signature))
                    found.append(Kernel(module, name, ", ".join(map(spelled, signature)), need))
    return found, not any(dispatcher.stats.cache_misses for dispatcher in dispatchers().values())


def unknown() -> list[Kernel]:
    """What the commands call that the table lacks."""
    for kernel in read_table():
        kernel.compile()
    there = {dispatcher: set(dispatcher.overloads) for dispatcher in dispatchers().values()}
    called()
    return [
        Kernel(module, name, ", ".join(map(spelled, signature)), OTHER)
        for (module, name), dispatcher in dispatchers().items()
        for signature in set(dispatcher.overloads) - there[dispatcher]
    ]


def main() -> None:
    """Write the table, or what it lacks."""
    if sys.argv[1:] == ["--write"]:
        found, whole = called()
        if not whole:  # Once more, and everything is in the cache.
            subprocess.run([sys.executable, *sys.argv], check=True)
            return
        write_table(found)
        print(f"{kernels.TABLE}: {len(found)} kernels")
        return
    for kernel in unknown():
        print(f"{kernel.module}.{kernel.name} {kernel.types}")


if __name__ == "__main__":
    main()

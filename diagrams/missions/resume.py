"""A mission that was cut short, to go on with: by a kill, a crash, an empty battery, Ctrl-C or its time limit."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

from tfg_drake.diagrams.scenario import LoadScenario, Scenario
from tfg_drake.storage.checkpoint import FILE_NAME as CHECKPOINT
from tfg_drake.storage.checkpoint import read_checkpoint
from tfg_drake.storage.port_recording import FILE_NAME as PORTS
from tfg_drake.storage.timeline import FILE_NAME as TIMELINE

# What a mission goes on with.
_FILES = ("scenario.yaml", CHECKPOINT, PORTS, TIMELINE, "map.npz", "grid.npz", "known_map.npz", "log.txt")


@dataclasses.dataclass(frozen=True)
class CutShort:
    """folder: where it goes on. scenario: all that defines it. name, world_name, robot: what these are called. method:
    the name or path of what explores. state: see `Mission.state`."""

    folder: Path
    scenario: Scenario
    name: str
    world_name: str
    robot: str
    method: str
    state: dict[str, Any]


def cut_short(run: Path, out: Path | None = None) -> CutShort:
    """A mission that was cut short, from its folder, or the checkpoint in it.

    out: where it goes on instead, a copy; it need not be there yet.

    Raises:
        CheckpointError: the folder holds none, or it cannot be gone on with.
        OSError: it cannot be copied.
    """
    told, state = read_checkpoint(run)
    run = run.parent if run.is_file() else run
    if out is not None and out.resolve() != run.resolve():
        out.mkdir(parents=True, exist_ok=True)
        for name in _FILES:
            (out / name).unlink(missing_ok=True)
            if (run / name).is_file():
                shutil.copyfile(run / name, out / name)
    folder = run if out is None else out
    names = told["scenario"], told["world"], told["robot"], told["source"]
    return CutShort(folder, LoadScenario(folder / "scenario.yaml"), *names, state)

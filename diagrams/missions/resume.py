"""A mission that was cut short, to go on with: by a kill, a crash, an empty battery, Ctrl-C or its time limit.

Its folder may be somebody else's: it says neither which robot is driven nor which code is run.
"""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
from pathlib import Path

from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.mission import MissionRequest
from tfg_drake.diagrams.missions.run_folder import RESULTS
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.storage.checkpoint import FILE_NAME as CHECKPOINT
from tfg_drake.storage.checkpoint import CheckpointError, read_checkpoint
from tfg_drake.storage.port_recording import FILE_NAME as PORTS
from tfg_drake.storage.timeline import FILE_NAME as TIMELINE

# The map that a mission began with, in its folder.
KNOWN_MAP = "known_map.npz"
# Files that a resumed mission uses; without the last one it cannot be resumed.
_FILES = ("scenario.yaml", KNOWN_MAP, PORTS, TIMELINE, "map.npz", "grid.npz", "log.txt", CHECKPOINT)


@dataclasses.dataclass(frozen=True)
class CutShort:
    """request: goes on with it, but for its robot and method. robot, method: what these are called. own: the method is
    a file or has parts of somebody's own."""

    request: MissionRequest
    robot: str
    method: str
    own: bool


def cut_short(run: Path, out: Path | None = None) -> CutShort:
    """A mission that was cut short, from its folder, or the checkpoint in it.

    out: where it goes on instead, a copy; it need not be there yet.

    Raises:
        CheckpointError: the folder holds none, or it cannot be gone on with.
        OSError: it cannot be copied.
    """
    told, state = read_checkpoint(run)
    run = run if run.is_dir() else run.parent
    if not told["own"] and told["method"] not in METHODS:
        raise CheckpointError(f"{run}: no method is called {told['method']}; begin a mission with its map: --map {run}")
    for name in _FILES:
        if (run / name).is_symlink():
            raise CheckpointError(f"{run / name}: is a link; put the file itself there")
    if scenario_digest(run) != told["scenario_digest"]:
        mend = f"put it back as it was, or begin a mission with the run's map: --map {run}"
        raise CheckpointError(f"{run / 'scenario.yaml'}: it, or the map begun with, is not that of the run; {mend}")
    folder = run if out is None else out
    if folder.resolve() != run.resolve():
        folder.mkdir(parents=True, exist_ok=True)
        for name in RESULTS:
            (folder / name).unlink(missing_ok=True)
        for name in _FILES:
            if (run / name).is_file():
                (folder / name).unlink(missing_ok=True)
                shutil.copyfile(run / name, folder / name)
    scenario = LoadScenario(folder / "scenario.yaml")
    request = MissionRequest(scenario, name=told["scenario"], world_name=told["world"], out_dir=folder, before=state)
    return CutShort(request, told["robot"], told["method"], told["own"])


def scenario_digest(run: Path) -> str:
    """Tells whether what defines a run is what it was: its scenario and the map that it begins with."""
    files = [run / name for name in ("scenario.yaml", KNOWN_MAP)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files if file.is_file())).hexdigest()

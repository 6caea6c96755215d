"""The folder of a run as plain arrays.

import tfg_drake
run = tfg_drake.load_run("runs/...")
run.summary["landmark_rmse_m"], run.map.p_ML, run.X_WB[-1], run.port("tags.detections")["range"]
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.io.extras import pip_install
from tfg_drake.io.files import FileError, read_object, read_text, reading
from tfg_drake.mapfile.saved_map import SavedMap, load_map
from tfg_drake.messages import FloatArray, TagDetections
from tfg_drake.storage.checkpoint import FILE_NAME as CHECKPOINT
from tfg_drake.storage.checkpoint import read_told
from tfg_drake.storage.port_recording import PortRecording, read_recording
from tfg_drake.storage.trajectory import read_tum

# Name of the array with the message index of each entry.
MESSAGE = "message"


class RunError(FileError):
    """The folder is not that of a run; the message is one line."""


@dataclasses.dataclass(frozen=True)
class Run:
    """Results of a run. summary: summary.json; stages: stages.jsonl, one row per stage. stamps: (n,) s and X_WB: (n, 3)
    the poses estimated online, m and rad; true_stamps (m,) and X_WB_true (m, 3): the true poses, empty if unknown. map:
    None for methods without a landmark map."""

    folder: Path
    summary: Mapping[str, Any]
    stages: list[dict[str, Any]]
    stamps: FloatArray
    X_WB: FloatArray
    true_stamps: FloatArray
    X_WB_true: FloatArray
    map: SavedMap | None

    def __repr__(self) -> str:
        outcome, time = self.summary.get("outcome"), self.summary.get("sim_time_s", 0)
        return f"<run {self.folder}: {outcome} after {time} s, {len(self.stages)} stages>"

    @functools.cached_property
    def recording(self) -> PortRecording:
        """The recording of the station's ports. Raises RecordingError if there is none."""
        return read_recording(self.folder)

    def port(self, name: str) -> dict[str, NDArray[Any]]:
        """Return the messages of a station's port as arrays by field name, one row per message, and `time`: (n,) s,
        when the port carried each.

        Frames of tags differ in length: their entries are concatenated, and `message` holds the index of the message of
        each entry. The row of a scan without rays is nan. Raises KeyError, which lists the ports, for other names.
        """
        recording = self.recording
        if name not in recording.messages:
            raise KeyError(f"no port {name}; the run has {', '.join(recording.messages)}")
        messages = recording.messages[name]
        columns: dict[str, NDArray[Any]] = {"time": recording.log_times[name] * 1e-9}
        for field in dataclasses.fields(messages[0]) if messages else ():
            values = [np.asarray(getattr(message, field.name)) for message in messages]
            if isinstance(messages[0], TagDetections) and values[0].ndim:
                columns[field.name] = np.concatenate(values)
                columns[MESSAGE] = np.repeat(np.arange(len(values)), [len(value) for value in values])
            else:
                width = max(value.size for value in values)
                columns[field.name] = np.array([value if value.size else np.full(width, np.nan) for value in values])
        return columns

    def frame(self, name: str) -> Any:
        """Return `port` as a pandas (or polars) DataFrame, one row per message or, for frames of tags, per entry.
        Raises ImportError if neither is installed."""
        found = next(filter(importlib.util.find_spec, ("pandas", "polars")), None)
        if found is None:
            raise ImportError(f"neither pandas nor polars is installed; get pandas with {pip_install('frames')}")
        frames = importlib.import_module(found)
        columns = self.port(name)
        if MESSAGE not in columns:
            return frames.DataFrame({key: list(value) if value.ndim > 1 else value for key, value in columns.items()})
        rows = columns[MESSAGE]
        of_messages = {"time", "stamp"}
        return frames.DataFrame({key: value[rows] if key in of_messages else value for key, value in columns.items()})


def load_run(folder: str | Path) -> Run:
    """Read a run's folder. For an interrupted mission summary and trajectory come from its checkpoint, with outcome
    cut_short. Raises RunError if the folder holds neither, FileError if a file is damaged."""
    folder = Path(folder)
    if not (folder / "summary.json").is_file():
        if not (folder / CHECKPOINT).is_file():
            raise RunError(f"{folder}: holds no run: no summary.json; name the folder of a mission")
        summary = {**read_told(folder), "outcome": "cut_short"}
        trajectory = summary.pop("stamps"), summary.pop("X_WB")
    else:
        summary, trajectory = read_object(folder / "summary.json"), _trajectory(folder / "trajectory.tum")
    stages = folder / "stages.jsonl"
    with reading(stages):
        lines = read_text(stages).splitlines() if stages.exists() else []
        rows = [{**json.loads(line)} for line in lines]
    true_stamps, X_WB_true = _trajectory(folder / "truth.tum")
    return Run(
        folder,
        summary,
        rows,
        *trajectory,
        true_stamps,
        X_WB_true,
        load_map(folder / "map.npz") if (folder / "map.npz").exists() else None,
    )


def _trajectory(path: Path) -> tuple[FloatArray, FloatArray]:
    return read_tum(path) if path.exists() else (np.zeros(0), np.zeros((0, 3)))

"""A recording by its path, whatever recorded it, as far as it is believed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tfg_drake.datasets.load import load_dataset
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.hardware.ros.bag import load_bag


def load_recording(path: Path, **options: Any) -> Recording | PoseGraph:
    """A ROS 2 bag or whatever else `load_dataset` reads. options: as its.

    Raises:
        DatasetError: it is none of these, or cannot be used.
    """
    return load_bag(path) if path.suffix == ".mcap" else load_dataset(path, **options)


def load_laser_recording(path: Path, **options: Any) -> Recording:
    """The same, of a robot with a laser scanner. Raises DatasetError where it has none, too."""
    recording = load_recording(path, **options)
    if not (isinstance(recording, Recording) and len(recording.scans)):
        raise DatasetError(f"{path}: has no scans; name a ROS 2 bag, a CARMEN or a BreezySLAM log")
    return recording

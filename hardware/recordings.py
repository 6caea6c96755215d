"""A recording by its path, whatever recorded it, as far as it is believed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tfg_drake.datasets.intake import believed
from tfg_drake.datasets.load import load_dataset
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.hardware.ros.bag import load_bag
from tfg_drake.hardware.ros.bag_files import is_bag


def load_recording(
    path: Path,
    robot: int | None = None,
    noise: float | None = None,
    seed: int | None = None,
    scanner: Mapping[str, Any] | None = None,
) -> Recording | PoseGraph:
    """A ROS bag or whatever else `load_dataset` reads, as which the options are. scanner: what of RobotScannerConfig is
    said of a laser recording's by hand.

    Raises:
        DatasetError: it is none of these, or cannot be used.
    """
    if not is_bag(path):
        loaded = load_dataset(path, robot, noise, seed, scanner)
        return believed(loaded) if isinstance(loaded, Recording) else loaded
    for option, value in (("--odometry-noise", noise), ("--robot", robot)):
        if value is not None:
            raise DatasetError(f"{option} {value}: a ROS bag has one robot, with odometry of its own; leave it out")
    return believed(load_bag(path, scanner))


def load_laser_recording(path: Path, **options: Any) -> Recording:
    """The same, of a robot with a laser scanner. Raises DatasetError where it has none, too."""
    recording = load_recording(path, **options)
    if not (isinstance(recording, Recording) and len(recording.scans)):
        raise DatasetError(f"{path}: has no scans; name a ROS 2 bag, a CARMEN or a BreezySLAM log")
    return recording

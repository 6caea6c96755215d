"""A recording by its path: what kind it is, it loaded, and as far as it is believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.g2o import read_g2o
from tfg_drake.datasets.intake import believed
from tfg_drake.datasets.laser_log import load_breezyslam, load_carmen
from tfg_drake.datasets.mrclam import load_mrclam
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.datasets.rows import found_file
from tfg_drake.datasets.tagslam import load_tagslam
from tfg_drake.hardware.ros.bag import load_bag
from tfg_drake.hardware.ros.bag_files import is_bag

# Suffixes of laser logs, which may be compressed (.gz, .bz2); _ROVER: of BreezySLAM's.
_ROVER = ".dat"
_LOGS = (".log", ".clf", _ROVER)
# A hint for a file that may be a video.
_VIDEO = "of a video give --calibration and --tag-size"


def load_dataset(
    path: Path,
    robot: int | None = None,
    noise: float | None = None,
    seed: int | None = None,
    scanner: Mapping[str, Any] | None = None,
) -> Recording | PoseGraph:
    """A ROS bag, an MR.CLAM folder (robot 1 unless another is named), a TagSLAM folder, a g2o file, or a laser log of
    CARMEN or of BreezySLAM.

    noise: factor of OdometryConfig's errors for the odometry of a corrected CARMEN log, 1 if not given; seed: of their
    draws. scanner: stated fields of `RobotScannerConfig` for the scanner of a bag or a laser log.

    Raises:
        DatasetError: it is none of these, or cannot be used.
    """
    if is_bag(path):
        for option, value in (("--odometry-noise", noise), ("--robot", robot)):
            if value is not None:
                raise DatasetError(f"{option} {value}: a ROS bag has one robot, with odometry of its own; leave it out")
        return load_bag(path, scanner)
    if not path.exists():
        raise DatasetError(f"{path}: no such file or folder; name a data set")
    name = path.name.removesuffix(".gz").removesuffix(".bz2")
    is_log = name.endswith(_LOGS) and path.is_file()
    is_carmen = is_log and not name.endswith(_ROVER)
    if not is_carmen:
        _check_own_odometry(path, noise, seed)
    if scanner and not is_log:
        raise DatasetError(f"--set hardware.scanner.{next(iter(scanner))}: {path} has no laser scanner; leave it out")
    if found_file(path, "Barcodes.dat"):
        return load_mrclam(path, 1 if robot is None else robot)
    if robot is not None:
        raise DatasetError(f"--robot {robot}: {path} has one robot only; leave --robot out")
    if found_file(path, "tag_corners.csv"):
        return load_tagslam(path)
    if path.is_dir():
        kinds = "neither Barcodes.dat (MR.CLAM) nor tag_corners.csv (TagSLAM) nor files of a ROS bag"
        raise DatasetError(f"{path}: holds {kinds}; name a folder with one of them, or {_VIDEO}")
    if is_carmen:
        errors = dataclasses.asdict(OdometryConfig())
        times = 1.0 if noise is None else noise
        model = OdometryConfig(**{name: times * one for name, one in errors.items()})
        log = load_carmen(path, model, seed or 0, scanner=scanner)
        if log.truth is None:
            _check_own_odometry(path, noise, seed)
        return log
    if is_log:
        return load_breezyslam(path, scanner)
    if not path.name.endswith((".g2o", ".g2o.gz")):
        kinds = (
            "a .g2o file, a laser log (.log, .clf, .dat), a ROS bag (its folder, .mcap, .db3, .bag), an MR.CLAM or "
            "TagSLAM folder"
        )
        raise DatasetError(f"{path}: not a data set; name {kinds}, or {_VIDEO}")
    return read_g2o(path)


def load_recording(path: Path, **options: Any) -> Recording | PoseGraph:
    """Load a data set as `load_dataset` does, a recording as far as it is believed. Raises DatasetError likewise."""
    loaded = load_dataset(path, **options)
    return believed(loaded) if isinstance(loaded, Recording) else loaded


def load_laser_recording(path: Path, **options: Any) -> Recording:
    """The same, of a robot with a laser scanner. Raises DatasetError where it has none, too."""
    recording = load_recording(path, **options)
    if not (isinstance(recording, Recording) and len(recording.scans)):
        raise DatasetError(f"{path}: has no scans; name a ROS 2 bag, a CARMEN or a BreezySLAM log")
    return recording


def _check_own_odometry(path: Path, noise: float | None, seed: int | None) -> None:
    if noise is not None or seed is not None:
        option = f"--seed {seed}" if noise is None else f"--odometry-noise {noise:g}"
        raise DatasetError(
            f"{option}: {path} has odometry of its own, only corrected CARMEN logs have not; leave it out"
        )

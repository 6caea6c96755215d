"""A data set by its path: what kind it is, and it loaded."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.g2o import read_g2o
from tfg_drake.datasets.laser_log import load_breezyslam, load_carmen
from tfg_drake.datasets.mrclam import load_mrclam
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.datasets.tagslam import load_tagslam
from tfg_drake.datasets.text import found_file

# What a user may have meant.
_VIDEO = "of a video give --calibration and --tag-size"


def load_dataset(
    path: Path, robot: int | None = None, noise: float | None = None, seed: int | None = None
) -> Recording | PoseGraph:
    """An MR.CLAM folder (robot 1 unless another is named), a TagSLAM folder, a g2o file, or a laser log of CARMEN or of
    BreezySLAM.

    noise: errors of the odometry of a CARMEN log, times those of OdometryConfig, 1 if not given; seed: of their draws.

    Raises:
        DatasetError: it is none of these, or cannot be used.
    """
    if not path.exists():
        raise DatasetError(f"{path}: no such file or folder; name a data set")
    is_carmen = path.name.endswith((".log", ".log.gz"))
    if not is_carmen and (noise is not None or seed is not None):
        option = f"--seed {seed}" if noise is None else f"--odometry-noise {noise:g}"
        raise DatasetError(f"{option}: {path} has odometry of its own, only CARMEN logs have not; leave it out")
    if found_file(path, "Barcodes.dat"):
        return load_mrclam(path, 1 if robot is None else robot)
    if robot is not None:
        raise DatasetError(f"--robot {robot}: {path} has one robot only; leave --robot out")
    if found_file(path, "tag_corners.csv"):
        return load_tagslam(path)
    if path.is_dir():
        kinds = "neither Barcodes.dat (MR.CLAM) nor tag_corners.csv (TagSLAM)"
        raise DatasetError(f"{path}: holds {kinds}; name a folder with one of them, or {_VIDEO}")
    if is_carmen:
        errors = dataclasses.asdict(OdometryConfig())
        times = 1.0 if noise is None else noise
        return load_carmen(path, OdometryConfig(**{name: times * one for name, one in errors.items()}), seed or 0)
    if path.name.endswith((".dat", ".dat.gz")):
        return load_breezyslam(path)
    if not path.name.endswith((".g2o", ".g2o.gz")):
        kinds = "a .g2o file, a laser log (.log, .dat), an MR.CLAM or TagSLAM folder"
        raise DatasetError(f"{path}: not a data set; name {kinds}, or {_VIDEO}")
    return read_g2o(path)

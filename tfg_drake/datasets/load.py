"""A data set by its path: what kind it is, and it loaded."""

from __future__ import annotations

from pathlib import Path

from tfg_drake.datasets.g2o import read_g2o
from tfg_drake.datasets.mrclam import load_mrclam
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.datasets.tagslam import load_tagslam
from tfg_drake.datasets.text import found_file

# What a user may have meant.
_VIDEO = "of a video give --calibration and --tag-size"


def load_dataset(path: Path, robot: int | None = None) -> Recording | PoseGraph:
    """An MR.CLAM folder (robot 1 unless another is named), a TagSLAM folder or a g2o file.

    Raises:
        DatasetError: it is none of these, or cannot be used.
    """
    if not path.exists():
        raise DatasetError(f"{path}: no such file or folder; name a data set")
    if found_file(path, "Barcodes.dat"):
        return load_mrclam(path, 1 if robot is None else robot)
    if robot is not None:
        raise DatasetError(f"--robot {robot}: {path} has one robot only; leave --robot out")
    if found_file(path, "tag_corners.csv"):
        return load_tagslam(path)
    if path.is_dir():
        kinds = "neither Barcodes.dat (MR.CLAM) nor tag_corners.csv (TagSLAM)"
        raise DatasetError(f"{path}: holds {kinds}; name a folder with one of them, or {_VIDEO}")
    if not path.name.endswith((".g2o", ".g2o.gz")):
        raise DatasetError(f"{path}: not a data set; name a .g2o file, an MR.CLAM or TagSLAM folder, or {_VIDEO}")
    return read_g2o(path)

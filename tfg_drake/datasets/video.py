"""A video or a folder of images as a recording: tags seen by one camera, and odometry if somebody kept it.

Without odometry nothing tells how the camera moves but the tags themselves: its pose is taken to wander at random, as
far as a person walks or turns in the time between two images. Where the odometry is known, it is a TUM trajectory or a
CSV file with the columns time (s), x, y (m) and heading (rad).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.recording import DatasetError, Recording, odometry_along
from tfg_drake.datasets.rows import read_table
from tfg_drake.io.clock_unit import in_seconds
from tfg_drake.messages import FloatArray, Odometry, TagDetections
from tfg_drake.notes import Note
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.frames import FrameError, frames
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagSizes, sighted
from tfg_drake.vision.tag_detector import TagDetector

# The online estimator closes a piece of the way after this time, s.
PIECE_TIME = 2.0
# Time from the start of the map to the first frame, s, as the estimator takes frames between two odometry messages.
MOMENT = 1e-5

# Bare H.264 and such say no times.
_INTO_A_CONTAINER = "give it its rate, as in ffmpeg -r 30 -i in.h264 -c copy out.mp4, and name out.mp4"
_TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_PLANAR = ("time", "x", "y", "heading")
# A higher mean turn rate, rad/s, means that headings are in degrees; wrapped headings may count each turn twice.
_SPINS = 3.0
# Least length of a quaternion, and its greatest difference from 1 by rounding.
_NO_LENGTH, _ROUNDED = 1e-6, 0.01


def wandering() -> OdometryConfig:
    """The model of a camera without odometry, which a person carries."""
    still = OdometryConfig(distance_noise=0.0, distance_scale=0.0, gyro_bias=0.0, gyro_scale=0.0)
    return dataclasses.replace(still, gyro_noise=1.0, position_noise=0.5)


def odometry_model() -> OdometryConfig:
    """Noise assumed for odometry of which only the poses are known: an ordinary wheeled base or better."""
    return OdometryConfig(distance_noise=0.05, distance_scale=0.03, gyro_noise=0.02, gyro_bias=0.002, gyro_scale=0.02)


def load_video(
    source: str,
    calibration: CameraCalibration,
    tag_size: float,
    mount: CameraMount,
    odometry: Path | None = None,
    on_frame: Callable[[int], object] = lambda _count: None,
) -> Recording:
    """The tags in a video or a folder of images.

    Args:
        source: as `tfg_drake.vision.frames.frames` opens it; its stamps are those of the frames.
        calibration: of the camera.
        tag_size: side of the black square, m.
        mount: of the camera on the body, which moves in a plane.
        odometry: a TUM or CSV file with the body's poses, by the clock of the frames; None: there is none.
        on_frame: called with the number of frames read.

    Raises:
        DatasetError: there is no image, no tag in any, or the odometry cannot be used.
    """
    detector, sizes = TagDetector(), TagSizes(tag_size)
    seen: list[TagDetections] = []
    remarks: dict[str, int] = {}
    notes: list[str] = []
    try:
        for count, frame in enumerate(frames(source, notes.append), start=1):
            if seen and frame.stamp <= seen[-1].stamp:
                anew = "number them anew" if Path(source).is_dir() else _INTO_A_CONTAINER
                raise DatasetError(f"{source}: frame {frame.name} is not later than the one before; {anew}")
            sighting = sighted(detector.detect(frame.image), frame.stamp, calibration, sizes, mount)
            seen.append(sighting.detections)
            for remark in sighting.remarks:
                remarks[remark] = remarks.get(remark, 0) + 1
            on_frame(count)
    except FrameError as error:
        raise DatasetError(str(error)) from None
    left_out = [f"{remark} ({number} frames)" for remark, number in sorted(remarks.items())]
    notes += left_out
    if not any(len(one.ids) for one in seen):
        why = f": {left_out[0]}" if left_out else "; is it of the family tag36h11, and sharp?"
        raise DatasetError(f"{source}: no tag in {len(seen)} frames{why}")
    name = Path(source).resolve().name.partition(".")[0]
    if odometry is None:
        while not len(seen[0].ids):
            del seen[0]
        messages = _standing(seen)
        return Recording(name, messages, tuple(seen), wandering(), None, _noted(notes), PIECE_TIME)
    stamps, X_OB, mended = read_poses(odometry)
    inside = [one for one in seen if stamps[0] <= one.stamp <= stamps[-1]]
    if not any(len(one.ids) for one in inside):
        span = f"{stamps[0]:.1f} to {stamps[-1]:.1f} s, the frames from {seen[0].stamp:.1f} to {seen[-1].stamp:.1f} s"
        raise DatasetError(f"{odometry}: reaches from {span}: they need one clock")
    if len(inside) < len(seen):
        notes.append(f"{len(seen) - len(inside)} frames outside the odometry were left out")
    return Recording(
        name, odometry_along(stamps, X_OB), tuple(inside), odometry_model(), None, (*mended, *_noted(notes))
    )


def _noted(lines: list[str]) -> tuple[Note, ...]:
    return tuple(Note("video", None, line) for line in lines)


def _standing(seen: list[TagDetections]) -> tuple[Odometry, ...]:
    """Odometry that says nothing, at every frame, and a moment before the first and after the last."""
    stamps = [seen[0].stamp - MOMENT, *(one.stamp for one in seen), seen[-1].stamp + MOMENT]
    return tuple(Odometry(stamp, np.zeros(3), np.zeros(2)) for stamp in stamps)


def read_poses(path: Path) -> tuple[FloatArray, FloatArray, tuple[Note, ...]]:
    """Stamps (n,), s, poses (n, 3), and what was mended in the file."""
    table, mended = read_table(path, _TUM, _PLANAR)
    stamps, told = in_seconds(table[:, 0])
    mended += tuple(Note("stamps", None, f"{path.name}: {line}") for line in told)
    if table.shape[1] == len(_PLANAR):
        heading = table[:, 3]
        turning = np.abs(np.diff(heading)).sum() / max(np.ptp(stamps), 1e-9) if len(table) else 0.0
        if turning > _SPINS:
            raise DatasetError(
                f"{path}: the heading turns by {turning:.3g} rad/s on average; write radians, not degrees"
            )
    else:
        length = np.linalg.norm(table[:, 4:], axis=1)
        if len(none := np.flatnonzero(length < _NO_LENGTH)):
            raise DatasetError(f"{path}: the quaternion at {stamps[none[0]]:.3f} s has no length; leave its row out")
        if (np.abs(length - 1.0) > _ROUNDED).any():
            told_length = f"{path.name}: quaternions of length {length.min():.3g} to {length.max():.3g}, normalised"
            mended += (Note("file", None, told_length),)
        heading = _heading(table[:, 4:] / length[:, None])
    if len(table) < 2:
        raise DatasetError(f"{path}: fewer than two poses in it; name a TUM trajectory or a CSV file")
    same = np.flatnonzero(np.diff(stamps) <= 0.0)
    if len(same):
        raise DatasetError(f"{path}: two poses at {stamps[same[0]]:.3f} s; leave one of them out")
    return stamps, np.column_stack([table[:, 1:3], heading]), mended


def _heading(quaternion: FloatArray) -> FloatArray:
    """(n,) rad of the x axis in the horizontal plane, of quaternions (n, 4) x, y, z, w."""
    x, y, z, w = quaternion.T
    return np.asarray(np.arctan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)))

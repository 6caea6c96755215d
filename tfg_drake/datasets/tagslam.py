"""Tag corners in the images of a moving camera rig, with visual-inertial odometry, in TagSLAM's formats.

A folder holds tag_corners.csv, vio_odometry.csv, cameras.yaml, camera_poses.yaml, tagslam.yaml and perhaps
tagslam_reference.csv, the tables plain or gzipped. The rig moves in space; here it is a body in the plane: at the
rig's origin, heading where its first camera looks, and a tag is the range and bearing of its centre in the horizontal
plane, which the odometry, being inertial, knows.

Frames: R the rig, V the odometry's world (z up), C a camera, T a tag, W the survey's world (z up).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.recording import DatasetError, GroundTruth, Recording, make_frames
from tfg_drake.datasets.rows import GREATEST, find_file, found_file, read_table, read_text
from tfg_drake.geometry.se2 import poses_of, wrap_angle
from tfg_drake.io.yaml_text import parse_yaml
from tfg_drake.messages import FloatArray, IntArray, Odometry, replace
from tfg_drake.notes import Note
from tfg_drake.table import empty
from tfg_drake.vision.calibration import calibration_of
from tfg_drake.vision.tag_position import polar, tag_positions

# Noise of a corner, px, and least deviations of range and bearing, m and rad, from calibration and tags that are not
# flat.
CORNER_NOISE = 0.5
RANGE_FLOOR = 0.05
BEARING_FLOOR = 0.01
# A step of the odometry that is faster than its neighbours by this, m/s and rad/s, is a jump.
JUMP_SPEED = 1.0
JUMP_TURN_RATE = 1.5
# Least distance of a tag from the rig in the plane, m, for its bearing to be used.
LEAST_RANGE = 0.3

_POSE_COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_TAG_COLUMNS = ("time", "camera", "tag_id", "hamming", *(f"{axis}{i}_px" for i in range(4) for axis in "xy"))


def odometry_model() -> OdometryConfig:
    """Noise of the visual-inertial odometry of a hand-held rig."""
    return OdometryConfig(distance_noise=0.03, distance_scale=0.02, gyro_noise=0.01, gyro_bias=0.001, gyro_scale=0.005)


def load_tagslam(folder: Path) -> Recording:
    """The rig's run.

    Raises:
        DatasetError: a file is missing or broken, or the files do not belong together.
    """
    setup = _Setup(folder)
    notes: list[Note] = []
    stamps, R_VR, p_VR = _rig_poses(folder, "vio_odometry.csv", setup.R_RO, setup.p_RO, notes)
    heading = _heading(R_VR)
    odometry, jumps = _planar_odometry(stamps, p_VR[:, :2], heading)
    if jumps:
        at = ", ".join(f"{jump - stamps[0]:.1f}" for jump in jumps)
        told = f"the odometry jumps at {at} s: there the motion before the jump was put in its place"
        notes.append(Note("jump", jumps[0] - float(stamps[0]), told))
    found = _detections(folder, setup, stamps, R_VR, heading, notes)
    truth = _truth(folder, setup, notes)
    return Recording(
        name=folder.resolve().name,
        odometry=odometry,
        detections=make_frames(*found),
        model=odometry_model(),
        truth=truth,
        notes=tuple(notes),
    )


class _Setup:
    """The rig and the tags as the three YAML files describe them."""

    def __init__(self, folder: Path) -> None:
        self.cameras: dict[str, dict[str, Any]] = {}
        # The rows of the cameras by all that a table may call them.
        self.named: dict[str, int] = {}
        with _tree(folder / "cameras.yaml") as cameras:
            for row, (name, camera) in enumerate(cameras.items()):
                self.cameras[name] = {"calibration": calibration_of(camera)}
                for other in (name, *filter(None, str(camera.get("tagtopic", "")).split("/"))):
                    self.named.setdefault(other, row)
        with _tree(folder / "camera_poses.yaml") as poses:
            for name, camera in self.cameras.items():
                camera["R_RC"], camera["p_RC"] = _pose(poses[name]["pose"])
        with _tree(folder / "tagslam.yaml") as world:
            bodies = {name: body for one in world["bodies"] for name, body in one.items()}
            static = bodies[world["default_body"]]
            rig = next(body for body in bodies.values() if not body["is_static"])
            self.R_RO, self.p_RO = _pose(rig["T_body_odom"]) if "T_body_odom" in rig else (np.eye(3), np.zeros(3))
            self.default_size = float(static["default_tag_size"])
            self.most_hamming = int(static.get("max_hamming_distance", 2))
            self.ignored = {int(tag) for tag in static.get("ignore_tags", [])}
            tags = static.get("tags") or []
            self.sizes = {int(tag["id"]): float(tag.get("size", self.default_size)) for tag in tags}
            surveyed = sorted((int(tag["id"]), _pose(tag["pose"])[1]) for tag in tags if "pose" in tag)
            R_WB, p_WB = _pose(static["pose"]) if "pose" in static else (np.eye(3), np.zeros(3))
            self.surveyed_ids: IntArray = np.array([tag for tag, _ in surveyed], dtype=np.int64)
        self.p_WT: FloatArray = np.array([p for _, p in surveyed]).reshape(-1, 3) @ R_WB.T + p_WB


def _planar_odometry(
    stamps: FloatArray, p_VR: FloatArray, heading: FloatArray
) -> tuple[tuple[Odometry, ...], list[float]]:
    """Odometry of the planar body, jumps taken out, and the stamps of the jumps.

    A step that is far from the median of the steps around it is replaced by the last step that was not.
    """
    dt = np.diff(stamps)
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    d = np.diff(p_VR, axis=0)
    turn = wrap_angle(np.diff(heading))
    steps = np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], turn]) / dt[:, None]
    padded = np.pad(steps, ((2, 2), (0, 0)), mode="edge")
    off = np.abs(steps - np.median(np.stack([padded[i : i + len(steps)] for i in range(5)]), axis=0))
    jumped = (np.hypot(off[:, 0], off[:, 1]) > JUMP_SPEED) | (off[:, 2] > JUMP_TURN_RATE)
    for i in np.flatnonzero(jumped):
        steps[i] = steps[i - 1] if i > 0 else 0.0
    X_OB = poses_of(steps * dt[:, None])
    V_B = np.vstack([np.zeros((1, 3)), steps])[:, [0, 2]]
    messages = tuple(Odometry(float(t), X, V) for t, X, V in zip(stamps, X_OB, V_B, strict=True))
    return messages, stamps[1:][jumped].tolist()


def _detections(
    folder: Path, setup: _Setup, stamps: FloatArray, R_VR: FloatArray, heading: FloatArray, notes: list[Note]
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stamps, ids, range, bearing and their deviations, a row a sighting, as make_frames takes them."""
    table, mended = read_table(find_file(folder, "tag_corners.csv"), _TAG_COLUMNS, names={"camera": setup.named})
    notes += mended
    ids = table[:, 2].astype(np.int64)
    inside = (table[:, 0] >= stamps[0]) & (table[:, 0] <= stamps[-1])
    trusted = (table[:, 3] <= setup.most_hamming) & ~np.isin(ids, sorted(setup.ignored))
    left_out = int(np.count_nonzero(~(inside & trusted)))
    if left_out:
        told = f"{left_out} detections outside the odometry or of tags to ignore were left out"
        notes.append(Note("messages", None, told))
    p_RT = np.zeros((len(table), 3))
    covariance = np.zeros((len(table), 3, 3))
    for number, camera in enumerate(setup.cameras.values()):
        rows = np.flatnonzero((table[:, 1] == number) & inside & trusted)
        sizes = np.array([setup.sizes.get(int(tag), setup.default_size) for tag in ids[rows]])
        p_CT, unit = tag_positions(table[rows, 4:].reshape(-1, 4, 2), sizes, camera["calibration"])
        p_RT[rows] = p_CT @ camera["R_RC"].T + camera["p_RC"]
        covariance[rows] = CORNER_NOISE**2 * (camera["R_RC"] @ unit @ camera["R_RC"].T)

    kept = np.flatnonzero(inside & trusted)
    at = table[kept, 0]
    R = Slerp(stamps, Rotation.from_matrix(R_VR))(at).as_matrix()
    theta = np.interp(at, stamps, np.unwrap(heading))
    # The body's frame: level, x where the camera looks.
    c, s, zero, one = np.cos(theta), np.sin(theta), np.zeros(len(at)), np.ones(len(at))
    R_BV = np.stack([np.stack([c, s, zero], -1), np.stack([-s, c, zero], -1), np.stack([zero, zero, one], -1)], axis=1)
    R_BR = R_BV @ R
    p = (R_BR @ p_RT[kept, :, None])[:, :2, 0]
    P = (R_BR @ covariance[kept] @ np.swapaxes(R_BR, 1, 2))[:, :2, :2]
    distance, bearing, along, across = polar(p, P)
    if lost := int(np.count_nonzero(np.isnan(distance))):
        notes.append(Note("messages", None, f"{lost} detections whose corners are no square's were left out"))
    far = distance > LEAST_RANGE
    distance, bearing, kept = distance[far], bearing[far], kept[far]
    sigma_range = np.sqrt(along[far] + RANGE_FLOOR**2)
    sigma_bearing = np.sqrt(across[far] / distance**2 + BEARING_FLOOR**2)
    return table[kept, 0], ids[kept], distance, bearing, sigma_range, sigma_bearing


def _truth(folder: Path, setup: _Setup, notes: list[Note]) -> GroundTruth | None:
    """The survey and the reference trajectory; not independent of the detections, but all there is."""
    truth = empty(GroundTruth, ids=setup.surveyed_ids, p_WL=setup.p_WT[:, :2])
    if found_file(folder, "tagslam_reference.csv"):
        stamps, R_WR, p_WR = _rig_poses(folder, "tagslam_reference.csv", np.eye(3), np.zeros(3), notes)
        truth = replace(truth, stamps=stamps, X_WB=np.column_stack([p_WR[:, :2], _heading(R_WR)]))
    return truth if len(truth.stamps) or len(truth.ids) else None


def _rig_poses(
    folder: Path, name: str, R_RO: FloatArray, p_RO: FloatArray, notes: list[Note]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """stamps (n,), R_VR (n, 3, 3), p_VR (n, 3) from a table of poses of the frame O that sits in the rig at X_RO."""
    file = find_file(folder, name)
    table, mended = read_table(file, _POSE_COLUMNS)
    notes += mended
    if len(table) < 2:
        raise DatasetError(f"{file}: fewer than two poses in it; copy it again")
    same = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
    if len(same):
        raise DatasetError(f"{file}: two different poses at {table[same[0], 0]:.3f} s; leave one of them out")
    if np.any(np.linalg.norm(table[:, 4:], axis=1) < 0.5):
        raise DatasetError(f"{file}: a quaternion is not of length one; copy it again")
    R_VR = Rotation.from_quat(table[:, 4:]).as_matrix() @ R_RO.T
    return table[:, 0], R_VR, table[:, 1:4] - R_VR @ p_RO


def _heading(R_VR: FloatArray) -> FloatArray:
    """(n,) rad of the rig's z axis, where the first camera looks, in the horizontal plane."""
    return np.asarray(np.arctan2(R_VR[:, 1, 2], R_VR[:, 0, 2]))


def _pose(node: Any) -> tuple[FloatArray, FloatArray]:
    """Rotation matrix and position of a pose in TagSLAM's YAML: position and rotation vector, each with x, y, z."""
    position, rotation = np.array([[float(node[part][axis]) for axis in "xyz"] for part in ("position", "rotation")])
    if not (np.abs([position, rotation]) < GREATEST).all():
        raise ValueError(f"3 finite numbers below {GREATEST:g} expected")
    return Rotation.from_rotvec(rotation).as_matrix(), position


@contextlib.contextmanager
def _tree(file: Path) -> Iterator[dict[str, Any]]:
    """The keys of a YAML file. Raises DatasetError where they are not as who reads them expects."""
    text = read_text(file)
    try:
        tree = parse_yaml(text)
    except ValueError as error:
        raise DatasetError(f"{file}: {error}; mend it") from error
    if not isinstance(tree, dict):
        raise DatasetError(f"{file}: not as TagSLAM writes it: no keys in it")
    try:
        yield tree
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, StopIteration) as error:
        what = f"no {error.args[0]!r}" if isinstance(error, KeyError) else str(error) or "the moving body is missing"
        raise DatasetError(f"{file}: not as TagSLAM writes it: {what}") from error

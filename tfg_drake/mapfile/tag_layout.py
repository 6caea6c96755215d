"""The tags of a map as other programs take them that locate cameras by tags: poses in space, in the world frame W.

The map is planar: all tags hang upright with their centres at one height, m. A tag's frame has x to the right and y up
for who looks at it, z out of the tag; WPILib's has x out of the tag and z up. Tags whose facing is not known, and
doubtful ones, are left out. size: side of the tags' black squares, m.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tfg_drake.io.yaml_text import dump_yaml
from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray

# Deviation of what the map does not know of a tag: its height, m, and its directions, rad.
HUNG = 0.05
# Deviation of the map in W, m and rad, which is zero, but TagSLAM needs a positive one.
FIXED = 1e-4


def tagslam_yaml(saved: SavedMap, height: float, size: float) -> str:
    """TagSLAM's tagslam.yaml: a static body `map` with the tags, a body `rig` for the cameras."""
    tags = []
    for tag, p, R_WT, P in _hung(saved, height):
        across = R_WT[:2, [0, 2]]
        deviation = np.sqrt(np.einsum("ik,ij,jk->k", across, P, across))
        noise = np.array([deviation[0], HUNG, deviation[1]])
        tags.append({"id": tag, "size": size, "pose": _tagslam_pose(p, R_WT, noise, HUNG)})
    body = {"type": "simple", "is_static": True, "default_tag_size": size, "tags": tags}
    body["pose"] = _tagslam_pose(np.zeros(3), np.eye(3), np.full(3, FIXED), FIXED)
    rig = {"type": "simple", "is_static": False, "default_tag_size": size}
    defaults = {"position_noise": HUNG, "rotation_noise": HUNG}
    return dump_yaml({"body_defaults": defaults, "default_body": "map", "bodies": [{"map": body}, {"rig": rig}]})


def apriltag_ros_yaml(saved: SavedMap, height: float, size: float) -> str:
    """tags.yaml of apriltag_ros (ROS 1): the tags as one bundle, `map`, whose frame is W."""
    layout = [
        {"id": tag, "size": size}
        | _named("xyz", p)
        | _named(("qx", "qy", "qz", "qw"), Rotation.from_matrix(R_WT).as_quat())
        for tag, p, R_WT, _ in _hung(saved, height)
    ]
    return dump_yaml({"standalone_tags": [], "tag_bundles": [{"name": "map", "layout": layout}]})


def wpilib_json(saved: SavedMap, height: float) -> str:
    """WPILib's AprilTagFieldLayout, of a field that reaches from W's origin to the farthest tags."""
    tags, (length, width) = [], landmarks_in_world(saved)[0].max(axis=0, initial=0.0).tolist()
    for tag, p, R_WT, _ in _hung(saved, height):
        turned = {"quaternion": _named("XYZW", Rotation.from_matrix(R_WT[:, [2, 0, 1]]).as_quat())}
        tags.append({"ID": tag, "pose": {"translation": _named("xyz", p), "rotation": turned}})
    return json.dumps({"tags": tags, "field": {"length": length, "width": width}}, indent=1) + "\n"


def left_out(saved: SavedMap) -> list[str]:
    """A line for each reason why tags are left out."""
    unknown = ~saved.facing.any(axis=1)
    reasons = {"it is not known which way they face": unknown, "they are doubtful": saved.is_doubtful & ~unknown}
    return [f"left out, as {why}: tags {', '.join(map(str, saved.ids[of]))}" for why, of in reasons.items() if of.any()]


def _hung(saved: SavedMap, height: float) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Id, position (3,), R_WT (3, 3) and covariance (2, 2) in the plane of each tag."""
    facing = tfg_in_world(saved).facing
    for tag, p, P, (x, y), doubtful in zip(
        saved.ids.tolist(), *landmarks_in_world(saved), facing, saved.is_doubtful, strict=True
    ):
        if (x or y) and not doubtful:
            yield tag, np.append(p, height), np.array([[-y, 0.0, x], [x, 0.0, y], [0.0, 1.0, 0.0]]), P


def _tagslam_pose(p: FloatArray, R: FloatArray, p_noise: FloatArray, turn_noise: float) -> dict[str, dict[str, float]]:
    vectors = {"position": p, "rotation": Rotation.from_matrix(R).as_rotvec(), "position_noise": p_noise}
    return {name: _named("xyz", one) for name, one in (vectors | {"rotation_noise": np.full(3, turn_noise)}).items()}


def _named(names: Any, values: FloatArray) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))

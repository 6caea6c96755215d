"""ROS messages of map, path and pose: pure functions that return dictionaries of ROS fields.

Metres and radians; the frames' names are the preset's. A header's stamp is the host's time (s) here, because only the
process that drives the robot knows the robot's ROS clock.
"""

from __future__ import annotations

import array
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from tfg_drake.geometry.se2 import compose, inverse, pose_at
from tfg_drake.grid.frontier import FREE as FREE_CELL
from tfg_drake.grid.frontier import OCCUPIED as OCCUPIED_CELL
from tfg_drake.grid.frontier import CellArray, classify
from tfg_drake.hardware.ros.preset import Frames
from tfg_drake.mapfile.occupancy_grid import CELL, rasterised
from tfg_drake.messages import (
    FloatArray,
    GridMap,
    Odometry,
    Path,
    PoseEstimate,
    TfgMap,
)
from tfg_drake.pictures.layers import LETTER, Layer, Look

Fields = dict[str, Any]

# Cell values of nav_msgs/OccupancyGrid.
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
# Types of visualization_msgs/Marker, and the action that clears a display.
LINE_LIST, SPHERE_LIST, TEXT, DELETE_ALL = 5, 7, 9, 3


def tfg_grid(tfg: TfgMap, stamp: float, frames: Frames, cell: float = CELL) -> Fields:
    """nav_msgs/OccupancyGrid of the TFG, see `mapfile.occupancy_grid.rasterised`. cell: side of a cell, m."""
    kinds, corner = rasterised(tfg, cell)
    return _grid(kinds, cell, corner, stamp, frames)


def grid_of_cells(grid: GridMap, stamp: float, frames: Frames) -> Fields:
    """nav_msgs/OccupancyGrid of a grid that is kept as one, its cells decided."""
    return _grid(classify(grid), grid.resolution, grid.origin, stamp, frames)


def _grid(kinds: CellArray, cell: float, corner: FloatArray, stamp: float, frames: Frames) -> Fields:
    height, width = kinds.shape
    cells = np.full(kinds.shape, UNKNOWN, dtype=np.int8)
    cells[kinds == FREE_CELL], cells[kinds == OCCUPIED_CELL] = FREE, OCCUPIED
    return {
        "header": _header(stamp, frames.map),
        "info": {
            "resolution": float(cell),
            "width": width,
            "height": height,
            "origin": pose_fields(np.array([*corner, 0.0])),
        },
        "data": array.array("b", cells.tobytes()),
    }


def markers(stamp: float, frames: Frames, shown: Iterable[Layer]) -> Fields:
    """visualization_msgs/MarkerArray of layers in the map frame: a namespace each, and one of its labels.

    It begins with the order to forget what was shown before: every array is the whole picture.
    """
    header = _header(stamp, frames.map)
    found: list[Fields] = [{"header": header, "action": DELETE_ALL}]

    def add(ns: str, kind: int, look: Look, scale: Fields, **fields: Any) -> None:
        marker = {"ns": ns, "id": len(found), "type": kind, "scale": scale, "color": look.rgba}
        found.append({"header": header, "action": 0, "pose": pose_fields(np.zeros(3)), **marker, **fields})

    for layer in shown:
        look = layer.look
        if not len(layer.shapes):
            continue
        if layer.kind == "points":
            size = dict.fromkeys("xyz", 2.0 * look.width)
            add(layer.name, SPHERE_LIST, look, size, points=_points(np.asarray(layer.shapes), look.high))
        else:  # Of lines only scale x, the width, is used.
            size = {"x": look.width, "y": 0.0, "z": 0.0}
            add(layer.name, LINE_LIST, look, size, points=_points(layer.segments.reshape(-1, 2), look.high))
        for words, place in layer.labels.items():
            at = pose_fields(np.append(place, 0.0), height=look.high + LETTER)
            add(f"{layer.name} labels", TEXT, look, dict.fromkeys("xyz", LETTER), text=words, pose=at)
    return {"markers": found}


def path(message: Path, stamp: float, frames: Frames) -> Fields:
    """nav_msgs/Path; every pose looks to the next point."""
    along = np.diff(message.points, axis=0)
    yaw = np.arctan2(along[:, 1], along[:, 0])
    header = _header(stamp, frames.map)
    poses = np.column_stack([message.points, np.append(yaw, yaw[-1:]) if len(yaw) else np.zeros(len(message.points))])
    return {"header": header, "poses": [{"header": header, "pose": pose_fields(pose)} for pose in poses]}


def pose(message: PoseEstimate, frames: Frames) -> Fields:
    """geometry_msgs/PoseWithCovarianceStamped: X_MB, and its covariance over x, y and the turn round z."""
    covariance = np.zeros((6, 6))
    covariance[np.ix_((0, 1, 5), (0, 1, 5))] = message.covariance
    return {
        "header": _header(message.stamp, frames.map),
        "pose": {"pose": pose_fields(message.X_MB), "covariance": covariance.ravel().tolist()},
    }


def map_to_odom(message: PoseEstimate, odometry: Odometry, frames: Frames) -> Fields:
    """tf2_msgs/TFMessage with X_MO = X_MB X_BO at the odometry's stamp (REP 105): with odom -> base_link, which the
    base publishes, it makes the estimate."""
    X_MO = compose(pose_at(message, odometry.stamp), inverse(odometry.X_OB))
    return transform(_header(odometry.stamp, frames.map), frames.odom, X_MO)


def transform(header: Fields, child: str, X: FloatArray) -> Fields:
    """tf2_msgs/TFMessage of the pose X (3,) of a frame, its child, in the header's."""
    at = pose_fields(X)
    moved = {"translation": at["position"], "rotation": at["orientation"]}
    return {"transforms": [{"header": header, "child_frame_id": child, "transform": moved}]}


def _header(stamp: float, frame: str) -> Fields:
    return {"stamp": float(stamp), "frame_id": frame}


def pose_fields(X: FloatArray, height: float = 0.0) -> Fields:
    """geometry_msgs/Pose of a pose (3,) in the plane, so high above the floor, m."""
    x, y, theta = (float(value) for value in X)
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * theta), "w": math.cos(0.5 * theta)}
    return {"position": {"x": x, "y": y, "z": height}, "orientation": orientation}


def _points(points: FloatArray, height: float) -> list[Fields]:
    return [{"x": x, "y": y, "z": height} for x, y in points.tolist()]

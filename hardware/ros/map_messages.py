"""ROS messages of map, path and pose: pure functions that return dictionaries of ROS fields.

Metres and radians; the frames' names are the preset's. A header's stamp is the host's time (s) here, because only the
process that drives the robot knows the robot's ROS clock.
"""

from __future__ import annotations

import array
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.geometry.raster import draw_segments, fill_polygon
from tfg_drake.geometry.se2 import compose, inverse, pose_at
from tfg_drake.grid.frontier import FREE as FREE_CELL
from tfg_drake.grid.frontier import OCCUPIED as OCCUPIED_CELL
from tfg_drake.grid.frontier import classify
from tfg_drake.hardware.ros.preset import Frames
from tfg_drake.mapfile.occupancy_grid import CELL
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    MapEstimate,
    Odometry,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)
from tfg_drake.pictures.drawing import ellipses, outline_segments
from tfg_drake.pictures.palette import LIGHT, Colour, gain_colours

Fields = dict[str, Any]
Cells = NDArray[np.int8]

# nav_msgs/OccupancyGrid.
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
# visualization_msgs/Marker: its types, and the action that clears a display.
CYLINDER, LINE_LIST, SPHERE_LIST, TEXT, DELETE_ALL = 3, 5, 7, 9, 3

# Few, because every point is an object of its own to ROS.
ELLIPSE_CORNERS = 16

# The surfaces' names and colours, by TfgMap.segment_kind.
_SURFACES = (("edges", LIGHT.edge), ("wall ends", LIGHT.wall_end), ("surfaces without landmark", LIGHT.bare_surface))


def tfg_grid(tfg: TfgMap, stamp: float, frames: Frames, cell: float = CELL) -> Fields:
    """nav_msgs/OccupancyGrid of the TFG: free where a cell's centre is in a star polygon, occupied along surfaces.

    cell: side of a cell, m. The grid's corner is a multiple of it, so that cells keep their place as the map grows.
    """
    points = np.vstack([tfg.star_vertices, tfg.segments.reshape(-1, 2)])
    if not len(points):
        return _grid(np.zeros((0, 0), dtype=np.int8), cell, np.zeros(2), stamp, frames)
    low = np.floor(points.min(axis=0) / cell) - 1.0
    width, height = (np.floor(points.max(axis=0) / cell) - low + 2.0).astype(int)
    cells = np.full((height, width), UNKNOWN, dtype=np.int8)
    for j in range(len(tfg.star_centers)):
        star = tfg.star_vertices[tfg.star_offsets[j] : tfg.star_offsets[j + 1]]
        fill_polygon(cells, star / cell - low, FREE)
    draw_segments(cells, tfg.segments / cell - np.tile(low, 2), OCCUPIED)
    return _grid(cells, cell, low * cell, stamp, frames)


def grid_of_cells(grid: GridMap, stamp: float, frames: Frames) -> Fields:
    """nav_msgs/OccupancyGrid of a grid that is kept as one, its cells decided."""
    kinds = classify(grid)
    cells = np.full(kinds.shape, UNKNOWN, dtype=np.int8)
    cells[kinds == FREE_CELL], cells[kinds == OCCUPIED_CELL] = FREE, OCCUPIED
    return _grid(cells, grid.resolution, grid.origin, stamp, frames)


def _grid(cells: Cells, cell: float, corner: FloatArray, stamp: float, frames: Frames) -> Fields:
    height, width = cells.shape
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


def markers(
    stamp: float,
    frames: Frames,
    estimate: MapEstimate | None = None,
    tfg: TfgMap | None = None,
    goal: GoalChoice | None = None,
    roadmap: Roadmap | None = None,
) -> Fields:
    """visualization_msgs/MarkerArray of what there is: landmarks with ids and ellipses of three standard deviations,
    surfaces, frontiers, candidate goals coloured by their gain, and the goal.

    It begins with the order to forget what was shown before: every array is the whole picture.
    """
    header = _header(stamp, frames.map)
    found: list[Fields] = [{"header": header, "action": DELETE_ALL}]

    def add(ns: str, kind: int, size: float, colour: Colour, **fields: Any) -> None:
        marker = {"ns": ns, "id": len(found), "type": kind, "pose": pose_fields(np.zeros(3)), "color": _colour(colour)}
        # Lines have no height and no thickness but x; letters only a height, z.
        scale = {"x": size, "y": 0.0 if kind == LINE_LIST else size, "z": 0.0 if kind == LINE_LIST else size}
        found.append({"header": header, "action": 0, **marker, "scale": scale, **fields})

    if tfg is not None:
        for kind, (name, colour) in enumerate(_SURFACES):
            segments = tfg.segments[tfg.segment_kind == kind]
            if len(segments):
                add(name, LINE_LIST, 0.03, colour, points=_points(segments.reshape(-1, 2)))
        if len(tfg.frontiers):
            add("frontiers", SPHERE_LIST, 0.08, LIGHT.frontier, points=_points(tfg.frontiers))
    if estimate is not None and len(estimate.ids):
        add("landmarks", SPHERE_LIST, 0.1, LIGHT.landmark, points=_points(estimate.p_ML))
        outlines = outline_segments(ellipses(estimate.p_ML, estimate.landmark_covariance, corners=ELLIPSE_CORNERS))
        add("ellipses", LINE_LIST, 0.01, LIGHT.landmark, points=_points(outlines.reshape(-1, 2)))
        for name, place in zip(estimate.ids.tolist(), estimate.p_ML, strict=True):
            add("ids", TEXT, 0.2, LIGHT.landmark, text=str(name), pose=pose_fields(np.array([*place, 0.0]), height=0.2))
    if goal is not None and roadmap is not None and goal.stage == roadmap.stage and len(goal.candidates):
        share = np.clip(goal.gain / max(float(goal.gain.max()), 1e-9), 0.0, 1.0)
        colours = [_colour(colour) for colour in gain_colours(share)]
        places = _points(roadmap.points[goal.candidates])
        add("candidates", SPHERE_LIST, 0.12, LIGHT.frontier, points=places, colors=colours)
    if goal is not None and goal.node >= 0:
        add("goal", CYLINDER, 0.25, LIGHT.path, pose=pose_fields(np.array([*goal.p_MG, 0.0])))
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


def _points(points: FloatArray) -> list[Fields]:
    return [{"x": x, "y": y, "z": 0.0} for x, y in points.tolist()]


def _colour(colour: Colour | FloatArray) -> Fields:
    r, g, b = (float(value) for value in colour)
    return {"r": r, "g": g, "b": b, "a": 1.0}

"""The figures of a run's summary that say how far it is from the world, and from the truth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tfg_drake.comparison import metrics
from tfg_drake.comparison.curves import scan_coverage
from tfg_drake.config import FASTEST
from tfg_drake.diagrams.missions.mission import Departure, Mission
from tfg_drake.diagrams.scenario import HatchedKeepOut, Scenario
from tfg_drake.geometry.se2 import compose, inverse, transform
from tfg_drake.grid.frontier import OCCUPIED, cell_sides, classify
from tfg_drake.messages import BoolArray, FloatArray, GridMap, IntArray, MapEstimate, TfgMap, replace
from tfg_drake.storage.trajectory import poses_at
from tfg_drake.world.reachability import (
    coarse,
    make_grid,
    reachable_cells,
    reachable_faces,
    reachable_tags,
    second_faces,
)
from tfg_drake.world.world import World

# The area counts as seen once the scanner has seen the share NEARLY_ALL of its reachable cells: scans may miss corners.
NEARLY_ALL = 0.99
# Scans less than IN_PLACE, m, from a turn's or glance's start count; a robot no farther from its start has not driven.
IN_PLACE = 0.1


class KnownWorld:
    """The world of a mission at its end and its reachable parts, to judge a map.

    reachable: (t,) mask of its tags.
    """

    def __init__(self, world: World, scenario: Scenario, X_WB: FloatArray | None = None) -> None:
        """X_WB: (3,) the robot's last pose, if known: a door may have shut behind it."""
        self._world, self._scenario = world, scenario
        self._grid = make_grid(world)
        limits = scenario.robot.radius, HatchedKeepOut(scenario)
        self._cells = reachable_cells(self._grid, world, *limits)
        if X_WB is not None and scenario.reality.changes:
            self._cells |= reachable_cells(self._grid, replace(world, start=X_WB), *limits)
        tags = scenario.tags
        self.reachable = reachable_tags(world, self._grid, self._cells, tags.range, tags.max_incidence)

    def places(self) -> FloatArray:
        """Return the centres (c, 2) in W, m, of the reachable cells of a grid."""
        return self._grid.centers(self._cells)

    def counted_places(self) -> FloatArray:
        """Return the centres (c, 2) of a coarser set of them, on which the area seen by the scanner is counted."""
        return coarse(self._grid, self._cells)

    def map_figures(self, mission: Mission, estimate: MapEstimate | None, tfg: TfgMap | None) -> dict[str, Any]:
        """Return the errors of a map: of surfaces, and of landmarks that are not doubtful."""
        world, walls = self._world, _mapped_surfaces(mission.X_WM, tfg, mission.grid)
        faces, normals = reachable_faces(world, self._grid, self._cells, self._scenario.scan.range)
        surface = faces[~second_faces(faces, normals)]
        return {
            **landmark_figures(world, self.reachable, estimate, mission.grid is None, mission.X_WM),
            "surface_coverage": metrics.surface_coverage(surface, walls),
            "surface_coverage_5cm": metrics.face_coverage(faces, normals, walls, has_sides=mission.grid is None),
            "surface_phantom_m": metrics.surface_phantom(walls, world.walls),
        }

    def way_figures(
        self, mission: Mission, stamps: FloatArray, X_WB: FloatArray, true_stamps: FloatArray, X_WB_true: FloatArray
    ) -> dict[str, Any]:
        """How far the estimated poses X_WB (n, 3) at stamps (n,), s, are from the true ones (m, 3), and what was seen
        from those."""
        departures = mission.departures
        X_WD_true = poses_at(np.array([one.stamp for one in departures]), true_stamps, X_WB_true)
        X_MD = np.array([one.X_MD for one in departures]).reshape(-1, 3)
        of_departures = np.array([one.covariance for one in departures]).reshape(-1, 3, 3)
        published, X_MB, covariance = mission.published_poses()
        X_WB_then = poses_at(published, true_stamps, X_WB_true)
        return {
            "distance_m": path_length(X_WB_true),
            "pose_anees": metrics.pose_anees(X_MD, compose(inverse(mission.X_WM), X_WD_true), of_departures),
            "online_pose_anees": online_pose_anees(X_MB, covariance, X_WB_then, mission.X_WM),
            **pose_errors(X_WB, poses_at(stamps, true_stamps, X_WB_true)),
            **self._area(mission, true_stamps, X_WB_true),
        }

    def _area(self, mission: Mission, stamps: FloatArray, X_WB: FloatArray) -> dict[str, float]:
        """Return the share of the reachable cells that was seen, and when the scanner had seen NEARLY_ALL of them, s.

        For a method that maps only at turns and glances, the share is that seen from their starts; otherwise that seen
        by the scanner on the whole way.
        """
        scan = self._scenario.scan
        seen = self.counted_places(), self._world.walls, scan.range, scan.field_of_view
        rows, share = scan_coverage(X_WB, *seen)
        nearly = np.flatnonzero(share >= NEARLY_ALL)
        coverage = float(share[-1]) if len(share) else math.nan
        if mission.grid is None:
            looked = [_looked(one, stamps, X_WB) for one in mission.departures]
            _, share = scan_coverage(X_WB[np.concatenate([np.zeros(0, dtype=np.int64), *looked])], *seen)
            coverage = float(share[-1]) if len(share) else 0.0
        return {"area_coverage": coverage, "area_seen_s": float(stamps[rows[nearly[0]]]) if len(nearly) else math.nan}


def online_pose_anees(X_MB: FloatArray, covariance: FloatArray, X_WB_true: FloatArray, X_WM: FloatArray) -> float:
    """ANEES of poses X_MB (n, 3) that a robot drove by, with the covariances (n, 3, 3) that were published with them.

    X_WB_true: (n, 3) at the same instants. X_WM: (3,) pose of the map frame. Poses with a singular covariance
    are left out: the first, at M's origin by definition.
    """
    judged = np.linalg.det(covariance) > 0.0
    return metrics.pose_anees(X_MB[judged], compose(inverse(X_WM), X_WB_true[judged]), covariance[judged])


def path_length(X_WB: FloatArray) -> float:
    """Length of the way through poses (n, 3), m."""
    return float(np.linalg.norm(np.diff(X_WB[:, :2], axis=0), axis=1).sum())


def driven(stamps: FloatArray, X_WB: FloatArray) -> float:
    """Length of the way through poses (n, 3) as they were estimated at stamps (n,), s, in m, without the jumps of the
    estimate: steps that no robot drives in their time."""
    steps = np.hypot(*np.diff(X_WB[:, :2], axis=0).T)
    return float(steps[steps <= FASTEST * np.diff(stamps)].sum())


def pose_errors(X_WB: FloatArray, X_WB_true: FloatArray) -> dict[str, Any]:
    """Statistics of the distance of poses (n, 3) from the true ones, of positions also from the first drive on, nan
    without any: at the start the robot is at the map's origin by definition."""
    position, heading = metrics.pose_errors(X_WB, X_WB_true)
    has_driven = np.maximum.accumulate(np.hypot(*(X_WB_true[:, :2] - X_WB_true[:1, :2]).T)) > IN_PLACE
    return {
        "position_error_m": metrics.statistics(position),
        "position_error_moving_m": metrics.statistics(position[has_driven]),
        "heading_error_rad": metrics.statistics(heading),
    }


def landmark_figures(
    world: World,
    reachable: BoolArray,
    estimate: MapEstimate | None,
    maps_landmarks: bool,
    X_WM: FloatArray,
) -> dict[str, Any]:
    """How many of the tags are mapped, and, where there is a map, how well.

    Args:
        world: with the true tags; reachable (n,): those of them that can be seen from where the robot can be.
        estimate: the map, None where there is none; maps_landmarks: whether the method makes one.
        X_WM: (3,) pose of the map frame.
    """
    mapped = estimate.ids if estimate is not None else np.zeros(0, dtype=np.int64)
    trusted = ~estimate.is_doubtful if estimate is not None else np.zeros(0, dtype=np.bool_)
    counted = trusted & np.isin(mapped, world.tag_ids[reachable])
    figures: dict[str, Any] = {
        "landmarks_present": len(world.tag_ids),
        "landmarks_reachable": int(np.count_nonzero(reachable)),
        "landmarks_mapped": int(np.count_nonzero(counted)) if maps_landmarks else None,
        "landmarks_extra": int(np.count_nonzero(trusted & ~counted)) if maps_landmarks else None,
    }
    if estimate is None:
        return figures
    row_of_tag = {tag: row for row, tag in enumerate(world.tag_ids.tolist())}
    known = np.array([i for i, tag in enumerate(mapped.tolist()) if trusted[i] and tag in row_of_tag], dtype=np.int64)
    rows = np.array([row_of_tag[mapped[i]] for i in known], dtype=np.int64)
    p_ML_true = transform(inverse(X_WM), world.p_WT[rows])
    p_ML = estimate.p_ML[known]
    each = estimate.landmark_covariance[known]
    entry = estimate.local_entry[known]
    of_joint = entry >= 0
    entry = entry[of_joint]
    entries = np.stack([2 * entry, 2 * entry + 1], axis=1).ravel()
    covariance = estimate.covariance[np.ix_(entries, entries)]
    return figures | {
        "landmark_rmse_m": metrics.landmark_rmse(p_ML, p_ML_true),
        "landmark_error_max_m": float(np.max(np.hypot(*(p_ML - p_ML_true).T), initial=0.0)),
        "landmark_rmse_aligned_m": metrics.landmark_rmse_aligned(p_ML, p_ML_true),
        "landmark_anees": metrics.anees(p_ML - p_ML_true, each),
        "landmark_nees": metrics.landmark_nees(p_ML[of_joint], p_ML_true[of_joint], covariance),
    }


def _mapped_surfaces(X_WM: FloatArray, tfg: TfgMap | None, grid: GridMap | None) -> FloatArray:
    """Return the obstacle surfaces of a map as segments (n, 4) in W, m; of a grid, the sides of occupied cells."""
    if tfg is not None:
        p_MS = tfg.segments
    elif grid is not None:
        p_MS = cell_sides(grid, classify(grid) == OCCUPIED)
    else:
        p_MS = np.zeros((0, 4))
    return transform(X_WM, p_MS.reshape(-1, 2)).reshape(-1, 4)


def _looked(one: Departure, stamps: FloatArray, X_WB: FloatArray) -> IntArray:
    """Return the rows of the true poses X_WB (n, 3) at stamps (n,) at which one view's scans were kept."""
    rows = np.flatnonzero((stamps >= one.since) & (stamps <= one.stamp))
    return rows[np.hypot(*(X_WB[rows, :2] - X_WB[rows[:1], :2]).T) < IN_PLACE] if len(rows) else rows

"""A map's frame M in the world: by surveyed tags, by the walls of a plan, or by its own walls."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.distance import point_distance
from tfg_drake.io.files import FileError, read_text
from tfg_drake.mapfile.placement import Standing, by_walls, standing_in
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.tag_search import by_tags
from tfg_drake.world.map_server import OccupancyMap

# Deviation of a surveyed tag, m. Least agreement of a map's walls, as a share, for axes along them.
SURVEY, ALIKE = 0.01, 0.5


class Surveyed(NamedTuple):
    """A map in the frame of a survey. ids: (c,) tags of both, off: (c,) how far the map has each from where it was
    surveyed, m, is_wrong: (c,) which contradict the others and do not count. scale: by how much the map's lengths are
    too long, as a share."""

    saved: SavedMap
    ids: IntArray
    off: FloatArray
    is_wrong: BoolArray
    scale: float


def read_survey(path: Path) -> MapEstimate:
    """Surveyed tags of a .csv with the columns id, x_m and y_m, as a map's own export has them, as a map in W.

    Raises:
        FileError: it cannot be read, has other columns, no numbers or a tag twice; one line.
    """
    try:
        rows = csv.DictReader(read_text(path).splitlines())
        table = np.array([[float(row[name]) for name in ("id", "x_m", "y_m")] for row in rows]).reshape(-1, 3)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise FileError(f"{path}: its first line must be id,x_m,y_m, and each other have a number for each") from None
    ids, rows_of_ids = np.unique(table[:, 0], return_index=True)
    if len(ids) < len(table) or not np.isfinite(table).all() or np.any(ids % 1.0):
        raise FileError(f"{path}: each tag must be in it once, by an integer id, at finite x_m and y_m")
    table = table[rows_of_ids]
    covariance, none = np.tile(SURVEY**2 * np.eye(2), (len(ids), 1, 1)), np.zeros((len(ids), 2))
    known = replace(empty_map(), ids=ids.astype(np.int64), p_ML=table[:, 1:], landmark_covariance=covariance)
    return replace(known, anchor=none, reach=none)


def in_survey(saved: SavedMap, survey: MapEstimate) -> Surveyed:
    """The map with its frame M where the surveyed tags have it, by least squares of those that agree.

    Raises:
        BadInput: fewer than three agree; one line.
    """
    found = by_tags(survey, saved.graph)
    ids, in_W, in_M = np.intersect1d(survey.ids, saved.ids, return_indices=True)
    if found is None:
        raise BadInput(f"{len(ids)} surveyed tags are in the map, too few or too near to each other: survey more of it")
    p_WL, p_ML, right = survey.p_ML[in_W], saved.p_ML[in_M], ~np.isin(ids, found.moved)
    X_WM = align(p_WL[right], p_ML[right])
    p = se2.transform(X_WM, p_ML)
    a, b = (one[right] - one[right].mean(axis=0) for one in (p_WL, p))
    scale = float(np.sum(b * b) / np.sum(a * b)) - 1.0
    return Surveyed(replace(saved, X_WM=X_WM), ids, np.hypot(*(p - p_WL).T), ~right, scale)


def in_plan(saved: SavedMap, plan: OccupancyMap) -> tuple[SavedMap, FloatArray]:
    """The map with its frame M where the walls of a plan have it, and how far the middle of each piece of its surfaces
    (m,) is from those walls, m. Raises BadInput where they do not tell it."""
    found = by_walls(Standing(plan.walls, np.empty((0, 3))), standing_in(saved))
    if found is None:
        raise BadInput("the walls of the map fit the plan nowhere, or in several places: align it by tags")
    segments = saved.tfg.segments
    middle = se2.transform(found.X, 0.5 * (segments[:, :2] + segments[:, 2:]))
    return replace(saved, X_WM=found.X), point_distance(middle, plan.walls)


def along_axes(saved: SavedMap) -> SavedMap:
    """The map turned about the origin of W, by 45 degrees at most, so that its walls lie along the axes.

    Raises:
        BadInput: its walls have no common direction; one line.
    """
    segments = saved.tfg.segments
    along = (segments[:, 2:] - segments[:, :2]) @ np.array([1.0, 1.0j])
    length = np.abs(along)
    # Directions a quarter turn apart are one.
    sum_of = np.sum(length * np.exp(4.0j * np.angle(along)))
    if np.abs(sum_of) <= ALIKE * length.sum():
        raise BadInput("the walls of the map lie in all directions: align it by tags or by a plan")
    turn = -0.25 * float(np.angle(sum_of * np.exp(4.0j * saved.X_WM[2])))
    return replace(saved, X_WM=se2.compose(np.array([0.0, 0.0, turn]), saved.X_WM))

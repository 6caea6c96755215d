"""One figure of an estimate on a data set: landmarks, or walls, and trajectories against the truth."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from scipy.spatial import cKDTree

from tfg_drake.datasets.recording import GroundTruth
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.pictures.figure_file import write_figure
from tfg_drake.pictures.palette import LIGHT, css
from tfg_drake.pictures.panels import add_legend, plan

_SMOOTHED, _ONLINE, _TRUTH = css(LIGHT.robot), css(LIGHT.bare_surface), css(LIGHT.scan)
# Of the drawing, inches.
_WIDTH = 9.0
# Landmarks are named up to this number.
_MOST_NAMES = 100
# Greatest number of hits that are drawn, as more are a uniform grey.
_MOST_HITS = 60_000
# A wall is drawn where a hit is within BESIDE, m, of it, in steps of STEP, m.
BESIDE, STEP = 0.15, 0.05


def draw_slam(
    path: Path,
    title: str,
    trajectories: dict[str, FloatArray],
    ids: IntArray,
    p_WL: FloatArray,
    truth: GroundTruth,
    misfit_ids: IntArray,
) -> None:
    """Write the figure as a PNG, atomically; everything in one frame, any part may be empty.

    Args:
        path: the file.
        title: stands above the figure.
        trajectories: "smoothed" and "online" positions (n, 2), m.
        ids, p_WL: (l,) and (l, 2) estimated landmarks.
        truth: true poses and landmarks.
        misfit_ids: landmarks that contradict their truth; a line joins the two.

    Raises:
        OSError: the file cannot be written.
    """
    known, path_true = np.isin(truth.ids, ids), truth.X_WB[:, :2]
    points = np.vstack([path_true, *trajectories.values(), p_WL, truth.p_WL[known], np.zeros((1, 2))])
    figure, axes, _ = plan(title, points, _WIDTH)
    if len(path_true):
        axes.plot(*path_true.T, color=_TRUTH, linewidth=1.8, label="true path")
    for (name, path_points), color in zip(trajectories.items(), (_SMOOTHED, _ONLINE), strict=False):
        if len(path_points):
            axes.plot(*path_points.T, color=color, linewidth=0.7, label=f"{name} path")
    if known.any():
        axes.plot(*truth.p_WL[known].T, "s", color="0.55", markersize=7, fillstyle="none", label="true landmark")
    if len(ids):
        axes.plot(*p_WL.T, "o", color="0.1", markersize=4, markeredgewidth=0, label="landmark")
    if len(ids) <= _MOST_NAMES:
        for name, p in zip(ids, p_WL, strict=True):
            axes.annotate(str(name), p, xytext=(4, 4), textcoords="offset points", fontsize=7, color="0.25")
    for name in misfit_ids:
        ends = np.vstack([p_WL[ids == name], truth.p_WL[truth.ids == name]])
        axes.plot(*ends.T, "--", color=css(LIGHT.keep_out), linewidth=0.8)
    write_figure(path, add_legend(figure, 5))


def draw_laser_map(
    path: Path, title: str, p_MH: FloatArray, walls: FloatArray, p_MS: FloatArray, p_MS_true: FloatArray
) -> None:
    """Write the map of a laser log as a PNG, atomically.

    Args:
        path: the file.
        title: stands above the figure.
        p_MH: (h, 2) what the scans met, m, at the poses that were solved.
        walls: (w, 2, 2) the ends of the map's walls.
        p_MS, p_MS_true: (n, 2) the scanner's path and the true one, which may be empty.

    Raises:
        OSError: the file cannot be written.
    """
    shown = p_MH[np.random.default_rng(0).permutation(len(p_MH))[:_MOST_HITS]]
    # A few scattered ones would make the building small.
    inside = np.all((shown > np.quantile(shown, 0.002, axis=0)) & (shown < np.quantile(shown, 0.998, axis=0)), axis=1)
    shown = shown[inside]
    pieces = met(walls, p_MH)
    figure, axes, _ = plan(title, np.vstack([shown, p_MS, p_MS_true, pieces.reshape(-1, 2)]), _WIDTH)
    axes.plot(*shown.T, ".", color="0.45", alpha=0.5, markersize=1.5, markeredgewidth=0, rasterized=True)
    axes.plot([], [], ".", color="0.45", markersize=5, label="hits of the scans")
    if len(pieces):
        axes.add_collection(LineCollection(list(pieces), colors=css(LIGHT.wall_landmark), linewidths=1.3, label="wall"))
    if len(p_MS_true):
        axes.plot(*p_MS_true.T, color=_TRUTH, linewidth=1.8, label="reference path")
    axes.plot(*p_MS.T, color=_ONLINE, linewidth=0.7, label="path")
    write_figure(path, add_legend(figure, 5))


def met(walls: FloatArray, p_MH: FloatArray) -> FloatArray:
    """The pieces (n, 2, 2) of walls (w, 2, 2) beside which scans met something at p_MH (h, 2), m: what lies on one
    straight line, such as the legs of chairs in a row, may be one wall, which is not there in between."""
    pieces, tree = [np.zeros((0, 2, 2))], cKDTree(p_MH)
    for a, b in walls:
        points = a + np.linspace(0.0, 1.0, 2 + int(math.dist(a, b) / STEP))[:, None] * (b - a)
        near = tree.query(points, distance_upper_bound=BESIDE)[0] < BESIDE
        ends = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2)
        pieces.append(np.stack([points[ends[:, 0]], points[ends[:, 1] - 1]], axis=1))
    return np.concatenate(pieces)

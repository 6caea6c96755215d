"""Figures of panels that show one area of the plane, all to one scale."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tfg_drake.messages import FloatArray
from tfg_drake.pictures.layers import SYMBOL

POINTS_PER_INCH = 72.0
# Margin around the content, m; least and greatest height of all panels, inches, and size of a symbol, points.
MARGIN = 1.0
HEIGHTS = 1.5, 12.0
SYMBOLS = 0.7, 2.0


def panels(
    points: FloatArray, width: float, beside: float, rows: int = 1, columns: int = 1
) -> tuple[Figure, list[Axes], float]:
    """A figure of equal panels without frames.

    Args:
        points: (n, 2) what is to be seen in each, m; what is drawn beyond it widens a panel's limits.
        width: of the figure, inches. beside: its height above and below the panels, inches.
        rows, columns: of panels.

    Returns:
        The figure, its axes row by row, and a symbol's size on them, points.
    """
    (x_min, y_min), (x_max, y_max) = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    scale = width / columns / (x_max - x_min)
    height = float(np.clip(rows * scale * (y_max - y_min), *HEIGHTS)) + beside
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel().tolist()
    for axis in axes:
        axis.set(aspect="equal", xmargin=0.0, ymargin=0.0)
        axis.update_datalim([(x_min, y_min), (x_max, y_max)])
        axis.autoscale_view()
        axis.spines[:].set_visible(False)
    return figure, axes, float(np.clip(SYMBOL * scale * POINTS_PER_INCH, *SYMBOLS))


def plan(title: str, points: FloatArray, width: float) -> tuple[Figure, Axes, float]:
    """A figure of one panel with its axes in metres and a title of one line or more; see `panels`."""
    figure, (axis,), symbol = panels(points, width, 0.7 + 0.2 * len(title.splitlines()))
    axis.set(xlabel="x (m)", ylabel="y (m)")
    axis.tick_params(labelsize=8, colors="0.35")
    axis.set_title(title, loc="left", fontsize=10)
    return figure, axis, symbol


def add_legend(figure: Figure, columns: int = 6) -> Figure:
    """The figure, with its legend below it."""
    figure.legend(loc="outside lower left", ncols=columns, fontsize=8, frameon=False, labelcolor="0.25")
    return figure

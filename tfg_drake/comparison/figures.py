"""The paper's comparison in figures (its Figs. 6 to 8, Table II): pose error against time, coverage against distance,
final maps, and what a map costs. One colour a method throughout."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tfg_drake.comparison.curves import Band
from tfg_drake.comparison.statistics import Spread
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, GridMap
from tfg_drake.percent import percent
from tfg_drake.pictures.figure import draw, draw_known
from tfg_drake.pictures.layers import Layer, layers
from tfg_drake.pictures.palette import LIGHT, css
from tfg_drake.pictures.panels import panels
from tfg_drake.pictures.scene import grid_cells
from tfg_drake.world.world import World

# Okabe and Ito's colours, which the colour-blind can tell apart too.
_NAMED = {"tfg": "#0072B2", "tfg-argmax": "#56B4E9", "tfg-nearest": "#D55E00", "grid-nearest": "#000000"}
_NAMED |= {"weighted": "#009E73", "random": "#E69F00", "scripted": "#CC79A7"}
_OTHERS = ("#8c6d31", "#7f3c8d", "#66a61e", "#a6761d", "#666666")
_WIDTH = 7.2  # of the text of a two-column paper, inches
_SMALL, _TEXT = 7, 8  # points
# A quantity that differs between methods by more than this factor has a logarithmic scale.
_WIDE = 10.0


@dataclasses.dataclass(frozen=True)
class FinalMap:
    """Map of one run of a method: a landmark map, a grid, or neither; X_WB (n, 3): its true way."""

    method: str
    seed: int
    world: World
    X_WB: FloatArray
    saved: SavedMap | None
    grid: GridMap | None


def colours(methods: Sequence[str]) -> dict[str, str]:
    """A colour for each method, the same in every comparison for those that come with the project."""
    others = [method for method in methods if method not in _NAMED]
    return _NAMED | {method: _OTHERS[i % len(_OTHERS)] for i, method in enumerate(others)}


def draw_errors(position: Mapping[str, Band], heading: Mapping[str, Band]) -> Figure:
    """Errors of position and heading against time: mean and range of each method."""
    figure = _figure(3.9)
    upper, lower = figure.subplots(2, 1, sharex=True)
    _draw_bands(upper, position)
    _draw_bands(lower, heading)
    upper.set_ylabel("position error (m)", fontsize=_TEXT)
    lower.set_ylabel("heading error (rad)", fontsize=_TEXT)
    lower.set_xlabel("simulated time (s)", fontsize=_TEXT)
    _legend(figure, upper)
    return figure


def draw_coverage(share: Mapping[str, Band]) -> Figure:
    """Share of the reachable area seen against the distance driven: mean and range of each method."""
    figure = _figure(2.9)
    axes = figure.subplots()
    _draw_bands(axes, {name: _scaled(one, 100.0) for name, one in share.items()}, may_be_wide=False)
    axes.set_ylim(0.0, 103.0)
    axes.set_ylabel("reachable area seen (%)", fontsize=_TEXT)
    axes.set_xlabel("distance driven (m)", fontsize=_TEXT)
    _legend(figure, axes)
    return figure


def draw_maps(maps: Sequence[FinalMap]) -> Figure:
    """The final maps side by side over the true walls, all to one scale."""
    columns = min(len(maps), 2)
    rows = -(-len(maps) // columns)
    points = np.vstack([p for one in maps for p in (one.world.walls.reshape(-1, 2), one.X_WB[:, :2])])
    figure, grid, symbol = panels(points, _WIDTH, 0.25 * rows + 0.45, rows, columns)
    for axes in grid:
        axes.set_axis_off()
    for axes, one in zip(grid, maps, strict=False):
        _draw_final_map(axes, one, symbol)
        axes.set_title(one.method, fontsize=_TEXT)
    marks = {label: mark for axes in grid for mark, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(
        marks.values(),
        marks.keys(),
        loc="outside lower center",
        ncols=3,
        fontsize=_SMALL,
        frameon=False,
        markerscale=1.5,
    )
    return figure


def draw_costs(costs: Mapping[str, Mapping[str, Spread]]) -> Figure:
    """Bars of what each method needs, a panel a quantity: its title with the unit, and each method's spread."""
    methods = list(next(iter(costs.values())))
    palette = colours(methods)
    figure = _figure(0.75 + 0.24 * len(methods))
    panels = np.atleast_1d(figure.subplots(1, len(costs), sharey=True))
    for axes, (title, spreads) in zip(panels, costs.items(), strict=True):
        means = np.array([spreads[method].mean.value for method in methods])
        shown = means[np.isfinite(means)]
        if len(shown) and shown.min() > 0.0 and shown.max() > _WIDE * shown.min():
            axes.set_xscale("log")
            axes.set_xlim(0.3 * shown.min(), 10.0 * shown.max())
        elif len(shown):
            axes.set_xlim(0.0, 1.35 * shown.max() or 1.0)
        axes.set_xticks([], minor=True)
        axes.set_xticks([])  # The bars say their numbers.
        bars = axes.barh(methods, means, color=[palette[method] for method in methods], height=0.65)
        texts = [_short(percent(0.01 * mean) if title.endswith("(%)") else mean) for mean in means]
        axes.bar_label(bars, texts, padding=2, fontsize=_SMALL)
        for row in np.flatnonzero(np.isnan(means)):
            axes.text(0.02, row, "-", transform=axes.get_yaxis_transform(), fontsize=_SMALL, va="center")
        axes.set_title(title, fontsize=_TEXT)
        _tidy(axes)
        axes.spines["bottom"].set_visible(False)
        axes.tick_params(axis="y", length=0)
    panels[0].invert_yaxis()
    return figure


def _draw_final_map(axes: Axes, one: FinalMap, symbol: float) -> None:
    draw(axes, np.zeros(3), [Layer("wall", one.world.walls)], symbol)
    if one.grid is not None:
        draw(axes, one.world.start, layers("grid", grid_cells(one.grid), cell=one.grid.resolution), symbol)
    if len(one.X_WB):
        axes.plot(*one.X_WB[:, :2].T, color=css(LIGHT.robot), linewidth=0.4, alpha=0.6, label="true path", zorder=2)
    if one.saved is not None:
        draw_known(axes, one.saved.X_WM, one.saved, one.saved.tfg, one.saved.graph, symbol)


def _draw_bands(axes: Axes, bands: Mapping[str, Band], *, may_be_wide: bool = True) -> None:
    """Mean line and shaded range; the line is thin where some of the runs have ended."""
    palette = colours(list(bands))
    levels = [float(np.median(one.mean)) for one in bands.values()]
    wide = may_be_wide and bool(levels) and min(levels) > 0.0 and max(levels) > _WIDE * min(levels)
    bottom = 0.05 * min(levels) if wide else 0.0
    for method, one in bands.items():
        colour, together = palette[method], one.x <= one.common
        # Robots that have not moved yet have no error, which no logarithm shows.
        mean = np.where(one.mean >= bottom, one.mean, np.nan)
        axes.fill_between(one.x, one.low, one.high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(one.x[together], mean[together], color=colour, linewidth=1.3, label=method)
        rest = one.x >= (one.x[together][-1] if together.any() else 0.0)
        axes.plot(one.x[rest], mean[rest], color=colour, linewidth=0.6)
    if wide:
        axes.set_yscale("log")
    axes.set_ylim(bottom=bottom)
    axes.set_xlim(0.0, max((float(one.x[-1]) for one in bands.values()), default=0.0) or 1.0)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    _tidy(axes)


def _scaled(one: Band, factor: float) -> Band:
    return dataclasses.replace(one, mean=factor * one.mean, low=factor * one.low, high=factor * one.high)


def _legend(figure: Figure, axes: Axes) -> None:
    marks, labels = axes.get_legend_handles_labels()
    columns = min(len(labels), 7) or 1
    figure.legend(marks, labels, loc="outside upper center", ncols=columns, fontsize=_TEXT, frameon=False)


def _figure(height: float) -> Figure:
    return Figure(figsize=(_WIDTH, height), layout="constrained")


def _tidy(axes: Axes) -> None:
    axes.tick_params(labelsize=_SMALL, colors="0.25")
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("0.6")


def _short(value: float) -> str:
    """A bar's number: three digits, and thousands apart."""
    if not np.isfinite(value):
        return ""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"

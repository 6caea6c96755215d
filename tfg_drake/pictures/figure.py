"""One figure that shows a whole run: the building, the map made of it, and the way the robot went."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from tfg_drake.geometry.se2 import compose, transform
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import BoolArray, FloatArray, GridMap, MapEstimate, TfgMap
from tfg_drake.pictures import scene
from tfg_drake.pictures.drawing import MAGNIFIED
from tfg_drake.pictures.figure_file import write_figure
from tfg_drake.pictures.layers import SPREAD, Layer, layers, of_free_space, of_map
from tfg_drake.pictures.palette import LIGHT, css
from tfg_drake.pictures.panels import POINTS_PER_INCH, add_legend, plan
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.walls import known_walls
from tfg_drake.world.world import World

# Least distance of two numbered views, points of the drawing.
NUMBER_SPACING = 36.0
# The truth is light and dashed on the dark estimate, as they overlap where they agree.
_ESTIMATE, _TRUTH = css(LIGHT.robot), css(LIGHT.camera)
# If their median is below this, m, three deviations are drawn MAGNIFIED times as large.
SEEN = 0.1
# Width of the drawing, inches.
_WIDTH = 11.0
NO_POSES = np.zeros((0, 3))


def run_figure(
    title: str,
    world: World | None = None,
    estimate: MapEstimate | SavedMap | None = None,
    tfg: TfgMap | None = None,
    grid: GridMap | None = None,
    X_WB_estimated: FloatArray = NO_POSES,
    X_WB_true: FloatArray = NO_POSES,
    reachable: BoolArray | None = None,
    X_WM: FloatArray | None = None,
    with_walls: MapEstimate | KeyframeGraph | None = None,
) -> Figure:
    """The building, the map made of it, and the way the robot went.

    Args:
        title: stands above the figure; one to three lines.
        world: walls, tags and start, in W; None where it is not known.
        estimate, tfg, grid: the map in M; None where there is none (yet).
        X_WB_estimated, X_WB_true: (n, 3) and (m, 3) trajectories in W; may be empty.
        reachable: (t,) of the world's tags: only these count as missed when they are not in the map; None for none.
        X_WM: (3,) pose of the map frame in W, that of the start where there is none.
        with_walls: the estimate with the walls that are landmarks, None where there are none.

    Of a world that is not known the map frame takes the place, and the map says how large it is.
    """
    grid = grid if grid is not None and grid.probability.size else None  # Nothing is mapped before the first scan.
    if X_WM is None:
        X_WM = world.start if world is not None else np.zeros(3)
    shown, in_M = [X_WB_true[:, :2], X_WM[None, :2]], list[FloatArray]()
    if world is not None:
        shown.append(world.walls.reshape(-1, 2))
    else:
        in_M += [estimate.p_ML, estimate.X_MA[:, :2]] if estimate is not None else []
        in_M += [tfg.segments.reshape(-1, 2), tfg.frontiers, tfg.star_vertices] if tfg is not None else []
        in_M += [scene.grid_cells(grid)["free"].reshape(-1, 2)] if grid is not None else []
        shown += [X_WB_estimated[:, :2], *(transform(X_WM, points) for points in in_M)]
    figure, axes, symbol = plan(title, np.vstack(shown), _WIDTH)

    if world is not None:
        draw(axes, np.zeros(3), [Layer("wall", world.walls)], symbol)
    if grid is not None:
        draw(axes, X_WM, layers("grid", scene.grid_cells(grid), cell=grid.resolution), symbol)
    draw_known(axes, X_WM, estimate, tfg, with_walls, symbol)
    if len(X_WB_estimated):
        axes.plot(*X_WB_estimated[:, :2].T, color=_ESTIMATE, linewidth=2.4, label="estimated path")
    if len(X_WB_true):
        (truth,) = axes.plot(*X_WB_true[:, :2].T, color=_TRUTH, linewidth=1.3, label="true path", zorder=4.95)
        truth.set_linestyle((0, (3, 2)))
    if estimate is not None:
        _draw_views(axes, X_WM, estimate.X_MA)
    if world is not None and grid is None and reachable is not None:
        missed = world.p_WT[reachable & ~np.isin(world.tag_ids, () if estimate is None else estimate.ids)]
        if len(missed):
            label = "tag missed"
            axes.plot(
                *missed.T, "X", color=css(LIGHT.keep_out), markersize=4.0 * symbol, markeredgewidth=0, label=label
            )
    start = X_WB_estimated[0] if len(X_WB_estimated) else X_WM
    axes.plot(*start[:2], "^", color="0.1", markersize=7, label="start", zorder=6)
    way = X_WB_true if len(X_WB_true) else X_WB_estimated
    if len(way):
        axes.plot(*way[-1, :2], "s", color="0.1", markersize=6, label="end", zorder=6)
    return add_legend(figure)


def draw_map(path: Path, title: str, saved: SavedMap) -> None:
    """Write the figure of a saved map as a PNG or PDF, by the file's suffix, atomically.

    Args:
        path: the file.
        title: stands above the figure; one or two lines.
        saved: the map; the figure is in W.

    Raises:
        OSError: the file cannot be written.
    """
    figure = run_figure(title, estimate=saved, tfg=saved.tfg, X_WM=saved.X_WM, with_walls=saved.graph)
    write_figure(path, figure)


def draw_known(
    axes: Axes,
    X_WM: FloatArray,
    known: MapEstimate | SavedMap | None,
    tfg: TfgMap | None,
    walls: MapEstimate | KeyframeGraph | None,
    symbol: float,
) -> None:
    """The layers of a map onto axes of W: free space, surfaces, frontiers, and landmarks with their deviations, all
    MAGNIFIED where most could not be seen. walls: with those that are landmarks. symbol: see `draw`."""
    deviations = [np.zeros(0)]
    if known is not None:
        deviations.append(np.sqrt(np.linalg.eigvalsh(known.landmark_covariance)[:, -1]))
    if walls is not None:
        deviations.append(known_walls(walls)[2].max(axis=1))
    all_of_them = np.concatenate(deviations)
    times = MAGNIFIED if len(all_of_them) and 3.0 * float(np.median(all_of_them)) < SEEN else 1.0
    if tfg is not None:
        draw(axes, X_WM, of_free_space(tfg), symbol)
    draw(axes, X_WM, of_map(known, tfg, walls, 3.0 * times), symbol, times)


def draw(axes: Axes, X_WM: FloatArray, shown: Iterable[Layer], symbol: float, times: float = 1.0) -> None:
    """Layers onto axes of W, what is higher above the rest, with their names for a legend.

    Args:
        axes, X_WM: the axes, and the pose (3,) of the layers' frame in W.
        shown: the layers.
        symbol: a symbol's size, points.
        times: standard deviations are drawn so many times as large.
    """
    for layer in shown:
        look, colour = layer.look, css(layer.look.colour)
        places = [transform(X_WM, np.reshape(shape, (-1, 2))) for shape in layer.shapes]
        if not places:
            continue
        label = look.words + (f" \u00d7 {times:g}" if layer.name.endswith(SPREAD) and times > 1.0 else "")
        # Standing layers are translucent in 3D only, to show what is behind them.
        opacity = 1.0 if look.stands else look.opacity
        style: dict[str, Any] = {"label": label or None, "alpha": opacity, "zorder": 1.0 + look.high}
        if layer.kind == "points":
            size = 2.0 * look.size * symbol
            axes.plot(*np.vstack(places).T, "o", color=colour, markersize=size, markeredgewidth=0, **style)
        elif layer.kind == "lines":
            axes.add_collection(LineCollection(places, colors=colour, linewidths=look.size * symbol, **style))
        else:
            # Cells side by side hang together by their edges.
            edges = {"edgecolors": colour, "linewidths": 0.2} if opacity == 1.0 else {"edgecolors": "none"}
            axes.add_collection(PolyCollection(places, facecolors=colour, **edges, **style))
    axes.autoscale_view()  # Collections do not.


def _draw_views(axes, X_WM: FloatArray, X_MA: FloatArray) -> None:  # type: ignore[no-untyped-def]
    """A dot where each turn or glance began, under its number where there is room for one."""
    views = compose(X_WM, X_MA)[:, :2] if len(X_MA) else np.zeros((0, 2))
    if not len(views):
        return
    x_min, x_max = axes.get_xlim()
    spacing = NUMBER_SPACING * (x_max - x_min) / (_WIDTH * POINTS_PER_INCH)
    numbered: list[int] = []
    # The last first: where the robot came back, the newer number says so.
    for number in range(len(views) - 1, -1, -1):
        if all(np.hypot(*(views[number] - views[other])) > spacing for other in numbered):
            numbered.append(number)
    dots = {"markerfacecolor": "white", "label": "turn or glance", "zorder": 4.97}
    axes.plot(*views.T, "o", markersize=4, color=_ESTIMATE, linewidth=0, **dots)
    # As wide as the number is.
    box = {"boxstyle": "round,pad=0.3,rounding_size=0.8", "facecolor": "white", "edgecolor": _ESTIMATE}
    middle = {"ha": "center", "va": "center"}
    for number in numbered:
        axes.text(*views[number], str(number + 1), fontsize=6, color=_ESTIMATE, bbox=box, **middle, zorder=5)

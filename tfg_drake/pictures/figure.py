"""One figure that shows a whole run: the building, the map made of it, and the way the robot went."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D

from tfg_drake.geometry.se2 import compose, rotation, transform
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import BoolArray, FloatArray, GridMap, MapEstimate, TfgMap
from tfg_drake.pictures.drawing import MAGNIFIED, ellipses, spreads
from tfg_drake.pictures.figure_file import write_figure
from tfg_drake.pictures.palette import LIGHT, css
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.walls import known_walls
from tfg_drake.world.world import World

_WALL, _EDGE, _BARE = "0.85", "0.15", "#e8962e"
_MAPPED, _DOUBTFUL, _MISSED = "#12876f", "#a32ea8", "#d62728"
# Views nearer to each other than this, m and in points of the drawing, are not both numbered.
NUMBER_SPACING = 1.5
NUMBER_POINTS = 36.0
# Light, dashed on dark: one lies over the other where both agree.
_ESTIMATE, _TRUTH = "#1f4e9c", "#ffc107"
_FREE, _FRONTIER = "#f1f4ee", "#1a5ce0"
# Three deviations whose median is below this, m, are drawn MAGNIFIED times as large.
SEEN = 0.1
# Of the drawing, inches.
_WIDTH = 11.0
_POINTS_PER_INCH = 72.0


def run_figure(
    title: str,
    world: World | None,
    estimate: MapEstimate | None,
    tfg: TfgMap | None,
    grid: GridMap | None,
    X_WB_estimated: FloatArray,
    X_WB_true: FloatArray,
    reachable: BoolArray,
    X_WM: FloatArray | None = None,
    with_walls: MapEstimate | None = None,
) -> Figure:
    """The building, the map made of it, and the way the robot went.

    Args:
        title: stands above the figure; one to three lines.
        world: walls, tags and start, in W; None where it is not known.
        estimate, tfg, grid: the map in M; None where there is none (yet).
        X_WB_estimated, X_WB_true: (n, 3) and (m, 3) trajectories in W; may be empty.
        reachable: (t,) of the world's tags: only these count as missed when they are not in the map.
        X_WM: (3,) pose of the map frame in W, that of the start where there is none.
        with_walls: the estimate with the walls that are landmarks, None where there are none.

    Of a world that is not known the map frame takes the place, and the map says how large it is.
    """
    grid = grid if grid is not None and grid.probability.size else None  # Nothing is mapped before the first scan.
    if X_WM is None:
        X_WM = world.start if world is not None else np.zeros(3)
    shown = [X_WB_true[:, :2], X_WM[None, :2]]
    if world is not None:
        shown.append(world.walls.reshape(-1, 2))
    else:
        shown.append(X_WB_estimated[:, :2])
        shown += [tfg.segments.reshape(-1, 2), tfg.star_vertices] if tfg is not None else []
        shown += [_corners(grid)] if grid is not None else []
    figure, axes, symbol = _canvas(title, np.vstack(shown))

    if world is not None:
        # Grey and wide below lines, but a thin colour on the grey of cells.
        color, width = (_WALL, 3.0) if grid is None else (_BARE, 1.0)
        walls = list(world.walls.reshape(-1, 2, 2))
        axes.add_collection(LineCollection(walls, colors=color, linewidths=width, label="true wall"))
    if grid is not None:
        draw_grid(axes, X_WM, grid)
        for color, label in (("black", "occupied cell"), ("white", "free cell"), ("0.5", "unknown cell")):
            axes.plot([], [], "s", color=color, markeredgecolor="0.5", markersize=6, label=label)
    mapped = np.zeros(0, dtype=np.int64)
    if tfg is not None:
        draw_surfaces(axes, X_WM, tfg)
    if with_walls is not None:
        _draw_walls(axes, X_WM, with_walls, 0.4 * symbol)
    if len(X_WB_estimated):
        axes.plot(*X_WB_estimated[:, :2].T, color=_ESTIMATE, linewidth=2.4, label="estimated path")
    if len(X_WB_true):
        (truth,) = axes.plot(*X_WB_true[:, :2].T, color=_TRUTH, linewidth=1.3, label="true path", zorder=4.95)
        truth.set_linestyle((0, (3, 2)))
    if estimate is not None:
        mapped = estimate.ids
        draw_landmarks(axes, X_WM, estimate, symbol)
        _draw_views(axes, X_WM, estimate.X_MA)
    if world is not None and grid is None:
        missed = world.p_WT[reachable & ~np.isin(world.tag_ids, mapped)]
        if len(missed):
            label = "tag missed"
            axes.plot(*missed.T, "X", color=_MISSED, markersize=1.5 * symbol, markeredgewidth=0, label=label)
    start = X_WB_estimated[0] if len(X_WB_estimated) else X_WM
    axes.plot(*start[:2], "^", color="0.1", markersize=7, label="start", zorder=6)
    way = X_WB_true if len(X_WB_true) else X_WB_estimated
    if len(way):
        axes.plot(*way[-1, :2], "s", color="0.1", markersize=6, label="end", zorder=6)
    return _with_legend(figure)


def draw_map(path: Path, title: str, saved: SavedMap) -> None:
    """Write the figure of a saved map as a PNG or PDF, by the file's suffix, atomically.

    Args:
        path: the file.
        title: stands above the figure; one or two lines.
        saved: the map; the figure is in W.

    Raises:
        OSError: the file cannot be written.
    """
    X_WM, tfg = saved.X_WM, saved.tfg
    shown = [saved.p_ML, saved.X_MA[:, :2], tfg.segments.reshape(-1, 2), tfg.frontiers, tfg.star_vertices]
    figure, axes, symbol = _canvas(title, transform(X_WM, np.vstack(shown)))
    draw_free_space(axes, X_WM, tfg)
    draw_surfaces(axes, X_WM, tfg)
    _draw_walls(axes, X_WM, saved.graph, 0.4 * symbol)
    draw_landmarks(axes, X_WM, saved, symbol)
    _draw_views(axes, X_WM, saved.X_MA)
    draw_frontiers(axes, X_WM, tfg, symbol)
    write_figure(path, _with_legend(figure))


def _canvas(title: str, points: FloatArray) -> tuple[Figure, Axes, float]:
    """Figure and axes for an area with some points (n, 2), m, and a symbol's size in points, from the scale of the
    drawing."""
    (x_min, y_min), (x_max, y_max) = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    height = float(np.clip(_WIDTH * (y_max - y_min) / (x_max - x_min), 3.5, 12.0))
    figure = Figure(figsize=(_WIDTH, height + 0.7 + 0.2 * len(title.splitlines())), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.tick_params(labelsize=8, colors="0.35")
    axes.spines[:].set_visible(False)
    axes.set_title(title, loc="left", fontsize=10)
    return figure, axes, float(np.clip(0.2 * _WIDTH * _POINTS_PER_INCH / (x_max - x_min), 1.2, 6.0))


def _with_legend(figure: Figure) -> Figure:
    figure.legend(loc="outside lower left", ncols=6, fontsize=8, frameon=False, labelcolor="0.25")
    return figure


def _corners(grid: GridMap) -> FloatArray:
    """Two opposite corners (2, 2) of what a grid covers, in M, m."""
    rows, columns = grid.probability.shape
    return np.stack([grid.origin, grid.origin + grid.resolution * np.array([columns, rows])])


def draw_free_space(axes: Axes, X_WM: FloatArray, tfg: TfgMap) -> None:
    """The free space of a map onto axes of W."""
    stars = np.split(transform(X_WM, tfg.star_vertices), tfg.star_offsets[1:-1])
    axes.add_collection(PolyCollection(stars, facecolors=_FREE, edgecolors="none", label="free space", zorder=0))


def draw_frontiers(axes: Axes, X_WM: FloatArray, tfg: TfgMap, symbol: float) -> None:
    """The frontiers of a map onto axes of W. symbol: the size of one, points."""
    if len(tfg.frontiers):
        p_WF = transform(X_WM, tfg.frontiers)
        axes.plot(*p_WF.T, "D", color=_FRONTIER, markersize=symbol, markeredgewidth=0, label="frontier")


def draw_surfaces(axes: Axes, X_WM: FloatArray, tfg: TfgMap, width: float = 1.1) -> None:
    """The surfaces of a map onto axes of W, those without a landmark in a colour of their own."""
    pieces = np.stack([transform(X_WM, tfg.segments[:, :2]), transform(X_WM, tfg.segments[:, 2:])], axis=1)
    tagged = tfg.segment_kind < 2
    for mask, colour, label in ((tagged, _EDGE, "mapped surface"), (~tagged, _BARE, "surface without landmark")):
        if mask.any():
            axes.add_collection(LineCollection(list(pieces[mask]), colors=colour, linewidths=width, label=label))
    if len(tfg.keep_out):
        lines = list(transform(X_WM, tfg.keep_out.reshape(-1, 2)).reshape(-1, 2, 2))
        axes.add_collection(LineCollection(lines, colors=_MISSED, linewidths=0.6, label="keep-out area"))


def _draw_walls(axes: Axes, X_WM: FloatArray, known: MapEstimate | KeyframeGraph, size: float) -> None:
    """The walls that are landmarks onto axes of W: a line from point to point that is seen on both sides of what it is
    the wall of, and three deviations to either side, see MAGNIFIED."""
    _, p_ML, deviation = known_walls(known)
    if not len(p_ML):
        return
    p_WL = transform(X_WM, p_ML.reshape(-1, 2))
    three, times = _three(deviation.max(axis=1))
    outlines, pieces = spreads(p_WL.reshape(-1, 4), deviation, three), p_WL.reshape(-1, 2, 2)
    colour = css(LIGHT.wall_landmark)
    axes.add_collection(PolyCollection(list(outlines), facecolors=colour, edgecolors="none", alpha=0.3, zorder=1.9))
    label = f"wall (landmark), {times}"
    axes.add_collection(LineCollection(list(pieces), colors=colour, linewidths=3.0, zorder=1.95))
    axes.plot([], [], "o-", color=colour, linewidth=3.0, markersize=size, markeredgewidth=0, label=label)
    axes.plot(*p_WL.T, "o", color=colour, markersize=size, markeredgewidth=0, zorder=2.1)


def _three(deviations: FloatArray) -> tuple[float, str]:
    """How many standard deviations are drawn for deviations (n,), m, and the words for it; see MAGNIFIED."""
    small = len(deviations) > 0 and 3.0 * float(np.median(deviations)) < SEEN
    return (3.0 * MAGNIFIED, f"3\u03c3 \u00d7 {MAGNIFIED:g}") if small else (3.0, "3\u03c3")


def draw_landmarks(axes: Axes, X_WM: FloatArray, known: MapEstimate | SavedMap, symbol: float) -> None:
    """The landmarks of a map onto axes of W, with the ellipses of their covariances, see MAGNIFIED; doubtful ones in
    another colour. symbol: a landmark's size, points."""
    R_WM, blocks, doubtful = rotation(float(X_WM[2])), known.landmark_covariance, known.is_doubtful
    p_WL = transform(X_WM, known.p_ML)
    three, times = _three(np.sqrt(np.linalg.eigvalsh(blocks)[:, -1]))
    outlines = ellipses(p_WL, R_WM @ blocks @ R_WM.T, three)
    # Thin where there are many on little room.
    width = min(0.9, 0.2 * symbol)
    for some, colour, what in ((~doubtful, _MAPPED, "mapped"), (doubtful, _DOUBTFUL, "doubtful")):
        if not some.any():
            continue
        label = f"tag {what}, {times}"
        axes.plot(*p_WL[some].T, "o", color=colour, markersize=symbol, markeredgewidth=0, label=label, zorder=4)
        rings = PolyCollection(list(outlines[some]), facecolors="none", edgecolors=colour, linewidths=width, zorder=4.5)
        axes.add_collection(rings)


def draw_grid(axes: Axes, X_WM: FloatArray, grid: GridMap) -> None:
    """A grid's probabilities as an image from white (free) to black (occupied), turned from M into W."""
    (x_min, y_min), (x_max, y_max) = _corners(grid)
    limits = axes.axis()
    # Black, as dense as the probability, over the true walls.
    ink = np.zeros((*grid.probability.shape, 4))
    ink[..., 3] = grid.probability
    extent = (x_min, x_max, y_min, y_max)
    image = axes.imshow(ink, extent=extent, origin="lower", interpolation="nearest", zorder=0.7)
    (a, c), (b, d) = rotation(float(X_WM[2]))
    image.set_transform(Affine2D.from_values(a, b, c, d, X_WM[0], X_WM[1]) + axes.transData)
    axes.axis(limits)


def _draw_views(axes, X_WM: FloatArray, X_MA: FloatArray) -> None:  # type: ignore[no-untyped-def]
    """A dot where each turn or glance began, under its number where there is room for one."""
    views = compose(X_WM, X_MA)[:, :2] if len(X_MA) else np.zeros((0, 2))
    if not len(views):
        return
    x_min, x_max = axes.get_xlim()
    spacing = max(NUMBER_SPACING, NUMBER_POINTS * (x_max - x_min) / (_WIDTH * _POINTS_PER_INCH))
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

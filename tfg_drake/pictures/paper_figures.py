"""The paper's figures (its Figs. 3 to 5 and 9), drawn from maps of our own runs."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure

from tfg_drake.messages import FloatArray, GoalChoice, IntArray, MapEstimate, Roadmap, TfgMap
from tfg_drake.pictures.figure import draw
from tfg_drake.pictures.layers import of_free_space, of_map
from tfg_drake.pictures.palette import LIGHT, css
from tfg_drake.pictures.panels import panels
from tfg_drake.planning.candidates import Situation, places, turn_gains
from tfg_drake.planning.information_gain import Gains
from tfg_drake.planning.parameters import PlanningParameters

# High, medium and low values for new landmarks, for which the paper gives no numbers: the prior's standard deviation,
# m, which its text varies, and the number per metre of frontier, which its caption varies.
PRIORS = {"high": 10.0, "medium": 0.1, "low": 0.001}
DENSITIES = {"high": 2.0, "medium": 0.2, "low": 0.0}
_VIEW = css(LIGHT.wall_end)
_COLOURS = "coolwarm"
_WIDTH = 7.2  # of the text of a two-column paper, inches


@dataclasses.dataclass(frozen=True)
class Stage:
    """The explorer's inputs at one stage."""

    estimate: MapEstimate
    tfg: TfgMap
    roadmap: Roadmap
    goal: GoalChoice


def gain_field(stage: Stage, parameters: PlanningParameters) -> tuple[IntArray, Gains]:
    """The nodes (c,) of the roadmap where the robot could turn, and what a turn at each is expected to gain."""
    estimate, tfg, roadmap = stage.estimate, stage.tfg, stage.roadmap
    nodes = places(roadmap, tfg, estimate.X_MD[:2])
    return nodes, turn_gains(nodes, Situation(estimate, tfg, roadmap, parameters))


def draw_gains(stage: Stage, parameters: PlanningParameters) -> Figure:
    """Exploitation, exploration and total gain over the samples of one map (the paper's Fig. 4)."""
    nodes, gains = gain_field(stage, parameters)
    figure, axes, symbol = _panels(stage.tfg, 1, 3)
    panels = (("Exploitation", gains.exploitation), ("Exploration", gains.exploration), ("Total", gains.gain))
    for axis, (title, values) in zip(axes, panels, strict=True):
        _draw_map(axis, stage, symbol)
        _draw_samples(figure, axis, stage.roadmap.points[nodes], values)
        axis.set_title(title, fontsize=9)
    return figure


def draw_priors(stage: Stage, parameters: PlanningParameters) -> Figure:
    """Total gain with a high, a medium and a low prior of new landmarks (the paper's Fig. 5)."""
    figure, axes, symbol = _panels(stage.tfg, 2, len(PRIORS))
    varied = [("prior", "prior_sigma", name, value, "m") for name, value in PRIORS.items()]
    varied += [("density", "density", name, value, "a metre") for name, value in DENSITIES.items()]
    for axis, (what, key, name, value, unit) in zip(axes, varied, strict=True):
        explorer = copy.copy(parameters.explorer)
        setattr(explorer, key, value)
        nodes, gains = gain_field(stage, dataclasses.replace(parameters, explorer=explorer))
        _draw_map(axis, stage, symbol)
        _draw_samples(figure, axis, stage.roadmap.points[nodes], gains.gain)
        axis.set_title(f"{name.capitalize()} {what}: {value:g} {unit}", fontsize=9)
    return figure


def draw_tfg(stage: Stage) -> Figure:
    """The topological feature graph with goal points and what the newest of them saw (the paper's Fig. 3)."""
    figure, (axis,), symbol = _panels(stage.tfg, 1, 1)
    _draw_map(axis, stage, symbol)
    X_MA, estimate = stage.estimate.X_MA, stage.estimate
    seen = estimate.p_ML[np.isin(estimate.ids, estimate.observation.ids)]
    rays = [(X_MA[-1, :2], p) for p in seen]
    axis.add_collection(
        LineCollection(rays, colors=css(LIGHT.frontier), linewidths=0.3, alpha=0.5, label="seen from the newest")
    )
    axis.plot(*X_MA[:, :2].T, "o", color=_VIEW, markersize=7, markeredgewidth=0, label="goal point", zorder=5)
    for number, (x, y, _) in enumerate(X_MA, start=1):
        axis.text(x, y, str(number), fontsize=5, color="white", ha="center", va="center", zorder=6)
    figure.legend(loc="outside lower center", ncols=5, fontsize=7, frameon=False)
    return figure


def draw_growth(stages: Sequence[Stage], stamps: FloatArray, p_MB: FloatArray) -> Figure:
    """The map at some stages of one mission with the robot's way so far, its places p_MB (n, 2), m, at stamps (n,), s
    (the paper's Fig. 9)."""
    columns = 2
    figure, axes, symbol = _panels(stages[-1].tfg, -(-len(stages) // columns), columns)
    for axis, stage in zip(axes, stages, strict=False):
        _draw_map(axis, stage, symbol)
        axis.plot(*p_MB[stamps <= stage.estimate.stamp].T, "-", color=_VIEW, linewidth=0.6, zorder=2)
        axis.plot(*stage.estimate.X_MA[:, :2].T, "o", color=_VIEW, markersize=3, markeredgewidth=0, zorder=5)
        text = f"stage {stage.estimate.stage}, {stage.estimate.stamp:.0f} s, {len(stage.estimate.ids)} landmarks"
        axis.set_title(text, fontsize=8)
    return figure


def _panels(tfg: TfgMap, rows: int, columns: int) -> tuple[Figure, list[Axes], float]:
    """A figure of equal panels that all show the area of the map, and a symbol's size, see `panels`."""
    points = np.vstack([tfg.segments.reshape(-1, 2), tfg.star_vertices])
    figure, axes, symbol = panels(points, _WIDTH, 0.55 * rows + 0.3, rows, columns)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
    return figure, axes, symbol


def _draw_map(axis: Axes, stage: Stage, symbol: float) -> None:
    """Free space, surfaces, landmarks, frontiers."""
    draw(axis, np.zeros(3), [*of_free_space(stage.tfg), *of_map(stage.estimate, stage.tfg, None)], symbol)


def _draw_samples(figure: Figure, axis: Axes, points: FloatArray, values: FloatArray) -> PathCollection:
    """Discs coloured by their gain, the largest on top, with a scale in nats."""
    order = np.argsort(values)
    x, y = points[order].T
    discs = axis.scatter(x, y, c=values[order], cmap=_COLOURS, s=7, linewidths=0, zorder=1.5)
    bar = figure.colorbar(discs, ax=axis, orientation="horizontal", fraction=0.05, pad=0.02, aspect=40)
    bar.ax.tick_params(labelsize=6, length=2)
    bar.outline.set_visible(False)
    bar.set_label("nats", fontsize=6, labelpad=1)
    return discs

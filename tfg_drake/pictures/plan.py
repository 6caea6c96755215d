"""A map as a plan to scale, in SVG."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tfg_drake.geometry.se2 import transform
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray
from tfg_drake.pictures.layers import SYMBOL, Layer, of_free_space, of_map
from tfg_drake.pictures.palette import css

# Scale of the drawing, 1 to SCALE.
SCALE = 100
# Margin around the map, length of the scale bar and height of letters, m.
MARGIN, BAR, LETTER = 1.0, 5, 0.25


def plan_svg(saved: SavedMap) -> str:
    """The file's contents: a group for each layer, named like it (`layers.LOOKS`), with ellipses and bands of three
    standard deviations, and a scale. A unit is a metre, x as in the world frame W, y the other way."""
    shown = sorted([*of_free_space(saved.tfg), *of_map(saved, saved.tfg, saved.graph)], key=lambda one: one.look.high)
    places = [np.reshape(shape, (-1, 2)) for layer in shown for shape in layer.shapes]
    corners = transform(saved.X_WM, np.vstack([saved.X_MA[:, :2], *places]))
    low, high = corners.min(axis=0), corners.max(axis=0)
    (x, bottom), (width, height) = low - MARGIN, high - low + 2.0 * MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:.3f} {-bottom - height:.3f} {width:.3f} {height:.3f}"'
        f' width="{1e3 / SCALE * width:.2f}mm" height="{1e3 / SCALE * height:.2f}mm" font-size="{LETTER}"'
        ' font-family="sans-serif" text-anchor="middle" stroke-width="0.05">',
        f'<rect x="{x:.3f}" y="{-bottom - height:.3f}" width="100%" height="100%" fill="white"/>',
    ]
    for layer in shown:
        lines += _group(layer, saved.X_WM)
    lines.append(
        f'<path id="scale" stroke="black" d="M{x + 0.5:.3f} {-bottom - 0.3:.3f}h{BAR}"/>'
        f'<text x="{x + 0.5 + 0.5 * BAR:.3f}" y="{-bottom - 0.4:.3f}">{BAR} m, 1:{SCALE}</text>'
    )
    return "\n".join([*lines, "</svg>\n"])


def _group(layer: Layer, X_WM: FloatArray) -> Iterable[str]:
    """A layer's group. X_WM: (3,) pose of its frame."""
    look, colour, down = layer.look, css(layer.look.colour), np.array([1.0, -1.0])
    places = [transform(X_WM, np.reshape(shape, (-1, 2))) * down for shape in layer.shapes]
    yield f'<g id="{layer.name}" opacity="{look.opacity}" fill="{colour}">'
    if layer.kind == "points":
        yield from (f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{SYMBOL * look.size:.3f}"/>' for ((x, y),) in places)
    elif layer.kind == "lines":
        yield f'<path stroke="{colour}" stroke-width="{SYMBOL * look.size:.3f}" d="{_path(places)}"/>'
    else:
        yield f'<path d="{_path(places, "Z")}"/>'
    for words, place in layer.labels.items():
        x, y = transform(X_WM, place[None])[0] * down
        # A white rim keeps what lies behind apart.
        rim = 'stroke="white" paint-order="stroke"'
        yield f'<text x="{x:.3f}" y="{y - 0.5 * LETTER:.3f}" {rim}>{words}</text>'
    yield "</g>"


def _path(lines: Iterable[FloatArray], end: str = "") -> str:
    """Polylines (v, 2) as the data of one path; end: what follows each."""
    return "".join("M" + "L".join(f"{x:.3f} {y:.3f}" for x, y in line.tolist()) + end for line in lines)

"""A map as a plan to scale, in SVG."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tfg_drake.mapfile.in_world import KINDS, corners_of, landmarks_in_world, stars_of, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray
from tfg_drake.pictures.drawing import ellipses
from tfg_drake.pictures.palette import FREE, LIGHT, css

# The drawing is so many times smaller than the building.
SCALE = 100
# Room round the map, m, and the scale bar's length, m.
MARGIN, BAR = 1.0, 5


def plan_svg(saved: SavedMap) -> str:
    """The file's contents: groups free_space, edge, wall_end, bare_surface (of surfaces), frontier and tags (with
    ellipses of three standard deviations). A unit is a metre, x as in the world frame W, y the other way."""
    tfg, (p_WL, covariance), down = tfg_in_world(saved), landmarks_in_world(saved), np.array([1.0, -1.0])
    low, high = corners_of(p_WL, tfg)
    (x, bottom), (width, height) = low - MARGIN, high - low + 2.0 * MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:.3f} {-bottom - height:.3f} {width:.3f} {height:.3f}"'
        f' width="{1e3 / SCALE * width:.2f}mm" height="{1e3 / SCALE * height:.2f}mm"'
        ' font-family="sans-serif" text-anchor="middle" stroke-width="0.05">',
        f'<rect x="{x:.3f}" y="{-bottom - height:.3f}" width="100%" height="100%" fill="white"/>',
        f'<path id="free_space" fill="{css(FREE)}" d="{_path((star * down for star in stars_of(tfg)), "Z")}"/>',
    ]
    pieces = tfg.segments.reshape(-1, 2, 2) * down
    for kind, (name, colour) in enumerate(zip(KINDS, (LIGHT.edge, LIGHT.wall_end, LIGHT.bare_surface), strict=True)):
        some = _path(pieces[tfg.segment_kind == kind])
        lines.append(f'<path id="{name}" stroke="{css(colour)}" stroke-linecap="round" d="{some}"/>')
    lines.append(f'<g id="frontier" fill="{css(LIGHT.frontier)}">')
    lines += [_dot(p, 0.08) for p in tfg.frontiers * down]
    lines.append('</g>\n<g id="tags" font-size="0.22">')
    rings = ellipses(p_WL, covariance) * down
    columns = (saved.ids.tolist(), p_WL * down, tfg.facing * down, rings, saved.is_doubtful.tolist())
    for tag, p, f, ring, doubtful in zip(*columns, strict=True):
        number = f'<text x="{p[0] + 0.25 * f[0]:.3f}" y="{p[1] + 0.25 * f[1] + 0.08:.3f}">{tag}</text>'
        spread = f'<path fill-opacity="0.3" d="{_path([ring], "Z")}"/>'
        lines.append(
            f'<g fill="{css(LIGHT.doubtful if doubtful else LIGHT.landmark)}">{_dot(p, 0.03)}{spread}{number}</g>'
        )
    lines.append(
        f'</g>\n<path id="scale" stroke="black" d="M{x + 0.5:.3f} {-bottom - 0.3:.3f}h{BAR}"/>'
        f'<text x="{x + 0.5 + 0.5 * BAR:.3f}" y="{-bottom - 0.4:.3f}" font-size="0.3">{BAR} m, 1:{SCALE}</text>'
    )
    return "\n".join([*lines, "</svg>\n"])


def _dot(p: FloatArray, radius: float) -> str:
    return f'<circle cx="{p[0]:.3f}" cy="{p[1]:.3f}" r="{radius}"/>'


def _path(lines: Iterable[FloatArray], end: str = "") -> str:
    """Polylines (v, 2) as the data of one path; end: what follows each."""
    return "".join("M" + "L".join(f"{x:.3f} {y:.3f}" for x, y in line.tolist()) + end for line in lines)

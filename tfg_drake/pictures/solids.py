"""Layers of a scene in space: solids and sheets, and those as an OBJ file. Pure geometry, no Drake."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray
from tfg_drake.pictures import palette
from tfg_drake.pictures.drawing import MAGNIFIED, bands, circles, ellipses, spreads
from tfg_drake.pictures.palette import LIGHT, Colour

# Of true walls, of the robot's surfaces, of a landmark, of the robot and of a person, m.
WALL_HEIGHT, SURFACE_HEIGHT, TAG_HEIGHT, ROBOT_HEIGHT, PERSON_HEIGHT = 0.35, 0.4, 0.45, 0.3, 1.6
# Heights of what lies on the floor, m: far enough apart for a browser to tell which is above.
SHEETS = {name: 0.01 * k for k, name in enumerate(("floor", "free", "trail", "gains", "frontiers", "path"), 1)}
SURFACES = (
    ("edge", LIGHT.edge),
    ("wall_end", LIGHT.wall_end),
    ("bare", LIGHT.bare_surface),
    ("keep_out", LIGHT.keep_out),
)
# Layers of bars: how many symbols wide, and their colour.
BARS = {"frontiers": (1.6, LIGHT.frontier), "path": (1.0, LIGHT.path), "trail": (0.6, LIGHT.trail)}
WHITE, FLOOR = (1.0, 1.0, 1.0), (0.80, 0.82, 0.85)
# Of uncertainty and of the numbers of a tour, m: above all that hides what lies lower.
UNCERTAINTY_HEIGHT, NUMBER_HEIGHT = TAG_HEIGHT + 0.02, TAG_HEIGHT + 0.05
# The candidates have so many shades, from no gain to the most.
SHADES = 6
# The seven bars of a numeral that is 1 wide and 2 high, and which of them 0, 1, ... have.
_BARS = np.array([(0, 2, 1, 2), (1, 1, 1, 2), (1, 0, 1, 1), (0, 0, 1, 0), (0, 0, 0, 1), (0, 1, 0, 2), (0, 1, 1, 1)])
_HAVE = ("012345", "12", "01346", "01236", "1256", "02356", "023456", "012", "0123456", "012356")
# Of its colour: what a solid shines by itself, lest lamps leave half a building in the dark, and what it reflects. Its
# sides are darker than its top.
SHINE, REFLECTION, SIDES = 0.9, 0.3, 0.8


@dataclasses.dataclass(frozen=True)
class Solid:
    """Prisms, or sheets where low and high are the same.

    name: a word. outlines: (n, c, 2), m; each is a star round its first corner, as convex ones are. low, high: m.
    """

    name: str
    outlines: FloatArray
    low: float
    high: float
    colour: Colour
    opacity: float = 1.0


def solids(layer: str, arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any], unit: float) -> Iterator[Solid]:
    """The solids that draw a layer of tfg_drake.pictures.scene, in its own frame. unit: a symbol's size, m."""
    flat = SHEETS.get(layer, 0.0)
    if layer == "world":
        yield Solid("walls", bands(arrays["segments"], 0.02), 0.0, WALL_HEIGHT, LIGHT.wall, 0.6)
        along = 0.1 * np.stack([-np.sin(arrays["tag_facing"]), np.cos(arrays["tag_facing"])], axis=1)
        plates = np.hstack([arrays["tags"] - along, arrays["tags"] + along])
        yield Solid("tags", bands(plates, 0.06), 0.1, 0.3, LIGHT.wall_end)
    elif layer == "map":
        points, covariance = arrays["points"], arrays["covariance"][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        for kind, (name, colour) in enumerate((("landmark", LIGHT.landmark), ("doubtful", LIGHT.doubtful))):
            some = arrays["doubtful"] == kind
            yield Solid(name, circles(points[some], 1.4 * unit, 8), 0.0, TAG_HEIGHT, colour)
            outlines = ellipses(points[some], covariance[some], 3.0 * MAGNIFIED, corners=20)
            yield Solid(f"{name}_3sigma", outlines, UNCERTAINTY_HEIGHT, UNCERTAINTY_HEIGHT, colour, 0.4)
    elif layer == "wall_landmarks":
        segments, deviation = arrays["segments"], arrays["deviation"]
        top = SURFACE_HEIGHT + 0.01
        yield Solid(layer, bands(segments, 0.6 * unit), top, top, LIGHT.wall_landmark)
        outlines, z = spreads(segments, deviation, 3.0 * MAGNIFIED), top + 0.005
        yield Solid(f"{layer}_3sigma", outlines, z, z, LIGHT.wall_landmark, 0.4)
    elif layer == "tfg":
        for kind, (name, colour) in enumerate(SURFACES):
            pieces = arrays["segments"][arrays["kind"] == kind]
            yield Solid(name, bands(pieces, 1.2 * unit), 0.0, SURFACE_HEIGHT, colour)
    elif layer in BARS:
        width, colour = BARS[layer]
        yield Solid(layer, bands(arrays["segments"], width * unit), flat, flat, colour)
    elif layer == "gains":
        share = arrays["share"] / 255.0
        # The larger and the deeper the more gain.
        for k, (r, g, b) in enumerate(palette.gain_colours(np.linspace(0.0, 1.0, SHADES)).tolist()):
            some = np.rint(share * (SHADES - 1)) == k
            size = unit * (0.4 + 1.6 * share[some, None, None])
            discs = size * circles(np.zeros((int(some.sum()), 2)), 1.0, 8) + arrays["points"][some, None]
            yield Solid(f"{layer}_{k}", discs, flat, flat, (r, g, b))
    elif layer == "pose":
        ellipse = ellipses(arrays["points"], arrays["covariance"], 3.0 * MAGNIFIED)
        yield Solid("pose_3sigma", ellipse, UNCERTAINTY_HEIGHT, UNCERTAINTY_HEIGHT, LIGHT.robot, 0.4)
    elif layer == "tour":
        stops, z = arrays["tour"], NUMBER_HEIGHT
        yield Solid("legs", bands(arrays["legs"], 0.6 * unit), SHEETS["path"], SHEETS["path"], LIGHT.path)
        yield Solid("stops", circles(stops, 3.6 * unit), z, z, LIGHT.path)
        bars = numerals(stops, 3.0 * unit, told["turn"])
        yield Solid("numbers", bands(bars, 0.6 * unit), z + 0.01, z + 0.01, WHITE)
    elif layer == "goal":
        yield Solid(layer, circles(arrays["points"], 2.5 * unit), SHEETS["path"], SHEETS["path"], LIGHT.path)
    elif layer == "free":
        # Round its centre, and back to where it began.
        star = np.vstack([arrays["points"], arrays["points"][1:2]])
        yield Solid(layer, star[None], flat, flat, palette.FREE)
    elif layer == "grid":
        size, z = told["resolution"], SHEETS["free"]
        yield Solid("free", bands(arrays["free"], size), z, z, palette.FREE)
        yield Solid("occupied", bands(arrays["occupied"], size), 0.0, SURFACE_HEIGHT, palette.OCCUPIED)


def numerals(places: FloatArray, height: float, turn: float) -> FloatArray:
    """The numbers 1, 2, ... in the middle of places (n, 2), so high, m, and turned, rad, as bars (k, 4)."""
    c, s = np.cos(turn), np.sin(turn)
    bars = [np.zeros((0, 2, 2))]
    for number, place in enumerate(places, 1):
        digits = str(number)
        for k, digit in enumerate(digits):
            ends = _BARS[list(map(int, _HAVE[int(digit)]))].reshape(-1, 2, 2) - (0.5, 1.0)
            ends = 0.5 * height * (ends + np.array([1.6 * (k - 0.5 * (len(digits) - 1)), 0.0]))
            bars.append(ends @ np.array([[c, s], [-s, c]]) + place)
    return np.concatenate(bars).reshape(-1, 4)


def wavefront(shown: Iterable[Solid]) -> tuple[str, str]:
    """Solids as the text of an OBJ file and of its materials; "" where there are none."""
    lines, materials, count = list[str](), list[str](), 1
    for solid in shown:
        n, c = solid.outlines.shape[:2]
        if not n:
            continue
        lines += _vertices(solid.outlines, solid.high)
        top = count + np.arange(n * c).reshape(n, c)
        count += n * c
        lines += _faces(solid.name, top)
        materials.append(_material(solid.name, solid.colour, solid.opacity))
        if solid.high > solid.low:
            lines += _vertices(solid.outlines, solid.low)
            low, count = top + n * c, count + n * c
            walls = np.stack([top, low, np.roll(low, -1, axis=1), np.roll(top, -1, axis=1)], axis=2)
            lines += _faces(f"{solid.name}_side", walls.reshape(-1, 4))
            sides = tuple(SIDES * part for part in solid.colour)
            materials.append(_material(f"{solid.name}_side", sides, solid.opacity))
    return "\n".join(lines), "\n".join(materials)


def _vertices(outlines: FloatArray, z: float) -> list[str]:
    return [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y in outlines.reshape(-1, 2).tolist()]


def _faces(material: str, corners: NDArray[np.int64]) -> list[str]:
    return [f"usemtl {material}", *(f"f {' '.join(map(str, face))}" for face in corners.tolist())]


def _material(name: str, colour: Sequence[float], opacity: float) -> str:
    shone, reflected = (" ".join(f"{share * part:.3f}" for part in colour) for share in (SHINE, REFLECTION))
    return f"newmtl {name}\nKe {shone}\nKd {reflected}\nKs 0 0 0\nd {opacity}"

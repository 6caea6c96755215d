"""Layers of a scene as an OBJ file, and numbers as bars. Pure geometry, no Drake."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray
from tfg_drake.pictures.layers import Layer

# The seven segments of a numeral 1 wide and 2 high, and the segments of 0, 1, ...
_BARS = np.array([(0, 2, 1, 2), (1, 1, 1, 2), (1, 0, 1, 1), (0, 0, 1, 0), (0, 0, 0, 1), (0, 1, 0, 2), (0, 1, 1, 1)])
_HAVE = ("012345", "12", "01346", "01236", "1256", "02356", "023456", "012", "0123456", "012356")
# Shares of a solid's colour that it emits, so that no half of a building is dark, and that it reflects; its sides are
# darker than its top.
SHINE, REFLECTION, SIDES = 0.9, 0.3, 0.8


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


def wavefront(shown: Iterable[Layer], unit: float) -> tuple[str, str]:
    """Layers as the text of an OBJ file and of its materials, named as they are; "" where there are none. unit: a
    symbol's size, m."""
    lines, materials, count = list[str](), list[str](), 1
    for layer in shown:
        if not len(layer.shapes):
            continue
        outlines, look, name = layer.outlines(unit), layer.look, layer.name
        n, c = outlines.shape[:2]
        lines += _vertices(outlines, look.high)
        top = count + np.arange(n * c).reshape(n, c)
        count += n * c
        lines += _faces(name, top)
        materials.append(_material(name, look.in_space, look.opacity))
        if look.stands:
            lines += _vertices(outlines, 0.0)
            low, count = top + n * c, count + n * c
            walls = np.stack([top, low, np.roll(low, -1, axis=1), np.roll(top, -1, axis=1)], axis=2)
            lines += _faces(f"{name}_side", walls.reshape(-1, 4))
            sides = tuple(SIDES * part for part in look.in_space)
            materials.append(_material(f"{name}_side", sides, look.opacity))
    return "\n".join(lines), "\n".join(materials)


def _vertices(outlines: FloatArray, z: float) -> list[str]:
    return [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y in outlines.reshape(-1, 2).tolist()]


def _faces(material: str, corners: NDArray[np.int64]) -> list[str]:
    return [f"usemtl {material}", *(f"f {' '.join(map(str, face))}" for face in corners.tolist())]


def _material(name: str, colour: Sequence[float], opacity: float) -> str:
    shone, reflected = (" ".join(f"{share * part:.3f}" for part in colour) for share in (SHINE, REFLECTION))
    return f"newmtl {name}\nKe {shone}\nKd {reflected}\nKs 0 0 0\nd {opacity}"

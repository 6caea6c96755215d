"""The colours of a map in pictures, red, green and blue in [0, 1]."""

from __future__ import annotations

from typing import NamedTuple

Colour = tuple[float, float, float]


class Palette(NamedTuple):
    """Colours by their use, here on a light ground."""

    wall: Colour = (0.84, 0.85, 0.87)
    edge: Colour = (0.16, 0.18, 0.22)
    edge_in_space: Colour = (0.42, 0.46, 0.54)
    wall_end: Colour = (0.52, 0.54, 0.58)
    bare_surface: Colour = (0.93, 0.60, 0.22)
    keep_out: Colour = (0.84, 0.15, 0.16)
    landmark: Colour = (0.07, 0.53, 0.44)
    doubtful: Colour = (0.64, 0.18, 0.66)
    wall_landmark: Colour = (0.42, 0.16, 0.82)
    frontier: Colour = (0.10, 0.36, 0.88)
    path: Colour = (0.84, 0.15, 0.16)
    scan: Colour = (0.36, 0.72, 0.90)
    robot: Colour = (0.10, 0.22, 0.42)
    truth: Colour = (0.45, 0.48, 0.53)
    person: Colour = (0.62, 0.64, 0.68)
    roadmap: Colour = (0.80, 0.83, 0.88)
    free: Colour = (0.985, 0.99, 0.98)
    ground: Colour = (0.915, 0.925, 0.94)
    trail: Colour = (0.93, 0.55, 0.40)
    camera: Colour = (0.98, 0.80, 0.25)
    fork: Colour = (0.42, 0.53, 0.08)


LIGHT = Palette()
# Colours of the page that differ on a dark background.
DARK = LIGHT._replace(
    wall=(0.33, 0.36, 0.41),
    edge=(0.86, 0.88, 0.91),
    wall_end=(0.60, 0.63, 0.68),
    landmark=(0.20, 0.78, 0.64),
    doubtful=(0.85, 0.42, 0.88),
    wall_landmark=(0.72, 0.56, 1.00),
    frontier=(0.36, 0.60, 1.00),
    path=(1.00, 0.36, 0.34),
    robot=(0.42, 0.62, 0.95),
    truth=(0.62, 0.66, 0.72),
    roadmap=(0.22, 0.25, 0.31),
    free=(0.145, 0.165, 0.195),
    ground=(0.075, 0.085, 0.105),
    trail=(0.80, 0.45, 0.32),
    fork=(0.72, 0.80, 0.30),
)
# Free space in pictures on white.
FREE: Colour = (0.955, 0.965, 0.945)
# Perceptually uniform colours from no gain to the most (matplotlib's magma_r from 0.08 to 0.85).
GAINS: tuple[Colour, ...] = (
    (0.994, 0.849, 0.606),
    (0.990, 0.565, 0.395),
    (0.885, 0.301, 0.400),
    (0.646, 0.192, 0.493),
    (0.396, 0.103, 0.503),
    (0.147, 0.069, 0.334),
)


def css(colour: Colour) -> str:
    """A colour as a page names it, such as #10357a."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)

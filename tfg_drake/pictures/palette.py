"""The colours of a map in pictures, red, green and blue in [0, 1]."""

from __future__ import annotations

from tfg_drake.pictures.caption import Colour

WALL: Colour = (0.84, 0.85, 0.87)
EDGE: Colour = (0.16, 0.18, 0.22)
WALL_END: Colour = (0.52, 0.54, 0.58)
BARE_SURFACE: Colour = (0.93, 0.60, 0.22)
LANDMARK: Colour = (0.07, 0.53, 0.44)
DOUBTFUL: Colour = (0.64, 0.18, 0.66)
FRONTIER: Colour = (0.10, 0.36, 0.88)

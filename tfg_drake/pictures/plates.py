"""Words and the legend as pictures, for a scene that can draw no text. No Drake."""

from __future__ import annotations

import io

import numpy as np
from matplotlib import get_data_path
from PIL import Image, ImageDraw, ImageFont

from tfg_drake.pictures import palette
from tfg_drake.pictures.drawing import MAGNIFIED

# All of them are so wide, and a line so high, pixels; of a legend so many entries are in a line.
WIDTH, LINE, COLUMNS = 1600, 46, 5
# The scale of the gains has so many shades.
SHADES = 6
_ENTRIES = (
    ("true wall", palette.WALL),
    ("mapped surface", palette.EDGE),
    ("past the last tag", palette.WALL_END),
    ("without a landmark", palette.BARE_SURFACE),
    ("keep-out area", palette.KEEP_OUT),
    ("tag", palette.LANDMARK),
    ("doubtful tag", palette.DOUBTFUL),
    ("wall (landmark)", palette.WALL_LANDMARK),
    (f"faint: 3\u03c3 \u00d7 {MAGNIFIED:g}", (0.63, 0.81, 0.78)),
    ("frontier", palette.FRONTIER),
    ("path, tour 1, 2, ...", palette.PATH),
    ("way driven", palette.LIGHT["trail"]),
    ("scan", palette.SCAN),
    ("robot", palette.ROBOT),
    ("robot, true", palette.GHOST),
)


def words_plate(text: str) -> bytes:
    """A line of text, black on white, as a PNG."""
    image = Image.new("L", (WIDTH, LINE), 255)
    ImageDraw.Draw(image).text((8, LINE / 2), text, 0, _font(), "lm")
    return _png(image)


def legend_plate() -> tuple[bytes, int]:
    """What each colour is, and the scale of the gains, as a PNG; and how high that is, pixels."""
    lines = -(-len(_ENTRIES) // COLUMNS) + 1
    image = Image.new("RGB", (WIDTH, lines * LINE), "white")
    draw = ImageDraw.Draw(image)
    for k, (name, colour) in enumerate(_ENTRIES):
        x, y = WIDTH // COLUMNS * (k % COLUMNS) + 8, LINE * (k // COLUMNS)
        draw.rectangle((x, y + 12, x + 34, y + LINE - 12), palette.css(colour))
        draw.text((x + 44, y + LINE / 2), name, "black", _font(), "lm")
    for k, (r, g, b) in enumerate(palette.gain_colours(np.linspace(0.0, 1.0, SHADES)).tolist()):
        box = (8 + 34 * k, image.height - LINE + 12, 42 + 34 * k, image.height - 12)
        draw.rectangle(box, palette.css((r, g, b)))
    told = "gain of a place to go to: none ... the most of all; the larger the more"
    draw.text((18 + 34 * SHADES, image.height - LINE / 2), told, "black", _font(), "lm")
    return _png(image), image.height


def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 26)


def _png(image: Image.Image) -> bytes:
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()

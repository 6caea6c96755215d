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
# Of each colour of palette.LIGHT what it is.
_ENTRIES = """wall:true wall, edge:mapped surface, wall_end:past the last tag, bare_surface:without a landmark,
keep_out:keep-out area, landmark:tag, doubtful:doubtful tag, wall_landmark:wall (landmark), frontier:frontier,
path:path and tour, trail:way driven, scan:scan, robot:robot, truth:robot (true)"""


def words_plate(text: str) -> bytes:
    """A line of text, black on white, as a PNG."""
    image = Image.new("L", (WIDTH, LINE), 255)
    ImageDraw.Draw(image).text((8, LINE / 2), text, 0, _font(), "lm")
    return _png(image)


def legend_plate() -> tuple[bytes, int]:
    """Legend of the colours and the scale of the gains, as a PNG; and its height, pixels."""
    entries = [entry.split(":") for entry in _ENTRIES.replace(",\n", ", ").split(", ")]
    lines = -(-len(entries) // COLUMNS) + 1
    image = Image.new("RGB", (WIDTH, lines * LINE), "white")
    draw = ImageDraw.Draw(image)
    for k, (colour, name) in enumerate(entries):
        x, y = WIDTH // COLUMNS * (k % COLUMNS) + 8, LINE * (k // COLUMNS)
        draw.rectangle((x, y + 12, x + 34, y + LINE - 12), palette.css(getattr(palette.LIGHT, colour)))
        draw.text((x + 44, y + LINE / 2), name, "black", _font(), "lm")
    for k, (r, g, b) in enumerate(palette.gain_colours(np.linspace(0.0, 1.0, SHADES)).tolist()):
        box = (8 + 34 * k, image.height - LINE + 12, 42 + 34 * k, image.height - 12)
        draw.rectangle(box, palette.css((r, g, b)))
    told = f"gain of a place to go to: none ... the most of all; pale rings and bands: 3\u03c3 \u00d7 {MAGNIFIED:g}"
    draw.text((18 + 34 * SHADES, image.height - LINE / 2), told, "black", _font(), "lm")
    return _png(image), image.height


def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 26)


def _png(image: Image.Image) -> bytes:
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()

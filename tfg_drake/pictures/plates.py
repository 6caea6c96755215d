"""Words and the legend as pictures, for a scene that can draw no text. No Drake."""

from __future__ import annotations

import io
from collections.abc import Container

from matplotlib import get_data_path
from PIL import Image, ImageDraw, ImageFont

from tfg_drake.pictures import palette
from tfg_drake.pictures.drawing import MAGNIFIED
from tfg_drake.pictures.layers import LOOKS, SPREAD

# Width of a plate and height of a line of text, pixels; number of entries in a line of a legend.
WIDTH, LINE, COLUMNS = 1600, 46, 5


def words_plate(text: str) -> bytes:
    """A line of text, black on white, as a PNG."""
    image = Image.new("L", (WIDTH, LINE), 255)
    ImageDraw.Draw(image).text((8, LINE / 2), text, 0, _font(), "lm")
    return _png(image)


def legend_plate(drawn: Container[str]) -> tuple[bytes, int]:
    """Legend of the layers that are drawn and the scale of the gains, as a PNG; and its height, pixels, which has room
    for all layers."""
    entries = [(name, look) for name, look in LOOKS.items() if look.words and not name.endswith(SPREAD)]
    lines = -(-len(entries) // COLUMNS) + 1
    image = Image.new("RGB", (WIDTH, lines * LINE), "white")
    draw = ImageDraw.Draw(image)
    for k, look in enumerate(look for name, look in entries if name in drawn):
        x, y = WIDTH // COLUMNS * (k % COLUMNS) + 8, LINE * (k // COLUMNS)
        draw.rectangle((x, y + 12, x + 34, y + LINE - 12), palette.css(look.in_space), "gray")
        draw.text((x + 44, y + LINE / 2), look.words, "black", _font(), "lm")
    for k, colour in enumerate(palette.GAINS):
        box = (8 + 34 * k, image.height - LINE + 12, 42 + 34 * k, image.height - 12)
        draw.rectangle(box, palette.css(colour))
    told = f"gain of a place to go to: none ... the most of all; pale rings and bands: 3\u03c3 \u00d7 {MAGNIFIED:g}"
    draw.text((18 + 34 * len(palette.GAINS), image.height - LINE / 2), told, "black", _font(), "lm")
    return _png(image), image.height


def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 26)


def _png(image: Image.Image) -> bytes:
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()

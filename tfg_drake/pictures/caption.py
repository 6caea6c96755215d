"""A line of figures and a legend on a flat, transparent panel, for scenes that have no text of their own."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tfg_drake.messages import FloatArray

Colour = tuple[float, float, float]

# Pixels; the panel's width in the scene decides how large that is.
WIDTH, HEIGHT = 2048, 168
_INK = (38, 42, 48)
_SOFT = (110, 116, 124)
# Room for a legend entry's mark, pixels.
_MARK = 50.0


def render_caption(title: str, figures: Sequence[tuple[str, str]], legend: Sequence[tuple[str, Colour, str]]) -> bytes:
    """The panel as a PNG.

    Args:
        title: stands at the left of the first line.
        figures: (name, value) pairs that follow it, spread evenly.
        legend: (label, colour in [0, 1], mark) triples of the second line; a mark is "line", "dot", "ring" or "ramp".
    """
    image = Image.new("RGBA", (WIDTH, HEIGHT), (255, 255, 255, 0))
    draw = ImageDraw.Draw(image)
    bold, plain, small = _font("DejaVuSans-Bold", 40), _font("DejaVuSans", 40), _font("DejaVuSans", 26)
    draw.text((4, 52), title, font=bold, fill=_INK, anchor="ls")
    # In steps, so that the figures do not move with every word of the title.
    begin = 560 + 100 * max(0, math.ceil((draw.textlength(title, font=bold) - 520) / 100))
    gap = (WIDTH - begin) / max(len(figures), 1)
    for i, (name, value) in enumerate(figures):
        x = begin + i * gap
        draw.text((x, 52), name, font=small, fill=_SOFT, anchor="ls")
        draw.text((x + draw.textlength(name, font=small) + 14, 52), value, font=plain, fill=_INK, anchor="ls")
    x, lengths = 4.0, [_MARK + draw.textlength(label, font=small) for label, _, _ in legend]
    between = (WIDTH - 8 - sum(lengths)) / max(len(legend) - 1, 1)
    for (label, colour, mark), length in zip(legend, lengths, strict=True):
        _mark(draw, x, 118.0, colour, mark)
        draw.text((x + _MARK, 127), label, font=small, fill=_SOFT, anchor="ls")
        x += length + min(between, 40.0)
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def caption_gltf(png: bytes, width: float) -> str:
    """A glTF document of one rectangle that shows the PNG unlit, `width` m wide, its top left corner at the origin.

    glTF has y up: the rectangle lies in its xz plane, which is the xy plane of a z-up scene such as Meshcat's.
    """
    height = width * HEIGHT / WIDTH
    corners = np.array([[0, 0, height], [width, 0, height], [width, 0, 0], [0, 0, 0]], dtype=np.float32)
    texture = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
    triangles = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)
    blobs = [array.tobytes() for array in (corners, texture, triangles)]
    starts = np.cumsum([0, *map(len, blobs)])
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "extensions": {"KHR_materials_unlit": {}}}
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 2, "material": 0}]}],
        "materials": [{**material, "doubleSided": True, "alphaMode": "BLEND"}],
        "textures": [{"source": 0}],
        "images": [{"uri": _data_uri("image/png", png)}],
        "buffers": [{"byteLength": int(starts[-1]), "uri": _data_uri("application/octet-stream", b"".join(blobs))}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(start), "byteLength": len(blob)}
            for start, blob in zip(starts[:-1], blobs, strict=True)
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": corners.min(axis=0).tolist(),
                "max": corners.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }
    return json.dumps(document)


def gain_colours(share: FloatArray) -> FloatArray:
    """Colours (n, 3) in [0, 1] for shares (n,) of the best gain: pale for none, deep for the best, even to the eye."""
    return np.asarray(matplotlib.colormaps["magma_r"](0.08 + 0.77 * share))[:, :3]


def _mark(draw: ImageDraw.ImageDraw, x: float, y: float, colour: Colour, mark: str) -> None:
    fill = tuple(round(255 * c) for c in colour)
    if mark == "line":
        draw.rectangle((x, y - 4, x + 38, y + 4), fill=fill)
    elif mark == "ring":
        draw.ellipse((x + 4, y - 13, x + 30, y + 13), outline=fill, width=4)
    elif mark == "ramp":
        for i, rgb in enumerate(gain_colours(np.linspace(0.0, 1.0, 3))):
            left = x + 15 * i - 4
            draw.ellipse((left, y - 7, left + 14, y + 7), fill=tuple(round(255 * float(c)) for c in rgb))
    else:
        draw.ellipse((x + 12, y - 9, x + 30, y + 9), fill=fill)


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


@cache
def _font(name: str, size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"), size)

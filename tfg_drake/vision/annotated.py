"""Pictures of what was seen: tags with their distances, and what is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from tfg_drake.vision.image import Image
from tfg_drake.vision.sighting import Sighting
from tfg_drake.vision.tag_detector import TagsInImage

# RGB of used tags, ignored tags, text and its background.
_GOOD, _BAD, _TEXT, _BEHIND = (0, 200, 0), (230, 60, 30), (255, 255, 255), (0, 0, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def annotated(image: Image, tags: TagsInImage, sighting: Sighting, notes: Sequence[str] = ()) -> Image:
    """The RGB image (h, w, 3) with tags outlined, green where they are used, and lines of text at its top: the notes,
    then what was left out."""
    picture = np.ascontiguousarray(image[..., :3]).copy()
    scale = max(picture.shape[1] / 1000.0, 0.45)
    seen = sighting.detections
    rows = {int(tag): row for row, tag in enumerate(seen.ids)}
    for tag, corners in zip(tags.ids.tolist(), tags.corners, strict=True):
        row = rows.get(tag)
        colour = _BAD if row is None else _GOOD
        outline = np.round(corners).astype(np.int32)
        cv2.polylines(picture, [outline], True, colour, max(1, round(2.0 * scale)))
        label = (
            str(tag) if row is None else f"{tag}: {seen.range[row]:.2f} m {math.degrees(seen.bearing[row]):+.1f} deg"
        )
        at = (int(outline[:, 0].min()), int(outline[:, 1].min()) - round(5 * scale))
        _write(picture, label, at, scale, colour)
    for number, line in enumerate([*notes, *sighting.remarks]):
        _write(picture, line, (round(8 * scale), round((22 + 24 * number) * scale)), scale, _TEXT)
    return picture


def _write(picture: Image, text: str, at: tuple[int, int], scale: float, colour: tuple[int, int, int]) -> None:
    size, thick = 0.6 * scale, max(1, round(scale))
    cv2.putText(picture, text, at, _FONT, size, _BEHIND, thick + 2, cv2.LINE_AA)
    cv2.putText(picture, text, at, _FONT, size, colour, thick, cv2.LINE_AA)

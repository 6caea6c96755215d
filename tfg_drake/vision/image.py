"""Images as arrays: grey (h, w), RGB (h, w, 3) or RGBA (h, w, 4), one byte a value."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

# Errors that Pillow raises for bytes that are no image, or not a whole one.
NO_IMAGE = (OSError, EOFError, SyntaxError, ValueError, TypeError, LookupError, ArithmeticError, struct.error)
# Luminance weights of ITU-R BT.601, as in OpenCV.
_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)


def grey(image: Image) -> Image:
    """(h, w) and contiguous, as detectors want it.

    Raises ValueError where an image is none.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(
            f"an image of shape {image.shape} and type {image.dtype}; give bytes of shape (h, w), (h, w, 3) or "
            "(h, w, 4)"
        )
    if image.ndim == 2 or image.shape[2] == 1:
        return np.ascontiguousarray(image.reshape(image.shape[:2]))
    return np.ascontiguousarray((image[..., :3] @ _WEIGHTS + 0.5).astype(np.uint8))


def eight_bits(image: NDArray[np.uint8] | NDArray[np.uint16]) -> Image:
    """An image of any shape with its upper eight bits; one of two bytes has as many as its brightest value takes: a
    camera's ten or twelve may be written into sixteen."""
    return (image >> max(int(image.max(initial=0)).bit_length() - 8, 0)).astype(np.uint8)

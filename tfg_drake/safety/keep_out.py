"""Areas that the base must not enter, as the scanner would show them if they had walls round them."""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import FloatArray, LaserScan, replace

_cast_rays = read_only_arguments(cast_rays)


def walled(scan: LaserScan, X_MB: FloatArray, keep_out: FloatArray) -> LaserScan:
    """A scan taken at X_MB (3,) whose rays end at keep_out (k, 4), m in M. A ray that says nothing says nothing yet."""
    to_area = _cast_rays(keep_out, X_MB[:2], scan.angles + X_MB[2], scan.range_max)
    return replace(scan, ranges=np.minimum(scan.ranges, to_area))

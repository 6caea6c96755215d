"""A map's contents in words."""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.star import covered_area
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray
from tfg_drake.slam.shared import RANGE_SCALE
from tfg_drake.slam.walls import known_walls

# Kinds of surfaces by number.
KINDS = ("on walls or between tags", "that end at a tag", "without a landmark")


def map_rows(saved: SavedMap, size: int) -> list[tuple[str, str]]:
    """Names and values, as a table for people; a name may be "". size: of the file, bytes."""
    tfg = saved.tfg
    x, y, theta = saved.X_WM
    length = np.hypot(*(tfg.segments[:, 2:] - tfg.segments[:, :2]).T)
    area = covered_area(tfg.star_offsets, tfg.star_vertices)
    across = known_walls(saved.graph)[2]
    names = ", ".join(map(str, saved.doubtful.tolist()))
    doubtful = f"; doubtful: tags {names}" if names else ""
    rows = [
        ("world frame", f"origin of the map at x {x:.3f} m, y {y:.3f} m, heading {theta:.4f} rad"),
        ("views", f"{saved.stage} turns and glances, the last at {saved.stamp:.1f} s"),
        ("landmarks", landmark_counts(len(saved.ids), len(across)) + doubtful),
        *([("tags", _deviation(saved))] if len(saved.ids) else []),
        *([("walls", _walls(across))] if len(across) else []),
        ("entropy", f"{saved.entropy:.1f} nats"),
    ]
    for kind, name in enumerate(KINDS):
        chosen = tfg.segment_kind == kind
        count = np.count_nonzero(saved.tfg_graph.surfaces.kind == kind)
        rows.append(("surfaces" if kind == 0 else "", f"{count} {name}, {length[chosen].sum():.1f} m"))
    rows += [
        ("free space", f"{area:.0f} m2"),
        ("frontiers", f"{len(tfg.frontiers)} open, {tfg.frontier_length.sum():.1f} m"),
        ("calibration", _calibration(saved)),
        ("file size", f"{size / 1000.0:.0f} kB"),
    ]
    return rows


def landmark_counts(tags: int, walls: int) -> str:
    """How many landmarks there are of each kind that there is: "4 tags, 1 wall"."""
    counts = [f"{n} {kind}{'s' if n != 1 else ''}" for kind, n in (("tag", tags), ("wall", walls)) if n]
    return ", ".join(counts) or "no landmarks"


def _deviation(saved: SavedMap) -> str:
    """Standard deviations of the tags along their worst direction."""
    sigma = np.sqrt(np.linalg.eigvalsh(saved.landmark_covariance)[:, -1])
    worst = int(np.argmax(sigma))
    return f"1\u03c3 {np.median(sigma):.3f} m median, {sigma[worst]:.3f} m worst (tag {saved.ids[worst]})"


def _walls(sigma: FloatArray) -> str:
    """How well walls are known, from the standard deviations (w, 2) of their points normal to them, m."""
    return f"1\u03c3 across {np.median(sigma):.4f} m median, {sigma.max():.4f} m worst"


def _calibration(saved: SavedMap) -> str:
    """The tag sensor as the map's estimator has learnt it."""
    if not saved.compared:
        return "no range of a tag was compared with a scan"
    share, sigma = saved.graph.shared.mean[RANGE_SCALE], saved.graph.shared.sigma[RANGE_SCALE]
    return f"tag ranges {100.0 * share:+.2f} % (1\u03c3 {100.0 * sigma:.2f} %)"

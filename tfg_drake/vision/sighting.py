"""Tags in an image as the sensor's message: range and bearing from the body, how exact, and what was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tfg_drake.messages import FloatArray, TagDetections, message
from tfg_drake.table import empty
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.tag_position import LEAST_RANGE, polar, tag_positions

if TYPE_CHECKING:
    # Only who detects tags needs the detector's package.
    from tfg_drake.vision.tag_detector import TagsInImage

# A corner within this distance of the image's edge, pixels, may lie beyond it.
EDGE = 1.0
# Least correlation of an image with a tag's cells; real tags that are fully visible have 0.91 to 1.
LEAST_LIKENESS = 0.9


@dataclasses.dataclass(frozen=True)
class TagSizes:
    """Sides of the tags' black squares, m: of an id, else of its family, else of all others (None: of none)."""

    default: float | None = None
    by_family: Mapping[str, float] = dataclasses.field(default_factory=dict)
    by_id: Mapping[int, float] = dataclasses.field(default_factory=dict)

    def of(self, tag: int, family: str) -> float | None:
        """The size of a tag, None where nobody has said."""
        return self.by_id.get(tag, self.by_family.get(family, self.default))


@dataclasses.dataclass(frozen=True)
class TagNoise:
    """Standard deviations of a sighting: pixels, of each corner along either axis, and place, m, of the tag's centre,
    what no pixel explains: calibration, mount, tags that are not flat. unlike: pixels, of a corner too, times the root
    of what the correlation of the image with the tag's cells lacks to 1: of a tag that is cut by a wall or seen aslant.

    The first two fit TagSLAM's recording in a building, whose survey and reference are in `place` too. Most of it is no
    white noise: the frames of one visit err alike. The third fits rendered tags, whose corners err by 0.06 pixels.
    """

    pixels: float = 0.4
    place: float = 0.02
    unlike: float = 1.0


@message
class Sighting:
    """The tags that one image showed. remarks: a line for each thing that was left out and why."""

    detections: TagDetections
    remarks: tuple[str, ...]


def sighted(
    tags: TagsInImage,
    stamp: float,
    calibration: CameraCalibration,
    sizes: TagSizes,
    mount: CameraMount,
    noise: TagNoise | None = None,
    least_margin: float = 30.0,
    least_side: float = 0.0,
) -> Sighting:
    """Range and bearing of the tags' centres in the body's horizontal plane, ids ascending, and what was left out.

    stamp: s. least_margin: the decision margin, grey levels, below which a tag is not believed. least_side: pixels of
    the longer side below which its range is not believed. Left out are tags that
    are not believed, of no known size, twice in the image, too small in it, cut off by its edge, or no squares; and all
    tags of an image that is not of the calibration's size.
    """
    noise = noise or TagNoise()
    if (tags.width, tags.height) != (calibration.width, calibration.height):
        remark = (
            f"the image has {tags.width} x {tags.height} pixels, the calibration {calibration.width} x "
            f"{calibration.height}: no tag is used; set the camera to the calibration's size or calibrate anew"
        )
        return Sighting(empty(TagDetections, stamp=stamp), (remark,))
    side = np.array([sizes.of(int(i), family) or np.nan for i, family in zip(tags.ids, tags.families, strict=True)])
    p_CT, unit = tag_positions(tags.corners, side, calibration)
    unit *= (1.0 + (noise.unlike / noise.pixels) ** 2 * (1.0 - tags.likeness))[:, None, None]
    distance, bearing, sigma_range, sigma_bearing = in_plane(p_CT, unit, mount, noise)
    last = np.array([tags.width - 1.0, tags.height - 1.0])
    cut_off = np.asarray(((tags.corners < EDGE) | (tags.corners > last - EDGE)).any(axis=(1, 2)))
    side_seen = np.linalg.norm(np.roll(tags.corners, -1, axis=1) - tags.corners, axis=2).max(axis=1, initial=0.0)
    counts = dict(zip(*np.unique(tags.ids, return_counts=True), strict=True))
    good, remarks = np.ones(len(tags.ids), dtype=bool), dict[str, None]()
    for i, (tag, family) in enumerate(zip(tags.ids.tolist(), tags.families, strict=True)):
        why = ""
        if counts[tag] > 1:
            of = sorted({other for one, other in zip(tags.ids, tags.families, strict=True) if one == tag})
            families = f" of the families {' and '.join(of)}" if len(of) > 1 else ""
            why = f"{counts[tag]} times in one image{families}; all are left out, print each id once"
        elif tags.margin[i] < least_margin:
            why = f"decision margin {tags.margin[i]:.0f}, below {least_margin:g}; left out as hidden, blurred or far"
        elif tags.likeness[i] < LEAST_LIKENESS:
            why = "its cells are not where its outline is; left out as half hidden"
        elif np.isnan(side[i]):
            why = f"the size of {family} is not given; left out"
        elif cut_off[i]:
            why = "at the edge of the image; left out"
        elif not distance[i] > LEAST_RANGE:
            why = "its corners are no square's; left out"
        elif side_seen[i] < least_side:
            why = f"{side_seen[i]:.0f} pixels wide, below {least_side:g}; left out as too far"
        if why:
            good[i] = False
            remarks[f"tag {tag}: {why}"] = None
    columns = (column[good] for column in (distance, bearing, sigma_range, sigma_bearing))
    return Sighting(TagDetections(stamp, tags.ids[good], *columns), tuple(remarks))


def nothing_sighted() -> Sighting:
    """The sighting before a camera's first image, stamped -inf."""
    return Sighting(empty(TagDetections, stamp=-np.inf), ())


def in_plane(
    p_CT: FloatArray, unit: FloatArray, mount: CameraMount, noise: TagNoise
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Range (n,), m, and bearing (n,), rad, from the body, and their standard deviations, of points p_CT (n, 3), m, in
    the camera's frame. unit: (n, 3, 3), their covariance for corners that err by one pixel."""
    R_BC = mount.R_BC[:2]
    p_BT = p_CT @ R_BC.T + mount.p_BC[:2]
    covariance = noise.pixels**2 * (R_BC @ unit @ R_BC.T) + noise.place**2 * np.eye(2)
    distance, bearing, along, across = polar(p_BT, covariance)
    return distance, bearing, np.sqrt(along), np.sqrt(across) / np.maximum(distance, LEAST_RANGE)

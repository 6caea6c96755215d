"""Star polygons of panoramas against the true visibility region."""

import numpy as np
import shapely

from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.tfg.panorama import BINS, Panorama
from tfg_drake.tfg.star_polygon import MOST_VERTICES, looked_round, star_polygon


def test_star_is_free_and_almost_all_of_what_was_seen(two_rooms) -> None:
    start = np.array([2.0, 3.0, 0.0])
    star = star_polygon(two_rooms.panorama(start))
    assert len(star) <= MOST_VERTICES
    polygon = shapely.Polygon(star + start[:2])
    assert polygon.is_valid
    angles = np.linspace(0.0, 2.0 * np.pi, 7200, endpoint=False)
    ranges = np.minimum(cast_rays(two_rooms.walls, start[:2], angles, 10.0), 10.0)
    truth = shapely.Polygon(start[:2] + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    assert polygon.difference(truth.buffer(0.05)).area < 1e-3
    assert polygon.area > 0.95 * truth.area
    area = 0.5 * np.sum(star[:, 0] * np.roll(star[:, 1], -1) - star[:, 1] * np.roll(star[:, 0], -1))
    assert area > 0.0


def test_free_space_reaches_the_scan_range_and_the_unseen_is_not_free() -> None:
    angles = (np.arange(BINS) + 0.5) * 2.0 * np.pi / BINS
    free = star_polygon(Panorama(angles, np.full(BINS, np.inf), 10.0, 0.015))
    reach = np.hypot(*free.T)
    np.testing.assert_allclose(reach, 10.0)
    assert len(free) < 60
    unseen = star_polygon(Panorama(angles, np.where(angles < np.pi, np.inf, np.nan), 10.0, 0.015))
    assert (np.hypot(*unseen.T)[unseen[:, 1] < -1e-3] < 0.1).all()


def test_a_look_all_round_is_told_from_a_glance() -> None:
    angles = (np.arange(BINS) + 0.5) * 2.0 * np.pi / BINS
    near = np.full(BINS, 0.25)
    stars = [
        star_polygon(Panorama(angles, ranges, 10.0, 0.015))
        for ranges in (near, np.where(np.abs(angles - 3.0) < 0.1, np.nan, near), np.full(BINS, np.inf))
    ]
    offsets = np.cumsum([0, *map(len, stars)])
    centers = np.array([[0.0, 0.0], [3.0, 1.0], [-2.0, 5.0]])
    packed = np.concatenate([star + center for star, center in zip(stars, centers, strict=True)])
    assert looked_round(offsets, packed, centers).tolist() == [True, False, True]
    assert looked_round(np.zeros(1, dtype=int), np.zeros((0, 2)), np.zeros((0, 2))).tolist() == []

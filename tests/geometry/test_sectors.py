import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.geometry.distance import segments_cross
from tfg_drake.geometry.sectors import SECTORS, diamond_angle, sector_of, segments_by_sector

SEEDS = st.integers(0, 2**32 - 1)


def test_the_diamond_angle_grows_with_the_direction_and_by_two_with_half_a_turn():
    angle = np.linspace(-0.5 * np.pi, 1.5 * np.pi, 400, endpoint=False)
    diamond = [diamond_angle(np.cos(a), np.sin(a)) for a in angle]
    assert diamond[0] < 1e-12
    assert (np.diff(diamond) > 0.0).all()
    assert diamond[-1] < 4.0
    opposite = [diamond_angle(-np.cos(a), -np.sin(a)) for a in angle]
    np.testing.assert_allclose(np.mod(np.subtract(opposite, diamond), 4.0), 2.0, atol=1e-9)


@given(seed=SEEDS)
def test_what_crosses_a_line_of_sight_is_in_its_sector(seed):
    rng = np.random.default_rng(seed)
    # Whole numbers: many segments begin on a line of sight, end on the viewer's axes or pass through the viewer.
    segments = rng.integers(-4, 5, (40, 4)).astype(float)
    x, y = rng.integers(-2, 3, 2).astype(float)
    offsets, rows = segments_by_sector(segments, x, y)
    assert offsets[0] == 0
    assert len(offsets) == SECTORS + 1
    for ex, ey in rng.integers(-4, 5, (20, 2)).astype(float):
        if (ex, ey) == (x, y):
            continue
        k = sector_of(ex - x, ey - y)
        here = set(rows[offsets[k] : offsets[k + 1]].tolist())
        crossing = {j for j, s in enumerate(segments) if segments_cross(x, y, ex, ey, *s)}
        assert crossing <= here


def test_far_small_segments_meet_few_sectors():
    angle = np.linspace(0.0, 2.0 * np.pi, 500, endpoint=False)
    start = 10.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    _, rows = segments_by_sector(np.hstack([start, start + 0.1]), 0.0, 0.0)
    assert len(rows) < 2 * len(start)


def test_without_segments_all_sectors_are_empty():
    offsets, rows = segments_by_sector(np.zeros((0, 4)), 0.0, 0.0)
    assert offsets.tolist() == [0] * (SECTORS + 1)
    assert len(rows) == 0

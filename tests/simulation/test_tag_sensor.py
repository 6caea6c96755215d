"""The tag sensor against geometry, and its noise."""

import numpy as np
import pytest
import shapely

from tfg_drake.config import TagSensorConfig
from tfg_drake.simulation.tag_sensor import (
    NOISE_PER_TAG,
    correlated,
    detect,
    detected_share,
    no_detections,
    visible_tags,
)
from tfg_drake.world.world import World

CONFIG = TagSensorConfig()


def make_world(tags, walls=()):
    """tags: (id, x, y, facing)."""
    tags = np.array(tags, dtype=float).reshape(-1, 4)
    walls = np.array(walls, dtype=float).reshape(-1, 4)
    return World(walls, tags[:, 0].astype(np.int64), tags[:, 1:3].copy(), tags[:, 3].copy(), np.zeros(3))


def ids_seen(world, X_WB=(0.0, 0.0, 0.0), config=CONFIG):
    return detect(world, np.array(X_WB), 0.0, np.zeros((len(world.tag_ids), NOISE_PER_TAG)), config).ids.tolist()


def test_exact_without_noise_in_ascending_order():
    world = make_world([[7, 3, 4, -2.2], [2, 5, 0, np.pi]])
    found = detect(world, np.array([0.0, 0.0, 0.1]), 1.5, np.zeros((2, NOISE_PER_TAG)), CONFIG)
    assert found.stamp == 1.5
    assert found.ids.tolist() == [2, 7]
    assert found.range == pytest.approx([5, 5], abs=1e-15)
    assert found.bearing == pytest.approx([-0.1, np.arctan2(4, 3) - 0.1], abs=1e-15)
    assert found.sigma_range == pytest.approx([0.07, 0.07])
    assert found.sigma_bearing == pytest.approx([0.01, 0.01])


def test_range_field_of_view_and_incidence_have_sharp_limits():
    half = 0.5 * CONFIG.field_of_view

    def tag(distance, bearing, incidence=0.0):
        p = distance * np.array([np.cos(bearing), np.sin(bearing)])
        return make_world([[1, *p, bearing + np.pi + incidence]])

    assert ids_seen(tag(9.99, 0.0)) == [1]
    assert ids_seen(tag(10.01, 0.0)) == []
    for sign in (1, -1):
        assert ids_seen(tag(5.0, sign * (half - 0.001))) == [1]
        assert ids_seen(tag(5.0, sign * (half + 0.001))) == []
        assert ids_seen(tag(5.0, 0.0, sign * (CONFIG.max_incidence - 0.001))) == [1]
        assert ids_seen(tag(5.0, 0.0, sign * (CONFIG.max_incidence + 0.001))) == []


def test_a_wall_carries_its_tags_and_hides_others():
    wall = [[2.0, -1, 2, 1]]
    on_front, off_front, on_back = [1, 2, 0, np.pi], [2, 1.99, 0.5, np.pi], [3, 2, 0.2, 0]
    behind = [4, 3, 0, np.pi]
    world = make_world([on_front, off_front, on_back, behind], wall)
    assert ids_seen(world) == [1, 2]
    assert ids_seen(world, (4.0, 0.0, np.pi)) == [3]


def test_visible_tags_agree_with_shapely():
    rng = np.random.default_rng(0)
    walls = rng.uniform(-6, 6, (15, 4))
    along = rng.uniform(0.1, 0.9, (15, 1))
    p_WT = walls[:, :2] + along * (walls[:, 2:] - walls[:, :2])
    normal = np.arctan2(walls[:, 3] - walls[:, 1], walls[:, 2] - walls[:, 0]) + 0.5 * np.pi
    world = World(walls, np.arange(15), p_WT, normal, np.zeros(3))
    lines = shapely.MultiLineString(walls.reshape(-1, 2, 2).tolist())
    for _ in range(100):
        X_WB = np.array([*rng.uniform(-6, 6, 2), rng.uniform(-np.pi, np.pi)])
        expected = []
        for i, (p, n) in enumerate(zip(p_WT, normal, strict=True)):
            to_tag = p - X_WB[:2]
            distance = np.hypot(*to_tag)
            bearing = np.angle(np.exp(1j * (np.arctan2(to_tag[1], to_tag[0]) - X_WB[2])))
            incidence = np.arccos(-(np.cos(n) * to_tag[0] + np.sin(n) * to_tag[1]) / distance)
            short = X_WB[:2] + to_tag * (1.0 - 0.01 / distance)
            clear = not lines.intersects(shapely.LineString([X_WB[:2], short]))
            if distance <= 10 and abs(bearing) <= 0.5 * CONFIG.field_of_view and incidence <= CONFIG.max_incidence:
                expected += [i] if clear else []
        arguments = world.p_WT, world.tag_facing, world.walls, X_WB, 10.0, CONFIG.field_of_view, CONFIG.max_incidence
        assert visible_tags(*arguments).tolist() == expected


def test_noise_has_the_stated_spread():
    world = make_world([[1, 6, 0, np.pi], [2, 1, 1, -2.4]])
    rng = np.random.default_rng(0)
    frames = [detect(world, np.zeros(3), 0.0, rng.normal(size=(2, NOISE_PER_TAG)), CONFIG) for _ in range(4000)]
    ranges, bearings = np.array([f.range for f in frames]), np.array([f.bearing for f in frames])
    assert ranges.mean(axis=0) == pytest.approx([6, np.sqrt(2)], abs=0.005)
    assert ranges.std(axis=0) == pytest.approx(frames[0].sigma_range, rel=0.05)
    assert bearings.mean(axis=0) == pytest.approx([0, np.pi / 4], abs=0.001)
    assert bearings.std(axis=0) == pytest.approx([0.01, 0.01], rel=0.05)


def test_detection_probability_and_range_scale():
    world = make_world([[i, 5, 0.01 * i, np.pi] for i in range(2000)])
    world = World(world.walls, world.tag_ids, np.tile([5.0, 0.0], (2000, 1)), world.tag_facing, world.start)
    normals = np.random.default_rng(0).normal(size=(2000, NOISE_PER_TAG))
    for probability in (0.0, 0.3, 1.0):
        config = TagSensorConfig(detection_probability=probability)
        assert len(detect(world, np.zeros(3), 0.0, normals, config).ids) / 2000 == pytest.approx(probability, abs=0.04)
    scaled = detect(world, np.zeros(3), 0.0, np.zeros_like(normals), TagSensorConfig(range_scale=1.01))
    assert scaled.range == pytest.approx(np.full(2000, 5.05))


def test_no_tags():
    assert ids_seen(make_world([])) == []
    assert no_detections().stamp == -np.inf
    assert no_detections().ids.shape == (0,)


def test_gross_errors_and_misread_ids_come_as_often_as_asked():
    world = make_world([[i, 5, 0.01 * i, np.pi] for i in range(4000)])
    world = World(world.walls, world.tag_ids, np.tile([5.0, 0.0], (4000, 1)), world.tag_facing, world.start)
    normals = np.random.default_rng(0).normal(size=(4000, NOISE_PER_TAG))
    config = TagSensorConfig(detection_probability=0.8, outlier_probability=0.1, wrong_id_probability=0.05)
    clean = detect(world, np.zeros(3), 0.0, normals, TagSensorConfig(detection_probability=0.8))
    spoilt = detect(world, np.zeros(3), 0.0, normals, config)
    moved, misread = spoilt.range != clean.range, spoilt.ids != clean.ids
    assert moved.mean() == pytest.approx(0.1, abs=0.02)
    assert misread.mean() == pytest.approx(0.05, abs=0.015)
    assert not (moved & misread).any()
    assert spoilt.range[moved].std() == pytest.approx(10.0 / np.sqrt(12.0), rel=0.1)
    assert np.isin(spoilt.ids, world.tag_ids).all()
    assert len(np.unique(spoilt.ids[misread])) > 0.8 * misread.sum()


def test_what_is_told_of_the_noise_is_the_data_sheet_at_the_measured_range():
    world = make_world([[1, 6, 0, np.pi]])
    real = TagSensorConfig(range_noise=0.5, bearing_noise=0.2)
    noise, errors = np.array([[2.0, -1.0, 0.0]]), np.array([[0.3, 0.01]])
    found = detect(world, np.zeros(3), 0.0, noise, real, CONFIG, errors)
    assert found.range == pytest.approx([6.0 + 2.0 * (0.5 + 0.06) + 0.3])
    assert found.bearing == pytest.approx([-0.2 + 0.01])
    assert found.sigma_range == pytest.approx(0.02 + 0.01 * found.range)
    assert found.sigma_bearing == pytest.approx([CONFIG.bearing_noise])


def test_noise_that_is_correlated_in_time():
    rng = np.random.default_rng(0)
    noise = [correlated(np.zeros(2000), rng.normal(size=2000), np.inf, 1.0)]
    for _ in range(10):
        noise.append(correlated(noise[-1], rng.normal(size=2000), 0.1, 1.0))
    assert np.std(noise[-1]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(noise[0] * noise[-1]) == pytest.approx(np.exp(-1.0), abs=0.07)
    fresh = rng.normal(size=5)
    assert correlated(np.ones(5), fresh, 0.1, 0.0) == pytest.approx(fresh)


def test_a_tag_behind_somebody_is_not_seen():
    world = make_world([[1, 4, 0, np.pi], [2, 4, 1, np.pi], [3, 4, 0.2, np.pi]])
    told = np.zeros((3, NOISE_PER_TAG))

    def seen(*discs):
        return detect(world, np.zeros(3), 0.0, told, CONFIG, discs=np.array(discs).reshape(-1, 3))

    assert seen([2.0, 0.0, 0.25]).ids.tolist() == [2]
    assert seen([5.0, 0.0, 0.25], [-2.0, 0.0, 0.25]).ids.tolist() == [1, 2, 3]
    alone = detect(world, np.zeros(3), 0.0, told, CONFIG)
    assert seen([2.0, 0.0, 0.25]).range == pytest.approx(alone.range[1:2], abs=0.0)


def test_detection_falls_with_range_and_incidence():
    assert detected_share(np.array([5.0, 10.0, 15.0, 20.0]), np.array([5.0, 10.0, 15.0, 20.0]), 10.0).tolist() == [
        1.0,
        0.5,
        0.0,
        0.0,
    ]
    fall = detected_share(np.linspace(4.0, 16.0, 50), np.linspace(4.0, 16.0, 50), 10.0)
    assert (np.diff(fall) <= 0.0).all()
    # At 60 degrees a tag seems half as wide.
    assert detected_share(np.array([5.0]), np.array([2.5]), 10.0) == pytest.approx([0.5])
    normals = np.random.default_rng(0).normal(size=(4000, NOISE_PER_TAG))
    config = TagSensorConfig(range=20.0, detection_probability=0.8, outlier_probability=0.1)
    for distance, share in ((4.0, 1.0), (10.0, 0.5), (16.0, 0.0)):
        ids = np.arange(4000)
        world = World(np.zeros((0, 4)), ids, np.tile([distance, 0.0], (4000, 1)), np.full(4000, np.pi), np.zeros(3))
        frame = detect(world, np.zeros(3), 0.0, normals, config, detection_range=10.0)
        assert len(frame.ids) / 4000 == pytest.approx(0.8 * share, abs=0.03)
        if share:
            assert (np.abs(frame.range - distance) > 1.0).mean() == pytest.approx(0.1, abs=0.03)

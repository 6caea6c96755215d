"""A map of schema 13, 52 s of `house` with a tag every 4 m, its walls pairs of points: read as one of today."""

from pathlib import Path

import numpy as np
import pytest

from tfg_drake.geometry.distance import clearance
from tfg_drake.mapfile.saved_map import MapFileError, load_map, save_map
from tfg_drake.messages import WALLS_BELOW
from tfg_drake.slam.keyframe_graph import no_observation
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.walls import known_walls
from tfg_drake.tfg.surfaces import place

OLD = Path(__file__).parent / "data" / "schema_13.npz"


def arrays_of(path):
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def test_its_walls_and_tags_are_where_they_were():
    old, saved = arrays_of(OLD), load_map(OLD)
    points = old["graph.ids"] < WALLS_BELOW
    np.testing.assert_array_equal(saved.ids, old["graph.ids"][~points])
    ids, ends, deviation = known_walls(saved.graph)
    assert 2 * len(ids) == points.sum() > 20
    assert (deviation > 0.0).all()
    pairs = old["graph.p_ML"][points].reshape(-1, 2, 2)
    along = (pairs[:, 1] - pairs[:, 0]) / np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1)[:, None]
    reach = old["walls.reach"][np.argsort(old["walls.first"])]
    np.testing.assert_allclose(ends, pairs[:, :1] + reach[:, :, None] * along[:, None], atol=1e-9)


def test_it_is_the_optimum_that_it_was():
    """The points along walls, which told nothing, are gone; the rest is at rest to a fraction of its deviations."""
    saved = load_map(OLD)
    graph, estimate = solve(saved.graph, saved.stamp, no_observation())
    assert np.abs(graph.X_MN - saved.graph.X_MN).max() < 1e-3
    assert np.abs(graph.p_ML - saved.graph.p_ML).max() < 1e-3
    assert np.isfinite(estimate.entropy)


def test_its_surfaces_lie_where_its_tfg_has_them():
    saved = load_map(OLD)
    estimate = solve(saved.graph, saved.stamp, no_observation())[1]
    vertices = place(saved.tfg_graph.surfaces, estimate)
    on = np.repeat(saved.tfg_graph.surfaces.on_wall, np.diff(saved.tfg_graph.surfaces.offsets))
    assert on.any()
    far = clearance(np.hstack([vertices[on], vertices[on]]), saved.tfg.segments, 1.0)
    assert np.max(far) < 0.01


def test_it_is_written_as_a_map_of_today(tmp_path):
    saved = load_map(OLD)
    save_map(tmp_path / "map.npz", saved)
    again = load_map(tmp_path / "map.npz")
    np.testing.assert_array_equal(again.graph.anchor, saved.graph.anchor)


@pytest.mark.parametrize("name", ["walls.reach", "walls.first", "graph.keyframes.y_AL", "graph.p_ML"])
def test_one_that_lacks_an_array_is_refused(tmp_path, name):
    arrays = arrays_of(OLD)
    del arrays[name]
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(MapFileError, match="is not a whole map"):
        load_map(tmp_path / "map.npz")

import dataclasses
import json
import math

import numpy as np
import pytest
import shapely
from shapely.geometry import shape

from tfg_drake.geometry.star import covered_area
from tfg_drake.mapfile.geojson import geojson_text
from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
from tfg_drake.messages import WALLS_BELOW
from tfg_drake.tfg.graph import empty_map


def features(saved):
    collection = json.loads(geojson_text(saved))
    assert collection["type"] == "FeatureCollection"
    found = {}
    for feature in collection["features"]:
        properties = dict(feature["properties"])
        found.setdefault(properties.pop("layer"), []).append((shape(feature["geometry"]), properties))
    return found


def test_shapely_reads_the_map_back(small_map):
    tfg, found = tfg_in_world(small_map), features(small_map)
    p_WL, covariance = landmarks_in_world(small_map)
    assert sorted(found) == ["free_space", "frontier", "surface", "tag"]
    ((free, of_free),) = found["free_space"]
    assert free.is_valid
    assert (
        free.area == of_free["area_m2"] == pytest.approx(covered_area(tfg.star_offsets, tfg.star_vertices, 0.02), 0.01)
    )
    # M lies at (5, 3) and is turned by 90 degrees.
    assert free.contains(shapely.Point(5.0, 3.0))
    assert free.contains(shapely.Point(5.0, 5.4))
    assert not free.contains(shapely.Point(5.0, 1.9))
    np.testing.assert_allclose([line.coords for line, _ in found["surface"]], tfg.segments.reshape(-1, 2, 2))
    np.testing.assert_allclose(found["surface"][0][0].coords, [[6.0, 5.0], [4.0, 5.0]], atol=1e-12)
    assert [told for _, told in found["surface"]] == [
        {"kind": "edge", "landmarks": [11, 10]},
        {"kind": "wall_end", "landmarks": [12, -1]},
        {"kind": "bare_surface", "landmarks": [-1, -1]},
        {"kind": "bare_surface", "landmarks": [-1, -1]},
    ]
    ((frontier, of_frontier),) = found["frontier"]
    np.testing.assert_allclose(frontier.coords, [[5.0, 1.0]], atol=1e-12)
    assert of_frontier == {"length_m": 0.4}
    for row, (point, told) in enumerate(found["tag"]):
        np.testing.assert_allclose(point.coords[0], p_WL[row])
        P = covariance[row]
        assert (told["id"], told["doubtful"]) == (10 + row, False)
        assert [told[f"cov_{name}_m2"] for name in ("xx", "xy", "yy")] == [P[0, 0], P[0, 1], P[1, 1]]
    assert found["tag"][0][1]["facing_rad"] == pytest.approx(-0.5 * math.pi)


def test_its_coordinates_are_metres_of_a_local_system(small_map):
    """GDAL 3.12 and PROJ read this name as an engineering system in metres, not as degrees (EPSG:4326)."""
    wkt = 'LOCAL_CS["W",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
    assert json.loads(geojson_text(small_map))["crs"] == {"type": "name", "properties": {"name": wkt}}


def test_what_is_not_known_is_not_there(small_map):
    bare = dataclasses.replace(small_map, tfg=empty_map(), doubtful=np.array([11]))
    found = features(bare)
    assert list(found) == ["tag"]
    assert [told["facing_rad"] for _, told in found["tag"]] == [None] * 4
    assert [told["doubtful"] for _, told in found["tag"]] == [False, True, False, False]


def test_a_wall_that_is_a_landmark_has_its_deviation(small_map):
    graph, wall = small_map.graph, WALLS_BELOW - 1
    of_wall = {
        "ids": [wall],
        "p_ML": [[0.0, 1.0]],  # 1 m ahead of its anchor, from 2 m on its right to 1 m on its left
        "anchor": [[2.0, 0.0]],
        "reach": [[-2.0, 1.0]],
        "landmark_covariance": [np.diag([0.01**2, 0.03**2])],
    }
    joined = {name: np.concatenate([rows, getattr(graph, name)]) for name, rows in of_wall.items()}
    saved = dataclasses.replace(small_map, graph=dataclasses.replace(graph, **joined))
    ((line, told),) = features(saved)["wall"]
    # M lies at (5, 3) and is turned by 90 degrees.
    np.testing.assert_allclose(line.coords, [[7.0, 6.0], [4.0, 6.0]], atol=1e-12)
    assert told == {
        "id": wall,
        "length_m": pytest.approx(3.0),
        "sigma_m": pytest.approx([math.hypot(0.03, 0.02), math.hypot(0.03, 0.01)]),
    }

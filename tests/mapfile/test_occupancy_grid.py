import dataclasses
import io

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.se2 import transform
from tfg_drake.mapfile.in_world import tfg_in_world
from tfg_drake.mapfile.occupancy_grid import CELL, keep_out_files, map_server_files
from tfg_drake.tfg.graph import empty_map
from tfg_drake.world.map_server import load_map_server


def test_cells_are_free_where_stars_are_occupied_where_surfaces_are_else_unknown(small_map):
    text, image = map_server_files(small_map, "plan.pgm")
    tree = yaml.safe_load(text)
    assert {name: tree[name] for name in ("image", "resolution", "negate", "free_thresh")} == {
        "image": "plan.pgm",
        "resolution": CELL,
        "negate": 0,
        "free_thresh": 0.196,
    }
    level = np.asarray(Image.open(io.BytesIO(image)))[::-1]
    assert set(np.unique(level)) == {0, 205, 254}

    def at(*p_MP):
        column, row = np.floor((transform(small_map.X_WM, np.array(p_MP)) - tree["origin"][:2]) / CELL).astype(int)
        return level[row, column]

    # In both stars, in the second one alone; beyond all; on the walls.
    assert (at(0.0, 0.0), at(2.4, 0.9), at(-0.9, 1.4)) == (254, 254, 254)
    assert (at(2.4, 1.1), at(-1.1, 0.0), at(-1.3, 2.5)) == (205, 205, 205)
    assert (at(2.0, -0.98), at(2.0, 0.7), at(-1.25, 2.05), at(1.17, 1.135)) == (0, 0, 0, 0)


def test_the_projects_own_reader_reads_it(small_map, tmp_path):
    text, image = map_server_files(small_map, "plan.pgm")
    (tmp_path / "plan.yaml").write_text(text)
    (tmp_path / "plan.pgm").write_bytes(image)
    found = load_map_server(tmp_path / "plan.yaml")
    assert found.notes == ()
    p_MP = np.array([[0.0, 0.0], [1.9, 0.5], [2.1, 0.5], [2.0, 0.5], [2.4, 1.1], [-1.1, 0.0]])
    assert found.is_free(transform(small_map.X_WM, p_MP)).tolist() == [True, True, True, False, False, False]
    # The walls are as far off the border of free space as cells make them, and all of it has one.
    tfg = tfg_in_world(small_map)
    shown = np.vstack([tfg.segments.reshape(-1, 2), tfg.star_vertices])
    low, high = shown.min(axis=0), shown.max(axis=0)
    ends = found.walls.reshape(-1, 2)
    assert np.all((ends > low - CELL) & (ends < high + CELL))
    assert np.count_nonzero(found.free) * CELL**2 == pytest.approx(6.25 + 1.5, rel=0.1)


def test_the_mask_to_keep_out_by_is_the_same_grid_and_covers_each_area(small_map):
    areas = [np.array([[4.5, 3.0], [6.2, 3.3], [5.0, 4.0], [5.2, 3.6]])]
    areas.append(np.array([[6.0, 4.0], [90.0, 4.0], [6.0, 5.0]]))  # beyond the grid
    (text, image), (plain, grid) = keep_out_files(small_map, areas, "k.pgm"), map_server_files(small_map, "k.pgm")
    assert text == plain
    level = np.asarray(Image.open(io.BytesIO(image)))[::-1]
    assert level.shape == np.asarray(Image.open(io.BytesIO(grid))).shape
    x, y = yaml.safe_load(text)["origin"][:2]
    barred = shapely.union_all([shapely.Polygon(corners) for corners in areas])
    rows, columns = np.indices(level.shape)
    cells = shapely.box(x + CELL * columns, y + CELL * rows, x + CELL * (columns + 1), y + CELL * (rows + 1))
    share = shapely.area(shapely.intersection(cells, barred)) / CELL**2
    assert set(level[share > 0.5]) == {0}
    assert set(level[shapely.distance(cells, barred) > 1e-6]) == {254}


def test_a_map_without_free_space_has_no_grid(small_map):
    bare = dataclasses.replace(small_map, tfg=empty_map())
    with pytest.raises(BadInput, match=r"^the map has no free space, so there is no grid of it; export what it has"):
        map_server_files(bare, "plan.pgm")

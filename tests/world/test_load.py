"""Maps from files: map_server grids, vector maps, starts, and the real buildings where they are at hand."""

import gzip
import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from shapely.geometry import LineString, box
from shapely.ops import polygonize, unary_union

from tfg_drake.world.load import draw_start, furnish, load_map
from tfg_drake.world.map_server import borders, load_map_server
from tfg_drake.world.vectormap import load_vectormap
from tfg_drake.world.world import WorldError, check_world

REAL_MAPS = Path(__file__).resolve().parents[3] / "shared" / "data" / "maps"


def write_grid(
    folder: Path, free: np.ndarray, name: str = "map.pgm", origin: str = "[0, 0, 0]", negate: int = 0
) -> Path:
    """A map_server map of 0.1 m a cell; free (rows, columns), row 0 lowest."""
    shade = np.where(free, 254, 0).astype(np.uint8)[::-1]
    if negate:
        shade = 255 - shade
    plain = folder / name.removesuffix(".gz")
    Image.fromarray(shade).save(plain)
    if name.endswith(".gz"):
        (folder / name).write_bytes(gzip.compress(plain.read_bytes()))
    file = folder / "map.yaml"
    file.write_text(
        f"image: {name}\nresolution: 0.1\norigin: {origin}\nnegate: {negate}\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return file


def area(walls: np.ndarray) -> list[float]:
    """Areas of the faces that the walls enclose, m^2, largest first."""
    lines = unary_union([LineString(w.reshape(2, 2)) for w in walls])
    return sorted((face.area for face in polygonize(lines)), reverse=True)


@pytest.mark.parametrize("name", ["map.pgm", "map.pgm.gz", "map.png"])
@pytest.mark.parametrize("negate", [0, 1])
def test_a_room_with_a_block_comes_back_exactly(tmp_path, name, negate):
    free = np.zeros((40, 60), dtype=bool)
    free[5:35, 5:55] = True
    free[15:20, 20:30] = False
    walls = load_map_server(write_grid(tmp_path, free, name, "[-1, 2, 0]", negate)).walls
    assert len(walls) == 8
    outline = unary_union([LineString(w.reshape(2, 2)) for w in walls])
    expected = box(-0.5, 2.5, 4.5, 5.5).boundary.union(box(1.0, 3.5, 2.0, 4.0).boundary)
    assert outline.hausdorff_distance(expected) < 1e-9


def test_the_origin_turns_the_map(tmp_path):
    free = np.ones((10, 20), dtype=bool)
    walls = load_map_server(write_grid(tmp_path, free, origin="[1, 2, 1.5707963267948966]")).walls
    assert len(walls) == 4
    x, y = walls[:, [0, 2]], walls[:, [1, 3]]
    np.testing.assert_allclose([x.min(), x.max(), y.min(), y.max()], [0.0, 1.0, 2.0, 4.0], atol=1e-9)


def test_numbers_with_an_exponent(tmp_path, shared_data):
    file = write_grid(tmp_path, np.ones((10, 20), dtype=bool), origin="[1e0, 2E0, 0]")
    file.write_text(file.read_text().replace("0.1\n", "1e-1\n"))
    walls = load_map_server(file).walls
    assert [walls.min(), walls.max()] == pytest.approx([1.0, 3.0])
    assert load_map_server(shared_data("reports") / "maps" / "exp_res.yaml").resolution == 0.05


def test_the_grey_of_savers_is_unknown(tmp_path, shared_data, caplog):
    file = shared_data("reports") / "maps" / "partial.yaml"
    with Image.open(file.with_suffix(".pgm")) as image:
        white = np.asarray(image)[::-1] == 254
    np.testing.assert_array_equal(load_map_server(file).free, white)
    world = load_map(file, 0.2, 1.0, None, 0)
    told = "grey 205 is below free_thresh 0.25; taken for unknown, as savers mean it"
    assert f"{file}: {told}" in caplog.text
    assert load_map_server(file).is_free(world.start[None, :2]).all()


@pytest.mark.parametrize(("other", "free"), [(254, False), (230, True)])
@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_grey_205_among_other_levels_is_as_free_thresh_has_it(tmp_path, other, free, suffix):
    level = np.full((40, 60), 254, dtype=np.uint8)
    level[:, 30:] = 205
    level[0, 0] = other
    Image.fromarray(level).save(tmp_path / f"map.{suffix}")
    file = tmp_path / "map.yaml"
    file.write_text(f"image: map.{suffix}\nresolution: 0.05\nfree_thresh: 0.3\n")
    found = load_map_server(file)
    assert found.free[:, 30:].all() == found.free[:, 30:].any() == free
    (note,) = found.notes
    assert "taken for free; if it is unknown, set free_thresh: 0.196" in note or not free
    file.write_text(file.read_text().replace("0.3", "0.196"))
    assert not load_map_server(file).notes


def test_specks_of_unknown_cells_are_free_and_told(tmp_path):
    level = np.full((100, 100), 254, dtype=np.uint8)
    level[5:95:10, 5:95:10] = 205  # 81 of one cell
    level[50:52, 50:52] = 205  # 10 cm a side
    level[70:73, 70:73] = 205  # 15 cm a side: it stays
    level[20, 22] = 0  # the leg of a table: it stays
    level[0, :50] = 205  # the edge of what was seen
    Image.fromarray(level[::-1]).save(tmp_path / "map.png")
    file = tmp_path / "map.yaml"
    file.write_text("image: map.png\nresolution: 0.05\nfree_thresh: 0.196\n")
    found = load_map_server(file)
    assert found.notes == ("82 specks of unknown cells within free space taken for free",)
    expected = np.ones((100, 100), dtype=bool)
    expected[70:73, 70:73] = expected[20, 22] = expected[0, :50] = False
    np.testing.assert_array_equal(found.free, expected)


CLOSED = "0,0,6,0\n6,0,6,4\n6,4,0,4\n0,4,0,0\n"


@pytest.mark.parametrize("seed", range(5))
def test_a_closed_building_is_begun_inside_and_an_open_one_anywhere(tmp_path, seed):
    file = tmp_path / "room.vectormap.txt"
    file.write_text(CLOSED)
    x, y, _ = load_map(file, 0.2, 1.0, None, seed).start
    assert 0.0 < x < 6.0
    assert 0.0 < y < 4.0
    # A cupboard within is not the building, though it is all that is shut.
    file.write_text("0,0,4,0\n6,0,6,4\n6,4,0,4\n0,4,0,0\n3,0,3,2\n" + "1,2,2,2\n2,2,2,3\n2,3,1,3\n1,3,1,2\n")
    x, y, _ = load_map(file, 0.2, 1.0, None, seed).start
    assert not (1.0 < x < 2.0 and 2.0 < y < 3.0)


def test_slanted_walls_become_straight_and_stay_within_a_cell(tmp_path):
    rows, columns = np.mgrid[0:200, 0:200]
    free = (columns > 10) & (rows > 10) & (rows + 0.3 * columns < 150)
    walls = load_map_server(write_grid(tmp_path, free)).walls
    assert len(walls) < 20
    assert area(walls)[0] == pytest.approx(free.sum() * 0.01, rel=0.02)


def test_blocks_that_touch_at_a_corner_are_kept_apart():
    free = np.zeros((8, 8), dtype=bool)
    free[1:4, 1:4] = free[4:7, 4:7] = True
    assert sorted(len(line) for line in borders(free)) == [13, 13]


def test_unknown_cells_are_walls_and_specks_keep_their_width(tmp_path):
    shade = np.full((20, 20), 254, dtype=np.uint8)
    shade[:, 10:] = 205
    shade[10, 5] = 0
    file = write_grid(tmp_path, shade == 254)
    Image.fromarray(shade).save(tmp_path / "map.pgm")
    walls = load_map_server(file).walls
    assert len(walls) == 4 + 4
    assert area(walls) == pytest.approx([1.0 * 2.0 - 0.1 * 0.1, 0.1 * 0.1])


def test_sixteen_bits_a_pixel_are_read_as_eight_are(tmp_path):
    free = np.ones((6, 9), dtype=bool)
    free[2:4, 3:5] = False
    file = write_grid(tmp_path, free)
    walls = load_map_server(file).walls
    shade = np.asarray(Image.open(tmp_path / "map.pgm"), dtype=np.uint16) * 257
    Image.fromarray(shade).save(tmp_path / "map.png")
    file.write_text(file.read_text().replace("map.pgm", "map.png"))
    np.testing.assert_array_equal(load_map_server(file).walls, walls)


def test_transparent_pixels_are_unknown(tmp_path):
    pixels = np.full((5, 8, 4), 255, dtype=np.uint8)
    pixels[:, 4:, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text("image: map.png\nresolution: 1.0\norigin: [0, 0, 0]\n")
    assert area(load_map_server(tmp_path / "map.yaml").walls) == [20.0]
    pixels[:, :, 3], pixels[2, :] = 0, [0, 0, 0, 255]  # black lines on nothing
    Image.fromarray(pixels).save(tmp_path / "map.png")
    with pytest.raises(WorldError) as error:
        load_map_server(tmp_path / "map.yaml")
    assert str(error.value) == (
        f"{tmp_path / 'map.yaml'}: image: {tmp_path / 'map.png'} has no free space, for what is transparent is "
        "unknown; give it a white ground"
    )


def test_bad_map_server_files_are_refused_in_one_line(tmp_path):
    file = tmp_path / "map.yaml"

    def message(text: str) -> str:
        file.write_text(text)
        with pytest.raises(WorldError) as error:
            load_map_server(file)
        return str(error.value)

    good = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"
    assert message("resolution: 0.1") == (
        f"{file}: image: missing; a map_server file names its image, for example image: map.pgm"
    )
    assert message(good) == f"{file}: image: {tmp_path / 'map.pgm'} does not exist"
    (tmp_path / "map.pgm").write_bytes(b"P5\n10 10\n255\nshort")
    assert message(good).startswith(f"{file}: image: {tmp_path / 'map.pgm'} is not a readable image: ")
    (tmp_path / "map.pgm.gz").write_bytes(b"not gzip")
    assert message(good.replace("pgm", "pgm.gz")).startswith(f"{file}: image: {tmp_path / 'map.pgm.gz'} is not a read")
    Image.fromarray(np.zeros((5, 5), dtype=np.uint8)).save(tmp_path / "map.pgm")
    assert message(good) == f"{file}: no free space in the image; check negate and free_thresh"
    assert message(good + "free_thresh: 196\n") == (
        f"{file}: free_thresh: must be greater than 0 and at most 1, is 196"
    )
    assert message(good.replace("0.1", "-0.1")) == (
        f"{file}: resolution: must be greater than 0 metres per cell, is -0.1"
    )
    assert message(good.replace("0.1", "fine")) == f"{file}: resolution: expected a number, found 'fine'"
    assert message(good.replace("resolution: 0.1\n", "")) == f"{file}: resolution: expected a number, missing"
    assert message(good.replace("0, 0]", "0, 90]")) == (
        f"{file}: origin: 90 rad is more than a turn; write radians, not degrees"
    )
    assert message(good.replace("[0, 0, 0]", "[0, 0]")) == (
        f"{file}: origin: expected [x, y, yaw] of the image's lower left corner, found [0, 0]"
    )
    assert message(good + "negate: '0'") == f"{file}: negate: expected 0 or 1, found '0'"
    assert message(good + "mode: raw") == f"{file}: mode: expected trinary or scale, found 'raw'"
    assert message("image: [").startswith(f"{file}: cannot be read: ")


def test_vectormap_has_a_fence_and_drops_walls_of_zero_length(tmp_path, caplog):
    file = tmp_path / "room.vectormap.txt"
    file.write_text("# a room, m\n 0,0, 4,0\n4,0,4,3  # with a door\n\n#4,0,9,9\n2,2,2,2\n4,3,0,3\n")
    walls, dropped = load_vectormap(file)
    assert dropped == 1
    np.testing.assert_allclose(walls[:3], [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3]])
    np.testing.assert_allclose(walls[3:], [[-1, -1, 5, -1], [5, -1, 5, 4], [5, 4, -1, 4], [-1, 4, -1, -1]])
    with caplog.at_level(logging.WARNING):
        load_map(file, 0.18, None, (2.0, 1.0, 0.0), 0)
    assert caplog.messages == [f"{file}: dropped 1 walls of zero length"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0,1,0\n1,2,3\n", "{file}: line 2: expected x0,y0,x1,y1 in metres, found '1,2,3'"),
        ("0,0,1,a\n", "{file}: line 1: expected x0,y0,x1,y1 in metres, found '0,0,1,a'"),
        ("0,0,1,nan\n", "{file}: line 1: expected x0,y0,x1,y1 in metres, found '0,0,1,nan'"),
        ("\n", "{file}: no walls in it; expected lines of x0,y0,x1,y1 in metres"),
        ("#0,0,1,0\n", "{file}: no walls in it; expected lines of x0,y0,x1,y1 in metres"),
        ("0,0,1,0\n1,2 # 3,4\n", "{file}: line 2: expected x0,y0,x1,y1 in metres, found '1,2'"),
    ],
)
def test_bad_vectormaps_are_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "bad.vectormap.txt"
    file.write_text(text)
    with pytest.raises(WorldError) as error:
        load_vectormap(file)
    assert str(error.value) == message.format(file=file)


def test_the_start_is_drawn_from_the_seed_in_the_region_with_the_most_wall():
    small = [[0, 0, 2, 0], [2, 0, 2, 2], [2, 2, 0, 2], [0, 2, 0, 0]]
    large = [[10, 0, 16, 0], [16, 0, 16, 5], [16, 5, 10, 5], [10, 5, 10, 0]]
    walls = np.array(small + large, dtype=float)
    starts = np.array([draw_start(walls, 0.18, seed) for seed in range(20)])
    assert (starts[:, 0] > 10.2).all()
    assert len(np.unique(starts, axis=0)) == 20
    np.testing.assert_array_equal(draw_start(walls, 0.18, 3), starts[3])
    with pytest.raises(WorldError, match="no free space inside the walls for a robot of radius 3 m; check the scale"):
        draw_start(walls, 3.0, 0)
    np.testing.assert_array_equal(draw_start(np.zeros((0, 4)), 0.18, 0), np.zeros(3))


def test_a_start_in_a_solid_block_of_a_grid_is_neither_drawn_nor_accepted(tmp_path):
    free = np.zeros((120, 120), dtype=bool)
    free[5:115, 5:115] = True
    free[10:110, 10:110] = False
    free[45:75, 112:115] = False
    file = write_grid(tmp_path, free)
    with pytest.raises(WorldError) as error:
        load_map(file, 0.18, None, (6.0, 6.0, 0.0), 0)
    assert str(error.value) == f"{file}: world.start: (6, 6) is not in a free cell of the map; start elsewhere"
    starts = np.array([load_map(file, 0.18, None, None, seed).start for seed in range(5)])
    assert not ((starts[:, :2] > 1.0) & (starts[:, :2] < 11.0)).all(axis=1).any()


def test_load_map_complains_in_one_line(tmp_path):
    with pytest.raises(WorldError) as error:
        load_map(tmp_path / "none.yaml", 0.18, None, None, 0)
    assert str(error.value) == f"{tmp_path / 'none.yaml'}: no such file"
    (tmp_path / "plan.dxf").write_text("")
    with pytest.raises(WorldError) as error:
        load_map(tmp_path / "plan.dxf", 0.18, None, None, 0)
    assert str(error.value) == (
        f"{tmp_path / 'plan.dxf'}: unknown kind of map; give a scenario or map_server .yaml or a *.vectormap.txt"
    )
    file = tmp_path / "room.vectormap.txt"
    file.write_text("0,0,4,0\n4,0,4,3\n4,3,0,3\n0,3,0,0\n")
    with pytest.raises(WorldError) as error:
        load_map(file, 0.18, 1.0, (0.1, 1.0, 0.0), 0)
    assert str(error.value) == (
        f"{file}: world.start: (0.1, 1) is too near to the wall from (0, 3) to (0, 0): 0.100 m, the robot's radius is"
        " 0.18 m; start at (0.3, 1), the nearest free place"
    )


def test_furnish_replaces_only_what_is_given(tmp_path):
    file = tmp_path / "room.vectormap.txt"
    file.write_text("0,0,4,0\n4,0,4,3\n4,3,0,3\n0,3,0,0\n")
    bare = load_map(file, 0.18, None, (2.0, 1.0, 0.0), 0)
    assert len(bare.tag_ids) == 0
    tagged = furnish(bare, 0.18, 1.0, None)
    assert len(tagged.tag_ids) == 14
    moved = furnish(tagged, 0.18, None, (1.0, 1.0, 0.5))
    np.testing.assert_array_equal(moved.p_WT, tagged.p_WT)
    np.testing.assert_array_equal(moved.start, [1.0, 1.0, 0.5])


@pytest.mark.skipif(not REAL_MAPS.is_dir(), reason="the real buildings' maps are not beside the repository")
@pytest.mark.parametrize(
    ("name", "most_walls", "least_tags"),
    [
        ("Joydeepb-Home.vectormap.txt", 100, 60),
        ("LGRC1.vectormap.txt", 200, 400),
        ("NSHA.vectormap.txt", 1100, 400),
        pytest.param("GDC3.vectormap.txt", 6500, 600, marks=pytest.mark.slow),
        ("building_31.yaml", 5000, 200),
        pytest.param("willow-2010-02-18-0.10.yaml", 5500, 300, marks=pytest.mark.slow),
    ],
)
def test_real_buildings_load(name, most_walls, least_tags):
    world = load_map(REAL_MAPS / name, 0.18, 2.0, None, 0)
    check_world(world, 0.18)
    assert len(world.walls) <= most_walls
    assert len(world.tag_ids) >= least_tags

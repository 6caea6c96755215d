"""Bad maps of buildings: every one is refused in one line, before it takes time or memory."""

import gzip
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from PIL import Image

from tests.mutations import assert_refused_or_read
from tests.world.test_load import write_grid
from tfg_drake.world.load import load_map
from tfg_drake.world.world import WorldError

ROOM = np.pad(np.ones((20, 30), dtype=bool), 2)


def load(file):
    return load_map(file, 0.2, 1.0, None, 0)


def complaint(file):
    """The one line that refuses a map, and MB of memory that it took to say so."""
    tracemalloc.start()
    with pytest.raises(WorldError) as error:
        load(file)
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    assert "\n" not in str(error.value)
    return str(error.value).replace(str(file.parent), "DIR"), peak


@pytest.mark.parametrize("name", ["map.pgm", "map.pgm.gz", "map.png"])
def test_a_mutated_image_is_refused_or_read(tmp_path, name):
    file = write_grid(tmp_path, ROOM, name)
    assert_refused_or_read(tmp_path / name, lambda: load(file), WorldError)


def test_a_mutated_map_file_is_refused_or_read(tmp_path):
    file = write_grid(tmp_path, ROOM)
    assert_refused_or_read(file, lambda: load(file), WorldError)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["map.yaml", "map.pgm", "map.pgm.gz", "map.png"])
def test_many_mutated_maps_are_refused_or_read(tmp_path, name):
    file = write_grid(tmp_path, ROOM, "map.pgm" if name == "map.yaml" else name)
    assert_refused_or_read(tmp_path / name, lambda: load(file), WorldError, count=1000, seed=1)


def test_a_mutated_vectormap_is_refused_or_read(tmp_path):
    file = tmp_path / "room.vectormap.txt"
    file.write_text("0,0,6,0\n6,0,6,4\n6,4,0,4\n0,4,0,0\n2,0,2,1.5\n4,4,4,2.5\n")
    assert_refused_or_read(file, lambda: load(file), WorldError, count=100)


@pytest.mark.parametrize("at", [12, 30, -9])
def test_a_broken_gzip_file_is_one_line(tmp_path, at):
    file = write_grid(tmp_path, ROOM, "map.pgm.gz")
    data = bytearray((tmp_path / "map.pgm.gz").read_bytes())
    data[at] ^= 0xFF
    (tmp_path / "map.pgm.gz").write_bytes(data)
    assert complaint(file)[0].startswith("DIR/map.yaml: image: DIR/map.pgm.gz is not a readable image: ")


def huge_png(side):
    """A white PNG of side x side cells, one bit each, made without them."""

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    squeeze = zlib.compressobj(9)
    row = b"\0" + b"\xff" * ((side + 7) // 8)
    pixels = b"".join(squeeze.compress(row) for _ in range(side)) + squeeze.flush()
    header = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "contents"),
    [
        ("map.png", huge_png(5001)),
        ("map.png", huge_png(13000)),
        ("map.pgm.gz", gzip.compress(b"P5\n48000 48000\n255\n")),
        ("map.pgm.gz", gzip.compress(b"P5\n9000 9000\n255\n" + bytes(100_000_000))),
    ],
    ids=["png of 25 million", "png of 169 million", "pgm without cells", "pgm of zeros"],
)
def test_an_image_of_too_many_cells_is_refused_before_it_is_unpacked(tmp_path, name, contents):
    file = write_grid(tmp_path, ROOM, name)
    (tmp_path / name).write_bytes(contents)
    line, peak = complaint(file)
    assert line == (
        f"DIR/map.yaml: image: DIR/{name} has more than 25000000 cells; crop it to the building, or make its cells"
        " larger"
    )
    assert peak < 20


def test_what_follows_the_cells_is_not_unpacked(tmp_path):
    file = write_grid(tmp_path, ROOM, "map.pgm.gz")
    image = (tmp_path / "map.pgm").read_bytes()
    (tmp_path / "map.pgm.gz").write_bytes(gzip.compress(image + bytes(200_000_000)))
    tracemalloc.start()
    assert len(load(file).walls) == 4
    assert tracemalloc.get_traced_memory()[1] < 20 * 2**20
    tracemalloc.stop()


def test_an_image_that_is_no_plan_is_one_line(tmp_path):
    file = write_grid(tmp_path, ROOM)
    Image.fromarray((255 * np.random.default_rng(0).integers(0, 2, (600, 600))).astype(np.uint8)).save(
        tmp_path / "map.pgm"
    )
    line, _ = complaint(file)
    assert line.startswith("DIR/map.yaml: image: ")
    assert line.endswith(" sides of its cells are wall, at most 200000 are read; is it a map of walls?")


@pytest.mark.parametrize(
    ("walls", "line"),
    [
        ("0,0,6,0\n5521,0,6,4\n", "the walls extend over 5521 x 4 m, the farthest to (5521, 0); check their unit"),
        ("0,0,600,0\n600,0,600,400\n", "the walls extend over 600 x 400 m, the farthest to (0, 0); check their unit"),
        ("0,0,6,0\n6,0,1e300,4\n", "a wall ends at (1e+300, 4), too far from the origin; check its unit and that"),
        ("-1e308,0,1e308,0\n", "a wall ends at (-1e+308, 0), too far from the origin; check its unit and that"),
    ],
)
def test_a_stray_coordinate_is_one_line(tmp_path, walls, line):
    file = tmp_path / "room.vectormap.txt"
    file.write_text(walls)
    message, peak = complaint(file)
    assert message.startswith(f"DIR/room.vectormap.txt: {line}")
    assert peak < 20

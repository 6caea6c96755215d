import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from tfg_drake.messages import GridMap, replace
from tfg_drake.pictures.figure import draw_known, draw_map, run_figure
from tfg_drake.pictures.figure_file import write_figure
from tfg_drake.world.world import World

WORLD = World(
    walls=np.array([[0.0, 0.0, 6.0, 0.0], [6.0, 0.0, 6.0, 4.0]]),
    tag_ids=np.array([4, 7]),
    p_WT=np.array([[1.0, 0.0], [3.0, 0.0]]),
    tag_facing=np.full(2, np.pi / 2),
    start=np.array([1.0, 1.0, 0.0]),
)


def test_draws_a_run_that_has_not_begun(tmp_path):
    nothing = np.zeros((0, 3))
    write_figure(
        tmp_path / "f.png", run_figure("nothing yet", WORLD, None, None, None, nothing, nothing, np.ones(2, dtype=bool))
    )
    image = Image.open(io.BytesIO((tmp_path / "f.png").read_bytes()))
    assert image.width == 1760
    # The missed tags are red.
    pixels = np.asarray(image.convert("RGB")).astype(int)
    assert np.any((pixels[..., 0] > 180) & (pixels[..., 1] < 70) & (pixels[..., 2] < 70))


def test_draws_a_grid_that_holds_no_scan_yet(tmp_path):
    nothing, grid = np.zeros((0, 3)), GridMap(0, 0.0, 0.05, np.zeros(2), np.zeros((0, 0), dtype=np.float32))
    write_figure(
        tmp_path / "f.png", run_figure("no scan", WORLD, None, None, grid, nothing, nothing, np.ones(2, dtype=bool))
    )
    assert (tmp_path / "f.png").exists()


def test_the_same_run_gives_the_same_file(tmp_path):
    poses = np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [2.0, 2.0, 1.0]])
    for name in ("a.png", "b.png"):
        write_figure(
            tmp_path / name, run_figure("twice", WORLD, None, None, None, poses, poses + 0.01, np.zeros(2, dtype=bool))
        )
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def like(path, colour, tolerance=8):
    """How many pixels of a picture have a colour, more or less."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    return int(np.count_nonzero(np.all(np.abs(pixels - colour) < tolerance, axis=-1)))


def test_the_true_path_is_seen_where_the_estimated_one_is_the_same(tmp_path):
    poses, blue, yellow = np.array([[1.0, 1.0, 0.0], [4.0, 1.0, 0.0]]), [26, 56, 107], [250, 204, 64]
    counts = []
    for truth in (np.zeros((0, 3)), poses):
        figure = run_figure("path", WORLD, None, None, None, poses, truth, np.zeros(2, dtype=bool))
        write_figure(tmp_path / "f.png", figure)
        counts.append([like(tmp_path / "f.png", colour) for colour in (blue, yellow)])
    (alone, none), (under, over) = counts
    assert none == 0
    assert over > 300
    assert under > 0.4 * alone


@pytest.mark.parametrize(
    ("sigma", "said", "radius"), [(0.01, "tag, 3\u03c3 \u00d7 10", 0.3), (0.1, "tag, 3\u03c3", 0.3)]
)
def test_small_ellipses_are_magnified_and_it_says_so(small_map, sigma, said, radius):
    figure = Figure()
    axes, blocks = figure.add_subplot(), np.tile(sigma**2 * np.eye(2), (4, 1, 1))
    known = replace(small_map, graph=replace(small_map.graph, landmark_covariance=blocks))
    draw_known(axes, np.zeros(3), known, None, None, 2.0)
    (dots,), (rings,) = axes.lines, axes.collections
    assert (dots.get_label(), rings.get_label()) == ("tag", said)
    assert rings.get_zorder() > dots.get_zorder()
    for path, p in zip(rings.get_paths(), small_map.p_ML, strict=True):
        np.testing.assert_allclose(np.hypot(*(path.vertices - p).T), 0.3, rtol=1e-6)


def test_draws_a_saved_map(tmp_path, small_map):
    for name in ("a.png", "b.png", "a.pdf", "b.pdf"):
        draw_map(tmp_path / name, "a map", small_map)
    for suffix in (".png", ".pdf"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    # The frontier is blue, the free space a light green.
    assert np.any((pixels[..., 0] < 60) & (pixels[..., 2] > 200))
    assert np.any(np.all(pixels == [0xF4, 0xF6, 0xF1], axis=-1))


def test_doubtful_landmarks_have_a_colour_of_their_own(tmp_path, small_map):
    def violet(saved):
        draw_map(tmp_path / "f.png", "a map", saved)
        pixels = np.asarray(Image.open(tmp_path / "f.png").convert("RGB")).astype(int)
        return int(np.count_nonzero(np.all(np.abs(pixels - [0xA3, 0x2E, 0xA8]) < 8, axis=-1)))

    assert violet(small_map) == 0
    assert violet(replace(small_map, doubtful=small_map.ids[:1])) > 20


def test_walls_that_are_landmarks_have_a_colour_of_their_own(tmp_path, small_map, walled_map):
    def tinted(saved):
        """Pixels of the line and of the band, as large as it is where nothing else lies over it."""
        draw_map(tmp_path / "f.png", "a map", saved)
        pixels = np.asarray(Image.open(tmp_path / "f.png").convert("RGB")).astype(float)
        line, free = np.array([107, 41, 209]), np.array([244, 246, 241])
        return [
            np.count_nonzero(np.all(np.abs(pixels - colour) < 4, axis=-1)) for colour in (line, 0.3 * line + 0.7 * free)
        ]

    assert tinted(small_map) == [0, 0]
    line, band = tinted(walled_map)
    assert line > 100
    assert band > 1000


def test_limits_hold_all_that_is_drawn(walled_map):
    """Both the way and a wall's deviation lead out of the world."""
    way = np.array([[1.0, 1.0, 0.0], [9.0, 1.0, 0.0]])
    figure = run_figure("out", WORLD, None, None, None, way, with_walls=walled_map.graph, X_WM=np.zeros(3))
    (axes,) = figure.axes
    drawn = [line.get_xydata() for line in axes.lines]
    drawn += [path.vertices for one in axes.collections for path in one.get_paths()]
    (x, y), (left, right), (bottom, top) = np.vstack(drawn).T, axes.get_xlim(), axes.get_ylim()
    assert left <= x.min() < x.max() == 9.0 <= right
    assert bottom <= y.min() < 5.0 < y.max() <= top


def test_a_run_shows_them_too(walled_map):
    nothing = np.zeros((0, 3))
    arguments = ("walls", WORLD, None, None, None, nothing, nothing, np.zeros(2, dtype=bool), np.zeros(3))

    def labels(figure):
        return [text.get_text() for text in figure.legends[0].get_texts()]

    assert set(labels(run_figure(*arguments, walled_map.graph))) - set(labels(run_figure(*arguments))) == {
        "wall (landmark)",
        "wall, 3\u03c3",
    }

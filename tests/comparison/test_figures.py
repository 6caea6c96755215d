import numpy as np
import pytest
from PIL import Image

from tfg_drake.comparison.curves import Curve, band
from tfg_drake.comparison.figures import FinalMap, colours, draw_costs, draw_coverage, draw_errors, draw_maps
from tfg_drake.comparison.statistics import spread
from tfg_drake.messages import GridMap
from tfg_drake.pictures.figure_file import write_formats
from tfg_drake.pictures.palette import LIGHT
from tfg_drake.world.world import World

WORLD = World(
    walls=np.array([[0.0, 0.0, 6.0, 0.0], [6.0, 0.0, 6.0, 4.0]]),
    tag_ids=np.zeros(0, dtype=np.int64),
    p_WT=np.zeros((0, 2)),
    tag_facing=np.zeros(0),
    start=np.array([1.0, 1.0, 0.5 * np.pi]),
)


def test_methods_have_colours_of_their_own():
    found = colours(["tfg", "mine", "grid-nearest", "yours"])
    assert len({found[name] for name in ("tfg", "mine", "grid-nearest", "yours")}) == 4
    assert colours(["tfg"])["tfg"] == found["tfg"]


@pytest.mark.parametrize("factor", [1.0, 100.0])
def test_bands_of_any_size_are_drawn(factor):
    curve = Curve(np.arange(3.0), np.array([0.1, 0.2, 0.1]))
    bands = {"a": band([curve], 1.0), "b": band([Curve(curve.x, factor * curve.y)], 1.0)}
    figure = draw_errors(bands, bands)
    assert figure.axes[0].get_yscale() == ("log" if factor > 10.0 else "linear")
    assert draw_coverage(bands).axes[0].get_yscale() == "linear"


def test_a_robot_that_stands_has_no_error_on_a_logarithmic_scale():
    curve = Curve(np.arange(3.0), np.array([0.0, 0.2, 0.1]))
    bands = {"a": band([curve], 1.0), "b": band([Curve(curve.x, 100.0 * curve.y)], 1.0)}
    assert [np.isnan(line.get_ydata()).any() for line in draw_errors(bands, bands).axes[0].lines[::2]] == [True, True]


def test_a_grid_is_turned_into_the_world(tmp_path, small_map):
    probability = np.full((40, 60), 0.5, dtype=np.float32)
    probability[:, -2:] = 1.0  # the far end in x of M, which is the top in W
    grid = GridMap(stage=1, stamp=0.0, resolution=0.05, origin=np.array([0.0, -1.0]), probability=probability)
    nothing = np.zeros((0, 3))
    way = np.array([[1.0, 1.0, 0.0], [3.0, 1.0, 0.0]])
    maps = [FinalMap("grid", 0, WORLD, nothing, None, grid), FinalMap("tfg", 0, WORLD, way, small_map, None)]
    figure = draw_maps(maps)
    png, _ = write_formats(tmp_path, "maps", figure)
    legend = figure.legends[0].get_window_extent()
    names = [one.get_text() for one in figure.legends[0].texts]
    assert {"true wall", "occupied cell", "mapped surface", "frontier", "tag"} < set(names)
    assert figure.bbox.x0 <= legend.x0 < legend.x1 <= figure.bbox.x1
    image = np.asarray(Image.open(png).convert("RGB")).astype(int)
    occupied = np.rint(255.0 * np.array(LIGHT.edge))
    rows, columns = np.nonzero((image == occupied).all(axis=2)[:, : image.shape[1] // 2])
    body = rows < 0.5 * image.shape[0]
    assert np.ptp(columns[body]) > 4 * np.ptp(rows[body][rows[body] > np.percentile(rows[body], 30)])


def test_what_is_missing_has_no_bar():
    costs = {"map (kB)": {"a": spread(np.array([10.0])), "b": spread(np.zeros(0)), "c": spread(np.array([2000.0]))}}
    (axes,) = draw_costs(costs).axes
    assert axes.get_xscale() == "log"
    assert [text.get_text() for text in axes.texts] == ["10", "", "2,000", "-"]

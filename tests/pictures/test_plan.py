import dataclasses
import re
from xml.etree import ElementTree

import numpy as np

from tfg_drake.mapfile.in_world import landmarks_in_world, stars_of, tfg_in_world
from tfg_drake.pictures.plan import plan_svg
from tfg_drake.tfg.graph import empty_map

SVG = "{http://www.w3.org/2000/svg}"


def polylines(path):
    return [np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", line), dtype=float) for line in path.get("d").split("M")[1:]]


def test_the_plan_is_the_map_to_scale(small_map):
    root, tfg, (p_WL, _) = (
        ElementTree.fromstring(plan_svg(small_map)),
        tfg_in_world(small_map),
        landmarks_in_world(small_map),
    )
    x, y, width, height = map(float, root.get("viewBox").split())
    # A metre is a centimetre; y is up in the world and down in the picture.
    assert (root.get("width"), root.get("height")) == (f"{10.0 * width:.2f}mm", f"{10.0 * height:.2f}mm")
    shown = np.vstack([p_WL, tfg.segments.reshape(-1, 2), tfg.star_vertices])
    low, high = np.array([x, -y - height]), np.array([x + width, -y])
    assert np.all((shown > low + 1.0 - 1e-3) & (shown < high - 1.0 + 1e-3))
    parts = {part.get("id"): part for part in root if part.get("id")}
    assert set(parts) == {
        *("free_space", "edge", "wall_end", "bare_surface", "keep_out", "frontier", "wall_landmark"),
        *("landmark", "doubtful", "wall_landmark_3sigma", "landmark_3sigma", "doubtful_3sigma", "scale"),
    }
    down = np.array([1.0, -1.0])
    for found, star, centre in zip(polylines(parts["free_space"][0]), stars_of(tfg), tfg.star_centers, strict=True):
        np.testing.assert_allclose(found, np.vstack([centre, star, star[:1]]) * down, atol=1e-3)
    for kind, name in enumerate(("edge", "wall_end", "bare_surface")):
        pieces = tfg.segments[tfg.segment_kind == kind].reshape(-1, 2, 2) * down
        np.testing.assert_allclose(polylines(parts[name][0]), pieces, atol=1e-3)
    dots = [(float(dot.get("cx")), float(dot.get("cy"))) for dot in parts["landmark"].iter(f"{SVG}circle")]
    np.testing.assert_allclose(dots, p_WL * down, atol=1e-3)
    assert [text.text for text in parts["landmark"].iter(f"{SVG}text")] == ["10", "11", "12", "13"]
    assert "h5" in parts["scale"].get("d")


def test_walls_that_are_landmarks_are_in_the_plan(walled_map):
    root = ElementTree.fromstring(plan_svg(walled_map))
    (wall,) = (part for part in root if part.get("id") == "wall_landmark")
    # From (1, 1) to (4, 5) in M.
    np.testing.assert_allclose(polylines(wall[0]), [[[4.0, -4.0], [0.0, -7.0]]], atol=1e-3)


def test_a_map_of_tags_alone_has_a_plan(small_map):
    root = ElementTree.fromstring(plan_svg(dataclasses.replace(small_map, tfg=empty_map())))
    assert len(list(root.iter(f"{SVG}text"))) == 5

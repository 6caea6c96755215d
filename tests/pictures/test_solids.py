"""Layers as solids, and solids as an OBJ file."""

import itertools

import numpy as np
import pytest

from tfg_drake.pictures.drawing import circles
from tfg_drake.pictures.layers import LOOKS, Layer, Look, layers
from tfg_drake.pictures.solids import numerals, wavefront

BLUE = (0.0, 0.5, 1.0)


@pytest.fixture
def looks(monkeypatch):
    """Looks of layers of a test's own, by their names."""
    return lambda **looks: [monkeypatch.setitem(LOOKS, name, look) for name, look in looks.items()]


def drawn(record, arrays, sigmas=3.0):
    return {one.name: one for one in layers(record, arrays, sigmas)}


def read(obj):
    """Vertices (n, 3) and of each material its triangles, as fans of polygons."""
    vertices, faces = [], {}
    for word, *rest in (line.split() for line in obj.splitlines()):
        if word == "v":
            vertices.append([float(number) for number in rest])
        elif word == "usemtl":
            triangles = faces.setdefault(rest[0], [])
        else:
            a, *others = (int(number) - 1 for number in rest)
            triangles += [(a, b, c) for b, c in itertools.pairwise(others)]
    return np.array(vertices), {name: np.array(some) for name, some in faces.items()}


def areas(vertices, triangles):
    """Vectors (n, 3), m^2, along the normals of those who see the triangles anticlockwise."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


def test_a_solid_is_closed_but_for_its_bottom_and_faces_outwards(looks):
    looks(box=Look("", BLUE, 2.0, 2.0, stands=True, opacity=0.4))
    obj, materials = wavefront([Layer("box", np.array([[0.0, 0.0, 3.0, 4.0]]))], 0.5)
    vertices, faces = read(obj)
    assert set(faces) == {"box", "box_side"}
    np.testing.assert_allclose(areas(vertices, faces["box"]).sum(axis=0), [0, 0, 6.0], atol=1e-2)
    sides = areas(vertices, faces["box_side"])
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1).sum(), 2.0 * (6.0 + 6.0 + 1.0 + 1.0), rtol=1e-2)
    outwards = vertices[faces["box_side"]].mean(axis=1) - vertices.mean(axis=0)
    assert np.all(np.sum(sides * outwards, axis=1) > 0.0)
    assert sorted(set(vertices[:, 2])) == [0.0, 2.0]
    top, side = (np.array(line.split()[1:], float) for line in materials.splitlines() if line.startswith("Ke"))
    assert np.all(side <= top)
    assert side[2] < top[2]
    assert materials.count("d 0.4") == 2


def test_sheets_have_no_sides_and_nothing_is_nothing(looks):
    looks(sheet=Look("", BLUE, high=0.1))
    vertices, faces = read(wavefront([Layer("sheet", circles(np.zeros((2, 2)), 1.0, 64))], 0.1)[0])
    assert set(faces) == {"sheet"}
    np.testing.assert_allclose(areas(vertices, faces["sheet"]).sum(axis=0)[2], 2.0 * np.pi, rtol=1e-2)
    assert wavefront([], 0.1) == wavefront([Layer("sheet", np.zeros((0, 4, 2)))], 0.1) == ("", "")


def test_free_space_that_is_not_convex_has_its_area():
    star = np.array([[0, 0], [2, 0], [0.2, 0.2], [0, 2], [-0.2, 0.2], [-2, 0], [0, -1]], dtype=float)
    (sheet,) = layers("free", {"points": star, "count": np.array([7])})
    vertices, faces = read(wavefront([sheet], 0.1)[0])
    found = areas(vertices, faces["free_space"])
    assert np.all(found[:, 2] > 0.0)
    x, y = star[1:].T
    exact = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert found[:, 2].sum() == pytest.approx(exact, rel=1e-3)


def test_surfaces_stand_by_kind_and_doubtful_landmarks_apart():
    segments = np.array([[0, 0, 1, 0], [1, 0, 1, 3], [5, 5, 6, 6], [7, 7, 8, 7]], dtype=float)
    shown = drawn("tfg", {"segments": segments, "kind": np.array([0, 2, 2, 3])})
    counts = {name: len(one.shapes) for name, one in shown.items()}
    assert counts == {"edge": 1, "wall_end": 0, "bare_surface": 2, "keep_out": 1}
    assert all(one.look.stands and one.look.high > 0.0 for one in shown.values())

    covariance = np.array([[1e-4, 0.0, 1e-4], [0.04, 0.0, 0.04]])
    arrays = {"points": segments[:2, :2], "covariance": covariance, "doubtful": np.array([True, False])}
    shown = drawn("map", {**arrays, "ids": np.array([7, 12])}, 30.0)
    assert [len(one.shapes) for one in shown.values()] == [1, 1, 1, 1]
    np.testing.assert_array_equal(shown["doubtful"].labels["7"], segments[0, :2])
    # As many deviations as are asked for, above all that could hide them.
    for name, sigma, center in (("doubtful", 0.01, segments[0, :2]), ("landmark", 0.2, segments[1, :2])):
        ellipse = shown[f"{name}_3sigma"]
        np.testing.assert_allclose(np.hypot(*(ellipse.shapes[0] - center).T), 30.0 * sigma)
        assert not ellipse.look.stands
        assert ellipse.look.high > shown[name].look.high


def test_a_wall_that_is_a_landmark_is_a_line_over_the_surfaces_and_a_band_over_that():
    arrays = {"segments": np.array([[0, 0, 4, 0], [5, 5, 6, 5]], dtype=float)}
    arrays["deviation"] = np.array([[0.02, 0.1], [0.001, 0.001]])
    line, band = layers("wall_landmarks", arrays, 30.0)
    assert (len(line.shapes), len(band.shapes)) == (2, 2)
    assert not band.look.stands
    assert band.look.high > line.look.high > LOOKS["edge"].high
    vertices, faces = read(wavefront([band], 0.1)[0])
    assert areas(vertices, faces[band.name]).sum(axis=0)[2] == pytest.approx(
        30.0 * (4.0 * (0.02 + 0.1) + 0.002), rel=1e-3
    )


def test_numbers_stand_upright_whatever_the_map_is_turned_by():
    """1 has the two bars on the right, 8 all seven; 11 is as wide as two digits, and all are in the middle."""
    places = np.stack([3.0 * np.arange(11), np.ones(11)], axis=1)
    bars = numerals(places, 0.5, 0.0)
    owner = np.argmin(np.abs(bars[:, [0]] - places[:, 0]), axis=1)
    assert np.bincount(owner).tolist() == [2, 5, 5, 4, 5, 6, 3, 7, 6, 2 + 6, 2 + 2]
    ends = bars[owner == 7].reshape(-1, 2) - places[7]
    np.testing.assert_allclose([ends.min(axis=0), ends.max(axis=0)], [[-0.125, -0.25], [0.125, 0.25]])
    one = bars[owner == 0].reshape(-1, 2) - places[0]
    np.testing.assert_allclose(one[:, 0], 0.125)
    turned = numerals(places[:1], 0.5, np.pi / 2).reshape(-1, 2) - places[0]
    np.testing.assert_allclose(turned[:, 1], 0.125)


def test_what_promises_more_is_larger_and_deeper():
    arrays = {"points": np.zeros((3, 2)), "share": np.array([0, 128, 255], dtype=np.uint8)}
    shown = [one for one in layers("gains", arrays) if len(one.shapes)]
    assert [len(one.shapes) for one in shown] == [1, 1, 1]
    radii = [np.hypot(*one.outlines(0.1)[0].T).mean() for one in shown]
    assert radii == sorted(radii)
    assert [sum(one.look.colour) for one in shown] == sorted((sum(one.look.colour) for one in shown), reverse=True)

"""A map in the frame of surveyed tags, or of a plan."""

import dataclasses

import numpy as np
import pytest

from tests.mapfile.test_merge import HERE, ROOM, in_room, saved
from tests.slam.rings import ring
from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.se2 import transform
from tfg_drake.mapfile.landmark_table import landmark_csv
from tfg_drake.mapfile.survey import along_axes, in_plan, in_survey, read_survey
from tfg_drake.world.map_server import OccupancyMap

FIRST_LINE = "its first line must be id,x_m,y_m, and each other have a number for each"
ONCE = "each tag must be in it once, by an integer id, at finite x_m and y_m"
X_WM = np.array([-7.0, 2.0, 2.5])


@pytest.fixture(scope="module")
def ring_map():
    return saved(ring(1, 0.0)[0])


def survey_of(one, tmp_path, scale=1.0, moved=()):
    """The tags of a map where a survey has them if M lies at X_WM, lengths by a scale, some tags moved by 3 m."""
    one = dataclasses.replace(one, X_WM=X_WM)
    path = tmp_path / "surveyed.csv"
    lines = landmark_csv(one).splitlines()
    rows = [line.split(",") for line in lines[1:]]
    text = [f"{r[0]},{scale * float(r[1]) + 3.0 * (int(r[0]) in moved)},{scale * float(r[2])}" for r in rows[::-1]]
    path.write_text("\n".join(["id,x_m,y_m", *text]) + "\n")
    return read_survey(path)


def test_exact_without_noise(ring_map, tmp_path):
    found = in_survey(ring_map, survey_of(ring_map, tmp_path))
    np.testing.assert_allclose(found.saved.X_WM, X_WM, atol=1e-9)
    np.testing.assert_array_equal(found.ids, ring_map.ids)
    assert (found.off.max() < 1e-9, found.is_wrong.any(), abs(found.scale) < 1e-9) == (True, False, True)


def test_a_maps_own_export_is_a_survey(ring_map, tmp_path):
    moved = dataclasses.replace(ring_map, X_WM=X_WM)
    (tmp_path / "map.csv").write_text(landmark_csv(moved))
    np.testing.assert_allclose(in_survey(ring_map, read_survey(tmp_path / "map.csv")).saved.X_WM, X_WM, atol=1e-9)


def test_a_tag_that_looks_wrong_is_told_and_does_not_count(ring_map, tmp_path):
    wrong = int(ring_map.ids[3])
    found = in_survey(ring_map, survey_of(ring_map, tmp_path, moved=[wrong]))
    np.testing.assert_allclose(found.saved.X_WM, X_WM, atol=1e-9)
    np.testing.assert_array_equal(found.ids[found.is_wrong], [wrong])
    assert found.off[found.is_wrong] == pytest.approx(3.0)


def test_the_scale_is_told_not_applied(ring_map, tmp_path):
    found = in_survey(ring_map, survey_of(ring_map, tmp_path, scale=1.002))
    assert found.scale == pytest.approx(1.0 / 1.002 - 1.0, abs=1e-6)
    np.testing.assert_array_equal(found.saved.p_ML, ring_map.p_ML)


def test_two_tags_are_too_few(ring_map, tmp_path):
    survey = survey_of(ring_map, tmp_path)
    few = {name: getattr(survey, name)[:2] for name in ("ids", "p_ML", "landmark_covariance")}
    with pytest.raises(BadInput, match=r"^2 surveyed tags are in the map, too few or too near to each other: survey "):
        in_survey(ring_map, dataclasses.replace(survey, **few))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("id,x,y\n1,2,3\n", FIRST_LINE),
        ("id,x_m,y_m\n1,2\n3,4,5\n", FIRST_LINE),
        ("id,x_m,y_m\n1,2,left\n", FIRST_LINE),
        ("id,x_m,y_m\n1,2,3\n1,4,5\n", ONCE),
        ("id,x_m,y_m\n1.5,2,3\n", ONCE),
        ("id,x_m,y_m\n1,2,nan\n", ONCE),
        (None, "cannot be read: no such file or directory"),
    ],
)
def test_what_is_no_survey_is_refused_in_one_line(tmp_path, text, told):
    path = tmp_path / "surveyed.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadInput) as caught:
        read_survey(path)
    assert str(caught.value) == f"{path}: {told}"


def plan_of(room):
    """A plan in which these walls (w, 4) stand, of cells that are free inside them."""
    walls = np.array(room, dtype=float)
    cell = 0.05
    x, y = np.meshgrid(cell * (np.arange(140) + 0.5) - 0.5, cell * (np.arange(100) + 0.5) - 0.5)
    inside = (x > 0) & (x < 6) & (y > 0) & (y < 4)
    inside &= clearance(np.column_stack([x.ravel(), y.ravel()] * 2), walls, 0.03).reshape(x.shape) >= 0.03
    return OccupancyMap(walls, inside, cell, np.array([-0.5, -0.5, 0.0]), ())


def test_the_walls_of_a_plan_tell_where_the_map_lies():
    found, off = in_plan(in_room(ROOM, range(6), HERE), plan_of(ROOM))
    np.testing.assert_allclose(found.X_WM, HERE, atol=1e-6)
    assert len(off) == len(found.tfg.segments) > 0
    np.testing.assert_allclose(off, 0.0, atol=1e-6)


def test_a_plan_of_something_else_is_refused():
    other = [[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
    with pytest.raises(BadInput, match=r"^the walls of the map fit the plan nowhere, or in several places: align it"):
        in_plan(in_room(ROOM, range(6), HERE), plan_of(other))


@pytest.mark.parametrize("turn", [0.3, -0.7, 1.4])
def test_a_map_is_turned_until_its_walls_lie_along_the_axes(turn):
    askew = dataclasses.replace(in_room(ROOM, range(6), HERE), X_WM=np.array([1.0, 2.0, turn]))
    there = along_axes(askew)
    segments = transform(there.X_WM, there.tfg.segments.reshape(-1, 2)).reshape(-1, 4)
    np.testing.assert_allclose(np.abs(segments[:, 2:] - segments[:, :2]).min(axis=1), 0.0, atol=1e-6)
    assert abs(there.X_WM[2] - turn) <= np.pi / 4
    np.testing.assert_allclose(np.hypot(*there.X_WM[:2]), np.hypot(1.0, 2.0))


def test_a_round_room_has_no_axes():
    corners = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 13)])
    saved = in_room(ROOM, range(6), HERE)
    tfg = dataclasses.replace(saved.tfg, segments=np.hstack([corners[:-1], corners[1:]]))
    with pytest.raises(BadInput, match=r"^the walls of the map lie in all directions: align it by tags or by a plan$"):
        along_axes(dataclasses.replace(saved, tfg=tfg))

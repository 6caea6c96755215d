import base64
import dataclasses
import json
import re
import socket
import sys
import urllib.request

import numpy as np
import pytest
import umsgpack

from tfg_drake.geometry.star import covered_area
from tfg_drake.mapfile.viewer import FREE, ViewerMissing, _stars, scene_page, serve
from tfg_drake.pictures.palette import EDGE


def commands(page):
    (listing,) = re.findall(r"for \(const command of (\[.*?\])\)", page)
    return {"/".join(c["path"].split("/")): c["object"] for c in map(_decode, json.loads(listing))}


def _decode(text):
    return umsgpack.unpackb(base64.b64decode(text))


def vertices(scene):
    return np.frombuffer(scene["geometries"][0]["data"]["attributes"]["position"]["array"].data, np.float32).reshape(
        -1, 3
    )


def test_the_page_shows_the_map_in_the_world(small_map):
    page = scene_page(small_map, "a <map>", [("views", "2")])
    assert "{{" not in page.split("<script>")[0]
    assert "<title>a &lt;map&gt;</title>" in page
    assert "<span>views <b>2</b></span>" in page
    scene = commands(page)
    names = {name.split("map/")[1] for name in scene}
    assert names == {"free", "surfaces/edges", "surfaces/ends", "surfaces/bare", "views", "frontiers", "ellipses",
                     "landmarks"}  # fmt: skip
    by_name = {name.split("map/")[1]: one for name, one in scene.items()}
    assert by_name["surfaces/edges"]["materials"][0]["color"] == int("".join(f"{round(255 * c):02x}" for c in EDGE), 16)
    # M lies at (5, 3), turned by 90 degrees: the frontier at (-2, 0) is at (5, 1).
    np.testing.assert_allclose(vertices(by_name["frontiers"]).mean(axis=0)[:2], [5.0, 1.0], atol=1e-5)
    heights = [vertices(by_name[name])[0, 2] for name in ("free", "surfaces/edges", "views", "frontiers", "landmarks")]
    assert heights == sorted(heights)
    assert len(FREE) == 3


def test_what_is_not_there_is_not_drawn(small_map):
    bare = dataclasses.replace(small_map.tfg, frontiers=np.zeros((0, 2)), frontier_length=np.zeros(0))
    names = commands(scene_page(dataclasses.replace(small_map, tfg=bare), "", []))
    assert not [name for name in names if name.endswith("frontiers")]


def test_stars_as_triangles_have_their_area(small_map):
    tfg = small_map.tfg
    points, faces = _stars(tfg.star_vertices, tfg.star_offsets, tfg.star_centers)
    a, b, c = (points[faces[:, i], :2] for i in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert np.all(doubled > 0.0)
    star = tfg.star_offsets[:2], tfg.star_vertices[:4]
    assert 0.5 * doubled.sum() == pytest.approx(2.0 * covered_area(*star, cell=0.01), rel=1e-3)
    assert len(_stars(np.zeros((0, 2)), np.zeros(1, dtype=np.int64), np.zeros((0, 2)))[1]) == 0


def test_the_page_is_served_to_this_machine_alone():
    with serve("<p>\u03c3</p>") as address, serve("<p>2</p>") as other:
        assert re.fullmatch(r"http://localhost:\d+", address)
        assert address != other
        assert urllib.request.urlopen(address, timeout=10).read().decode() == "<p>\u03c3</p>"
        assert urllib.request.urlopen(other, timeout=10).read().decode() == "<p>2</p>"
        port = int(address.rsplit(":", 1)[1])
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_without_meshcat_it_says_how_to_get_it(small_map, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshcat", None)
    with pytest.raises(ViewerMissing) as caught:
        scene_page(small_map, "", [])
    assert str(caught.value) == "the package meshcat is missing: pip install 'tfg-drake[viewer]'"

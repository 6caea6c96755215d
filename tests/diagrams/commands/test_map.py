import dataclasses
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import urllib.request

import gtsam
import numpy as np
import pytest
import yaml
from PIL import Image

from tests.diagrams.rooms import QUICK_LOOK
from tfg_drake.diagrams.commands.map import FORMATS, OF_GRAPH, OF_TAGS, SUFFIXES
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario
from tfg_drake.geometry.star import covered_area
from tfg_drake.io.extras import pip_install
from tfg_drake.mapfile.saved_map import load_map, save_map
from tfg_drake.messages import replace
from tfg_drake.slam.evidence import Evidence
from tfg_drake.slam.keyframe import without_tags as without_landmarks
from tfg_drake.table import empty

ALIGN_BY = "name one of --tags, --plan and --walls; see tfg-drake map align --help"
INFO = """\
world frame  origin of the map at x 5.000 m, y 3.000 m, heading 1.5708 rad
views        2 turns and glances, the last at 20.2 s
landmarks    4 tags
tags         1\u03c3 {median} m median, {worst} m worst (tag 13)
entropy      {entropy} nats
surfaces     1 on walls or between tags, 2.0 m
             1 that end at a tag, 0.5 m
             1 without a landmark, 1.1 m
free space   {area} m2
frontiers    1 open, 0.4 m
calibration  no range of a tag was compared with a scan
file size    {size} kB
"""


@pytest.fixture
def path(tmp_path, small_map):
    save_map(tmp_path / "map.npz", small_map)
    return tmp_path / "map.npz"


def test_info(call, path, small_map, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = call("map", "info", path)
    assert (code, err) == (0, "")
    median, worst = out.split("\u03c3 ")[1].split(" m median, ")[0], out.split("median, ")[1].split(" m worst")[0]
    assert 0.0 < float(median) <= float(worst) < 0.1
    area = out.split("free space   ")[1].split(" m2")[0]
    assert 6.0 < float(area) < 10.0
    size = round(path.stat().st_size / 1000.0)
    expected = INFO.format(median=median, worst=worst, entropy=f"{small_map.entropy:.1f}", area=area, size=size)
    assert [line.rstrip() for line in out.splitlines()] == expected.splitlines()


def test_walls_that_are_landmarks_are_told(call, tmp_path, walled_map, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    save_map(tmp_path / "map.npz", walled_map)
    code, out, err = call("map", "info", tmp_path)
    assert (code, err) == (0, "")
    lines = [line.rstrip() for line in out.splitlines()]
    assert "landmarks    4 tags, 1 wall" in lines
    assert "walls        1\u03c3 across 0.1600 m median, 0.3000 m worst" in lines


@pytest.mark.parametrize("arguments", [["info", "RUN"], ["export", "RUN", "a.csv"], ["export", "RUN", "a.png"]])
def test_a_runs_folder_stands_for_its_map(call, path, monkeypatch, arguments):
    monkeypatch.chdir(path.parent)
    said = [call("map", *(word.replace("RUN", str(run)) for word in arguments)) for run in (path, path.parent)]
    assert said[0] == said[1]
    assert said[0][0] == 0


def test_export(call, path, tmp_path):
    starts = {
        ".png": b"\x89PNG",
        ".pdf": b"%PDF",
        ".csv": b"id,x_m",
        ".html": b"<!DOCTYPE html>",
        ".g2o": b"VERTEX_SE2",
        ".geojson": b'{"type": "FeatureCollection"',
        ".dxf": b"  0\nSECTION",
        ".svg": b"<svg xmlns=",
        ".json": b'{\n "tags": [',
        ".yaml": b"image: out.pgm\n",
        ".gtsam": b"22 serialization::archive",
    }
    assert starts.keys() == set(SUFFIXES)
    for suffix, start in starts.items():
        out = tmp_path / f"out{suffix}"
        code, said, complaint = call("map", "export", path, out)
        first = out.read_bytes()
        files = [
            out,
            *(out.with_suffix(beside) for beside in {".yaml": [".pgm"], ".gtsam": [".values"]}.get(suffix, [])),
        ]
        size = sum(file.stat().st_size for file in files)
        told = f"{', '.join(map(str, files))}: 4 tags, {size / 1e3:.0f} kB\n"
        assert (code, said, complaint) == (0, told, "")
        assert first.startswith(start)
        assert call("map", "export", path, out) == (0, said, "")
        assert out.read_bytes() == first
    factors, values = gtsam.readG2o(str(tmp_path / "out.g2o"), False)
    assert (factors.size(), values.size()) == (3, 8)
    assert (tmp_path / "out.pgm").read_bytes().startswith(b"P5\n")
    values = gtsam.Values()
    values.deserialize((tmp_path / "out.values").read_text())
    assert values.size() == 8


def test_a_format_is_named_where_the_suffix_is_that_of_several(call, path, tmp_path, small_map):
    out = tmp_path / "tags.yaml"
    sized = ("--tag-size", "0.2", "--tag-height", "1.5")
    assert call("map", "export", path, out, "--format", "tagslam", *sized)[0] == 0
    assert yaml.safe_load(out.read_text())["default_body"] == "map"
    assert call("map", "export", path, out, "--format", "apriltag_ros", *sized)[0] == 0
    tags = yaml.safe_load(out.read_text())["tag_bundles"][0]["layout"]
    assert [(tag["id"], tag["size"], tag["z"]) for tag in tags] == [(tag, 0.2, 1.5) for tag in (10, 11, 12, 13)]


def test_a_grid_of_a_run_with_keep_out_areas_has_a_mask_for_nav2_beside_it(call, path, tmp_path):
    (tmp_path / "scenario.yaml").write_text("explorer: {keep_out: [[[4.5, 3], [5.5, 3], [5.5, 3.5], [4.5, 3.5]]]}\n")
    code, out, err = call("map", "export", path, tmp_path / "plan.yaml")
    files = [tmp_path / name for name in ("plan.yaml", "plan.pgm", "plan_keepout.pgm", "plan_keepout.yaml")]
    size = sum(file.stat().st_size for file in files) / 1e3
    assert (code, out, err) == (0, f"{', '.join(map(str, files))}: 4 tags, {size:.0f} kB\n", "")
    assert yaml.safe_load(files[3].read_text()) == yaml.safe_load(files[0].read_text()) | {"image": "plan_keepout.pgm"}
    barred = np.count_nonzero(np.asarray(Image.open(files[2])) == 0)
    assert 1.0 * 0.5 <= barred * 0.05**2 <= 1.1 * 0.6  # whole cells
    path.rename(tmp_path / "aligned.npz")  # perhaps to another frame
    code, out, _ = call("map", "export", tmp_path / "aligned.npz", tmp_path / "b.yaml")
    assert (code, out.splitlines()[0].partition(": ")[2].partition(",")[0]) == (0, "no keep-out mask")
    assert not (tmp_path / "b_keepout.yaml").exists()


def test_walls_that_only_an_earlier_session_has_seen_are_told(call, finished, tmp_path):
    saved = load_map(finished.folder / "map.npz")
    graph = replace(saved.graph, sessions=np.array([1, 7]))
    last = len(graph.keyframes) - 1
    walls = len(np.setdiff1d(np.setdiff1d(graph.ids, saved.ids), graph.keyframes[last].ids))
    tfg = replace(saved.tfg, segment_ids=np.full_like(saved.tfg.segment_ids, -1))
    save_map(tmp_path / "merged.npz", replace(saved, graph=graph, tfg=tfg))
    graph = replace(graph, view_keyframe=np.full_like(graph.view_keyframe, last))
    save_map(tmp_path / "day2.npz", replace(saved, graph=graph, tfg=tfg))
    told = f"day2.npz: {walls} walls of the known map are not drawn"
    assert walls > 0
    assert told in call("map", "export", tmp_path / "day2.npz", tmp_path / "plan.svg")[1]
    assert told not in call("map", "export", tmp_path / "day2.npz", tmp_path / "graph.g2o")[1]
    assert call("map", "export", tmp_path / "day2.npz", tmp_path / "plan.geojson")[0] == 0
    drawn = (tmp_path / "plan.geojson").read_text().count('"layer": "wall"')
    assert drawn == len(graph.ids) - len(saved.ids) - walls
    for whole in (finished.folder, tmp_path / "merged.npz"):
        assert "not drawn" not in call("map", "export", whole, tmp_path / "whole.svg")[1]


@pytest.mark.slow
def test_what_was_explored_is_explored_again_by_its_grid(call, tmp_path, finished):
    assert call("map", "export", finished.folder, tmp_path / "room.yaml")[0] == 0
    scenario = ApplyWorldFile(LoadScenario(data=QUICK_LOOK), tmp_path / "room.yaml", 1.0, (2.0, 1.5, 0.3))
    summary = run_mission(scenario, name="again", out_dir=tmp_path / "again", record=False).summary
    assert (summary["outcome"], summary["contacts"]) == ("complete", 0)
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"] >= 20
    again = load_map(tmp_path / "again" / "map.npz")
    areas = [covered_area(one.tfg.star_offsets, one.tfg.star_vertices) for one in (again, load_map(finished.folder))]
    # But for the cells that the walls take.
    assert 0.95 < areas[0] / areas[1] < 1.0


@pytest.mark.parametrize(
    ("tags", "simulated", "size"), [("", True, 0.1), ("camera:0", False, 0.3), ("", False, None), (None, True, None)]
)
def test_the_run_says_how_large_its_tags_are(call, path, tmp_path, tags, simulated, size):
    scenario = {"camera": {"tag_size": 0.1}, "hardware": {"tags": tags, "camera": {"tag_size": 0.3}}}
    path.with_name("scenario.yaml").write_text(yaml.safe_dump(scenario) if tags is not None else "base: paper")
    if simulated:
        path.with_name("truth.tum").touch()
    out = tmp_path / "tags.yaml"
    said = call("map", "export", path, out, "--format", "apriltag_ros")
    if size is None:
        ask = "give the side of their black squares, --tag-size M"
        assert said == (2, "", f"tfg-drake: {path}: nothing beside it says how large the tags are; {ask}\n")
    else:
        assert {tag["size"] for tag in yaml.safe_load(out.read_text())["tag_bundles"][0]["layout"]} == {size}


def test_tags_that_are_left_out_are_told(call, tmp_path, small_map):
    facing = small_map.tfg.facing.copy()
    facing[:2] = 0.0
    tfg = dataclasses.replace(small_map.tfg, facing=facing)
    save_map(tmp_path / "map.npz", dataclasses.replace(small_map, tfg=tfg, doubtful=np.array([12])))
    code, said, complaint = call("map", "export", tmp_path, tmp_path / "field.json")
    assert (code, complaint) == (0, "")
    assert said.splitlines()[:-1] == [
        "left out, as it is not known which way they face: tags 10, 11",
        "left out, as they are doubtful: tags 12",
    ]
    none = dataclasses.replace(small_map.tfg, facing=np.zeros_like(facing))
    save_map(tmp_path / "map.npz", dataclasses.replace(small_map, tfg=none))
    told = "has no tag to tell; left out, as it is not known which way they face: tags 10, 11, 12, 13; its walls go to"
    code, said, complaint = call("map", "export", tmp_path, tmp_path / "none.json")
    assert (code, said, (tmp_path / "none.json").exists()) == (2, "", False)
    assert complaint.startswith(f"tfg-drake: {tmp_path / 'map.npz'}: {told} another format")


def without_tags(saved):
    """A map that has walls alone."""
    none = np.empty(0, dtype=np.int64)
    graph = replace(
        saved.graph,
        ids=none,
        p_ML=np.empty((0, 2)),
        anchor=np.empty((0, 2)),
        reach=np.empty((0, 2)),
        landmark_covariance=np.empty((0, 2, 2)),
        keyframes=tuple(without_landmarks(one, one.ids) for one in saved.graph.keyframes),
    )
    names = replace(saved.tfg_graph, tag_ids=none, tag_view=none, tag_facing=np.empty((0, 2)), tag_range=np.empty(0))
    names = replace(names, surfaces=replace(names.surfaces, ids=np.full_like(names.surfaces.ids, -1)))
    tfg = replace(saved.tfg, facing=np.empty((0, 2)), segment_ids=np.full_like(saved.tfg.segment_ids, -1))
    return replace(saved, graph=graph, evidence=empty(Evidence), tfg_graph=names, tfg=tfg)


def test_no_empty_file_is_written(call, tmp_path, small_map):
    """Without tags nothing that has tags alone, without walls either no picture; all the rest has something to say."""
    walls = without_tags(small_map)
    save_map(tmp_path / "walls.npz", walls)
    bare = replace(walls.tfg, segments=np.empty((0, 4)), segment_ids=np.empty((0, 2), dtype=np.int64))
    save_map(tmp_path / "bare.npz", replace(walls, tfg=replace(bare, segment_kind=np.empty(0, dtype=np.int64))))
    for name, (suffix, _, _) in FORMATS.items():
        out = tmp_path / f"out-{name}{suffix}"
        code, _, err = call("map", "export", tmp_path / "walls.npz", out, "--format", name)
        if name in OF_TAGS:
            told = "has no tags; its walls go to another format, such as .dxf, .geojson, .svg or .yaml"
            assert (code, err) == (2, f"tfg-drake: {tmp_path / 'walls.npz'}: {told}\n")
        else:
            assert (code, err) == (0, "")
        assert out.exists() == (name not in OF_TAGS)
        out.unlink(missing_ok=True)
        code, _, err = call("map", "export", tmp_path / "bare.npz", out, "--format", name)
        assert (code, out.exists(), err.count("\n")) == ((0, True, 0) if name in OF_GRAPH else (2, False, 1))


@pytest.mark.parametrize(("suffix", "missing"), [(".geojson", "shapely"), (".dxf", "ezdxf")])
def test_a_missing_package_is_named(call, path, tmp_path, monkeypatch, suffix, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.delitem(sys.modules, f"tfg_drake.mapfile.{suffix[1:]}", raising=False)
    said = call("map", "export", path, tmp_path / f"a{suffix}")
    assert said == (2, "", f"tfg-drake: {missing} is not installed; get it with {pip_install('export')}\n")


def test_a_map_is_not_merged_with_itself(call, path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = call("map", "merge", path, tmp_path, "both.npz")
    told = "2 looks are in both maps, and would count twice: merge maps of runs that share none"
    assert said == (2, "", f"tfg-drake: {told}\n")
    assert not (tmp_path / "both.npz").exists()


def test_merge(call, path, tmp_path, small_map, monkeypatch):
    monkeypatch.chdir(tmp_path)
    another = tuple(replace(one, information=1.01 * one.information) for one in small_map.graph.keyframes)
    graph = replace(small_map.graph, keyframes=another, sessions=np.array([7]))
    save_map(tmp_path / "b.npz", replace(small_map, graph=graph))
    said = call("map", "merge", path, "b.npz", "none/both.npz")
    assert said == (2, "", "tfg-drake: none/both.npz: cannot be written: no such file or directory\n")
    code, out, err = call("map", "merge", path, "b.npz", "both.npz")
    assert (code, out, err) == (0, "both.npz: 4 tags; in both maps: 4 tags\n", "")
    code, out, err = call("map", "info", "both.npz")
    assert (code, err) == (0, "")
    assert "4 turns and glances" in out


def test_align(call, path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("map", "export", path, "own.csv")[0] == 0
    lines = (tmp_path / "own.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    moved = [f"{row[0]},{float(row[1]) + 1.0},{row[2]}" for row in rows]
    moved[2] = f"{rows[2][0]},0,0"
    (tmp_path / "surveyed.csv").write_text("\n".join(["id,x_m,y_m", *moved]))
    code, out, err = call("map", "align", path, "--tags", "surveyed.csv", "there.npz")
    assert (code, err) == (0, "")
    off = math.hypot(float(rows[2][1]) + 1.0, float(rows[2][2]))
    assert out.splitlines() == [
        "tag 10: 0.000 m off",
        "tag 11: 0.000 m off",
        f"tag 12: {off:.3f} m off, looks wrong and does not count",
        "tag 13: 0.000 m off",
        "scale: lengths of the map are off by +0.00 %, and stay so",
        "there.npz: origin of the map at x 6.000 m, y 3.000 m, heading 1.5708 rad",
    ]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("info none.npz", "none.npz: no such file; name the folder of a run that was recorded"),
        ("info none", "none: no such file; name the folder of a run that was recorded"),
        ("info empty", "empty/map.npz: no such file; name the folder of a run that was recorded"),
        ("view text.npz", "text.npz: is damaged; copy it again from where it was recorded"),
        ("export none.npz a.csv", "none.npz: no such file; name the folder of a run that was recorded"),
        (
            "export map.npz a.zip",
            "a.zip: unknown format; name a file that ends in .csv, .dxf, .g2o, .geojson, .gtsam, .html, .pdf, .png, "
            ".svg, .yaml or .json",
        ),
        (
            "export map.npz a.yaml --format ros",
            "--format ros: unknown; must be one of csv, dxf, g2o, geojson, gtsam, html, pdf, png, svg, map_server, "
            "tagslam, apriltag_ros, wpilib",
        ),
        ("export map.npz a.csv --format wpilib", "a.csv: --format wpilib is written to a file that ends in .json"),
        ("export map.npz a.json --tag-height -1", "--tag-height -1: must be greater than 0 m"),
        ("export map.npz a.json --tag-size nan", "--tag-size nan: must be greater than 0 m"),
        ("export map.npz none/a.csv", "none/a.csv: cannot be written: no such file or directory"),
        ("export map.npz none/a.png", "none/a.png: cannot be written: no such file or directory"),
        ("export map.npz", "missing argument 'OUT'; see tfg-drake map export --help"),
        ("merge map.npz none.npz both.npz", "none.npz: no such file; name the folder of a run that was recorded"),
        (
            "merge map.npz map.npz both.yaml",
            "both.yaml: a map is a .npz file; name one, and make other formats of it by tfg-drake map export",
        ),
        ("align map.npz out.npz", ALIGN_BY),
        ("align map.npz out.npz --tags a --walls", ALIGN_BY),
        ("align map.npz out.npz --tags none.csv", "none.csv: cannot be read: no such file or directory"),
        ("fly", "no such command 'fly'; see tfg-drake map --help"),
        ("", "missing command; see tfg-drake map --help"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(call, path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(path.parent)
    (path.parent / "text.npz").write_text("a map\n")
    (path.parent / "empty").mkdir()
    assert call("map", *arguments.split()) == (2, "", f"tfg-drake: {complaint}\n")


# A process in which there is no Drake.
NO_DRAKE = """
import sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "pydrake":
            raise ImportError("no Drake here")
sys.meta_path.insert(0, Finder())
from tfg_drake.diagrams import cli
for command in " ".join(sys.argv[1:]).split(" and "):
    try:
        cli.main(command.split())
    except SystemExit as end:
        if end.code:
            raise
"""


@pytest.mark.slow
def test_no_drake_is_needed_and_without_a_keyboard_the_view_stays_until_a_signal(path):
    """SIGTERM; test_view.py ends a view by Ctrl-C."""
    picture = path.with_suffix(".png")
    commands = ["map", "info", path, "and", "map", "export", path, picture, "and", "map", "view", path.parent]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-u", "-c", NO_DRAKE, *commands], text=True, **pipes) as process:
        said = iter(process.stdout.readline, "")
        assert any("2 turns and glances" in line for line in said)
        assert any(line.startswith(f"{picture}: 4 tags") for line in said)
        assert any(line.startswith("page: http://localhost:") for line in said)
        assert process.stdout.readline() == "The scene stays open until Ctrl-C.\n"
        process.send_signal(signal.SIGTERM)
        assert (process.wait(timeout=30), process.stderr.read()) == (0, "")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_on_a_terminal_the_view_stays_until_enter(path):
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", NO_DRAKE, "map", "view", path]
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    try:
        said = b""
        while b"close it. " not in said:
            assert select.select([ours], [], [], 60.0)[0], said
            said += os.read(ours, 1000)
        address = re.search(r"page: (http://localhost:\d+)", said.decode())
        assert address, said
        page = urllib.request.urlopen(address[1], timeout=10).read().decode()
        assert "<title>map.npz</title>" in page
        os.write(ours, b"\n")
        assert process.wait(timeout=30) == 0
    finally:
        process.kill()
        process.wait()
        os.close(ours)

"""`tfg-drake map`: describes, shows, exports, locates, merges and aligns saved maps. Needs no Drake."""

from __future__ import annotations

import contextlib
import importlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from tfg_drake.config import CameraConfig
from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option, positive, writing
from tfg_drake.diagrams.screen import Screen
from tfg_drake.io.files import of_run, write_atomic

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap


class Format(NamedTuple):
    """Suffix of a format, and the module in tfg_drake and its function that make the contents of a saved map."""

    suffix: str
    module: str = ""
    function: str = ""


# Formats by name; the first one with a suffix is that suffix's default.
FORMATS = {
    "csv": Format(".csv", "mapfile.landmark_table", "landmark_csv"),
    "dxf": Format(".dxf", "mapfile.dxf", "dxf_text"),
    "g2o": Format(".g2o", "mapfile.g2o", "g2o_text"),
    "geojson": Format(".geojson", "mapfile.geojson", "geojson_text"),
    "gtsam": Format(".gtsam", "mapfile.gtsam_text", "gtsam_texts"),
    "html": Format(".html"),
    "pdf": Format(".pdf"),
    "png": Format(".png"),
    "svg": Format(".svg", "pictures.plan", "plan_svg"),
    "map_server": Format(".yaml", "mapfile.occupancy_grid", "map_server_files"),
    "tagslam": Format(".yaml", "mapfile.tag_layout", "tagslam_yaml"),
    "apriltag_ros": Format(".yaml", "mapfile.tag_layout", "apriltag_ros_yaml"),
    "wpilib": Format(".json", "mapfile.tag_layout", "wpilib_json"),
}
SUFFIXES = tuple(dict.fromkeys(one.suffix for one in FORMATS.values()))
# Suffix of the second file of formats with two files.
BESIDE = {"gtsam": ".values", "map_server": ".pgm"}
# Formats without walls, and formats with poses.
OF_TAGS, OF_GRAPH = ("csv", "tagslam", "apriltag_ros", "wpilib"), ("g2o", "gtsam")
_NAMED = ", ".join(name if f".{name}" == one.suffix else f"{name} ({one.suffix})" for name, one in FORMATS.items())


def _map_file(path: Path) -> Path:
    return of_run(path, "map.npz")


def _new_map(path: Path) -> Path:
    if path.suffix != ".npz":
        bad_input(f"{path}: a map is a .npz file; name one, and make other formats of it by tfg-drake map export")
    return path


MapArgument = Annotated[Path, argument("MAP", "A map or the folder of a run.", callback=_map_file)]
OtherMap = Annotated[Path, argument("OTHER", "Another map, or the folder of a run.", callback=_map_file)]
NewMap = Annotated[Path, argument("OUT", "The map to write, a .npz file.", callback=_new_map)]

map_app = command.group(
    "map",
    "Describe, show, export, locate, merge or align saved maps.",
)


@map_app.command()
def info(map_file: MapArgument) -> None:
    """Print the contents of a map."""
    from rich.console import Console
    from rich.table import Table

    from tfg_drake.mapfile.summary import map_rows

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in map_rows(_load(map_file), map_file.stat().st_size):
        table.add_row(name, value)
    Console(highlight=False).print(table)


@map_app.command()
def view(map_file: MapArgument) -> None:
    """Show a map in the browser."""
    from tfg_drake.diagrams.missions.page import open_page

    saved = _load(map_file)
    with (
        _timeline(saved, map_file) as timeline,
        open_page(map_file.name, "localhost", None, timeline=timeline, live=False, controls=False),
    ):
        command.wait_for_enter()


@map_app.command()
def export(
    map_file: MapArgument,
    out: Annotated[Path, argument("OUT", "The file to write; its suffix determines the format.")],
    name: Annotated[
        str | None, option("NAME", f"The format; by default the first one with OUT's suffix: {_NAMED}.", "--format")
    ] = None,
    tag_height: Annotated[
        float, positive("M", "Height of the tags' centres (tagslam, apriltag_ros, wpilib).", "m")
    ] = CameraConfig.tag_height,
    tag_size: Annotated[
        float | None,
        positive("M", "Side of the tags' black squares (tagslam, apriltag_ros); by default the run's.", "m"),
    ] = None,
) -> None:
    """Write a map in another format.

    map_server also writes an image, and a mask of the run's keep-out areas, beside OUT; gtsam also writes .values.
    """
    import numpy as np

    from tfg_drake.mapfile.summary import landmark_counts
    from tfg_drake.messages import is_tag, replace
    from tfg_drake.slam.keyframe_graph import seen_by
    from tfg_drake.table import take

    if name is None:
        name = next((one for one, form in FORMATS.items() if form.suffix == out.suffix.lower()), None)
        if name is None:
            bad_input(f"{out}: unknown format; name a file that ends in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    elif name not in FORMATS:
        bad_input(f"--format {name}: unknown; must be one of {', '.join(FORMATS)}")
    elif out.suffix.lower() != FORMATS[name].suffix:
        bad_input(f"{out}: --format {name} is written to a file that ends in {FORMATS[name].suffix}")
    saved = _load(map_file)
    _check_not_empty(saved, map_file, name)
    graph, walls = saved.graph, np.setdiff1d(saved.graph.ids, saved.ids)
    # The map that a session began with is a keyframe before its first view.
    seen = seen_by(graph, graph.keyframes[graph.view_keyframe.min(initial=len(graph.keyframes)) :])
    drawn = seen | is_tag(graph.ids) | np.isin(graph.ids, saved.tfg.segment_ids)
    if draws := name not in (*OF_TAGS, *OF_GRAPH):
        saved = replace(saved, graph=take(graph, n=drawn))
    with writing(out):
        if name == "html":
            _write_page(saved, map_file, out)
        elif name in ("pdf", "png"):
            _draw(saved, map_file, out)
        else:
            arguments: list[object] = [tag_height] if "tag_layout" in FORMATS[name].module else []
            if name in ("tagslam", "apriltag_ros"):
                arguments.append(tag_size or _tag_size(map_file))
            elif name == "map_server":
                arguments.append(out.with_suffix(BESIDE[name]).name)
            _write(saved, out, name, arguments)
        mask = _write_mask(saved, map_file, out) if name == "map_server" else []
    files = [out, out.with_suffix(BESIDE[name]), *mask] if name in BESIDE else [out]
    size = sum(file.stat().st_size for file in files)
    if draws and not drawn.all():
        unseen = len(drawn) - drawn.sum()
        print(f"{map_file}: {unseen} walls of the known map are not drawn, as this session has not seen them")
    print(f"{', '.join(map(str, files))}: {landmark_counts(len(saved.ids), len(walls))}, {size / 1e3:.0f} kB")


def _check_not_empty(saved: SavedMap, map_file: Path, name: str) -> None:
    """Raise BadInput if the export would be empty."""
    if name in OF_TAGS:
        from tfg_drake.mapfile.tag_layout import left_out

        said = len(saved.ids) if name == "csv" else (saved.facing.any(axis=1) & ~saved.is_doubtful).sum()
        why = "; ".join(["has no tags" if not len(saved.ids) else "has no tag to tell", *left_out(saved)])
        if not said:
            bad_input(f"{map_file}: {why}; its walls go to another format, such as .dxf, .geojson, .svg or .yaml")
    elif name not in OF_GRAPH and not (len(saved.ids) or len(saved.tfg.segments)):
        bad_input(f"{map_file}: has neither tags nor walls yet, so there is nothing to draw; let the robot see more")


def _write(saved: SavedMap, out: Path, name: str, arguments: list[object]) -> None:
    """Write one or two files of a format from the map and further arguments."""
    _, module, function = FORMATS[name]
    with command.installed("export"):
        made = importlib.import_module(f"tfg_drake.{module}")
    contents = getattr(made, function)(saved, *arguments)
    if name in BESIDE:
        contents, beside = contents
        write_atomic(out.with_suffix(BESIDE[name]), beside)
    write_atomic(out, contents)
    if module == "mapfile.tag_layout":
        print("".join(f"{line}\n" for line in made.left_out(saved)), end="")


def _beside(map_file: Path) -> Any:
    """Return the parsed scenario file beside a run's map, {} if there is none."""
    from tfg_drake.io.yaml_text import parse_yaml

    with contextlib.suppress(OSError, ValueError):
        return parse_yaml(map_file.with_name("scenario.yaml").read_text())
    return {}


def _write_mask(saved: SavedMap, map_file: Path, out: Path) -> list[Path]:
    """Write Nav2's keep-out mask beside a grid if the scenario of the run has keep-out areas; returns the files."""
    import numpy as np

    from tfg_drake.mapfile.occupancy_grid import keep_out_files

    areas: list[Any] = []
    with contextlib.suppress(ValueError, LookupError, TypeError):
        rings = _beside(map_file)["explorer"]["keep_out"]
        areas = [np.array(corners, dtype=float).reshape(-1, 2) for corners in rings]
    if map_file.name != "map.npz":  # It may lie in another frame.
        print(f"{map_file}: no keep-out mask, as only a run's own map.npz has its keep-out areas beside it")
        return []
    if not areas:
        return []
    files = [out.with_name(f"{out.stem}_keepout{suffix}") for suffix in (".pgm", ".yaml")]
    text, image = keep_out_files(saved, areas, files[0].name)
    write_atomic(files[0], image)
    write_atomic(files[1], text)
    return files


def _tag_size(map_file: Path) -> float:
    """Return the size of a run's tags, m, from the scenario beside its map. Raises BadInput if it is not stated."""
    with contextlib.suppress(ValueError, LookupError, TypeError, AttributeError):
        scenario = _beside(map_file)
        if scenario["hardware"]["tags"].startswith("camera:"):
            return float(scenario["hardware"]["camera"]["tag_size"])
        if map_file.with_name("truth.tum").exists():  # A simulated run.
            return float(scenario["camera"]["tag_size"])
    bad_input(
        f"{map_file}: nothing beside it says how large the tags are; give the side of their black squares, --tag-size M"
    )


def _draw(saved: SavedMap, map_file: Path, out: Path) -> None:
    from tfg_drake.mapfile.summary import map_rows
    from tfg_drake.pictures.figure import draw_map

    rows = dict(map_rows(saved, map_file.stat().st_size))
    known = "; ".join(f"{name} {rows[name]}" for name in ("tags", "walls") if name in rows)
    draw_map(out, f"{map_file}: {rows['landmarks']}, {rows['views']}\n{known}", saved)


def _write_page(saved: SavedMap, map_file: Path, out: Path) -> None:
    from tfg_drake.cockpit.page import export_page, viewer_script

    with _timeline(saved, map_file) as timeline:
        export_page(timeline, out, map_file.name, viewer_script())


@map_app.command()
def merge(first: MapArgument, second: OtherMap, out: NewMap) -> None:
    """Merge MAP and OTHER, two maps of one building, into OUT, in the frame of MAP."""
    from tfg_drake.mapfile.merge import merge as merged
    from tfg_drake.mapfile.summary import landmark_counts

    a, b = _load(first), _load(second)
    both = merged(a, b)
    _save(both, out)
    tags = len(a.ids) + len(b.ids) - len(both.ids)
    walls = len(a.graph.ids) + len(b.graph.ids) - len(both.graph.ids) - tags
    of_both = landmark_counts(len(both.ids), len(both.graph.ids) - len(both.ids))
    print(f"{out}: {of_both}; in both maps: {landmark_counts(tags, walls)}")
    if disputed := sorted({*both.doubtful.tolist()} - {*a.doubtful.tolist(), *b.doubtful.tolist()}):
        print(f"doubtful, for they stand elsewhere in {second}: tags {', '.join(map(str, disputed))}")


@map_app.command()
def locate(map_file: MapArgument, other: OtherMap) -> None:
    """Print where OTHER begins in the world frame of MAP, with probabilities; exit code 1 if the place is not found."""
    from tfg_drake.bad_input import BadInput
    from tfg_drake.geometry.se2 import compose
    from tfg_drake.mapfile.placement import places_of
    from tfg_drake.slam.place_search import WRONG
    from tfg_drake.slam.tag_search import by_tags

    a, b = _load(map_file), _load(other)
    try:
        tagged = by_tags(a.graph, b.graph)
    except BadInput as error:
        print(error)
        tagged = None
    if tagged is not None:
        x, y, yaw = compose(a.X_WM, tagged.X)
        print(f"by the tags of both: it begins at ({x:.2f}, {y:.2f}) m, {yaw:.3f} rad")
        return
    places = places_of(a, b)
    for X, probability in zip(compose(a.X_WM, places.X), places.probability, strict=True):
        if probability > WRONG:
            print(f"it begins at ({X[0]:.2f}, {X[1]:.2f}) m, {X[2]:.3f} rad: probability {probability:.4g}")
    none = 1.0 - float(places.probability.sum())
    print(f"{'it begins elsewhere' if none < 1.0 else 'it is not found in this map'}: probability {none:.2g}")
    if places.found() is None:
        print(f"that is not sure: a place counts as found from a probability of {1.0 - WRONG:g} on")
        raise typer.Exit(1)


@map_app.command()
def align(
    map_file: MapArgument,
    out: NewMap,
    tags: Annotated[Path | None, option("FILE", "Surveyed tags, a .csv with id,x_m,y_m.")] = None,
    plan: Annotated[Path | None, option("FILE", "A floor plan, a map_server .yaml.")] = None,
    walls: Annotated[bool, flag("--walls", "Turn it until its own walls lie along the axes.")] = False,
) -> None:
    """Move a map into the frame of surveyed tags or of a floor plan, or turn it by its own walls."""
    from tfg_drake.mapfile.survey import along_axes, in_plan, in_survey, read_survey
    from tfg_drake.world.map_server import load_map_server

    if [tags is not None, plan is not None, walls].count(True) != 1:
        bad_input("name one of --tags, --plan and --walls; see tfg-drake map align --help")
    if tags is not None:
        saved, ids, off, is_wrong, scale = in_survey(_load(map_file), read_survey(tags))
        for tag, distance, wrong in zip(ids.tolist(), off.tolist(), is_wrong.tolist(), strict=True):
            print(f"tag {tag}: {distance:.3f} m off{', looks wrong and does not count' if wrong else ''}")
        print(f"scale: lengths of the map are off by {round(100.0 * scale, 2) + 0.0:+.2f} %, and stay so")
    elif plan is not None:
        saved, off = in_plan(_load(map_file), load_map_server(plan))
        if len(off):
            half, most = sorted(off)[len(off) // 2], sorted(off)[9 * len(off) // 10]
            print(f"walls: half of them within {half:.3f} m of the plan's, nine tenths within {most:.3f} m")
    else:
        saved = along_axes(_load(map_file))
    _save(saved, out)
    x, y, theta = saved.X_WM
    print(f"{out}: origin of the map at x {x:.3f} m, y {y:.3f} m, heading {theta:.4f} rad")


def _save(saved: SavedMap, out: Path) -> None:
    from tfg_drake.mapfile.saved_map import save_map

    with writing(out):
        save_map(out, saved)


def _load(path: Path) -> SavedMap:
    with Screen(f"reading {path}"):
        from tfg_drake.mapfile.saved_map import load_map

        return load_map(path)


@contextlib.contextmanager
def _timeline(saved: SavedMap, path: Path) -> Iterator[Path]:
    """Write the timeline with which the page shows a map into a temporary file."""
    from tfg_drake.storage.timeline import FILE_NAME, write_map_timeline

    with tempfile.TemporaryDirectory() as folder:
        write_map_timeline(saved, Path(folder) / FILE_NAME, path.name)
        yield Path(folder) / FILE_NAME

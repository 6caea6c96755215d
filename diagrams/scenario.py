"""The scenario: everything that defines a run, as one tree of dataclasses read from YAML.

A file is merged into the tree and checked by the annotations of the fields. This module has no `from __future__ import
annotations`, as the loader reads the types.
"""

import contextlib
import copy
import dataclasses
import importlib.resources
import logging
import math
import typing
from pathlib import Path

import numpy as np

from tfg_drake import config
from tfg_drake.bad_input import BadInput
from tfg_drake.constraints import Point, Pose, Segment
from tfg_drake.geometry.polygon import fault, hatched
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.io.extras import pip_install
from tfg_drake.io.files import of_run
from tfg_drake.io.yaml_text import dump_yaml, parse_yaml
from tfg_drake.messages import FloatArray
from tfg_drake.typed_tree import Misfit, annotation_of, described, document_fields, read
from tfg_drake.vision.camera_sheet import camera_sheets
from tfg_drake.world.changing import successive
from tfg_drake.world.world import LONGEST, World, WorldError, check_world, wall_distance

_log = logging.getLogger("tfg_drake.world")


class ScenarioError(BadInput, ValueError):
    """A scenario cannot be used; the message is one line: file, place, what is wrong, how to fix it."""


@dataclasses.dataclass
class WorldConfig:
    """The true world, see tfg_drake.world.world.World."""

    # Opaque wall segments [x0, y0, x1, y1] in W, m.
    walls: list[Segment] = dataclasses.field(default_factory=list)
    # Tags on the walls.
    tags: list[config.TagConfig] = dataclasses.field(default_factory=list)
    # Start [x, y, yaw] in W, m and rad.
    start: Pose = dataclasses.field(default_factory=lambda: [0.0, 0.0, 0.0])


@dataclasses.dataclass
class Scenario:
    """Everything that defines a run."""

    # Every random number of the run comes from it.
    seed: int = 0
    world: WorldConfig = dataclasses.field(default_factory=WorldConfig)
    robot: config.RobotConfig = dataclasses.field(default_factory=config.RobotConfig)
    odometry: config.OdometryConfig = dataclasses.field(default_factory=config.OdometryConfig)
    tags: config.TagSensorConfig = dataclasses.field(default_factory=config.TagSensorConfig)
    scan: config.ScanConfig = dataclasses.field(default_factory=config.ScanConfig)
    # Parts of a simulated station, and its camera, if it has one.
    station: config.StationConfig = dataclasses.field(default_factory=config.StationConfig)
    camera: config.CameraConfig = dataclasses.field(default_factory=config.CameraConfig)
    # Deviations of a simulated world from the sections tags, odometry and scan; not used with a real robot.
    reality: config.RealityConfig = dataclasses.field(default_factory=config.RealityConfig)
    safety: config.SafetyConfig = dataclasses.field(default_factory=config.SafetyConfig)
    # Motions of the base that its wheels do not notice.
    disturbances: list[config.DisturbanceConfig] = dataclasses.field(default_factory=list)
    explorer: config.ExplorerConfig = dataclasses.field(default_factory=config.ExplorerConfig)
    planner: config.PlannerConfig = dataclasses.field(default_factory=config.PlannerConfig)
    # Where a human operator would drive and look round, [x, y] in W, m: the method "scripted".
    drive: list[Point] = dataclasses.field(default_factory=list)
    grid: config.GridConfig = dataclasses.field(default_factory=config.GridConfig)
    # Not used with a simulated robot.
    hardware: config.HardwareConfig = dataclasses.field(default_factory=config.HardwareConfig)

    @property
    def field_of_view(self) -> float:
        """The field of view that tag sensor and scanner share, rad."""
        return min(self.tags.field_of_view, self.scan.field_of_view)

    @property
    def view(self) -> config.TagSensorConfig:
        """The tag sensor with its range limited to the scanner's, for exploration: frontiers bound free space."""
        return dataclasses.replace(self.tags, range=min(self.tags.range, self.scan.range))


def FindScenario(name_or_path: str) -> Path:
    """Return the file of a shipped scenario ("paper"), or the path itself. Raises ScenarioError if neither exists."""
    shipped = Path(str(importlib.resources.files("tfg_drake.diagrams"))) / "scenarios"
    path = shipped / f"{name_or_path}.yaml"
    if path.is_file():
        return path
    path = Path(name_or_path)
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in shipped.glob("*.yaml")))
        raise ScenarioError(f"{name_or_path}: no such file or scenario; name a YAML file or one of {names}")
    return path


def LoadScenario(
    filename: str | Path | None = None,
    data: str | None = None,
    scenario_name: str | None = None,
    defaults: Scenario | None = None,
) -> Scenario:
    """Load a scenario from a YAML file or string, merged into `defaults` (Drake's convention for stations).

    filename is a path or the name of a shipped scenario; data is merged into the file's contents if both are given.
    scenario_name selects a child of each document. A document may name another scenario as its `base:` (a shipped name,
    or a path relative to the document), which is loaded first; the document is merged into it, sections key by key,
    while lists are replaced. In a list of bases each is merged into the ones before it; only the first may have a base
    of its own. Raises ScenarioError.
    """
    if filename is None and data is None:
        raise ScenarioError("LoadScenario: give filename or data, or both")
    scenario = defaults
    if filename is not None:
        scenario = _Load(FindScenario(str(filename)), None, scenario_name, scenario, above=())
    if data is not None:
        scenario = _Load(None, data, scenario_name, scenario, above=())
    return typing.cast(Scenario, scenario)


def _Load(
    path: Path | None, data: str | None, scenario_name: str | None, defaults: Scenario | None, above: tuple[Path, ...]
) -> Scenario:
    source = "scenario" if path is None else str(path)
    if path is not None and path.name.endswith(_PLANS):
        given = "it" if path.suffix == ".txt" else "the map_server .yaml that names it"
        raise ScenarioError(f"{source}: is a floor plan, not a scenario; give {given} by --world")
    text = _ReadText(path) if path is not None else typing.cast(str, data)
    tree = _Parse(text, source)
    if path is not None and isinstance(tree, dict) and _MAP_KEYS & tree.keys():
        raise ScenarioError(f"{source}: is a floor plan, not a scenario; give it by --world")
    if scenario_name is not None:
        if not isinstance(tree, dict) or scenario_name not in tree:
            names = ", ".join(map(str, tree)) if isinstance(tree, dict) else "none"
            raise ScenarioError(f"{source}: no scenario {scenario_name}; the file has {names}")
        tree = tree[scenario_name]
    if not isinstance(tree, dict):
        raise ScenarioError(f"{source}: expected keys and values such as `seed: 0`, found {described(tree)}")
    base = tree.pop("base", None)
    if base is not None:
        if defaults is not None:
            raise ScenarioError(f"{source}: base: {base} cannot be combined with defaults; give one of them")
        if path is not None and path.resolve() in above:
            raise ScenarioError(f"{source}: base: {base} leads back to this file; break the circle")
        for one in base if isinstance(base, list) and base else [base]:
            defaults = _LoadBase(one, path, source, above, defaults)
    scenario = _Merge(tree, defaults or Scenario(), source)
    if path is not None and scenario.explorer.known_map:
        scenario.explorer.known_map = str(path.parent.resolve() / scenario.explorer.known_map)
    _CheckWorld(scenario, source)
    return scenario


def _LoadBase(
    base: object, path: Path | None, source: str, above: tuple[Path, ...], defaults: Scenario | None
) -> Scenario:
    if not isinstance(base, str):
        raise ScenarioError(f"{source}: base: expected a scenario's name or file, found {described(base)}")
    beside = path.parent / base if path is not None else Path(base)
    try:
        base_path = beside if beside.is_file() else FindScenario(base)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: base: {error}") from None
    return _Load(base_path, None, None, defaults, above if path is None else (*above, path.resolve()))


def CheckScenario(scenario: Scenario, source: str = "scenario") -> None:
    """Raise ScenarioError if a scenario has a value that a file could not give it; source: its name in the message."""
    _Read(_Tree(scenario, source), source)
    _CheckWorld(scenario, source)


def DumpScenario(scenario: Scenario) -> str:
    """Return a scenario with all values as YAML text for LoadScenario."""
    return dump_yaml(_Tree(scenario, "scenario"), sort_keys=False, default_flow_style=None)


def _Tree(value: typing.Any, source: str) -> typing.Any:
    """A scenario, or part of one, as a file has it, with the attributes that are none of its fields."""
    if dataclasses.is_dataclass(value):
        return {name: _Tree(item, source) for name, item in vars(value).items()}
    if isinstance(value, dict):
        raise ScenarioError(f"{source}: {value} is a dict; give a section as its class in tfg_drake.config")
    if isinstance(value, list):
        return [_Tree(item, source) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def ApplySettings(scenario: Scenario, settings: typing.Sequence[str]) -> Scenario:
    """Return a copy of the scenario with settings such as "explorer.stop_gain=5" applied in order. Raises
    ScenarioError, also if the scenario already has an invalid value."""
    CheckScenario(scenario)
    result = copy.deepcopy(scenario)
    for setting in settings:
        key, equals, text = setting.partition("=")
        source = f"--set {setting}"
        if not equals or not key or not text.strip():
            raise ScenarioError(f"{source}: expected KEY=VALUE, such as explorer.stop_gain=5")
        tree: typing.Any = _Parse(text, source)
        annotation: typing.Any = Scenario
        names = key.split(".")
        for depth, name in enumerate(names):
            with _complaining(source):
                annotation = annotation_of(annotation, name, ".".join(names[:depth]))
        if dataclasses.is_dataclass(annotation):
            raise ScenarioError(f"{source}: {key} is a section; set one of its keys, or write a scenario file")
        for name in reversed(names):
            tree = {name: tree}
        result = _Merge(tree, result, source)
    _CheckWorld(result, "--set")
    return result


def PrepareScenario(
    scenario: str | Path | Scenario,
    settings: typing.Sequence[str] = (),
    seed: int | None = None,
    world: str | Path | None = None,
    tag_spacing: float | None = None,
    start: typing.Sequence[float] | None = None,
    known_map: str | Path | None = None,
    known_at: typing.Sequence[float] | None = None,
) -> Scenario:
    """Return a copy of a scenario, loaded if given by name, with settings, a known map, a seed and a world applied;
    None leaves them unchanged. See ApplySettings and ApplyWorldFile. The keep-out areas of a known map's run are taken
    over, with a line in the log, unless there are others or a setting of them. Raises ScenarioError."""
    own = [] if known_map is None else [f"explorer.known_map={Path(known_map).resolve()}"]
    own += [] if known_at is None else [f"explorer.known_at={list(known_at)}"]
    own += [] if seed is None else [f"seed={seed}"]
    settings = [settings] if isinstance(settings, str) else settings
    loaded = scenario if isinstance(scenario, Scenario) else LoadScenario(scenario)
    loaded = ApplySettings(loaded, [*settings, *own])
    given = any(setting.startswith("explorer.keep_out=") for setting in settings)
    loaded = _WithAreasOfRun(loaded, given=given)
    if world is not None or tag_spacing is not None or start is not None:
        loaded = ApplyWorldFile(loaded, world, tag_spacing, start)
    return loaded


def _WithAreasOfRun(scenario: Scenario, *, given: bool) -> Scenario:
    """Return a scenario with the keep-out areas of the run whose map it begins with, as these belong to the building,
    unless it has areas or they are given. A map of another name than a run's may lie in another frame."""
    if not scenario.explorer.known_map:
        return scenario
    known = of_run(Path(scenario.explorer.known_map), "map.npz")
    run = known.with_name("scenario.yaml")
    if known.name != "map.npz" or not run.is_file():
        return scenario
    tree = _Parse(_ReadText(run), str(run))
    section = tree.get("explorer") if isinstance(tree, dict) else None
    areas = section.get("keep_out") if isinstance(section, dict) else None
    if not areas:
        return scenario
    before = _Merge({"explorer": {"keep_out": areas}}, scenario, str(run))
    _CheckWorld(before, str(run))
    own = scenario.explorer.keep_out
    if not own and not given:
        told = "keep-out areas: %d of %s hold once the robot knows its place; --set explorer.keep_out=[] for none"
        _log.warning(told, len(areas), run)
        return before
    if gone := [area for area in before.explorer.keep_out if area not in own]:
        _log.warning("keep-out areas: %d of %s hold no longer, as others are given", len(gone), run)
    return scenario


def _Merge(tree: dict[str, typing.Any], defaults: Scenario, source: str) -> Scenario:
    """Return a copy of a scenario with the values of a parsed file. With `station.eyes: camera` the camera's data sheet
    sets tags and scan first, and the file's values override it. Raises ScenarioError."""
    scenario = _Read(tree, source, copy.deepcopy(defaults))
    if tree.get("station", {}).get("eyes") == "camera":
        scenario.tags, scenario.scan = camera_sheets(scenario.camera, defaults.tags, defaults.scan)
        scenario = _Read(tree, source, scenario)
    return scenario


def _Read(tree: typing.Any, source: str, defaults: Scenario | None = None) -> Scenario:
    with _complaining(source):
        return typing.cast(Scenario, read(tree, Scenario, default=defaults))


@contextlib.contextmanager
def _complaining(source: str) -> typing.Iterator[None]:
    """Turn Misfit into a ScenarioError that names the source of the value."""
    try:
        yield
    except Misfit as error:
        raise ScenarioError(f"{source}: {error}") from None


def MakeWorld(section: WorldConfig) -> World:
    """Make the World of a scenario's section."""
    return World(
        walls=np.array(section.walls, dtype=float).reshape(-1, 4),
        tag_ids=np.array([tag.id for tag in section.tags], dtype=np.int64),
        p_WT=np.array([tag.position for tag in section.tags], dtype=float).reshape(-1, 2),
        tag_facing=np.array([tag.facing for tag in section.tags], dtype=float),
        start=np.array(section.start, dtype=float),
    )


def HatchedKeepOut(scenario: Scenario) -> FloatArray:
    """Return outlines of the keep-out areas with a hatching so dense that the robot fits nowhere inside: segments
    (k, 4), m in W."""
    return hatched(_Areas(scenario), scenario.robot.radius)


def _Areas(scenario: Scenario) -> list[FloatArray]:
    """Return the corners (n, 2) of each keep-out area, m in W, without a repeated first corner at the end."""
    areas = [np.array(corners, dtype=float).reshape(-1, 2) for corners in scenario.explorer.keep_out]
    return [p[:-1] if len(p) > 1 and (p[0] == p[-1]).all() else p for p in areas]


def AreasOutside(scenario: Scenario) -> list[str]:
    """Return a line for each keep-out area that lies outside the bounding box of the walls."""
    corners = np.array(scenario.world.walls, dtype=float).reshape(-1, 2)
    return [
        f"explorer.keep_out[{i}]: lies outside the building, so it bars nothing; is this meant?"
        for i, p in enumerate(_Areas(scenario))
        if len(corners) and ((p.max(axis=0) < corners.min(axis=0)) | (p.min(axis=0) > corners.max(axis=0))).any()
    ]


def MakeKeepOut(scenario: Scenario) -> FloatArray:
    """Return HatchedKeepOut (k, 4), m in M. Raises ScenarioError if the robot starts in such an area, or if one reaches
    farther from the map's origin than any building."""
    start = np.array(scenario.world.start, dtype=float)
    X_WM = MapFrame(scenario, start)
    for i, p in enumerate(_Areas(scenario)):
        x, y = p[np.argmax(np.abs(p - X_WM[:2]).max(axis=1))]
        if max(abs(x - X_WM[0]), abs(y - X_WM[1])) > LONGEST:
            raise ScenarioError(
                f"explorer.keep_out[{i}]: its corner ({x:g}, {y:g}) is more than {LONGEST:g} m from where the map "
                "begins; check its unit and that number"
            )
    keep_out = HatchedKeepOut(scenario)
    # In a known map the robot's start is unknown.
    near = wall_distance(start[:2], keep_out) < scenario.robot.radius
    if near.any() and not scenario.explorer.known_map:
        where = f"at ({start[0]:g}, {start[1]:g}), or nearer to it than its radius, {scenario.robot.radius:g} m"
        raise ScenarioError(f"explorer.keep_out: the robot starts in it, {where}; move its corners or the start")
    return transform(inverse(X_WM), keep_out.reshape(-1, 2)).reshape(-1, 4)


def MapFrame(scenario: Scenario, X_WS: FloatArray) -> FloatArray:
    """Return X_WM (3,), the pose of the map frame in the world: that of the known map, otherwise the start X_WS (3,).
    Raises MapFileError."""
    if not scenario.explorer.known_map:
        return X_WS
    # Imported here, as few missions need it.
    from tfg_drake.mapfile.saved_map import load_map

    return load_map(Path(scenario.explorer.known_map)).X_WM


def MakeWorldConfig(world: World) -> WorldConfig:
    """Make a scenario's section of a World, the inverse of MakeWorld."""
    rows = zip(world.tag_ids.tolist(), world.p_WT.tolist(), world.tag_facing.tolist(), strict=True)
    tags = [config.TagConfig(id=i, position=position, facing=facing) for i, position, facing in rows]
    return WorldConfig(walls=world.walls.tolist(), tags=tags, start=world.start.tolist())


def ApplyWorldFile(
    scenario: Scenario,
    path: str | Path | None = None,
    tag_spacing: float | None = None,
    start: typing.Sequence[float] | None = None,
) -> Scenario:
    """Return a copy of the scenario with walls, tags and start replaced.

    path: a scenario file, a map_server .yaml or a *.vectormap.txt; None keeps the walls. tag_spacing: m, replaces the
    tags by tags along every reachable surface. start: (x, y, yaw), m and rad; without it the start of a scenario is
    kept, and that in a map is drawn from the seed. Raises ScenarioError.
    """
    # Needed by few missions and slow to import.
    from tfg_drake.world.load import furnish, load_map

    result = copy.deepcopy(scenario)
    source = "world" if path is None else str(path)
    try:
        if path is not None and not IsScenario(Path(path)):
            world = load_map(Path(path), scenario.robot.radius, tag_spacing, start, scenario.seed)
        else:
            world = MakeWorld((result if path is None else LoadScenario(path)).world)
            world = furnish(world, scenario.robot.radius, tag_spacing, start)
    except WorldError as error:
        raise ScenarioError(f"{source}: {error}" if source not in str(error) else str(error)) from None
    result.world = MakeWorldConfig(world)
    return result


# Suffixes of wall lists and map_server images; keys that distinguish a map_server file from a scenario.
_PLANS = (".vectormap.txt", ".pgm", ".pgm.gz", ".png")
_MAP_KEYS = frozenset({"image", "resolution", "occupied_thresh", "free_thresh"})


def IsScenario(path: Path) -> bool:
    """Return True if a world file is a scenario (or the name of a shipped one), not a map to import."""
    if not path.is_file():
        return path.suffix in ("", ".yaml", ".yml")
    if path.suffix not in (".yaml", ".yml"):
        return False
    tree = _Parse(_ReadText(path), str(path))
    return not (isinstance(tree, dict) and _MAP_KEYS & tree.keys())


def _ReadText(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ScenarioError(f"{path}: cannot be read: {reason}") from None


def _Parse(text: str, source: str) -> object:
    try:
        return parse_yaml(text)
    except ValueError as error:
        raise ScenarioError(f"{source}: {error}") from None


# Keys of the section reality that also apply to rendered sensors; the others apply to ideal ones only.
_RENDERED = ("yaw", "ahead", "left")
# Greatest field of view of a camera without distortion, rad (150 degrees).
_WIDEST = math.radians(150.0)


def _CheckEyes(scenario: Scenario, source: str) -> None:
    """Raise ScenarioError for settings that a rendered camera does not simulate and would silently ignore."""
    if scenario.station.eyes != "camera":
        return
    reality, usual = scenario.reality, config.RealityConfig()
    for section in ("tags", "scan"):
        given, default = getattr(reality, section), getattr(usual, section)
        for field in dataclasses.fields(given):
            if field.name not in _RENDERED and getattr(given, field.name) != getattr(default, field.name):
                place = f"reality.{section}.{field.name}"
                raise ScenarioError(f"{source}: {place}: of ideal sensors; leave it out where station.eyes is camera")
    if reality.changes:
        raise ScenarioError(f"{source}: reality.changes: cannot be rendered; leave them out or set station.eyes=ideal")
    if scenario.scan.least_range >= scenario.scan.range:
        raise ScenarioError(f"{source}: scan.least_range: must be less than scan.range, {scenario.scan.range:g}")
    for section in ("tags", "scan"):
        if getattr(scenario, section).field_of_view > _WIDEST:
            most = f"must be at most {_WIDEST:.6g} where station.eyes is camera"
            raise ScenarioError(f"{source}: {section}.field_of_view: {most}")
    try:
        # OpenCV is not installed with every robot: only a camera needs it.
        import robotpy_apriltag  # noqa: F401

        from tfg_drake.world.scene import check_drawn
    except ModuleNotFoundError as error:
        missing = f"{error.name} is not installed; get it with {pip_install('camera')}"
        raise ScenarioError(f"{source}: station.eyes=camera: {missing}") from None
    check_drawn(MakeWorld(scenario.world))


def _CheckWorld(scenario: Scenario, source: str) -> None:
    for i, corners in enumerate(_Areas(scenario)):
        if told := fault(corners):
            mend = "give the three or more corners [x, y] of a polygon, in their order round it"
            raise ScenarioError(f"{source}: explorer.keep_out[{i}]: {told}; {mend}")
    try:
        world = MakeWorld(scenario.world)
        check_world(world, scenario.robot.radius)
        _CheckEyes(scenario, source)
        worlds = successive(world, scenario.reality.changes)
        if scenario.reality.people:
            # Needed by few missions and slow to import.
            from tfg_drake.simulation.people import ground

            for one in worlds:
                ground(one, scenario.robot.radius)
    except WorldError as error:
        raise ScenarioError(f"{source}: {error}") from None


document_fields(globals())

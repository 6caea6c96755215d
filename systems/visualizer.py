"""The live picture of a mission in Drake's Meshcat, seen from above: what is true, faint, and what the robot knows."""

from __future__ import annotations

import math
import time
from typing import Any, TypeVar

import numpy as np
from pydrake.common import MemoryFile
from pydrake.common.value import AbstractValue
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, State, System

from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    LaserScan,
    MapEstimate,
    MissionStatus,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)
from tfg_drake.pictures import scene
from tfg_drake.pictures.caption import HEIGHT as CAPTION_HEIGHT
from tfg_drake.pictures.caption import WIDTH as CAPTION_WIDTH
from tfg_drake.pictures.caption import Colour, caption_gltf, gain_colours, render_caption
from tfg_drake.pictures.drawing import Mesh as Triangles
from tfg_drake.pictures.drawing import discs, ellipses, outline_segments, ribbons
from tfg_drake.pictures.palette import (
    BARE_SURFACE,
    DOUBTFUL,
    EDGE,
    FREE,
    FRONTIER,
    GHOST,
    LANDMARK,
    OCCUPIED,
    PATH,
    PERSON,
    ROADMAP,
    ROBOT,
    SCAN,
    WALL,
    WALL_END,
)
from tfg_drake.simulation.people import RADIUS, People, places_at
from tfg_drake.slam.pose_prediction import pose_at
from tfg_drake.systems.picture import Picture, picture_of
from tfg_drake.systems.ports import declare_message_input, eval_optional
from tfg_drake.world.world import World

T = TypeVar("T")

# Pictures a simulated second.
RATE = 8.0
# Wall time between two captions, s, and how many of them the browser can still ask for.
CAPTION_INTERVAL = 0.5
CAPTIONS = 8
# Width over height of the narrowest window that shows the whole first view.
ASPECT = 1.5

LEGEND = (
    ("true wall", WALL, "line"),
    ("edge", EDGE, "line"),
    ("wall end", WALL_END, "line"),
    ("surface without tag", BARE_SURFACE, "line"),
    ("landmark, 3\u03c3", LANDMARK, "dot"),
    ("doubtful landmark", DOUBTFUL, "dot"),
    ("frontier", FRONTIER, "dot"),
    ("information gain", FRONTIER, "ramp"),
    ("path", PATH, "line"),
    ("scan", SCAN, "dot"),
)

GRID_LEGEND = (
    ("true wall", WALL, "line"),
    ("occupied", OCCUPIED, "line"),
    ("free", FREE, "dot"),
    ("path", PATH, "line"),
    ("scan", SCAN, "dot"),
)

# Heights, m, one a layer, so that nothing fights for the same pixel and the robot stays on top.
_LAYERS = (
    "free",
    "walls",
    "occupied",
    "roadmap",
    "scan",
    "surfaces",
    "candidates",
    "frontiers",
    "ellipses",
    "landmarks",
    "path",
    "people",
    "robot",
    "heading",
)
_Z = {name: 0.02 * (1 + i) for i, name in enumerate(_LAYERS)}

_SLOW_INPUTS = {
    "map": MapEstimate,
    "tfg": TfgMap,
    "roadmap": Roadmap,
    "goal": GoalChoice,
    "path": Path,
    "grid": GridMap,
}
_FAST_INPUTS = ("pose", "mission", "scan", "people")


class TfgVisualizer(LeafSystem):
    """Draws a mission.

    .. pydrake_system::

        name: TfgVisualizer
        input_ports:
        - pose
        - map
        - tfg
        - roadmap
        - goal
        - path
        - mission
        - scan
        - grid
        - truth
        - people

    Every port is optional and draws its own part. `truth` is the true pose (x, y, theta, v, w) in W, `people` a People
    message. Robot, scan, path and people are drawn at every picture, the rest when its message has changed: the state
    holds the messages that the scene shows. Simulator publishes before it updates, so an unrestricted update at the
    same instant sees exactly the inputs that the picture was made of. A forced publish draws everything.

    Where the picture fails, see `tfg_drake.systems.picture`, nothing is drawn, and everything when it is back.
    """

    def __init__(
        self, meshcat: Meshcat | Picture, world: World | None, X_WM: FloatArray, radius: float, title: str
    ) -> None:
        """
        Args:
            meshcat: where to draw; only what lies under /tfg is touched, and the camera.
            world: the true walls, None where they are not known.
            X_WM: (3,) pose of the map frame in the world, m and rad.
            radius: of the robot, m.
            title: the first words of the caption.
        """
        super().__init__()
        self._picture = picture_of(meshcat)
        self._opened = 0  # which Meshcat holds the scene
        self._world = world
        self._X_WM = np.array(X_WM, dtype=float)
        self._radius = radius
        self._title = title
        self.word = ""  # in the caption instead of the mission's phase, if it is not ""
        self._captions, self._next_caption, self._grid = 0, 0.0, False
        self._inputs = {name: declare_message_input(self, name) for name in (*_SLOW_INPUTS, *_FAST_INPUTS)}
        self._truth = self.DeclareVectorInputPort("truth", 5).get_index()
        self._drawn = self.DeclareAbstractState(AbstractValue.Make(object()))
        self.DeclareInitializationPublishEvent(self._DrawEverything)
        self.DeclarePeriodicPublishEvent(1.0 / RATE, 1.0 / RATE, self._Draw)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / RATE, 0.0, self._Remember)
        self.DeclareForcedPublishEvent(self._DrawEverything)
        # A symbol's size: visible when the whole building fills the window.
        self._view = _view(world, self._X_WM)
        self._unit = max(0.06, (self._view[2] - self._view[0]) / 420.0)
        self._picture.attempt(self._Begin, None)

    def Connect(self, builder: DiagramBuilder, station: System, explorer: System) -> None:
        """Adds it to a builder and connects it to a mission's station and explorer, by port name."""
        builder.AddNamedSystem("visualizer", self)
        for name in (*_SLOW_INPUTS, "pose", "mission"):
            if not explorer.HasOutputPort(name):
                continue
            builder.Connect(explorer.GetOutputPort(name), self.GetInputPort(name))
        builder.Connect(station.GetOutputPort("scan.ranges"), self.GetInputPort("scan"))
        for name, port in (("truth.pose", "truth"), ("truth.people", "people")):
            if station.HasOutputPort(name):
                builder.Connect(station.GetOutputPort(name), self.GetInputPort(port))

    def ShowBeginning(self) -> None:
        """Shows what there is before there is a context: the caption with `word`, no more often than any other."""
        if time.monotonic() >= self._next_caption:
            self._picture.attempt(lambda: self._ShowCaption(f"{self._title}, {self.word}", []), None)

    # Events

    def _DrawEverything(self, context: Context) -> EventStatus:
        self._picture.attempt(lambda: self._ShowEverything(context), None)
        return EventStatus.Succeeded()

    def _Draw(self, context: Context) -> EventStatus:
        self._picture.attempt(lambda: self._ShowChanges(context), None)
        return EventStatus.Succeeded()

    def _Remember(self, context: Context, state: State) -> None:
        # A tuple of messages: copying the context costs nothing, since a message's deep copy is itself.
        shown = tuple(self._Get(context, name, kind) for name, kind in _SLOW_INPUTS.items())
        state.get_mutable_abstract_state(int(self._drawn)).set_value(shown)

    def _Get(self, context: Context, name: str, kind: type[T]) -> T | None:
        return eval_optional(self._inputs[name], context, kind)

    @property
    def _meshcat(self) -> Meshcat:
        return self._picture.meshcat

    def PlaceMap(self, X_WM: FloatArray) -> None:
        """Shows the map at another pose (3,) in the world, as it becomes known."""
        if np.array_equal(X_WM, self._X_WM):
            return
        self._X_WM = np.array(X_WM, dtype=float)
        self._meshcat.SetTransform("/tfg/map", _planar(self._X_WM))

    def _Begin(self) -> None:
        """Shows what stays as it is."""
        self._opened = self._picture.opened
        self._meshcat.Delete("/tfg")
        self._meshcat.SetTransform("/tfg/map", _planar(self._X_WM))
        self._meshcat.SetTransform("/tfg/truth", _planar(self._X_WM))
        self._meshcat.SetProperty("/tfg/truth", "visible", self._world is not None)
        self._meshcat.SetProperty("/tfg/captions", "visible", False)
        self._ShowWalls(self._world)
        self._ShowRobots()
        self._ShowCamera()

    def _ShowEverything(self, context: Context) -> None:
        if self._opened != self._picture.opened:
            self._Begin()
        self._meshcat.SetProperty("/tfg/truth", "visible", self._Truth(context) is not None)
        self._DrawSlow(context, drawn=None)
        self._DrawFast(context)
        self._DrawCaption(context)

    def _ShowChanges(self, context: Context) -> None:
        if self._opened != self._picture.opened:
            self._ShowEverything(context)
            return
        drawn = context.get_abstract_state(int(self._drawn)).get_value()
        self._DrawSlow(context, drawn if isinstance(drawn, tuple) else None)
        self._DrawFast(context)
        if time.monotonic() >= self._next_caption:
            self._DrawCaption(context)

    # What changes with the stage

    def _DrawSlow(self, context: Context, drawn: tuple[object, ...] | None) -> None:
        now: dict[str, Any] = {name: self._Get(context, name, kind) for name, kind in _SLOW_INPUTS.items()}
        before = dict(zip(_SLOW_INPUTS, drawn, strict=True)) if drawn is not None else {}
        changed = {name for name, message in now.items() if message is not None and message is not before.get(name)}
        if "map" in changed:
            self._ShowLandmarks(now["map"])
        if "tfg" in changed:
            self._ShowSurfaces(now["tfg"])
        if "roadmap" in changed:
            self._ShowRoadmap(now["roadmap"])
        if "goal" in changed and now["roadmap"] is not None:
            self._ShowChoice(now["goal"], now["roadmap"])
        if "goal" in changed:
            self._ShowGoal(now["goal"])
        if "grid" in changed:
            self._ShowGrid(now["grid"])
        if "path" in changed:
            self._ShowRibbons("map/path/line", scene.path(now["path"])["segments"], 0.8 * self._unit, "path", PATH)

    def _ShowWalls(self, world: World | None) -> None:
        walls = world.walls if world is not None else np.zeros((0, 4))
        self._ShowRibbons("walls", walls, 1.2 * self._unit, "walls", WALL)

    def _ShowLandmarks(self, estimate: MapEstimate) -> None:
        layer = scene.landmarks(estimate)
        doubtful = layer["doubtful"]
        for some, name, colour in ((~doubtful, "landmarks", LANDMARK), (doubtful, "doubtful", DOUBTFUL)):
            p_ML, covariance = layer["points"][some], layer["covariance"][some]
            self._ShowTriangles(f"map/{name}", discs(p_ML, 1.3 * self._unit, _Z["landmarks"]), colour)
            outlines = outline_segments(ellipses(p_ML, covariance[:, [0, 1, 1, 2]].reshape(-1, 2, 2)))
            self._ShowLines(f"map/ellipses/{name}", outlines, "ellipses", colour)

    def _ShowSurfaces(self, tfg: TfgMap) -> None:
        layer = scene.surfaces(tfg)
        for kind, (name, colour) in enumerate((("edge", EDGE), ("end", WALL_END), ("bare", BARE_SURFACE))):
            pieces = layer["segments"][layer["kind"] == kind]
            self._ShowRibbons(f"map/surfaces/{name}", pieces, self._unit, "surfaces", colour)
        bars = scene.frontiers(tfg)["segments"]
        self._ShowRibbons("map/frontiers", bars, 1.6 * self._unit, "frontiers", FRONTIER)

    def _ShowRoadmap(self, roadmap: Roadmap) -> None:
        layer = scene.roadmap_lines(roadmap)
        self._ShowLines("map/roadmap", layer["points"][layer["edges"]].reshape(-1, 4), "roadmap", ROADMAP)

    def _ShowChoice(self, choice: GoalChoice, roadmap: Roadmap) -> None:
        layer = scene.gains(choice, roadmap)
        candidates = discs(layer["points"], 1.1 * self._unit, _Z["candidates"], corners=10)
        self._ShowTriangles("map/candidates", candidates, np.repeat(gain_colours(layer["share"]), 10, axis=0))

    def _ShowGoal(self, choice: GoalChoice) -> None:
        ring = _circles(scene.goal(choice)["points"], 4.0 * self._unit)
        self._ShowRibbons("map/path/goal", ring, 0.8 * self._unit, "path", PATH)

    def _ShowGrid(self, grid: GridMap) -> None:
        layer = scene.grid_cells(grid)
        for name, colour in (("free", FREE), ("occupied", OCCUPIED)):
            self._ShowRibbons(f"map/grid/{name}", layer[name], grid.resolution, name, colour)

    # What changes all the time

    def _DrawFast(self, context: Context) -> None:
        pose, scan = self._Get(context, "pose", PoseEstimate), self._Get(context, "scan", LaserScan)
        mission = self._Get(context, "mission", MissionStatus)
        if pose is not None:
            self._meshcat.SetTransform("/tfg/map/robot", _planar(pose_at(pose, context.get_time())))
        if pose is not None and scan is not None and math.isfinite(scan.stamp):
            layer = scene.scan_rays(scan, pose)
            points = layer["rays"][1:][layer["met"]]
            self._ShowTriangles("map/scan", discs(points, 0.6 * self._unit, _Z["scan"], corners=6), SCAN)
        if mission is not None:
            self._meshcat.SetProperty("/tfg/map/path", "visible", mission.drives)
        truth = self._Truth(context)
        if truth is not None:
            self._meshcat.SetTransform("/tfg/truth", _planar(truth))
        people = self._Get(context, "people", People)
        if people is not None:
            self._ShowTriangles("people", discs(places_at(people, context.get_time()), RADIUS, _Z["people"]), PERSON)

    def _Truth(self, context: Context) -> FloatArray | None:
        port = self.get_input_port(self._truth)
        return np.asarray(port.Eval(context))[:3] if port.HasValue(context) else None

    def _DrawCaption(self, context: Context) -> None:
        estimate, mission = self._Get(context, "map", MapEstimate), self._Get(context, "mission", MissionStatus)
        pose, truth = self._Get(context, "pose", PoseEstimate), self._Truth(context)
        self._grid = self._inputs["grid"].HasValue(context)
        title, figures = self._title, [("time", f"{context.get_time():.0f} s")]
        if mission is not None:
            title = f"{self._title}, {self.word or mission.outcome or mission.phase}"
            figures.insert(0, ("stage", str(mission.stage)))
        if estimate is not None:
            figures.append(("landmarks", str(len(estimate.ids))))
        if pose is not None:
            figures.append(
                ("1\u03c3", f"{100.0 * math.sqrt(max(np.trace(pose.covariance[:2, :2]) / 2.0, 0.0)):.1f} cm")
            )
        if pose is not None and truth is not None:
            X_MB = pose_at(pose, context.get_time())
            error = np.linalg.norm(transform(self._X_WM, X_MB[:2]) - truth[:2])
            figures.append(("error", f"{100.0 * error:.1f} cm"))
        self._ShowCaption(title, figures)

    def _ShowCaption(self, title: str, figures: list[tuple[str, str]]) -> None:
        entries = GRID_LEGEND if self._grid else LEGEND
        legend = [entry for entry in entries if self._world is not None or entry[1] != WALL]
        document = caption_gltf(render_caption(title, figures, legend), self._view[2] - self._view[0])
        mesh = Mesh(mesh_data=InMemoryMesh(mesh_file=MemoryFile(document.encode(), ".gltf", "caption")))
        self._meshcat.SetObject("/tfg/caption", mesh)
        # A browser asks for the text as a file of its own, some time later. Meshcat keeps what any of these shows.
        self._meshcat.SetObject(f"/tfg/captions/{self._captions % CAPTIONS}", mesh)
        self._captions += 1
        self._next_caption = time.monotonic() + CAPTION_INTERVAL

    # Meshcat

    def _ShowCamera(self) -> None:
        """Looks straight down; the whole building and the caption above it fill the window."""
        x_min, y_min, x_max, y_max = self._view
        caption = (x_max - x_min) * CAPTION_HEIGHT / CAPTION_WIDTH
        margin = 0.025 * (x_max - x_min)
        height, width = y_max - y_min + caption + 3.0 * margin, x_max - x_min + 2.0 * margin
        height = max(height, width / ASPECT)
        center = np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max + caption + margin), 50.0])
        camera = Meshcat.OrthographicCamera()
        camera.left, camera.right = -0.5 * height * ASPECT, 0.5 * height * ASPECT
        camera.bottom, camera.top = -0.5 * height, 0.5 * height
        camera.near, camera.far, camera.zoom = 0.1, 200.0, 1.0
        self._meshcat.SetCamera(camera)
        # A hair to the south of straight down: the orbit controls keep z up, and so north stays up in the picture.
        self._meshcat.SetCameraPose(center - [0.0, 1e-3, 0.0], center * [1.0, 1.0, 0.0])
        for path in ("/Background", "/Grid", "/Axes"):
            self._meshcat.SetProperty(path, "visible", False)
        # Flat colours: ambient light only, so that a surface has the colour it was given.
        for path in ("/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX", "/Lights/FillLight"):
            self._meshcat.SetProperty(path, "visible", False)
        self._meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", math.pi)
        self._meshcat.SetTransform("/tfg/caption", RigidTransform([x_min, y_max + margin + caption, 0.0]))

    def _ShowRobots(self) -> None:
        # At true size, or as large as a symbol where that could not be seen.
        r, z = max(self._radius, 2.2 * self._unit), _Z["robot"]
        tick = np.array([[0.0, 0.0, 0.8 * r, 0.0]])
        self._ShowTriangles("map/robot/body", discs(np.zeros((1, 2)), r, z, corners=32), ROBOT)
        self._ShowRibbons("map/robot/heading", tick, 0.25 * r, "heading", (1.0, 1.0, 1.0))
        self._ShowRibbons("truth", np.vstack([_circles(np.zeros((1, 2)), 1.25 * r), tick]), 0.15 * r, "robot", GHOST)

    def _ShowTriangles(self, path: str, mesh: Triangles, colour: Colour | FloatArray) -> None:
        vertices, faces = mesh
        if not len(faces):
            self._meshcat.Delete(f"/tfg/{path}")
            return
        # Vertex colours are taken as linear light.
        colours = np.broadcast_to(np.asarray(colour) ** 2.2, vertices.shape)
        self._meshcat.SetTriangleColorMesh(f"/tfg/{path}", vertices.T, faces.T, colours.T)

    def _ShowRibbons(self, path: str, segments: FloatArray, width: float, layer: str, colour: Colour) -> None:
        self._ShowTriangles(path, ribbons(segments, width, _Z[layer]), colour)

    def _ShowLines(self, path: str, segments: FloatArray, layer: str, colour: Colour) -> None:
        z = np.full((1, len(segments)), _Z[layer])
        start, end = np.vstack([segments[:, :2].T, z]), np.vstack([segments[:, 2:].T, z])
        self._meshcat.SetLineSegments(f"/tfg/{path}", start, end, 1.0, Rgba(*colour))


def _planar(X_AB: FloatArray) -> RigidTransform:
    return RigidTransform(RotationMatrix.MakeZRotation(float(X_AB[2])), [X_AB[0], X_AB[1], 0.0])


def _circles(centers: FloatArray, radius: float) -> FloatArray:
    """Circles round centers (n, 2) as segments (32 n, 4)."""
    return outline_segments(ellipses(centers, np.tile(np.eye(2), (len(centers), 1, 1)), sigmas=radius))


def _view(world: World | None, X_WM: FloatArray) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max in W, m: the walls, or 15 m round the start where none are known."""
    if world is None or not len(world.walls):
        return X_WM[0] - 15.0, X_WM[1] - 10.0, X_WM[0] + 15.0, X_WM[1] + 10.0
    points = world.walls.reshape(-1, 2)
    (x_min, y_min), (x_max, y_max) = points.min(axis=0), points.max(axis=0)
    return float(x_min), float(y_min), float(x_max), float(y_max)

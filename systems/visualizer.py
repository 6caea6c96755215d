"""Draws a mission in Drake's Meshcat, live and in a recording: the truth faintly, and the robot's knowledge."""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat, Rgba
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, DiagramBuilder, System

from tfg_drake.config import RobotConfig
from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import FloatArray
from tfg_drake.pictures import scene
from tfg_drake.pictures.drawing import MAGNIFIED, bands, circles, ellipses, polyline_segments
from tfg_drake.pictures.layers import LOOKS, Layer, layers
from tfg_drake.pictures.plates import LINE, WIDTH, legend_plate, words_plate
from tfg_drake.pictures.rows import Table
from tfg_drake.pictures.solids import numerals, wavefront
from tfg_drake.simulation.people import RADIUS
from tfg_drake.systems.ports import PERIOD
from tfg_drake.systems.rendered_world import PlanarPose
from tfg_drake.systems.timeline_recorder import TimelineRecorder
from tfg_drake.world.world import World

# Height of text and legend above Meshcat's grid, m.
PLATE_HEIGHT = 0.05
# NUMBER: height of a stop's number, in symbol sizes. SIGMAS: half axes of ellipses, in standard deviations.
NUMBER, SIGMAS = 3.0, 3.0 * MAGNIFIED
# An empty Meshcat path, used to find out whether Meshcat records.
PROBE = "/tfg/recorded"
# Least interval of scans and of the line of text in a recording, s.
RECORDED = 2.0
# A piece of the trail has TRAIL_STEPS steps of at least TRAIL_STEP, m. WORDS: least interval of the live text, s.
TRAIL_STEPS, TRAIL_STEP, WORDS = 16, 0.25, 1.0
# Greatest mean rate of a layer in a recording, bytes per simulated second: a grid changes all the time.
RECORDED_RATE = 50e3
# The camera: VIEW_ANGLE: vertical field of view, rad. ELEVATION: rad. ASPECT: least aspect ratio of a window that shows
# the whole building.
VIEW_ANGLE, ELEVATION, ASPECT = math.radians(35.0), math.radians(58.0), 1.5

_log = logging.getLogger("tfg_drake.visualizer")


# TABLES: layers that are tables. RECORDS: those with one record at a time. DRIVING: those shown while the robot drives.
TABLES = ("map", "wall_landmarks", "tfg", "frontiers", "gains")
RECORDS, DRIVING = ("path", "goal", "grid"), ("path", "goal")


class TfgVisualizer(TimelineRecorder):
    """Draws a mission in Meshcat.

    It has the input ports of TimelineRecorder; every one is optional and draws its own part. It changes only objects
    under /tfg, and the camera.

    While Meshcat records, everything drawn has its time: play it with PublishRecording, save it with StaticHtml.
    Earlier versions of the map stay in the scene, invisible, until another recording or simulation begins.

    A published or saved recording shows its end until you press play under "Open Controls"; from then on the time
    slider works, too.

    A Meshcat that fails, as its server does after a malformed message, is reported once in the log and not used again.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        world: World | None = None,
        X_WM: FloatArray | None = None,
        radius: float = RobotConfig.radius,
    ) -> None:
        """
        Args:
            meshcat: the Meshcat to draw in.
            world: the true walls, None if unknown.
            X_WM: (3,) pose of the map frame in the world, m and rad; by default the start in the world.
            radius: of the robot, m.
        """
        start = np.zeros(3) if world is None else world.start
        self._scene = MeshcatScene(meshcat, world, start if X_WM is None else X_WM, radius)
        super().__init__(self._scene)
        self._scene.begin()
        self.DeclareInitializationPublishEvent(self._Begin)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, self._WriteEnd)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        station: System,
        explorer: System,
        meshcat: Meshcat,
        world: World | None = None,
        radius: float = RobotConfig.radius,
    ) -> TfgVisualizer:
        """Add a visualizer of a mission, connected to its station and explorer by port name."""
        visualizer = TfgVisualizer(meshcat, world, radius=radius)
        builder.AddNamedSystem("visualizer", visualizer)
        visualizer.Connect(builder, station, explorer)
        return visualizer

    def PlaceMap(self, X_WM: FloatArray, time: float) -> None:
        """Show the map at another pose (3,) in the world from a time on, s, when it becomes known."""
        self._scene.write("frame", time, {"pose": X_WM})

    def _Begin(self, context: Context) -> None:
        # Drawings belong to one simulation; another one starts anew.
        self._Forget()
        self._scene.begin(context.get_time())

    def _WriteEnd(self, context: Context) -> None:
        # A mission that is over ends the simulation before the next periodic drawing.
        mission = self._Get(context, "mission")
        if mission is not None and mission.outcome and mission is not self._newest.get("mission"):
            self._Write(True, context)


class MeshcatScene:
    """Draws layers in Meshcat at their times, see TimelineWriter."""

    def __init__(self, meshcat: Meshcat, world: World | None, X_WM: FloatArray, radius: float) -> None:
        """See TfgVisualizer."""
        self._meshcat, self._world, self._X_WM, self._radius = meshcat, world, X_WM, radius
        self._lost = False
        self._view = _view(world, X_WM)
        # A symbol's size, m: visible when the whole building fills the window.
        self._unit = max(0.06, (self._view[2] - self._view[0]) / 420.0)
        _, lines = legend_plate(())
        # Size of a pixel of the plates, m, and their extent in y, south of the building.
        pixel, top = (self._view[2] - self._view[0]) / WIDTH, self._view[1] - 5.0 * self._unit
        self._words_y = top - LINE * pixel, top
        self._legend_y = self._words_y[0] - lines * pixel, self._words_y[0]

    def is_due(self, layer: str, time: float) -> bool:
        """Return True unless the layer was drawn recently or a recording has taken too much of it."""
        return time >= self._due.get(layer, -math.inf)

    def flush(self, *, all_of_it: bool = True) -> None:
        """Do nothing."""

    def begin(self, time: float = 0.0) -> None:
        """Draw the scene before the mission begins, at a time, s."""
        # Number of each object's newest version, and whether a recording contains it.
        self._versions: dict[str, tuple[int, bool]] = {}
        self._old: list[str] = []
        self._recorded = False
        self._shown: dict[str, tuple[bool, float]] = {}
        self._due: dict[str, float] = {}
        self._people = 0
        self._said: dict[str, str] = {}
        self._way: list[FloatArray] = []
        self._drawn: set[str] = set()  # names of layers, and those in the legend
        self._listed: set[str] = set()
        self._attempt(functools.partial(self._Begin, time))

    def write(self, layer: str, time: float, arrays: Mapping[str, NDArray[Any]], **told: Any) -> None:
        """Draw a record."""
        self._attempt(functools.partial(self._Write, layer, time, arrays, told))

    def write_rows(self, layer: str, time: float, table: Table, **told: Any) -> None:
        """Redraw a table."""
        if layer in TABLES:
            shown = layers(layer, table.arrays, SIGMAS)
            self._attempt(functools.partial(self._Show, layer, time, layer, shown))

    def _attempt(self, draw: Callable[[], None]) -> None:
        if self._lost:
            return
        try:
            draw()
        except (Exception, SystemExit) as error:  # Drake's failed assertions come as SystemExit.
            self._lost = True
            reason = " ".join(str(error).split()) or type(error).__name__
            _log.warning("the picture in Meshcat is lost: %s; the mission goes on", reason)

    def _Begin(self, time: float) -> None:
        meshcat, (x_min, y_min, x_max, y_max) = self._meshcat, self._view
        meshcat.Delete("/tfg")
        for path in ("/tfg/map", "/tfg/truth"):
            meshcat.SetTransform(path, PlanarPose(self._X_WM), time)
        self._Toggle("/tfg/truth", self._world is not None, time, self._IsRecorded())
        if self._world is not None:
            floor = np.array([[(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]])
            self._ShowLayers("/tfg/world/floor", [Layer("floor", floor)])
            self._ShowLayers("/tfg/world/walls", layers("world", scene.walls(self._world)))
        # At true size, or as large as a symbol where that could not be seen.
        r, here = max(self._radius, 2.2 * self._unit), np.zeros((1, 2))
        mark = bands(np.array([[0.25 * r, 0.0, 0.85 * r, 0.0]]), 0.25 * r)
        self._ShowLayers("/tfg/map/robot", [Layer("robot", circles(here, r, 32)), Layer("heading", mark)])
        self._ShowLayers("/tfg/truth", [Layer("truth", circles(here, 1.2 * r, 32))])
        self._ShowLegend(time)
        self._ShowCamera()

    def _Write(self, layer: str, time: float, arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any]) -> None:
        if layer == "frame":
            self._X_WM = arrays["pose"]
            self._meshcat.SetTransform("/tfg/map", PlanarPose(arrays["pose"]), time)
        elif layer == "pose":
            self._meshcat.SetTransform("/tfg/map/robot", PlanarPose(arrays["pose"]), time)
            self._ShowTrail(arrays["pose"].astype(float), time)
            self._ShowWords(time)
        elif layer == "truth":
            self._meshcat.SetTransform("/tfg/truth", PlanarPose(arrays["pose"]), time)
            if not self._shown["/tfg/truth"][0]:
                self._Toggle("/tfg/truth", True, time, self._IsRecorded())
        elif layer == "people":
            self._ShowPeople(arrays["points"], time)
        elif layer == "mission":
            recorded, over = self._IsRecorded(), bool(told["outcome"])
            self._Toggle("/tfg/map/driving", told["drives"], time, recorded)
            for name in ("gains", "tour"):  # No goal is left.
                self._Toggle(f"/tfg/map/{name}", not over, time, recorded)
            self._said["mission"] = f"stage {told['stage']}, {told['outcome'].replace('_', ' ') or told['phase']}"
            if over:
                self._said.pop("goal", None)
                self._due["words"] = time
                self._ShowWords(time)
        elif layer == "scan":
            self._ShowScan(arrays["rays"][1:][arrays["met"]], time)
        elif layer == "free":
            (stars,) = layers(layer, arrays)
            for view, star in zip(arrays["index"], stars.shapes, strict=True):
                self._Show(f"free/{view}", time, layer, [stars._replace(shapes=[star])])
        elif layer in RECORDS:
            shown = layers(layer, arrays, cell=told.get("resolution", 0.0))
            self._Show(f"driving/{layer}" if layer in DRIVING else layer, time, layer, shown)
            if layer == "goal" and "tour" in arrays:
                # The numbers stand upright, whatever the map's rotation.
                numbers = numerals(arrays["tour"], NUMBER * self._unit, -float(self._X_WM[2]))
                self._Show("tour", time, "tour", [*layers("tour", arrays), Layer("number", numbers)])
                self._said["goal"] = _words_of_goal(arrays, told, self._X_WM)

    def _ShowTrail(self, pose: FloatArray, time: float) -> None:
        """Draw the path driven, piece by piece, and the uncertainty of the pose; pose: (7,) x, y, yaw and the variances
        xx, xy, yy, yaw."""
        if self._way and np.hypot(*(pose[:2] - self._way[-1])) < TRAIL_STEP:
            return
        self._way.append(pose[:2])
        piece = max(len(self._way) - 2, 0) // TRAIL_STEPS
        way = np.array(self._way[TRAIL_STEPS * piece : TRAIL_STEPS * (piece + 1) + 1])
        self._Show(f"trail/{piece}", time, "trail", [Layer("trail", polyline_segments(way))])
        ellipse = ellipses(pose[None, :2], pose[None, [3, 4, 4, 5]].reshape(-1, 2, 2), SIGMAS)
        self._Show("uncertainty", time, "pose", [Layer("robot_3sigma", ellipse)])

    def _ShowLegend(self, time: float) -> None:
        if self._drawn != self._listed:
            self._listed = set(self._drawn)
            path = self._NextVersion("legend", time, "/tfg")
            self._ShowPlate(path, legend_plate(self._drawn)[0], *self._legend_y)

    def _ShowWords(self, time: float) -> None:
        if not self.is_due("words", time):
            return
        self._ShowLegend(time)
        path = self._NextVersion("words", time, "/tfg")
        self._due["words"] = time + (RECORDED if self._recorded else WORDS)
        said = ", ".join([f"{time:.0f} s", *(self._said[name] for name in ("mission", "goal") if name in self._said)])
        self._ShowPlate(path, words_plate(said), *self._words_y)

    def _ShowPlate(self, path: str, png: bytes, low: float, high: float) -> None:
        """Draw a picture on the floor, as wide as the building, from one y to another, m in W."""
        x_min, _, x_max, _ = self._view
        corners = ((x_min, low), (x_max, low), (x_max, high), (x_min, high))
        lines = [f"v {x:.3f} {y:.3f} {PLATE_HEIGHT}" for x, y in corners]
        obj = "\n".join(["mtllib plate.mtl", *lines, "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl plate"])
        material = "newmtl plate\nKe 1 1 1\nKd 0 0 0\nKs 0 0 0\nmap_Ke plate.png\n"
        mesh = _mesh(f"{obj}\nf 1/1 2/2 3/3 4/4\n", {"plate.mtl": material.encode(), "plate.png": png})
        self._meshcat.SetObject(path, mesh)

    def _ShowPeople(self, points: FloatArray, time: float) -> None:
        for k, place in enumerate(points):
            if k >= self._people:
                self._ShowLayers(f"/tfg/people/{k}", [Layer("person", circles(np.zeros((1, 2)), RADIUS))])
            self._meshcat.SetTransform(f"/tfg/people/{k}", PlanarPose(np.append(place, 0.0)), time)
        self._people = max(self._people, len(points))

    def _ShowScan(self, points: FloatArray, time: float) -> None:
        if self._IsRecorded() and not self.is_due("scan", time):
            return
        self._due["scan"] = time + RECORDED
        self._drawn.add("scan")
        cloud, look = PointCloud(len(points)), LOOKS["scan"]
        cloud.mutable_xyzs()[:] = np.column_stack([points, np.full(len(points), look.high)]).T
        path = self._NextVersion("scan", time)
        self._meshcat.SetObject(path, cloud, 2.0 * look.size * self._unit, Rgba(*look.colour))

    # In Meshcat only transforms and properties have a time, so each version of an object's shape gets its own path.

    def _Show(self, name: str, time: float, record: str, shown: Iterable[Layer]) -> None:
        size = self._ShowLayers(self._NextVersion(name, time), shown)
        if self._recorded:
            self._due[record] = max(time, self._due.get(record, time)) + size / RECORDED_RATE

    def _NextVersion(self, name: str, time: float, under: str = "/tfg/map") -> str:
        """Return the Meshcat path of an object's version from a time on, s: a new path if a recording has the last."""
        recorded = self._IsRecorded()
        if recorded and not self._recorded:
            for path in self._old:  # versions of an earlier recording
                self._meshcat.Delete(path)
            self._old.clear()
            self._meshcat.get_mutable_recording().set_autoplay(False)  # It opens as it ends.
        self._recorded = recorded
        version, is_kept = self._versions.get(name, (0, False))
        path, is_new = f"{under}/{name}/{version}", recorded or is_kept or not version
        if is_new and version:
            self._Toggle(path, False, time, recorded)
            self._old.append(path)
        if is_new:
            version += 1
            path = f"{under}/{name}/{version}"
            self._Toggle(path, True, time, recorded)
        self._versions[name] = version, recorded
        return path

    def _IsRecorded(self) -> bool:
        """Return True if Meshcat records. It has no query, but refuses a number in a recording's track of booleans."""
        self._meshcat.get_mutable_recording().SetProperty(0, PROBE, "visible", True)
        try:
            self._meshcat.SetProperty(PROBE, "visible", 1.0, 0.0)
        except RuntimeError:
            return True
        return False

    def _Toggle(self, path: str, visible: bool, time: float, recorded: bool) -> None:
        """Show or hide the objects at a path from a time on, s; a recording also gets their state before."""
        before, since = self._shown.get(path, (False, -math.inf))
        if recorded:
            start = self._meshcat.get_mutable_recording().start_time()
            self._meshcat.SetProperty(path, "visible", before, max(since, start))
        self._meshcat.SetProperty(path, "visible", visible, time)
        self._shown[path] = visible, time

    def _ShowLayers(self, path: str, shown: Iterable[Layer]) -> int:
        """Draw layers; returns their size, bytes."""
        shown = [layer for layer in shown if len(layer.shapes)]
        self._drawn.update(layer.name for layer in shown)
        obj, materials = wavefront(shown, self._unit)
        if not obj:
            self._meshcat.Delete(path)
            return 0
        mesh = _mesh(f"mtllib materials.mtl\n{obj}\n", {"materials.mtl": materials.encode()})
        self._meshcat.SetObject(path, mesh)
        return len(obj)

    def _ShowCamera(self) -> None:
        """Set the camera south of and above the building, so that building and legend fill the window."""
        x_min, _, x_max, y_max = self._view
        y_min = self._legend_y[0]
        height = max((y_max - y_min) * math.sin(ELEVATION), (x_max - x_min) / ASPECT)
        distance = 0.5 * 1.15 * height / math.tan(0.5 * VIEW_ANGLE) + 0.5 * (y_max - y_min) * math.cos(ELEVATION)
        target = np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0])
        camera = Meshcat.PerspectiveCamera()
        camera.fov, camera.near, camera.far = math.degrees(VIEW_ANGLE), 0.5, 1000.0
        self._meshcat.SetCamera(camera)
        towards = np.array([0.0, -math.cos(ELEVATION), math.sin(ELEVATION)])
        self._meshcat.SetCameraPose(target + distance * towards, target)


def _words_of_goal(arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any], X_WM: FloatArray) -> str:
    stops, done = arrays["tour"], arrays["done"]
    if not len(arrays["points"]):
        return "no goal"
    x, y = transform(X_WM, arrays["points"])[0]
    tour = f", tour of {len(stops)} in {done[-1]:.0f} s" if len(stops) else ""
    return f"goal ({x:.1f}, {y:.1f}) m{tour}, most gain {told['most']:.0f} nats"


def _mesh(obj: str, files: Mapping[str, bytes]) -> Mesh:
    """Return a mesh from the text of an OBJ file and the files that it names."""
    there = {name: MemoryFile(content, f".{name.partition('.')[2]}", name) for name, content in files.items()}
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(obj.encode(), ".obj", "mesh"), supporting_files=there))


def _view(world: World | None, X_WM: FloatArray) -> tuple[float, float, float, float]:
    """Return x_min, y_min, x_max, y_max in W, m: the walls, or 15 m around the start if none are known."""
    if world is None or not len(world.walls):
        return X_WM[0] - 15.0, X_WM[1] - 10.0, X_WM[0] + 15.0, X_WM[1] + 10.0
    points = world.walls.reshape(-1, 2)
    (x_min, y_min), (x_max, y_max) = points.min(axis=0), points.max(axis=0)
    return float(x_min), float(y_min), float(x_max), float(y_max)

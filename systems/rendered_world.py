"""Renders a world: its scene in a SceneGraph, rendered by VTK without a display."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    DepthRange,
    DepthRenderCamera,
    FrameId,
    GeometryFrame,
    GeometryInstance,
    InMemoryMesh,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    QueryObject,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    SceneGraph,
    SourceId,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from tfg_drake.simulation.people import RADIUS
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.hue import hue_of, photographed
from tfg_drake.vision.image import Image
from tfg_drake.vision.mount import CameraMount
from tfg_drake.world.scene import SceneConfig, make_scene
from tfg_drake.world.world import World

_RENDERER = "vtk"
# Clipping range: least and greatest rendered distance, m; a building is smaller.
_NEAREST, _FARTHEST = 0.03, 100.0
# Headings of three directional lamps and their elevation above the horizon, rad.
_LAMP_HEADINGS, _LAMP_HEIGHT = np.radians([20.0, 140.0, 260.0]), math.radians(20.0)

# Height of people, m, and grey levels of their clothes and of the sky.
_TALL, _CLOTHES, _SKY = 1.7, 85.0, 225.0
# Drake's renderer counts (center_x, center_y) from the corner of the first pixel, our calibration from its centre: an
# edge on the optical axis shows it, in colour and in depth (RenderEngineVtk, Drake 1.51).
_PIXEL_CENTRE = 0.5


def AddScene(scene: SceneGraph, world: World, config: SceneConfig) -> SourceId:
    """Add a world with its own renderer to a SceneGraph; returns its source.

    Raises WorldError if the world cannot be drawn.
    """
    drawn = make_scene(world, config)
    look = RenderEngineVtkParams(default_clear_color=_Hue(_SKY), lights=[_Lamp(a) for a in _LAMP_HEADINGS])
    scene.AddRenderer(_RENDERER, MakeRenderEngineVtk(look))
    source = scene.RegisterSource("building")
    files = {
        "scene.mtl": MemoryFile(drawn.mtl, ".mtl", "scene.mtl"),
        "scene.png": MemoryFile(drawn.png, ".png", "scene.png"),
    }
    mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(drawn.obj, ".obj", "scene.obj"), supporting_files=files))
    instance = GeometryInstance(RigidTransform(), mesh, "building")
    instance.set_perception_properties(PerceptionProperties())
    scene.RegisterAnchoredGeometry(source, instance)
    return source


def AddPeople(scene: SceneGraph, source: SourceId, count: int) -> list[FrameId]:
    """Add `count` people, each a cylinder standing on the floor; returns their frames."""
    frames = []
    for k in range(count):
        frame = scene.RegisterFrame(source, GeometryFrame(f"person{k}"))
        body = GeometryInstance(RigidTransform([0.0, 0.0, 0.5 * _TALL]), Cylinder(RADIUS, _TALL), "body")
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(*_Hue(_CLOTHES)))
        body.set_perception_properties(properties)
        scene.RegisterGeometry(source, frame, body)
        frames.append(frame)
    return frames


def _Hue(grey: float) -> NDArray[np.float64]:
    """Return the shares of red, green, blue (3,)."""
    return hue_of(np.array(grey)) / 255.0


def _Lamp(heading: float) -> LightParameter:
    level, down = math.cos(_LAMP_HEIGHT), -math.sin(_LAMP_HEIGHT)
    return LightParameter(
        type="directional", frame="world", direction=[level * math.cos(heading), level * math.sin(heading), down]
    )


def MakeCameraInfo(width: int, height: int, field_of_view: float) -> CameraInfo:
    """Return the intrinsics of a camera without distortion with a horizontal field of view, rad."""
    return CameraInfo(width, height, 2.0 * math.atan(math.tan(0.5 * field_of_view) * height / width))


def calibration_of(info: CameraInfo) -> CameraCalibration:
    """Return the calibration of images that Drake renders with these intrinsics."""
    matrix = np.array(info.intrinsic_matrix(), dtype=float)
    matrix[:2, 2] -= _PIXEL_CENTRE
    return CameraCalibration(info.width(), info.height(), matrix, "plumb_bob", np.zeros(0))


def MakeCameras(info: CameraInfo, least_depth: float, most_depth: float) -> tuple[ColorRenderCamera, DepthRenderCamera]:
    """Return a colour and a depth camera; depth is 0 below least_depth (m), inf beyond most_depth (m)."""
    drawn = ClippingRange(_NEAREST, max(_FARTHEST, most_depth))
    core = RenderCameraCore(_RENDERER, info, drawn, RigidTransform())
    return ColorRenderCamera(core), DepthRenderCamera(core, DepthRange(max(least_depth, _NEAREST), most_depth))


def MountPose(mount: CameraMount) -> RigidTransform:
    """Return X_BC of a camera (z forward) in the body's frame (z up)."""
    return RigidTransform(RotationMatrix(mount.R_BC), mount.p_BC)


def PlanarPose(X_WB: NDArray[Any]) -> RigidTransform:
    """Return X_WB in 3D of a planar pose, the first 3 entries of an array."""
    x, y, theta = np.asarray(X_WB[:3], dtype=float)
    return RigidTransform(RotationMatrix.MakeZRotation(theta), [x, y, 0.0])


class WorldView:
    """Renders single images of a world outside of a diagram, for a stream, a figure or a test."""

    def __init__(self, world: World, mount: CameraMount, info: CameraInfo):
        """mount: of the camera on the body. Raises WorldError if the world cannot be drawn."""
        self._scene = SceneGraph()
        AddScene(self._scene, world, SceneConfig())
        self._context = self._scene.CreateDefaultContext()
        self._colour, self._depth = MakeCameras(info, least_depth=0.1, most_depth=10.0)
        self._X_BC = MountPose(mount)
        self.calibration: CameraCalibration = calibration_of(info)

    def image(self, X_WB: NDArray[np.float64]) -> Image:
        """Return the grey image (h, w) of the camera on a body at the pose X_WB (3,)."""
        image = self._Query().RenderColorImage(
            self._colour, self._scene.world_frame_id(), PlanarPose(X_WB) @ self._X_BC
        )
        return photographed(image.data)

    def depth(self, X_WB: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the depth image (h, w), m along the optical axis, 0 if too near, inf if too far."""
        X_WC = PlanarPose(X_WB) @ self._X_BC
        image = self._Query().RenderDepthImage(self._depth, self._scene.world_frame_id(), X_WC)
        return np.array(image.data[..., 0])

    def _Query(self) -> QueryObject:
        query: QueryObject = self._scene.get_query_output_port().Eval(self._context)
        return query

"""Eyes made of pixels: a camera's tags and a scan from its depth, instead of an ideal tag sensor and scanner."""

from __future__ import annotations

from pydrake.geometry import GeometryFrame, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.sensors import RgbdSensor

from tfg_drake.config import ScanRealityConfig, TagRealityConfig
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.systems.depth_scanner import DepthScanner
from tfg_drake.systems.exposure import Exposure
from tfg_drake.systems.planar_frame_poses import PlanarFramePoses
from tfg_drake.systems.rendered_world import AddPeople, AddScene, MakeCameraInfo, MakeCameras, MountPose, calibration_of
from tfg_drake.systems.tag_detector import TagDetector
from tfg_drake.vision.depth_scan import DepthScanConfig
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagNoise, TagSizes
from tfg_drake.world.scene import SceneConfig
from tfg_drake.world.world import World

# Least width of a tag in the image, pixels: the renderer's mipmaps make a smaller one appear a per cent nearer.
LEAST_SIDE = 18.0
# Noise of tag corners in rendered images, from benchmarks/rendered_detections.py.
TAG_NOISE = TagNoise(pixels=0.04, place=0.001, unlike=0.7)


def MakeRenderedEyes(scenario: Scenario, world: World) -> Diagram:
    """Colour to tags and depth to a scan, each rendered when a frame is due and at no other time.

    .. pydrake_system::

        name: rendered_eyes
        input_ports:
        - pose
        - noise
        - people
        output_ports:
        - detections
        - ranges

    pose: x, y, theta, v, w of the plant. noise: a uniform number, fresh every frame. people: a People message, there
    where people are. detections, ranges: as those of TagSensor and LaserScanner. Raises WorldError where the world
    cannot be drawn.
    """
    config, tags, scan, reality = scenario.camera, scenario.tags, scenario.scan, scenario.reality
    builder = DiagramBuilder()
    scene = builder.AddNamedSystem("scene", SceneGraph())
    source = AddScene(scene, world, SceneConfig(config.tag_size, config.tag_height, config.wall_height))
    robot = scene.RegisterFrame(source, GeometryFrame("robot"))
    poses = builder.AddNamedSystem("frame_poses", PlanarFramePoses(robot, AddPeople(scene, source, reality.people)))
    builder.Connect(poses.GetOutputPort("geometry_pose"), scene.get_source_pose_port(source))

    mount = CameraMount(z=config.mount_height)

    def camera(name: str, field_of_view: float, where: TagRealityConfig | ScanRealityConfig) -> RgbdSensor:
        info = MakeCameraInfo(config.width, config.height, field_of_view)
        X_BF = RigidTransform(RotationMatrix.MakeZRotation(where.yaw), [where.ahead, where.left, 0.0])
        cameras = MakeCameras(info, scan.least_range, scan.range)
        sensor = builder.AddNamedSystem(name, RgbdSensor(robot, X_BF @ MountPose(mount), *cameras))
        builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
        return sensor

    colour = camera("camera", tags.field_of_view, reality.tags)
    calibration = calibration_of(colour.default_color_render_camera().core().intrinsics())
    exposure = Exposure(config.width, config.height, float(calibration.matrix[0, 0]), reality.camera)
    exposure = builder.AddNamedSystem("exposure", exposure)
    sizes = TagSizes(config.tag_size)
    detector = TagDetector(calibration, sizes, mount, tags.rate, noise=TAG_NOISE, least_side=LEAST_SIDE)
    detector = builder.AddNamedSystem("tag_detector", detector)
    builder.Connect(colour.color_image_output_port(), exposure.GetInputPort("image"))
    builder.Connect(exposure.GetOutputPort("image"), detector.GetInputPort("image"))

    depth = camera("depth_camera", scan.field_of_view, reality.scan)
    reach = {"least_depth": scan.least_range, "most_depth": scan.range, "range_max": scan.range}
    sheet = DepthScanConfig(**reach, sigma=scan.noise, noise=reality.camera.depth_noise)
    calibration = calibration_of(depth.default_depth_render_camera().core().intrinsics())
    scanner = builder.AddNamedSystem("depth_scanner", DepthScanner(calibration, mount, sheet, scan.rate))
    builder.Connect(depth.depth_image_32F_output_port(), scanner.GetInputPort("image"))

    builder.ExportInput(poses.GetInputPort("pose"), "pose")
    builder.ConnectInput("pose", exposure.GetInputPort("pose"))
    builder.ExportInput(exposure.GetInputPort("noise"), "noise")
    builder.ConnectInput("noise", scanner.GetInputPort("noise"))
    builder.ExportInput(poses.GetInputPort("people"), "people")
    builder.ExportOutput(detector.GetOutputPort("detections"), "detections")
    builder.ExportOutput(scanner.GetOutputPort("ranges"), "ranges")
    diagram = builder.Build()
    diagram.set_name("eyes")
    return diagram

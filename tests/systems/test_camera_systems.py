"""Tags and walls that Drake renders, seen through the camera's systems: an oracle besides OpenCV's warps."""

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, ImageDepth32F, ImageRgba8U, RgbdSensor

from tests.vision.rendering import DICTIONARY, cv2
from tfg_drake.messages import LaserScan, TagDetections
from tfg_drake.systems.depth_scanner import DepthScanner
from tfg_drake.systems.rendered_world import calibration_of
from tfg_drake.systems.tag_detector import TagDetector
from tfg_drake.vision.depth_scan import DepthScanConfig
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagSizes

INFO = CameraInfo(640, 480, 520.0, 520.0, 319.5, 239.5)
CAMERA = calibration_of(INFO)
MOUNT = CameraMount(x=0.1, y=0.02, z=0.3, yaw=0.1, pitch=-0.05)
WALL = 4.0
# id: place of its centre in B, m, and the direction its front looks to, rad.
TAGS = {4: ([2.0, 0.3, 0.5], np.pi), 11: ([1.5, -0.3, 0.4], np.pi - 0.5), 300: ([2.5, -0.2, 0.6], np.pi + 0.7)}


def tag_mesh(folder, tag, size):
    """A quad with a tag's texture, its normal along x; the white border is one cell wide."""
    texture = np.full((400, 400), 255, np.uint8)
    texture[40:-40, 40:-40] = cv2.aruco.generateImageMarker(DICTIONARY, tag, 320)
    cv2.imwrite(str(folder / f"{tag}.png"), texture)
    h = 0.5 * size * 10 / 8
    (folder / f"{tag}.mtl").write_text(f"newmtl tag\nKd 1 1 1\nmap_Kd {tag}.png\n", encoding="utf-8")
    (folder / f"{tag}.obj").write_text(
        f"mtllib {tag}.mtl\nv 0 {-h} {-h}\nv 0 {h} {-h}\nv 0 {h} {h}\nv 0 {-h} {h}\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 1 0 0\nusemtl tag\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n",
        encoding="utf-8",
    )
    return Mesh(str(folder / f"{tag}.obj"))


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """The diagram's newest detections, remarks and scan."""
    folder, builder = tmp_path_factory.mktemp("tags"), DiagramBuilder()
    scene = builder.AddSystem(SceneGraph())
    scene.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    source = scene.RegisterSource("world")

    def anchor(shape, X_WG, name, colour):
        instance = GeometryInstance(X_WG, shape, name)
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(*colour, 1.0))
        instance.set_perception_properties(properties)
        scene.RegisterAnchoredGeometry(source, instance)

    for tag, (place, facing) in TAGS.items():
        X_WG = RigidTransform(RotationMatrix.MakeZRotation(facing), place)
        anchor(tag_mesh(folder, tag, 0.16), X_WG, f"tag{tag}", (1, 1, 1))
    anchor(Box(0.2, 20.0, 6.0), RigidTransform([WALL + 0.1, 0.0, 0.0]), "wall", (0.5, 0.5, 0.5))
    core = RenderCameraCore("vtk", INFO, ClippingRange(0.05, 30.0), RigidTransform())
    sensor = builder.AddSystem(
        RgbdSensor(
            scene.world_frame_id(),
            RigidTransform(RotationMatrix(MOUNT.R_BC), MOUNT.p_BC),
            ColorRenderCamera(core),
            DepthRenderCamera(core, DepthRange(0.2, 10.0)),
        )
    )
    builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
    detector = builder.AddNamedSystem("tag_detector", TagDetector(CAMERA, TagSizes(0.16), MOUNT))
    config = DepthScanConfig(low=0.05, high=0.35, least_depth=0.2, most_depth=8.0, range_max=8.0)
    scanner = builder.AddNamedSystem("depth_scanner", DepthScanner(CAMERA, MOUNT, config))
    builder.Connect(sensor.color_image_output_port(), detector.GetInputPort("image"))
    builder.Connect(sensor.depth_image_32F_output_port(), scanner.GetInputPort("image"))
    for system, port in ((detector, "detections"), (detector, "remarks"), (scanner, "ranges")):
        builder.ExportOutput(system.GetOutputPort(port), port)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.2)
    context = simulator.get_context()
    return [simulator.get_system().GetOutputPort(p).Eval(context) for p in ("detections", "remarks", "ranges")]


def test_rendered_tags_are_where_they_are(rendered):
    detections, remarks, _ = rendered
    assert isinstance(detections, TagDetections)
    assert remarks == ()
    assert detections.stamp == 0.125
    assert detections.ids.tolist() == sorted(TAGS)
    places = np.array([TAGS[tag][0] for tag in sorted(TAGS)])
    np.testing.assert_allclose(detections.range, np.hypot(places[:, 0], places[:, 1]), atol=0.02)
    np.testing.assert_allclose(detections.bearing, np.arctan2(places[:, 1], places[:, 0]), atol=np.radians(0.05))


def test_a_rendered_wall_is_where_it_is(rendered):
    scan = rendered[2]
    assert isinstance(scan, LaserScan)
    assert scan.stamp == 0.125
    assert len(scan.ranges) > 600
    x = scan.ranges * np.cos(scan.angles)
    # The mount's tilt leaves a column's direction open by a part of a column; a quad hides some of the wall.
    assert np.count_nonzero(np.abs(x - WALL) < 0.005) > 0.8 * len(x)
    assert (x < WALL + 0.01).all()


def test_before_the_first_frame_there_is_nothing():
    detector, scanner = TagDetector(CAMERA, TagSizes(0.16), MOUNT), DepthScanner(CAMERA, MOUNT)
    detections = detector.GetOutputPort("detections").Eval(detector.CreateDefaultContext())
    assert detections.stamp == -np.inf
    assert detector.GetOutputPort("remarks").Eval(detector.CreateDefaultContext()) == ()
    assert scanner.GetOutputPort("ranges").Eval(scanner.CreateDefaultContext()).stamp == -np.inf


def test_a_wrong_image_is_told_by_the_detector():
    detector = TagDetector(CAMERA, TagSizes(0.16), MOUNT)
    context = detector.CreateDefaultContext()
    detector.GetInputPort("image").FixValue(context, ImageRgba8U(320, 240))
    Simulator(detector, context).AdvanceTo(0.01)
    assert "320 x 240" in detector.GetOutputPort("remarks").Eval(context)[0]


def test_ports_hold_drake_s_images():
    for system, image in ((TagDetector(CAMERA, TagSizes(0.16), MOUNT), ImageDepth32F(640, 480)),
                          (DepthScanner(CAMERA, MOUNT), ImageRgba8U(640, 480))):  # fmt: skip
        with pytest.raises(Exception, match="Image"):
            system.GetInputPort("image").FixValue(system.CreateDefaultContext(), image)

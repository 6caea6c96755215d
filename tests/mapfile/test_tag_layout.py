import dataclasses
import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tfg_drake.datasets import tagslam
from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
from tfg_drake.mapfile.tag_layout import apriltag_ros_yaml, left_out, tagslam_yaml, wpilib_json
from tfg_drake.tfg.graph import empty_map

HEIGHT = 0.4
UP = np.array([0.0, 0.0, 1.0])


def assert_hang_as_mapped(saved, ids, p_WT, out, up):
    """Tags with these ids hang upright where the map has them, and face where it says."""
    assert list(ids) == saved.ids.tolist()
    n = len(saved.ids)
    np.testing.assert_allclose(p_WT, np.column_stack([landmarks_in_world(saved)[0], np.full(n, HEIGHT)]))
    np.testing.assert_allclose(out, np.column_stack([tfg_in_world(saved).facing, np.zeros(n)]), atol=1e-9)
    np.testing.assert_allclose(up, np.tile(UP, (n, 1)), atol=1e-9)


def test_robotpy_reads_wpilibs(small_map, tmp_path):
    apriltag = pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is missing: 'tfg-drake[camera]'")
    (tmp_path / "field.json").write_text(wpilib_json(small_map, HEIGHT))
    layout = apriltag.AprilTagFieldLayout(str(tmp_path / "field.json"))
    ids = sorted(tag.ID for tag in layout.getTags())
    tags = [layout.getTagPose(tag) for tag in ids]
    R = np.array([tag.rotation().toMatrix() for tag in tags])
    p_WT = [[tag.x, tag.y, tag.z] for tag in tags]
    assert_hang_as_mapped(small_map, ids, p_WT, R[:, :, 0], R[:, :, 2])
    size = layout.getFieldLength(), layout.getFieldWidth()
    np.testing.assert_allclose(size, landmarks_in_world(small_map)[0].max(axis=0))


def test_our_reader_of_tagslam_reads_tagslams(small_map, tmp_path):
    (tmp_path / "tagslam.yaml").write_text(tagslam_yaml(small_map, HEIGHT, 0.2))
    for name in ("cameras.yaml", "camera_poses.yaml"):
        (tmp_path / name).write_text("{}\n")
    setup = tagslam._Setup(tmp_path)
    assert setup.sizes == dict.fromkeys([10, 11, 12, 13], 0.2)
    body = yaml.safe_load((tmp_path / "tagslam.yaml").read_text())["bodies"][0]["map"]
    R = np.array([tagslam._pose(tag["pose"])[0] for tag in body["tags"]])
    assert_hang_as_mapped(small_map, setup.surveyed_ids, setup.p_WT, R[:, :, 2], R[:, :, 1])
    # Tag 10 faces -y: who looks at it looks along y, and has x to the right.
    np.testing.assert_allclose(R[0, :, 0], [1.0, 0.0, 0.0], atol=1e-9)
    # Along the wall and across, tags 10 and 12 facing -x and -y in M.
    for row, (along, across) in ((0, (1, 0)), (2, (0, 1))):
        noise, P = body["tags"][row]["pose"]["position_noise"], small_map.landmark_covariance[row]
        np.testing.assert_allclose([noise["x"], noise["z"]], np.sqrt([P[along, along], P[across, across]]))


def test_apriltag_ros_has_them_as_a_bundle(small_map):
    tree = yaml.safe_load(apriltag_ros_yaml(small_map, HEIGHT, 0.2))
    (bundle,) = tree["tag_bundles"]
    assert (tree["standalone_tags"], bundle["name"]) == ([], "map")
    layout = bundle["layout"]
    assert {tag["size"] for tag in layout} == {0.2}
    R = Rotation.from_quat([[tag[name] for name in ("qx", "qy", "qz", "qw")] for tag in layout]).as_matrix()
    p_WT = [[tag[name] for name in "xyz"] for tag in layout]
    assert_hang_as_mapped(small_map, [tag["id"] for tag in layout], p_WT, R[:, :, 2], R[:, :, 1])


def test_tags_that_face_nowhere_or_are_doubtful_are_left_out(small_map):
    facing = small_map.tfg.facing.copy()
    facing[1] = 0.0
    tfg = dataclasses.replace(small_map.tfg, facing=facing)
    partly = dataclasses.replace(small_map, tfg=tfg, doubtful=np.array([11, 12]))
    tags = yaml.safe_load(apriltag_ros_yaml(partly, HEIGHT, 0.2))["tag_bundles"][0]["layout"]
    assert [tag["id"] for tag in tags] == [10, 13]
    assert left_out(partly) == [
        "left out, as it is not known which way they face: tags 11",
        "left out, as they are doubtful: tags 12",
    ]
    none = dataclasses.replace(small_map, tfg=empty_map())
    assert left_out(none) == ["left out, as it is not known which way they face: tags 10, 11, 12, 13"]
    assert yaml.safe_load(tagslam_yaml(none, HEIGHT, 0.2))["bodies"][0]["map"]["tags"] == []
    assert json.loads(wpilib_json(none, HEIGHT))["tags"] == []
    assert left_out(small_map) == []

"""What is written by hand is what protobuf reads."""

import dataclasses
import itertools

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from tfg_drake.messages import Path, PoseEstimate
from tfg_drake.storage import foxglove
from tfg_drake.storage.port_recording import MAP_SHARE, PortWriter, read_recording


def pose(stamp, theta=0.5):
    none = np.zeros(0, dtype=np.int64)
    return PoseEstimate(stamp, np.array([1.0, -2.0, theta]), np.eye(3), np.zeros(2), 1, none, np.zeros((0, 2)))


def test_a_pose_ties_base_to_map():
    read = FrameTransform.FromString(foxglove.pose_message(13.0, pose(12.5)))
    assert (read.parent_frame_id, read.child_frame_id) == ("map", "base")
    assert (read.translation.x, read.translation.y, read.translation.z) == (1.0, -2.0, 0.0)
    assert 2.0 * np.arctan2(read.rotation.z, read.rotation.w) == pytest.approx(0.5)
    assert (read.timestamp.seconds, read.timestamp.nanos) == (12, 500_000_000)


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_a_path_is_lines_from_point_to_point(count):
    points = np.random.default_rng(count).normal(size=(count, 2))
    (entity,) = SceneUpdate.FromString(foxglove.path_message(3.0, Path(1, 1, points))).entities
    assert (entity.id, entity.frame_id, entity.lines[0].type) == ("path", "map", foxglove.LINE_LIST)
    ends = [(p.x, p.y, p.z) for p in entity.lines[0].points]
    assert ends == [(x, y, 0.0) for pair in itertools.pairwise(points) for x, y in pair]


def test_a_map_is_its_surfaces_frontiers_walls_and_tags(walled_map):
    data = foxglove.map_message(2.0, (walled_map, walled_map.tfg, walled_map.graph))
    entities = {one.id: one for one in SceneUpdate.FromString(data).entities}
    assert {one.frame_id for one in entities.values()} == {"map"}

    def ends(name):
        return np.array([(p.x, p.y) for p in entities[name].lines[0].points]).reshape(-1, 4)

    for kind, name in enumerate(("edge", "wall_end", "bare_surface")):
        np.testing.assert_array_equal(ends(name), walled_map.tfg.segments[walled_map.tfg.segment_kind == kind])
    assert len(ends("frontier")) == len(walled_map.tfg.frontiers)
    np.testing.assert_allclose(ends("wall_landmark"), [[1.0, 1.0, 4.0, 5.0]])
    tags = entities["landmark"]
    np.testing.assert_array_equal([(one.pose.position.x, one.pose.position.y) for one in tags.spheres], walled_map.p_ML)
    assert [int(one.text) for one in tags.texts] == walled_map.ids.tolist()


def test_maps_take_a_share_of_the_file(tmp_path, small_map):
    """A large map is shown seldom."""
    size = len(foxglove.map_message(0.0, (small_map, small_map.tfg, None)))
    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        shown = 0
        for stage in range(1, 1000):
            assert writer.wants_map(stage)
            writer._bytes += 100
            before = writer._bytes
            writer.write_map(float(stage), small_map, dataclasses.replace(small_map.tfg, stage=stage), None)
            shown += writer._bytes < before
            assert not writer.wants_map(stage)
    assert shown == pytest.approx(1000 * 100 * MAP_SHARE / size, abs=1.0)


def test_what_is_shown_is_not_played(tmp_path):
    from tests.storage.test_port_recording import messages

    with PortWriter(tmp_path / "ports.mcap", "sim") as writer:
        for port, one in messages(0.0).items():
            writer.write(port, 0.0, one)
        writer.write(foxglove.POSE, 0.5, pose(0.5))
        writer.write(foxglove.PATH, 0.5, Path(1, 1, np.zeros((2, 2))))
    assert read_recording(tmp_path).end_time == 0.0

"""Range and bearing of rendered tags and of TagSLAM's recorded corners, and what is left out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from tests.cameras import pinhole
from tests.vision.rendering import corners_of, projected, render
from tfg_drake.datasets import tagslam
from tfg_drake.messages import replace
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagNoise, TagSizes, nothing_sighted, sighted
from tfg_drake.vision.tag_detector import TagDetector, TagsInImage

CAMERA = pinhole(640, 480, 520.0)
SIZES = TagSizes(0.16)
AHEAD = CameraMount()


def seen(positions, ids=None, R_CT=None, camera=CAMERA, **changes):
    """Exact TagsInImage of tags at positions (n, 3) in C, as seen straight."""
    n = len(positions)
    turned = np.eye(3) if R_CT is None else R_CT
    corners = np.array([projected(corners_of(turned, p, 0.16), camera) for p in positions]).reshape(-1, 4, 2)
    tags = TagsInImage(
        camera.width, camera.height, np.arange(n) if ids is None else np.array(ids), corners, np.full(n, 99.0),
        np.ones(n),
        n * ("tag36h11",),
    )  # fmt: skip
    return replace(tags, **changes)


def test_exact_corners_give_exact_range_and_bearing_in_the_body_s_plane():
    mount = CameraMount(x=0.1, y=-0.05, z=0.4, yaw=0.3, pitch=0.2, roll=-0.1)
    p_CT = np.array([[0.3, 0.1, 2.0], [-0.5, -0.2, 1.5]])
    p_BT = p_CT @ mount.R_BC.T + mount.p_BC
    found = sighted(seen(p_CT, [7, 9]), 3.5, CAMERA, SIZES, mount)
    assert found.remarks == ()
    assert found.detections.stamp == 3.5
    assert found.detections.ids.tolist() == [7, 9]
    np.testing.assert_allclose(found.detections.range, np.hypot(p_BT[:, 0], p_BT[:, 1]), atol=1e-5)
    np.testing.assert_allclose(found.detections.bearing, np.arctan2(p_BT[:, 1], p_BT[:, 0]), atol=1e-5)


def test_the_mount_s_angles_are_those_of_the_body():
    """A camera that looks left sees what is ahead of it at 90 degrees; one that looks down sees the floor."""
    np.testing.assert_allclose(CameraMount().R_BC @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(CameraMount().R_BC @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(CameraMount(yaw=np.pi / 2).R_BC @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(CameraMount(pitch=0.5).R_BC @ [0, 0, 1], [np.cos(0.5), 0, -np.sin(0.5)], atol=1e-12)


@pytest.mark.parametrize("incidence", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 1.0])
def test_rendered_tags_are_where_they_are(incidence):
    """Markers, warps and projection are OpenCV's. Rendered corners err by far less than is stated for real ones."""
    rng, detector, noise = np.random.default_rng(3), TagDetector(), TagNoise(pixels=0.03, place=0.0005, unlike=0.0)
    squares = []
    for k in range(40):
        distance = 0.7 + 2.3 * k / 40
        p_CT = np.append(rng.uniform(-0.35, 0.35, 2), 1.0) * distance
        turn = Rotation.from_euler("ZYX", [rng.uniform(-0.3, 0.3), rng.choice([-1, 1]) * incidence, 0.0])
        facing = Rotation.from_rotvec(np.arctan2(p_CT[0], p_CT[2]) * np.array([0.0, 1.0, 0.0]))
        image = render([(k, (facing * turn).as_matrix(), p_CT, 0.16)], CAMERA, seed=k)
        found = sighted(detector.detect(image), 0.0, CAMERA, SIZES, AHEAD, noise).detections
        if not len(found.ids):
            continue
        assert found.ids.tolist() == [k]
        along, across = found.range[0] - np.hypot(p_CT[0], p_CT[2]), found.bearing[0] + np.arctan2(p_CT[0], p_CT[2])
        assert abs(along) < 0.01 + 0.01 * distance**2
        assert abs(across) < np.radians(0.1)
        squares.append([(along / found.sigma_range[0]) ** 2, (across / found.sigma_bearing[0]) ** 2])
    assert len(squares) >= (40 if incidence < 0.9 else 36)
    assert (np.mean(squares, axis=0) < 1.4).all()
    assert np.mean(squares, axis=0)[0] > 0.1


def test_deviations_are_those_of_noisy_corners():
    rng, noise = np.random.default_rng(4), TagNoise(pixels=0.3, place=0.0)
    squares = []
    for _ in range(1000):
        p_CT = np.append(rng.uniform(-0.3, 0.3, 2), 1.0) * rng.uniform(0.8, 3.0)
        R_CT = Rotation.from_euler("ZYX", rng.uniform(-0.8, 0.8, 3)).as_matrix()
        tags = seen([p_CT], R_CT=R_CT)
        tags = replace(tags, corners=tags.corners + 0.3 * rng.normal(size=(1, 4, 2)))
        found = sighted(tags, 0.0, CAMERA, SIZES, AHEAD, noise).detections
        along, across = found.range[0] - np.hypot(p_CT[0], p_CT[2]), found.bearing[0] + np.arctan2(p_CT[0], p_CT[2])
        squares.append([(along / found.sigma_range[0]) ** 2, (across / found.sigma_bearing[0]) ** 2])
    anees = np.mean(squares, axis=0)
    assert ((anees > 0.85) & (anees < 1.2)).all(), anees


def test_a_tag_that_is_partly_hidden_has_larger_deviations():
    whole = sighted(seen(THREE), 1.0, CAMERA, SIZES, AHEAD, TagNoise(pixels=0.1)).detections
    cut = sighted(seen(THREE, likeness=np.full(3, 0.96)), 1.0, CAMERA, SIZES, AHEAD, TagNoise(pixels=0.1, unlike=2.0))
    far = TagNoise(pixels=np.hypot(0.1, 2.0 * 0.2))
    expected = sighted(seen(THREE), 1.0, CAMERA, SIZES, AHEAD, far).detections
    np.testing.assert_allclose(cut.detections.sigma_range, expected.sigma_range)
    assert (cut.detections.sigma_range > whole.sigma_range).all()


def test_a_size_is_an_id_s_else_its_family_s_else_any():
    sizes = TagSizes(0.1, {"tag36h11": 0.16}, {1: 0.32})
    assert [sizes.of(1, "tag36h11"), sizes.of(2, "tag36h11"), sizes.of(3, "tag16h5")] == [0.32, 0.16, 0.1]
    tags = seen([[0.0, 0.0, 2.0], [0.3, 0.0, 2.0]], [1, 2])
    ranges = sighted(tags, 0.0, CAMERA, sizes, AHEAD).detections.range
    np.testing.assert_allclose(ranges, [4.0, np.hypot(0.3, 2.0)], atol=1e-4)


def remarks(tags, sizes=SIZES, camera=CAMERA, **limits):
    found = sighted(tags, 1.0, camera, sizes, AHEAD, **limits)
    assert all("\n" not in line for line in found.remarks)
    return found.detections.ids.tolist(), found.remarks


THREE = [[0.0, 0.0, 2.0], [0.4, 0.0, 2.0], [-0.4, 0.0, 2.0]]


def test_what_is_left_out_is_told():
    assert remarks(seen(THREE, [4, 7, 7])) == (
        [4], ("tag 7: 2 times in one image; all are left out, print each id once",),
    )  # fmt: skip
    assert remarks(seen(THREE, [4, 7, 7], families=("tag36h11", "tag36h11", "tag16h5"))) == (
        [4],
        ("tag 7: 2 times in one image of the families tag16h5 and tag36h11; all are left out, print each id once",),
    )
    assert remarks(seen(THREE, margin=np.array([99.0, 12.0, 31.0]))) == (
        [0, 2], ("tag 1: decision margin 12, below 30; left out as hidden, blurred or far",),
    )  # fmt: skip
    assert remarks(seen(THREE, likeness=np.array([0.99, 0.8, 0.95]))) == (
        [0, 2], ("tag 1: its cells are not where its outline is; left out as half hidden",),
    )  # fmt: skip
    assert remarks(seen(THREE, families=("tag36h11", "tag16h5", "tag36h11")), TagSizes(None, {"tag36h11": 0.16})) == (
        [0, 2], ("tag 1: the size of tag16h5 is not given; left out",),
    )  # fmt: skip
    assert remarks(seen([[0.0, 0.0, 2.0], [1.25, 0.0, 2.0]])) == ([0], ("tag 1: at the edge of the image; left out",))
    line = seen(THREE)
    corners = line.corners.copy()
    corners[1] = [[100, 100], [101, 101], [102, 102], [103, 103]]
    assert remarks(replace(line, corners=corners)) == ([0, 2], ("tag 1: its corners are no square's; left out",))
    assert remarks(seen([[0.0, 0.0, 4.5], [0.4, 0.0, 5.2]]), least_side=18.0) == (
        [0], ("tag 1: 16 pixels wide, below 18; left out as too far",),
    )  # fmt: skip


def test_an_image_of_another_size_than_the_calibration_s():
    assert remarks(seen(THREE), camera=pinhole(320, 240, 260.0)) == (
        [],
        (
            "the image has 640 x 480 pixels, the calibration 320 x 240: no tag is used; set the camera to the "
            "calibration's size or calibrate anew",
        ),
    )


def test_no_tags():
    assert remarks(seen(np.zeros((0, 3)))) == ([], ())
    assert nothing_sighted().detections.stamp == -np.inf


def test_half_hidden_tags_are_no_tags():
    image = render([(5, np.eye(3), [-0.2, 0.0, 1.0], 0.16), (3, np.eye(3), [0.2, 0.0, 1.0], 0.16)], CAMERA)
    image[:, 340:425] = 128  # the left half of tag 3
    ids, _ = remarks(TagDetector().detect(image))
    assert ids == [5]


# The survey has these somewhere else, by 18 and 28 cm in every sighting.
MISPLACED = (79, 97)


@pytest.fixture(scope="module")
def recorded(shared_data):
    """Of TagSLAM's test_11: stamp, id, true range, errors of range (m) and bearing (rad), normalised squared errors of
    both, a row a sighting. Truth is the survey and TagSLAM's own trajectory, which err by centimetres themselves."""
    folder = shared_data("tagslam") / "test_11"
    setup = tagslam._Setup(folder)
    stamps, R_WR, p_WR = tagslam._rig_poses(folder, "tagslam_reference.csv", np.eye(3), np.zeros(3), [])
    file = tagslam.find_file(folder, "tag_corners.csv")
    table, _ = tagslam.read_table(file, tagslam._TAG_COLUMNS, names={"camera": setup.named})
    cameras = list(setup.cameras.values())
    places = dict(zip(setup.surveyed_ids.tolist(), setup.p_WT, strict=True))
    inside = (table[:, 0] >= stamps[0]) & (table[:, 0] <= stamps[-1])
    every_third = np.searchsorted(np.unique(table[:, 0]), table[:, 0]) % 3 == 0
    rotations, rows = Slerp(stamps, Rotation.from_matrix(R_WR)), []
    for row in np.flatnonzero(inside & every_third):
        t, camera, tag, _, *corners = table[row]
        if int(tag) not in places:
            continue
        one = cameras[int(camera)]
        camera = replace(one["calibration"], width=1280, height=1024)
        R, p = rotations(t).as_matrix(), np.array([np.interp(t, stamps, p_WR[:, k]) for k in range(3)])
        # A body that is level and looks along W's x axis at the rig.
        R_BC, p_BC = R @ one["R_RC"], R @ one["p_RC"]
        angles = Rotation.from_matrix(R_BC @ CameraMount().R_BC.T).as_euler("ZYX")
        mount = CameraMount(*p_BC, *angles)
        np.testing.assert_allclose(mount.R_BC, R_BC, atol=1e-12)
        tags = TagsInImage(
            1280,
            1024,
            np.array([int(tag)]),
            np.array(corners).reshape(1, 4, 2),
            np.array([99.0]),
            np.ones(1),
            ("tag36h11",),
        )
        size = TagSizes(setup.sizes.get(int(tag), setup.default_size))
        found = sighted(tags, t, camera, size, mount).detections
        if len(found.ids):
            x, y = (places[int(tag)] - p)[:2]
            e = found.range[0] - np.hypot(x, y)
            b = (found.bearing[0] - np.arctan2(y, x) + np.pi) % (2.0 * np.pi) - np.pi
            squares = (e / found.sigma_range[0]) ** 2, (b / found.sigma_bearing[0]) ** 2
            rows.append([t, tag, np.hypot(x, y), e, b, *squares])
    assert np.count_nonzero(inside & every_third) > 1000
    return np.array(rows)


def test_recorded_corners_give_range_and_bearing(recorded):
    distance, along, across = recorded[:, 2], np.abs(recorded[:, 3]), np.degrees(np.abs(recorded[:, 4]))
    assert np.count_nonzero(distance < 4.0) > 1000
    assert np.median(along[distance < 4.0]) < 0.03
    assert np.median(across[(distance > 2.0) & (distance < 4.0)]) < 0.5


@pytest.mark.parametrize("half", [0, 1])
def test_recorded_errors_are_as_large_as_stated(recorded, half):
    """The two deviations of TagNoise were fitted to the even frames (half 0), each tag weighing the same; the odd ones
    check them. Frames of one visit err alike, so that the halves are no independent runs: of the first 100 s alone the
    means are 1.38 and 1.43, of the rest 0.95 and 1.38."""
    frame = np.searchsorted(np.unique(recorded[:, 0]), recorded[:, 0])
    distance = recorded[:, 2]
    good = (frame % 2 == half) & (distance > 0.5) & (distance < 4.0) & ~np.isin(recorded[:, 1], MISPLACED)
    tags = recorded[good, 1]
    means = np.array([recorded[good][tags == tag, 5:].mean(axis=0) for tag in np.unique(tags)])
    assert len(means) >= 15
    assert ((means.mean(axis=0) > 0.7) & (means.mean(axis=0) < 1.4)).all(), means.mean(axis=0)

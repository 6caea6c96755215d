"""The detector on photographs, with a detector's own answers beside them, and on rendered tags."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.cameras import pinhole
from tests.vision.rendering import corners_of, cv2, projected, render
from tfg_drake.vision.tag_detector import DetectorConfig, TagDetector

CAMERA = pinhole(640, 480, 520.0)
# How many tags a stock detector finds in pupil's photographs of several, and in NASA's.
PUPIL = {1: 2, 2: 4, 3: 4, 4: 3, 5: 4, 6: 3, 7: 6, 8: 1, 9: 1, 10: 3}
NASA = {"33369213973_9d9bb4cc96_c": 12, "34085369442_304b6bafd9_c": 22, "34139872896_defdb2f8d9_c": 10}


def test_every_photograph_shows_its_tags(shared_data):
    folder, detector = shared_data("apriltag") / "pupil", TagDetector()
    for path in sorted(folder.glob("*.png")):
        tags = detector.detect(cv2.imread(str(path)))
        if "multiple" in path.stem:
            assert len(tags.ids) >= PUPIL[int(path.stem[-2:])], path.name
        elif "rotation" in path.stem:
            assert tags.ids.tolist() == [76], path.name
        else:
            assert tags.ids.tolist() == [318, 387]
        assert (tags.margin > 50.0).all()


def test_a_tag_that_is_turned_is_seen_to_turn(shared_data):
    """The angle between the optical axis and the tag's normal, of the better one of the two poses of IPPE. That the
    sensor does not trust it from far away is no reason to see corners wrongly nearby."""
    folder, detector = shared_data("apriltag") / "pupil", TagDetector()
    info = yaml.safe_load((folder / "test_info.yaml").read_text(encoding="utf-8"))["rotation_test"]
    square = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]]) * info["tag_size"]
    told = np.arange(-70, 80, 10)
    angles = []
    for degrees in told:
        tags = detector.detect(cv2.imread(str(folder / f"test_image_rotation_{degrees}.png")))
        _, rotations, _, _ = cv2.solvePnPGeneric(
            square, tags.corners[0][::-1, None], np.array(info["K"]).reshape(3, 3), None, flags=cv2.SOLVEPNP_IPPE
        )
        normal = cv2.Rodrigues(rotations[0])[0][:, 2]
        angles.append(np.degrees(np.arctan2(normal[0], -normal[2])))
    assert (np.diff(angles) > 0.0).all(), angles
    np.testing.assert_allclose(angles, told, atol=9.0)


@pytest.mark.parametrize("name", NASA)
def test_small_tags_in_a_crowd(name, shared_data):
    folder = shared_data("apriltag") / "nasa"
    tags = TagDetector(DetectorConfig(decimation=1.0)).detect(cv2.imread(str(folder / f"{name}.jpg"), 0))
    lines = (folder / f"{name}.txt").read_text(encoding="utf-8").split("\n")
    told = [[float(word.strip("(),")) for word in line.split()[1:]] for line in lines if line.strip()]
    expected = np.array(told).reshape(-1, 4, 2).mean(axis=1) - 0.5
    found = tags.corners.mean(axis=1)
    near = np.linalg.norm(expected[:, None] - found[None], axis=2).min(axis=1) < 2.0
    assert np.count_nonzero(near) >= NASA[name]
    assert (tags.ids == 0).all()


def test_corners_are_exact_to_a_tenth_of_a_pixel_without_bias():
    rng, detector, errors = np.random.default_rng(0), TagDetector(), []
    for tag in range(40):
        R_CT = Rotation.from_euler("ZYX", [rng.uniform(-3.0, 3.0), *rng.uniform(-0.8, 0.8, 2)]).as_matrix()
        p_CT = np.append(rng.uniform(-0.3, 0.3, 2), 1.0) * rng.uniform(0.8, 2.0)
        exact = projected(corners_of(R_CT, p_CT, 0.16), CAMERA)
        tags = detector.detect(render([(tag, R_CT, p_CT, 0.16)], CAMERA, seed=tag))
        if len(tags.ids):
            assert tags.ids.tolist() == [tag]
            nearest = np.linalg.norm(exact[:, None] - tags.corners[0][None], axis=2).argmin(axis=1)
            errors.append(tags.corners[0][nearest] - exact)
    assert len(errors) >= 38  # some are seen aslant by more than 60 degrees
    errors = np.concatenate(errors)
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    assert np.sqrt((errors**2).mean()) < 0.1


def test_threads_and_colours_change_nothing():
    image = render([(5, np.eye(3), [-0.2, 0.0, 1.0], 0.16), (3, np.eye(3), [0.2, 0.1, 1.0], 0.16)], CAMERA)
    colour = np.repeat(image[..., None], 3, axis=2)
    rgba = np.concatenate([colour, np.full((480, 640, 1), 255, np.uint8)], axis=2)
    one, *others = [
        TagDetector(DetectorConfig(threads=threads)).detect(pixels)
        for threads, pixels in ((1, image), (4, image), (1, colour), (1, rgba), (1, image[::-1][::-1]))
    ]
    assert one.ids.tolist() == [3, 5]
    assert one.families == ("tag36h11", "tag36h11")
    for other in others:
        np.testing.assert_array_equal(other.ids, one.ids)
        np.testing.assert_array_equal(other.corners, one.corners)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (3, 500), (31, 33), (33, 37), (480, 640, 1)])
@pytest.mark.parametrize("decimation", [1.0, 2.0, 3.0])
def test_an_image_of_any_size_without_tags(shape, decimation):
    noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    tags = TagDetector(DetectorConfig(decimation=decimation)).detect(noise)
    assert len(tags.ids) == 0
    assert tags.corners.shape == (0, 4, 2)


def test_what_is_no_image_or_no_family_is_told():
    with pytest.raises(ValueError, match=r"^an image of shape \(4, 4\) and type float64; give bytes of shape"):
        TagDetector().detect(np.zeros((4, 4)))
    with pytest.raises(ValueError, match=r"^tag25h9: unknown family of tags; known are tag36h11, tag16h5$"):
        TagDetector(DetectorConfig(families=("tag25h9",)))
    with pytest.raises(ValueError, match=r"^0 threads, decimation 2: both must be 1 or more$"):
        TagDetector(DetectorConfig(threads=0))

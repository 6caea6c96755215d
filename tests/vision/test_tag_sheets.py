"""What is printed is what the detector reads, in the size that was asked for."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from tests.cameras import pinhole
from tests.vision.rendering import cv2
from tfg_drake.vision.annotated import annotated
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagSizes, sighted
from tfg_drake.vision.tag_detector import DetectorConfig, TagDetector
from tfg_drake.vision.tag_sheets import SheetError, draw_page, parse_ids, per_page, print_tags

DPI = 100


def page_image(ids, size):
    buffer = io.BytesIO()
    draw_page(ids, size).savefig(buffer, dpi=DPI, format="png")
    return np.asarray(Image.open(buffer).convert("L"))


@pytest.mark.parametrize(("ids", "size"), [([586], 0.16), ([7, 3, 100, 5, 1, 2], 0.06), (list(range(20)), 0.03)])
def test_printed_tags_are_read_and_have_their_size(ids, size):
    tags = TagDetector(DetectorConfig(decimation=1.0)).detect(page_image(ids, size))
    assert tags.ids.tolist() == sorted(ids)
    sides = np.linalg.norm(tags.corners - np.roll(tags.corners, 1, axis=1), axis=2)
    np.testing.assert_allclose(sides, size / 0.0254 * DPI, atol=1.0)


def test_they_stand_upright_as_apriltag_has_them():
    (tag,) = TagDetector(DetectorConfig(decimation=1.0)).detect(page_image([5], 0.16)).corners
    # Its corners run counter-clockwise from the lower left one of the tag; rows of an image run downward.
    np.testing.assert_array_equal(np.sign(tag - tag.mean(axis=0)), [[-1, 1], [1, 1], [1, -1], [-1, -1]])


def test_tags_do_not_touch_one_another_or_the_page_s_edge():
    across, down = per_page(0.06)
    assert (across, down) == (2, 3)
    page = page_image(list(range(6)), 0.06)
    edge = round(0.004 / 0.0254 * DPI)
    inner = page[edge:-edge, edge:-edge]
    assert np.count_nonzero(page < 250) == np.count_nonzero(inner < 250)


def test_a_pdf(tmp_path):
    assert print_tags(list(range(13)), 0.06, tmp_path / "tags.pdf") == 3
    data = (tmp_path / "tags.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", data)) == 3
    # A4, in points.
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)
    np.testing.assert_allclose([float(box[1]), float(box[2])], [595.28, 841.89], atol=0.1)


@pytest.mark.parametrize(("text", "ids"), [("0-3", [0, 1, 2, 3]), ("7", [7]), ("5, 3,5-6", [5, 3, 6]), ("586", [586])])
def test_lists_of_ids(text, ids):
    assert parse_ids(text) == ids


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", ": is no list of ids; write it as 0-99 or 3,5,10-12"),
        ("a", "a: is no list of ids; write it as 0-99 or 3,5,10-12"),
        ("1-", "1-: is no list of ids; write it as 0-99 or 3,5,10-12"),
        ("1,-5", "1,-5: is no list of ids; write it as 0-99 or 3,5,10-12"),
        ("0-999999999999999", "0-999999999999999: is no list of ids; write it as 0-99 or 3,5,10-12"),
        ("587", "587: tag36h11 has the ids 0 to 586, a range goes upward"),
        ("5-3", "5-3: tag36h11 has the ids 0 to 586, a range goes upward"),
    ],
)
def test_lists_that_are_none(text, told):
    with pytest.raises(SheetError, match="^" + re.escape(told) + "$"):
        parse_ids(text)


@pytest.mark.parametrize("size", [0.0, -1.0, 0.17, np.nan, np.inf])
def test_a_size_that_does_not_go_on_a_page(size):
    told = f"a tag of {size:g} m does not go on A4; the size is above 0 and at most 0.16 m"
    with pytest.raises(SheetError, match="^" + re.escape(told) + "$"):
        per_page(size)


def test_a_picture_shows_what_is_used_and_what_is_not():
    page = cv2.resize(page_image([1, 2], 0.06), (640, 480))
    tags = TagDetector().detect(page)
    sighting = sighted(tags, 0.0, pinhole(640, 480, 500.0), TagSizes(None, {}, {1: 0.06}), CameraMount())
    picture = annotated(np.repeat(page[..., None], 3, axis=2), tags, sighting, ["a note"])
    assert picture.shape == (480, 640, 3)
    for tag, colour in ((1, [0, 200, 0]), (2, [230, 60, 30])):
        corner = np.round(tags.corners[tags.ids == tag][0, 0]).astype(int)
        near = picture[corner[1] - 2 : corner[1] + 3, corner[0] - 2 : corner[0] + 3].reshape(-1, 3)
        assert (near == colour).all(axis=1).any()

import io

import numpy as np
from PIL import Image

from tfg_drake.pictures import palette
from tfg_drake.pictures.layers import LOOKS
from tfg_drake.pictures.plates import COLUMNS, LINE, WIDTH, _font, legend_plate, words_plate


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def test_the_legend_has_every_colour_and_the_scale_of_gains():
    png, height = legend_plate(LOOKS)
    picture = pixels(png)
    assert picture.shape == (height, WIDTH, 3)
    names = (
        "wall",
        "edge_in_space",
        "bare_surface",
        "keep_out",
        "landmark",
        "frontier",
        "path",
        "trail",
        "robot",
        "truth",
    )
    for colour in [*(getattr(palette.LIGHT, name) for name in names), *palette.GAINS]:
        there = np.all(np.abs(picture - np.rint(255.0 * np.array(colour))) <= 1, axis=-1)
        assert np.count_nonzero(there) > 500


def test_the_legend_lists_what_is_drawn():
    walls, height = legend_plate({"wall", "wall_landmark_3sigma"})
    assert height == legend_plate(())[1] == legend_plate(LOOKS)[1]
    there = [np.all(pixels(walls) == np.rint(255.0 * np.array(LOOKS[name].in_space)), axis=-1).any() for name in LOOKS]
    assert [name for name, is_there in zip(LOOKS, there, strict=True) if is_there and LOOKS[name].words] == ["wall"]


def test_words_are_ink_on_white_and_longer_ones_reach_farther():
    reach = []
    for words in ("", "49 s", "49 s, stage 4, follow"):
        picture = pixels(words_plate(words))
        assert picture.shape == (LINE, WIDTH, 3)
        reach.append(np.flatnonzero((picture < 128).any(axis=(0, 2))).max(initial=0))
    assert 0 == reach[0] < reach[1] < reach[2] < WIDTH - 8


def test_every_name_fits_its_column():
    for look in LOOKS.values():
        assert _font().getlength(look.words) < WIDTH // COLUMNS - 52

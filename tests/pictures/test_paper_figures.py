import dataclasses

import numpy as np
import pytest
from PIL import Image

from tests.systems.test_info_gain_goal_selector import half_known_room, roadmap
from tfg_drake.pictures.figure_file import FORMATS, write_formats
from tfg_drake.pictures.paper_figures import (
    Stage,
    draw_gains,
    draw_growth,
    draw_priors,
    draw_tfg,
    gain_field,
)
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import with_frontiers

PARAMETERS = PlanningParameters()


@pytest.fixture
def stage():
    estimate, tfg = half_known_room()
    estimate = dataclasses.replace(estimate, landmark_covariance=np.tile(1e-2 * np.eye(2), (3, 1, 1)))
    tfg = dataclasses.replace(tfg, segment_kind=np.zeros(3, dtype=int))
    return Stage(estimate, tfg, with_frontiers(roadmap(), estimate, tfg, PARAMETERS), empty_choice())


def test_the_field_covers_what_the_robot_can_reach_and_follows_the_prior(stage):
    nodes, gains = gain_field(stage, PARAMETERS)
    assert (stage.roadmap.points[nodes, 1] <= 1.0).all()
    narrow = dataclasses.replace(PARAMETERS.explorer, prior_sigma=0.001)
    _, low = gain_field(stage, dataclasses.replace(PARAMETERS, explorer=narrow))
    np.testing.assert_allclose(low.exploitation, gains.exploitation)
    assert low.exploration.max() < 0.1 * gains.exploration.max()


def drawn(stage):
    return {
        "gains": draw_gains(stage, PARAMETERS),
        "priors": draw_priors(stage, PARAMETERS),
        "tfg": draw_tfg(stage),
        "growth": draw_growth([stage, stage], np.arange(3.0), np.zeros((3, 2))),
    }


@pytest.mark.slow
def test_every_figure_is_written_in_every_format_the_same_each_time(stage, tmp_path):
    written = []
    for figures in (drawn(stage), drawn(stage)):
        paths = [path for name, figure in figures.items() for path in write_formats(tmp_path, name, figure)]
        assert [path.name for path in paths] == [name + suffix for name in figures for suffix in FORMATS]
        written.append([path.read_bytes() for path in paths])
    assert written[0] == written[1]
    image = np.asarray(Image.open(tmp_path / "gains.png").convert("RGB"))
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100

"""Words for the numbers of tags and walls of a map."""

import dataclasses

import pytest

from tfg_drake.mapfile.summary import landmark_counts, map_rows
from tfg_drake.slam.evidence import Evidence
from tfg_drake.table import empty


@pytest.mark.parametrize(
    ("tags", "walls", "told"),
    [(4, 0, "4 tags"), (0, 43, "43 walls"), (1, 1, "1 tag, 1 wall"), (0, 0, "no landmarks")],
)
def test_landmarks_are_counted_by_what_they_are(tags, walls, told):
    assert landmark_counts(tags, walls) == told


def test_a_map_without_tags_speaks_of_walls_alone(walled_map):
    graph = walled_map.graph
    columns = ("ids", "p_ML", "anchor", "reach", "landmark_covariance")
    walls = dataclasses.replace(graph, **{name: getattr(graph, name)[:1] for name in columns})
    told = dict(map_rows(dataclasses.replace(walled_map, graph=walls, evidence=empty(Evidence)), 1000))
    assert told["landmarks"] == "1 wall"
    assert told["walls"] == "1\u03c3 across 0.1600 m median, 0.3000 m worst"
    assert "tags" not in told
    assert dict(map_rows(walled_map, 1000))["tags"].endswith(" m worst (tag 13)")

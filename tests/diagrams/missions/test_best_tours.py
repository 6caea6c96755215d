"""Best tours are computed once for a world, and missions are set over them."""

import dataclasses

import numpy as np
import pytest

from tfg_drake.comparison.best_tour import BestTour
from tfg_drake.comparison.measures import MEASURES
from tfg_drake.comparison.runs import Run, flatten
from tfg_drake.diagrams.missions import best_tours
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.storage.trajectory import write_tum

TOUR = BestTour(np.array([0.0, 4.0, 50.0]), np.array([[0.0, 0, 0], [2, 0, 0], [20, 0, 0]]), True)


@pytest.fixture
def computed(monkeypatch):
    """The seeds' worlds that a tour was computed of, by the start's x."""
    starts = []

    def best_tour(world, cells, see, *_, **__):
        assert not see.is_tag.any()
        assert len(cells) > len(see.points) > 500
        starts.append(float(world.start[0]))
        return TOUR

    monkeypatch.setattr(best_tours, "best_tour", best_tour)
    return starts


@pytest.fixture
def house():
    scenario = LoadScenario(FindScenario("house"))
    scenario.world.tags = []
    return scenario


def test_a_tour_is_computed_once_for_a_world_and_a_start(computed, house, tmp_path):
    best_tours.kept_tour(house, tmp_path)
    again = best_tours.kept_tour(dataclasses.replace(house, seed=7), tmp_path)
    assert computed == [4.9]
    assert (again.time, again.distance, again.is_enough) == (50.0, 20.0, True)
    house.world.start = [4.5, 3.4, 0.0]
    best_tours.kept_tour(house, tmp_path)
    assert computed == [4.9, 4.5]
    for path in tmp_path.iterdir():
        path.write_text("{")
    best_tours.kept_tour(house, tmp_path)
    assert computed == [4.9, 4.5, 4.5]


def test_missions_that_explored_all_are_set_over_the_tour(computed, house, tmp_path):
    write_tum(tmp_path / "truth.tum", np.array([0.0, 60.0, 100.0]), np.array([[0.0, 0, 0], [30, 0, 0], [45, 0, 0]]))
    summary = {"outcome": "complete", "explored_s": 75.0}
    runs = [
        Run("tfg", 3, tmp_path, summary),
        Run("grid", 3, tmp_path, summary | {"outcome": "time_limit", "explored_s": None}),
        Run("mine", 3, tmp_path, None, "killed"),
    ]
    over = best_tours.over_tours(runs, {3: house}, tmp_path, lambda line: None)
    assert over[1:] == runs[1:]
    assert computed == [4.9]
    flat = flatten(over[0].summary)
    assert flat["best_tour.explored_over_time"] == 1.5
    assert flat["best_tour.explored_over_distance"] == 1.5
    shown = {one.name: one.read(over[0].summary) for one in MEASURES if "best tour" in one.name}
    assert shown == {"time until then over the best tour's": 1.5, "way until then over the best tour's": 1.5}

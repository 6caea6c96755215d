"""The best tours of the worlds that missions were in: computed once and kept as JSON, and the missions over them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.comparison.best_tour import BestTour, ToSee, best_tour, to_see
from tfg_drake.comparison.runs import Run
from tfg_drake.diagrams.missions.errors import NEARLY_ALL, KnownWorld, path_length
from tfg_drake.diagrams.scenario import HatchedKeepOut, MakeWorld, Scenario
from tfg_drake.io.files import FileError, read_object, write_atomic
from tfg_drake.storage.trajectory import read_tum
from tfg_drake.world.world import World

# Version of the search; stored tours of another one are not used.
SEARCH = 2


def to_see_in(known: KnownWorld, world: World, scenario: Scenario) -> ToSee:
    """Cells and tags that a mission in a scenario's world is judged by: NEARLY_ALL of the cells that `area_seen_s`
    counts, seen by the scanner, and each tag that can be reached."""
    return to_see(known.counted_places(), world, known.reachable, NEARLY_ALL, scenario.scan, scenario.tags)


def kept_tour(scenario: Scenario, folder: Path, say: Callable[[str], object] = lambda line: None) -> BestTour:
    """The best tour of a scenario's world, robot, sensors and start, from its file in the folder; computed and written
    where there is none. say: is told how far it is.

    What changes in a world while a mission goes on is left out. Raises OSError where the file cannot be written.
    """
    asked = _asked(scenario)
    path = folder / f"tour-{hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:16]}.json"
    try:
        kept = read_object(path)
        poses = np.array(kept["X_WB"], dtype=float).reshape(-1, 3)
        return BestTour(np.array(kept["stamps"], dtype=float), poses, bool(kept["is_enough"]))
    except (FileError, KeyError, TypeError, ValueError):
        pass
    world, keep_out = MakeWorld(scenario.world), HatchedKeepOut(scenario)
    known = KnownWorld(world, scenario)
    tour = best_tour(world, known.places(), to_see_in(known, world, scenario), scenario.robot, keep_out, say=say)
    folder.mkdir(parents=True, exist_ok=True)
    found = {"stamps": tour.stamps.round(3).tolist(), "X_WB": tour.X_WB.round(4).tolist(), "is_enough": tour.is_enough}
    write_atomic(path, json.dumps({"time_s": tour.time, "distance_m": tour.distance, **found, "of": asked}) + "\n")
    return tour


def over_tours(
    runs: Sequence[Run], scenarios: dict[int, Scenario], folder: Path, say: Callable[[str], object]
) -> list[Run]:
    """Runs with `best_tour` in their summaries: its time and distance, and those of the run until everything
    was explored as multiples of the tour's. scenarios: by seed. Runs that never explored all have none.

    Raises OSError where a tour cannot be written.
    """
    return [_over_tour(run, scenarios[run.seed], folder, say) for run in runs]


def _over_tour(run: Run, scenario: Scenario, folder: Path, say: Callable[[str], object]) -> Run:
    explored = None if run.summary is None or not run.counts else run.summary.get("explored_s")
    if run.summary is None or explored is None:
        return run
    tour = kept_tour(scenario, folder, lambda line: say(f"the best tour, seed {run.seed}: {line}"))
    if not tour.is_enough or tour.time <= 0.0 or tour.distance <= 0.0:
        return run
    stamps, X_WB = read_tum(run.folder / "truth.tum")
    over = {
        "time_s": tour.time,
        "distance_m": tour.distance,
        "explored_over_time": explored / tour.time,
        "explored_over_distance": path_length(X_WB[stamps <= explored]) / tour.distance,
    }
    return dataclasses.replace(run, summary=run.summary | {"best_tour": over})


def _asked(scenario: Scenario) -> dict[str, Any]:
    """All that a tour depends on."""
    sections = {name: dataclasses.asdict(getattr(scenario, name)) for name in ("world", "robot", "scan", "tags")}
    return {"search": SEARCH, "share": NEARLY_ALL, "keep_out": scenario.explorer.keep_out, **sections}

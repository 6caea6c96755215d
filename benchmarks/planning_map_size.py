"""What one stage of planning costs on maps of up to 100 000 landmarks.

    python benchmarks/planning_map_size.py
    python benchmarks/planning_map_size.py --landmarks 1000 10000 --stages 3

A mission in a scenario is recorded at its last but one stages; the map of each is then laid beside itself as often as
makes a map of the size asked for, graph, roadmap and candidates alike, so that the robot's neighbourhood stays as it
is and all else grows. Landmarks are known jointly in the robot's own copy, as they would be. No way leads from one
copy to the next: what the search for ways costs on a large map is not measured. A row a size: median CPU milliseconds
a stage of the TFG's update and its resolution in the map, of the roadmap's and of the choice of a goal, of all
together, and that over the first row's.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake.diagrams.run import explore
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.messages import FloatArray, GoalChoice, IntArray, MapEstimate, replace
from tfg_drake.planning import planner
from tfg_drake.planning.goal_choice import choose
from tfg_drake.planning.roadmap import RoadmapState
from tfg_drake.systems import info_gain_goal_selector, tfg_builder
from tfg_drake.tfg.frontier import FrontierPoints
from tfg_drake.tfg.graph import TfgGraph, resolve
from tfg_drake.tfg.window import update

# Distance between two copies, m, and between their tags' ids.
PITCH = 80.0
IDS = 10_000


class Copies:
    """A map laid beside itself: `count` copies, the robot's own the last and where it was."""

    def __init__(self, count: int) -> None:
        across = math.ceil(math.sqrt(count))
        place = np.arange(count)[::-1]
        self.count, self.offset = count, PITCH * np.column_stack([place % across, place // across])

    def tiled(self, array: Any) -> Any:
        """An array (n, ...) as often as there are copies."""
        return np.concatenate([array] * self.count)

    def shifted(self, rows: IntArray, step: int) -> IntArray:
        """Numbers (n, ...) of something there are `step` of in each copy, -1 for none."""
        return np.concatenate([np.where(rows < 0, rows, rows + step * k) for k in range(self.count)])

    def placed(self, points: FloatArray) -> FloatArray:
        """Points or poses (n, 2 or 3) in M, m."""
        moved = [points + np.append(offset, np.zeros(points.shape[1] - 2)) for offset in self.offset]
        return np.concatenate(moved)

    def packed(self, offsets: IntArray) -> IntArray:
        """Offsets (n + 1,) into packed arrays."""
        return np.append(0, self.shifted(offsets[1:], int(offsets[-1])))

    def frontier(self, points: FrontierPoints, goals: int) -> FrontierPoints:
        """Frontier points in the frames of goals."""
        same = (self.tiled(getattr(points, name)) for name in ("p", "normal", "length", "on_surface"))
        return FrontierPoints(self.shifted(points.goal, goals), *same, self.shifted(points.id, IDS))

    def graph(self, graph: TfgGraph) -> TfgGraph:
        """The TFG."""
        goals, surfaces = graph.stage, graph.surfaces
        names = ("shadows", "uninspected", "unseen_backs", "open_ends", "sighted", "viewpoints", "tried")
        return replace(
            graph,
            stage=goals * self.count,
            surfaces=replace(
                surfaces,
                kind=self.tiled(surfaces.kind),
                ids=self.shifted(surfaces.ids, IDS),
                goal=self.shifted(surfaces.goal, goals),
                range=self.tiled(surfaces.range),
                offsets=self.packed(surfaces.offsets),
                vertices=self.tiled(surfaces.vertices),
            ),
            tag_ids=self.shifted(graph.tag_ids, IDS),
            tag_goal=self.shifted(graph.tag_goal, goals),
            tag_facing=self.tiled(graph.tag_facing),
            tag_range=self.tiled(graph.tag_range),
            star_offsets=self.packed(graph.star_offsets),
            star_vertices=self.tiled(graph.star_vertices),
            tried_count=self.tiled(graph.tried_count),
            **{name: self.frontier(getattr(graph, name), goals) for name in names},
        )

    def estimate(self, estimate: MapEstimate) -> MapEstimate:
        """The map; the newest goal is in the robot's own copy only."""
        n, own = len(estimate.ids), IDS * (self.count - 1)
        X_MA = np.vstack([self.placed(estimate.X_MA[:-1]), estimate.X_MA[-1:]])
        return replace(
            estimate,
            stage=len(X_MA),
            ids=self.shifted(estimate.ids, IDS),
            p_ML=self.placed(estimate.p_ML),
            local=estimate.local + n * (self.count - 1),
            landmark_covariance=self.tiled(estimate.landmark_covariance),
            X_MA=X_MA,
            observation=replace(estimate.observation, ids=estimate.observation.ids + own),
        )

    def nodes(self, nodes: RoadmapState) -> RoadmapState:
        """The roadmap before the newest goal."""
        same = ("p_AN", "travelled", "free", "sigma", "edge_clearance", "edge_required", "usable")
        return replace(
            nodes,
            stage=nodes.stage * self.count,
            anchor=self.shifted(nodes.anchor, nodes.stage),
            edges=self.shifted(nodes.edges, len(nodes.points)),
            points=self.placed(nodes.points),
            **{name: self.tiled(getattr(nodes, name)) for name in same},
        )

    def choice(self, choice: GoalChoice, nodes: int) -> GoalChoice:
        """The choice before."""
        same = ("exploitation", "exploration", "pose_price", "gain", "value")
        tiled = {name: self.tiled(getattr(choice, name)) for name in same}
        return replace(choice, candidates=self.shifted(choice.candidates, nodes), **tiled)


def recorded(name: str) -> list[dict[str, tuple[Any, ...]]]:
    """What the parts of planning were asked at each stage of a mission."""
    stages: list[dict[str, tuple[Any, ...]]] = []

    def noted(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def inner(*arguments: Any, **options: Any) -> Any:
            if part == "update":
                stages.append({})
            stages[-1][part] = arguments
            return function(*arguments, **options)

        return inner

    with (
        mock.patch.object(tfg_builder, "update", noted("update", update)),
        mock.patch.object(planner, "grow", noted("grow", planner.grow)),
        mock.patch.object(info_gain_goal_selector, "choose", noted("choose", choose)),
    ):
        folder = Path(tempfile.mkdtemp(prefix="planning-"))
        done = explore(LoadScenario(FindScenario(name)), max_time=3600.0, out_dir=folder)
    if done.summary["outcome"] == "fault":
        sys.exit(done.summary["reason"])
    return stages


def stage_ms(asked: dict[str, tuple[Any, ...]], count: int) -> list[float]:
    """CPU ms of a stage's parts on a map of `count` copies: update and resolve, grow, choose."""
    copies = Copies(count)
    graph, estimate, panorama, sightings, tags, robot, explorer = asked["update"]
    state, _, _, parameters = asked["grow"]
    *_, previous, seed = asked["choose"]
    state = replace(
        state, nodes=copies.nodes(state.nodes), obstacle_goal=state.obstacle_goal + (count - 1) * graph.stage
    )
    previous = copies.choice(previous, len(asked["grow"][0].nodes.points))
    graph, estimate = copies.graph(graph), copies.estimate(estimate)
    ends = [time.thread_time()]
    graph = update(graph, estimate, panorama, sightings, tags, robot, explorer)
    tfg = resolve(graph, estimate, robot, explorer)
    ends.append(time.thread_time())
    state = planner.grow(state, estimate, tfg, parameters)
    ends.append(time.thread_time())
    choose(estimate, tfg, state.roadmap, tags, *asked["choose"][4:-2], previous, seed)
    ends.append(time.thread_time())
    return [*(1e3 * np.diff(ends)), 1e3 * (ends[-1] - ends[0])]


def main() -> None:
    """Run a mission, lay its maps out, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--landmarks", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--stages", type=int, default=3)
    options = parser.parse_args()
    stages = recorded(options.scenario)[-1 - options.stages : -1]
    print("   landmarks     TFG ms  roadmap ms    goal ms     all ms  over the first")
    least = math.nan
    for landmarks in [0, *options.landmarks]:
        rows, sizes = [], []
        for asked in stages:
            size = len(asked["update"][1].ids)
            count = max(1, round(landmarks / size))
            sizes.append(count * size)
            rows.append(stage_ms(asked, count))
        median = np.median(rows, axis=0)
        least = median[-1] if math.isnan(least) else least
        print(
            f"{max(sizes):12}" + "".join(f"{value:>11.1f}" for value in median) + f"{median[-1] / least:>14.1f}",
            flush=True,
        )


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()

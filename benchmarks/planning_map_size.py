"""The CPU time of one stage of planning on maps of up to 10 000 landmarks.

    python benchmarks/planning_map_size.py
    python benchmarks/planning_map_size.py --landmarks 1000 3000 --stages 3

A mission in a scenario is recorded at its last but one stages; the map of each is then laid beside itself as often as
makes a map of the size asked for, graph, roadmap and landmarks alike, so that the robot's neighbourhood stays as it
is and all else grows. Landmarks are known jointly in the robot's own copy, as they would be. A row a size: median CPU
milliseconds a stage of the TFG's update and its resolution in the map, of the roadmap, of the choice of a goal and of a
path some metres long, of all together, and that over the first row's. The last column is what one choice costs where
nothing near is worth going to and all of the map is looked at; no way leads from one copy to the next, which makes the
search for ways cheaper.
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

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, replace
from tfg_drake.planning import planner
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.goal_choice import choose, choose_near, empty_choice
from tfg_drake.planning.local import local, planning_radius
from tfg_drake.planning.path import plan_path
from tfg_drake.planning.roadmap import RoadmapState
from tfg_drake.systems import tfg_builder
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.frontier import FrontierPoints
from tfg_drake.tfg.graph import resolve, update

# PITCH: distance between neighbouring copies, m. IDS: offset of their tags' ids. WAY: length of the path, m.
PITCH = 80.0
IDS = 10_000
WAY = 6.0


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
        """Numbers (n, ...) of something there are `step` of in each copy; -1 stays."""
        return np.concatenate([np.where(rows < 0, rows, rows + step * k) for k in range(self.count)])

    def offsets(self, offsets: IntArray) -> IntArray:
        """Offsets (n + 1,) of a packed array."""
        return np.append(0, np.cumsum(self.tiled(np.diff(offsets))))

    def placed(self, points: FloatArray) -> FloatArray:
        """Points or poses (n, 2 or 3) in M, m."""
        moved = [points + np.append(offset, np.zeros(points.shape[1] - 2)) for offset in self.offset]
        return np.concatenate(moved)

    def graph(self, graph: TfgGraph) -> TfgGraph:
        """The TFG."""
        views, changed = graph.stage, {}
        for name, value in vars(graph).items():
            if isinstance(value, np.ndarray):
                changed[name] = self.tiled(value)
            elif name == "surfaces" or isinstance(value, FrontierPoints):
                columns = {column: self.tiled(of) for column, of in vars(value).items()}
                changed[name] = replace(value, **columns | {"view": self.shifted(value.view, views)})
        changed |= {
            "stage": views * self.count,
            "surfaces": replace(
                changed["surfaces"],
                ids=self.shifted(graph.surfaces.ids, IDS),
                offsets=self.offsets(graph.surfaces.offsets),
            ),
            "tag_ids": self.shifted(graph.tag_ids, IDS),
            "tag_view": self.shifted(graph.tag_view, views),
            "star_offsets": self.offsets(graph.star_offsets),
        }
        return replace(graph, **changed)

    def estimate(self, estimate: MapEstimate) -> MapEstimate:
        """The map; the newest view is in the robot's own copy only."""
        n, own = len(estimate.ids), IDS * (self.count - 1)
        X_MA = np.vstack([self.placed(estimate.X_MA[:-1]), estimate.X_MA[-1:]])
        return replace(
            estimate,
            stage=len(X_MA),
            ids=self.shifted(estimate.ids, IDS),
            p_ML=self.placed(estimate.p_ML),
            anchor=self.tiled(estimate.anchor),
            reach=self.tiled(estimate.reach),
            local=estimate.local + n * (self.count - 1),
            landmark_covariance=self.tiled(estimate.landmark_covariance),
            X_MA=X_MA,
            observation=replace(estimate.observation, ids=estimate.observation.ids + own),
        )

    def roadmap(self, nodes: RoadmapState) -> RoadmapState:
        """The roadmap before the newest view."""
        edges = {name: self.tiled(column) for name, column in vars(nodes.edges).items()}
        edges["nodes"] = self.shifted(nodes.edges.nodes, len(nodes.ids))
        return replace(
            nodes,
            stage=nodes.stage * self.count,
            ids=self.shifted(nodes.ids, nodes.next_id),
            next_id=nodes.next_id * self.count,
            anchor=self.shifted(nodes.anchor, nodes.stage),
            p_AN=self.tiled(nodes.p_AN),
            points=self.placed(nodes.points),
            sigma=self.tiled(nodes.sigma),
            edges=replace(nodes.edges, **edges),
            way_end=nodes.way_end + nodes.next_id * (self.count - 1),
        )


def recorded(name: str) -> list[dict[str, tuple[Any, ...]]]:
    """Arguments of the parts of planning at each stage of a mission."""
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
    ):
        folder = Path(tempfile.mkdtemp(prefix="planning-"))
        scenario = LoadScenario(FindScenario(name))
        # A wall's ids say no copy.
        scenario.explorer.landmarks = "tags"
        done = run_mission(scenario, max_time=3600.0, out_dir=folder)
    if done.summary["outcome"] == "fault":
        sys.exit(done.summary["reason"])
    return stages


def stage_ms(asked: dict[str, tuple[Any, ...]], count: int) -> list[float]:
    """CPU ms of a stage's parts on a map of `count` copies: TFG, roadmap, goal, path, all; and of a choice of all the
    map."""
    copies = Copies(count)
    graph, estimate, *seen, robot, explorer = asked["update"]
    state, parameters = asked["grow"][0], asked["grow"][-1]
    views = graph.stage
    state = replace(
        state,
        nodes=copies.roadmap(state.nodes),
        obstacle_view=state.obstacle_view + (count - 1) * views,
        driven=np.zeros((0, 2)),
    )
    graph, estimate = copies.graph(graph), copies.estimate(estimate)
    radius, is_large = planning_radius(estimate, explorer), not estimate.is_joint
    nothing = empty_choice()
    ends = [time.thread_time()]
    graph = update(graph, estimate, *seen, robot, explorer)
    tfg = resolve(graph, estimate, robot, explorer)
    ends.append(time.thread_time())
    state = planner.grow(state, estimate, tfg, parameters)
    ends.append(time.thread_time())
    if is_large:
        part = local(estimate, tfg, radius, parameters.sensor.range)
        choose_near(Situation(*part, state.roadmap, parameters, is_large), nothing, radius)
    else:
        choose(Situation(estimate, tfg, state.roadmap, parameters), nothing)
    ends.append(time.thread_time())
    node = some_way_off(state.roadmap)
    plan_path(state.part, state.estimate, state.tfg, estimate.X_MD, node, parameters)
    ends.append(time.thread_time())
    obstacles = planner.obstacles_in_map(state, estimate)
    roadmap = planner.make_roadmap(state.nodes, tfg, estimate, parameters, obstacles, state.driven_before)
    choose(Situation(estimate, tfg, roadmap, parameters, is_large), nothing)
    ends.append(time.thread_time())
    ms = 1e3 * np.diff(ends)
    return [*ms[:4], ms[:4].sum(), ms[4]]


def some_way_off(roadmap: Any) -> int:
    """A node that is about so far by way."""
    return int(np.argmin(np.abs(np.where(roadmap.reachable, roadmap.travel_length, np.inf) - WAY)))


def main() -> None:
    """Run a mission, lay its maps out, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--landmarks", type=int, nargs="+", default=[1000, 3000, 10_000])
    parser.add_argument("--stages", type=int, default=3)
    options = parser.parse_args()
    stages = recorded(options.scenario)[-1 - options.stages : -1]
    print("   landmarks     TFG ms  roadmap ms    goal ms    path ms     all ms  over the first  all of the map ms")
    least, over = math.nan, []
    for landmarks in [0, *options.landmarks]:
        rows, sizes = [], []
        for asked in stages:
            size = len(asked["update"][1].ids)
            count = max(1, round(landmarks / size))
            sizes.append(count * size)
            rows.append(stage_ms(asked, count))
        median = np.median(rows, axis=0)
        least = median[4] if math.isnan(least) else least
        columns = "".join(f"{value:>11.1f}" for value in median[:5])
        print(f"{max(sizes):12}{columns}{median[4] / least:>16.2f}{median[5]:>19.1f}", flush=True)
        over.append(f"{median[4] / least:.2f} on {max(sizes)}")
    print(f"\nCPU time of a stage of planning, over that of the first, on so many landmarks: {', '.join(over)}")


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()

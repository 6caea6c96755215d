"""What one stage of planning costs on maps of up to 100 000 landmarks.

    python benchmarks/planning_map_size.py
    python benchmarks/planning_map_size.py --landmarks 1000 10000 --stages 3

A mission in a scenario is recorded at its last but one stages; the map of each is then laid beside itself as often as
makes a map of the size asked for, graph, roadmap and candidates alike, so that the robot's neighbourhood stays as it
is and all else grows. Landmarks are known jointly in the robot's own copy, as they would be, and all other copies are
inactive:
they are farther from the robot than anything a stage needs. A row a size: median CPU milliseconds a stage of the TFG's
update and its resolution in the map, of the roadmap's and of the choice of a goal, of all together, and that over the
first row's; then the same of a ring just before it closes, where what the first half of the views saw lies round the
robot but is not known jointly with it. The last column is what one choice costs where nothing near is worth going to
and all of the map is looked at; no way leads from one copy to the next, which makes the search for ways cheaper.
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
from tfg_drake.messages import FloatArray, GoalChoice, IntArray, MapEstimate, replace
from tfg_drake.planning import planner
from tfg_drake.planning.goal_choice import choose, remember
from tfg_drake.planning.roadmap import RoadmapState
from tfg_drake.planning.roadmap_parts import whole_roadmap
from tfg_drake.systems import info_gain_goal_selector, tfg_builder
from tfg_drake.tfg.graph import TfgGraph, resolve
from tfg_drake.tfg.submaps import Submaps
from tfg_drake.tfg.working_map import update, whole_graph, working_map

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
        """Numbers (n, ...) of something there are `step` of in each copy."""
        return np.concatenate([rows + step * k for k in range(self.count)])

    def placed(self, points: FloatArray) -> FloatArray:
        """Points or poses (n, 2 or 3) in M, m."""
        moved = [points + np.append(offset, np.zeros(points.shape[1] - 2)) for offset in self.offset]
        return np.concatenate(moved)

    def submaps(self, part: Callable[[int], Any], views: int) -> Submaps[Any]:
        """Content of some views a copy: the robot's own is active, the others are not."""
        names = np.repeat(np.arange(self.count) * views, views)
        names[-views:] = -1
        return Submaps(part(self.count - 1), names, {k * views: part(k) for k in range(self.count - 1)})

    def graphs(self, graph: TfgGraph) -> Submaps[TfgGraph]:
        """The TFG."""
        views = graph.stage

        def part(k: int) -> TfgGraph:
            points = {
                name: replace(of, view=of.view + k * views, id=np.where(of.id < 0, of.id, of.id + k * IDS))
                for name in (
                    "free_space_frontiers",
                    "uninspected",
                    "unseen_backs",
                    "open_ends",
                    "sighted",
                    "viewpoints",
                    "tried",
                )
                for of in (getattr(graph, name),)
            }
            ids = graph.surfaces.ids
            return replace(
                graph,
                stage=views * self.count,
                surfaces=replace(
                    graph.surfaces, view=graph.surfaces.view + k * views, ids=np.where(ids < 0, ids, ids + k * IDS)
                ),
                tag_ids=graph.tag_ids + k * IDS,
                tag_view=graph.tag_view + k * views,
                **points,
            )

        return self.submaps(part, views)

    def estimate(self, estimate: MapEstimate) -> MapEstimate:
        """The map; the newest view is in the robot's own copy only."""
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

    def roadmaps(self, nodes: RoadmapState) -> Submaps[RoadmapState]:
        """The roadmap before the newest view."""
        views, count = nodes.stage, nodes.next_id

        def part(k: int) -> RoadmapState:
            return replace(
                nodes,
                stage=views * self.count,
                ids=nodes.ids + k * count,
                next_id=count * self.count,
                anchor=nodes.anchor + k * views,
            )

        return self.submaps(part, views)

    def remembered(self, choice: GoalChoice, nodes: int, stop_gain: float) -> GoalChoice:
        """What the choices before are remembered by: those of other copies that had enough gain."""
        worth = np.flatnonzero(choice.gain > stop_gain)
        rows = np.concatenate([*[worth] * (self.count - 1), np.arange(len(choice.gain))])
        copy = np.repeat(np.arange(self.count), [*[len(worth)] * (self.count - 1), len(choice.gain)])
        same = ("exploitation", "exploration", "pose_price", "gain", "value")
        taken = {name: getattr(choice, name)[rows] for name in same}
        return replace(choice, candidates=choice.candidates[rows] + nodes * copy, **taken)


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
        done = run_mission(LoadScenario(FindScenario(name)), max_time=3600.0, out_dir=folder)
    if done.summary["outcome"] == "fault":
        sys.exit(done.summary["reason"])
    return stages


def with_a_loop_open(estimate: MapEstimate, graph: TfgGraph) -> MapEstimate:
    """The map as it is known where the robot comes, after a long way round, to what it saw from the first views."""
    old = graph.tag_ids[graph.tag_view < graph.stage // 2]
    joint = ~np.isin(estimate.ids[estimate.local], old)
    rows = np.append(np.repeat(joint, 2), np.ones(3, dtype=bool))
    return replace(estimate, local=estimate.local[joint], covariance=estimate.covariance[np.ix_(rows, rows)])


def stage_ms(asked: dict[str, tuple[Any, ...]], count: int, *, ring: bool = False) -> list[float]:
    """CPU ms of a stage's parts on a map of `count` copies: TFG, roadmap, goal, all; and of a choice of all the map."""
    copies = Copies(count)
    graphs, estimate, panorama, sightings, tags, robot, explorer = asked["update"]
    state, _, parameters = asked["grow"]
    *_, goal_parameters, previous = asked["choose"]
    if ring:
        estimate = with_a_loop_open(estimate, graphs.active)
    views, names = graphs.active.stage, state.nodes.next_id
    state = replace(state, parts=copies.roadmaps(state.nodes), obstacle_view=state.obstacle_view + (count - 1) * views)
    previous = copies.remembered(previous, names, explorer.stop_gain)
    graphs, estimate = copies.graphs(graphs.active), copies.estimate(estimate)
    ends = [time.thread_time()]
    graphs = update(graphs, estimate, panorama, sightings, tags, robot, explorer)
    working = working_map(graphs, estimate, panorama, robot, explorer)
    ends.append(time.thread_time())
    state = planner.grow(state, working, parameters)
    ends.append(time.thread_time())
    choice = choose(working.estimate, working.tfg, state.roadmap, goal_parameters, previous)
    remember(previous, choice, state.roadmap, explorer.stop_gain)
    ends.append(time.thread_time())
    tfg = resolve(whole_graph(graphs), estimate, robot, explorer)
    obstacles = planner.obstacles_in_map(state, estimate)
    nodes = whole_roadmap(state.parts, estimate.X_MA)
    roadmap = planner.make_roadmap(nodes, tfg, estimate, parameters, obstacles, state.driven_before)
    choose(estimate, tfg, roadmap, goal_parameters, previous)
    ends.append(time.thread_time())
    ms = 1e3 * np.diff(ends)
    return [*ms[:3], ms[:3].sum(), ms[3]]


def main() -> None:
    """Run a mission, lay its maps out, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--landmarks", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--stages", type=int, default=3)
    options = parser.parse_args()
    stages = recorded(options.scenario)[-1 - options.stages : -1]
    print("   landmarks     TFG ms  roadmap ms    goal ms     all ms  over the first  a ring  all of the map ms")
    least = math.nan
    for landmarks in [0, *options.landmarks]:
        rows, sizes = [], []
        for asked in stages:
            size = len(asked["update"][1].ids)
            count = max(1, round(landmarks / size))
            sizes.append(count * size)
            rows.append([*stage_ms(asked, count), stage_ms(asked, count, ring=True)[3]])
        median = np.median(rows, axis=0)
        least = median[3] if math.isnan(least) else least
        columns = "".join(f"{value:>11.1f}" for value in median[:4])
        ratios = f"{median[3] / least:>16.2f}{median[5] / least:>8.2f}"
        print(f"{max(sizes):12}{columns}{ratios}{median[4]:>19.1f}", flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()

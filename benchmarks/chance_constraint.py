"""Whether planned paths keep the collision probability they promise: Monte Carlo rollouts along them.

    python benchmarks/chance_constraint.py paper --inflate 3 --rollouts 10000

At every stage of a mission the standard deviations of the map's joint Gaussian and of the sensors are multiplied by
--inflate, the roadmap is checked anew, and --paths paths to nodes drawn at random are planned and rolled out. A row a
probability asked for and what it is asked of (planner.risk): paths, their points, the largest share of rollouts that
collide at any one of them, how many points have a 95 % (Wilson) interval wholly above what was asked; mean and largest
share that collide somewhere on the path; and how much of the roadmap could be reached at all. Points with too little
room beside edges that stay open all the same, as the robot has driven them and nothing else leads home, or where it
sets off from a place with too little room, are left out and counted: kept. Others with too little room by what is
predicted there, between nodes that have enough, are counted and not left out: narrow.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
from monte_carlo import collisions
from scipy.stats import binomtest

from tfg_drake.config import RISKS, OdometryConfig, PlannerConfig, TagSensorConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario, Scenario
from tfg_drake.geometry.distance import point_distance
from tfg_drake.messages import BoolArray, FloatArray, MapEstimate, TfgMap, replace
from tfg_drake.planning import planner
from tfg_drake.planning.chance_constraint import required_clearance
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.path import ROUNDING, edges_on, plan_path, too_narrow
from tfg_drake.planning.roadmap import RoadmapState, extend
from tfg_drake.planning.routes import nodes_to, roadmap_message, routes

Stage = tuple[MapEstimate, TfgMap, RoadmapState]


def stages_of(scenario: Scenario, max_time: float) -> list[Stage]:
    """Map, TFG and roadmap of every stage of a mission of at most this time, s."""
    stages: list[Stage] = []
    grow = planner.grow

    def noted(state, estimate, tfg, parameters, **options):  # type: ignore[no-untyped-def]
        state = grow(state, estimate, tfg, parameters, **options)
        stages.append((estimate, tfg, state.nodes))
        return state

    with mock.patch.object(planner, "grow", noted):
        run_mission(scenario, out_dir=Path(tempfile.mkdtemp(prefix="chance-")), max_time=max_time)
    return stages


def inflated(scenario: Scenario, factor: float) -> tuple[TagSensorConfig, OdometryConfig]:
    """Sensors whose deviations are so many times as large."""
    sensor, odometry = copy.copy(scenario.tags), copy.copy(scenario.odometry)
    for config, names in (
        (sensor, ("range_noise", "range_noise_per_metre", "bearing_noise")),
        (odometry, ("distance_noise", "distance_scale", "gyro_noise", "gyro_bias")),
    ):
        for name in names:
            setattr(config, name, factor * getattr(config, name))
    return sensor, odometry


def without_choice(
    path: FloatArray, narrow: BoolArray, state: RoadmapState, on_way: BoolArray, parameters: PlanningParameters
) -> BoolArray:
    """Which of the narrow points (k,) of a path (k, 2), m in M, the robot has no choice about.

    They lie beside an edge of the way (e,) that is open though too narrow, no farther than a rounded corner may lead,
    or are where the robot sets off from a place with too little room.
    """
    edges, probability = state.edges, parameters.planner.collision_probability
    need = required_clearance(parameters.robot.radius, state.sigma[edges.nodes].max(axis=1), probability)
    forced = state.points[edges.nodes[on_way & (edges.clearance < need)]].reshape(-1, 4)
    return narrow & ((point_distance(path, forced) < ROUNDING) | np.logical_and.accumulate(narrow))


def main() -> None:
    """Run the mission, plan, roll out, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-time", type=float, default=3600.0, help="of the mission, s")
    parser.add_argument("--inflate", type=float, default=3.0)
    parser.add_argument("--rollouts", type=int, default=10_000)
    parser.add_argument("--paths", type=int, default=3)
    parser.add_argument("--probability", type=float, nargs="+", default=[0.1, 0.01])
    parser.add_argument("--risk", nargs="+", choices=RISKS, default=RISKS)
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    scenario = ApplySettings(LoadScenario(FindScenario(options.scenario)), options.settings)
    scenario.seed = options.seed
    stages = stages_of(scenario, options.max_time)
    sensor, odometry = inflated(scenario, options.inflate)
    print("risk   asked   paths  points  kept  narrow  worst point  points above   path mean  path most  reachable")
    for risk, probability in itertools.product(options.risk, options.probability):
        config = PlannerConfig(probability, risk)
        parameters = PlanningParameters(scenario.robot, sensor, odometry, scenario.explorer, config, scenario.seed)
        rng = np.random.default_rng(0)
        counts, kept, narrow, whole, reach = [], 0, 0, [], []
        for estimate, tfg, nodes in stages:
            loose = replace(estimate, covariance=options.inflate**2 * estimate.covariance)
            again = extend(nodes, tfg, loose, parameters)
            ways = routes(again, tfg, loose.X_MD, parameters)
            reach.append(
                np.isfinite(ways.cost).sum() / max(roadmap_message(again, ways, tfg, parameters).enterable.sum(), 1)
            )
            there = np.flatnonzero(np.isfinite(ways.cost))
            for node in rng.choice(there, min(options.paths, len(there)), replace=False):
                path = plan_path(again, loose, tfg, loose.X_MD, int(node), parameters)
                if len(path) < 2:
                    continue
                hits = collisions(path, loose, tfg, scenario.robot, sensor, odometry, rng, options.rollouts)
                lacking = too_narrow(path, loose, tfg, parameters)
                on_way = edges_on(again, nodes_to(ways, int(node)))
                left_out = without_choice(path, lacking, again, on_way, parameters)
                kept += int(left_out.sum())
                narrow += int((lacking & ~left_out).sum())
                counts.extend(hits[:, ~left_out].sum(axis=0).tolist())
                whole.append(float(hits[:, ~left_out].any(axis=1).mean()))
        above = sum(
            binomtest(count, options.rollouts).proportion_ci(method="wilson").low > probability
            for count in counts
            if count > probability * options.rollouts
        )
        print(
            f"{risk:<7}{probability:<8g}{len(whole):>5}{len(counts):>8}{kept:>6}{narrow:>8}"
            f"{max(counts) / options.rollouts:>13.4f}{above:>14}"
            f"{np.mean(whole):>12.4f}{max(whole):>11.4f}{np.mean(reach):>11.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Whether planned paths keep the collision probability they promise: Monte Carlo rollouts along them.

    python benchmarks/chance_constraint.py paper --inflate 3 --rollouts 10000

At every stage of a mission the standard deviations of the map's joint Gaussian and of the sensors are multiplied by
--inflate, the roadmap is checked anew, and --paths paths to nodes drawn at random are planned and rolled out. A row a
probability asked for: paths, their points, the largest share of rollouts that collide at any one of them with how many
points have a 95 % (Wilson) interval wholly above what was asked, and mean and largest share that collide somewhere on
the path; then how much of the roadmap could be reached at all.
"""

from __future__ import annotations

import argparse
import copy
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.stats import binomtest

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.diagrams.run import explore
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario, Scenario
from tfg_drake.messages import MapEstimate, TfgMap, replace
from tfg_drake.planning import planner
from tfg_drake.planning.monte_carlo import collisions
from tfg_drake.planning.path import plan_path
from tfg_drake.planning.roadmap import RoadmapParameters, RoadmapState, extend
from tfg_drake.planning.routes import roadmap_message, routes

Stage = tuple[MapEstimate, TfgMap, RoadmapState]


def stages_of(scenario: Scenario) -> list[Stage]:
    """Map, TFG and roadmap of every stage of a mission."""
    stages: list[Stage] = []
    grow = planner._grow

    def noted(state, estimate, tfg, parameters):  # type: ignore[no-untyped-def]
        state = grow(state, estimate, tfg, parameters)
        stages.append((estimate, tfg, state.nodes))
        return state

    with mock.patch.object(planner, "_grow", noted):
        explore(scenario, out_dir=Path(tempfile.mkdtemp(prefix="chance-")))
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


def main() -> None:
    """Run the mission, plan, roll out, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--inflate", type=float, default=3.0)
    parser.add_argument("--rollouts", type=int, default=10_000)
    parser.add_argument("--paths", type=int, default=3)
    parser.add_argument("--probability", type=float, nargs="+", default=[0.1, 0.01])
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    scenario = ApplySettings(LoadScenario(FindScenario(options.scenario)), options.settings)
    scenario.seed = options.seed
    stages = stages_of(scenario)
    sensor, odometry = inflated(scenario, options.inflate)
    print("asked   paths  points  worst point  points above   path mean  path most  reachable")
    for probability in options.probability:
        config = copy.copy(scenario.planner)
        config.collision_probability = probability
        parameters = RoadmapParameters(scenario.robot, sensor, odometry, scenario.explorer, config, scenario.seed)
        rng = np.random.default_rng(0)
        worst, above, points, whole, reach = 0.0, 0, 0, [], []
        for estimate, tfg, nodes in stages:
            loose = replace(estimate, covariance=options.inflate**2 * estimate.covariance)
            again = extend(nodes, tfg, loose, parameters)
            ways = routes(again, tfg, loose.X_MD, scenario.robot, config)
            roadmap = roadmap_message(again, ways, scenario.robot, config)
            reach.append(roadmap.reachable.sum() / max(roadmap.enterable.sum(), 1))
            there = np.flatnonzero(roadmap.reachable)
            for node in rng.choice(there, min(options.paths, len(there)), replace=False):
                path = plan_path(again, tfg, loose.X_MD, int(node), scenario.robot, config)
                if len(path) < 2:
                    continue
                hits = collisions(path, loose, tfg, scenario.robot, sensor, odometry, rng, options.rollouts)
                share = hits.mean(axis=0)
                worst, points = max(worst, float(share.max())), points + len(path)
                above += sum(
                    binomtest(int(count), options.rollouts).proportion_ci(method="wilson").low > probability
                    for count in hits.sum(axis=0)
                    if count > probability * options.rollouts
                )
                whole.append(float(hits.any(axis=1).mean()))
        print(
            f"{probability:<8g}{len(whole):>5}{points:>8}{worst:>13.4f}{above:>14}{np.mean(whole):>12.4f}"
            f"{max(whole):>11.4f}{np.mean(reach):>11.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Published approximations to the information gain against the exact one, on the maps of missions.

    python benchmarks/gains.py paper --seeds 3

At every stage of a mission each formula (explorer.gain) is evaluated at every node of the roadmap that the robot could
turn at. A row a formula: mean and largest difference from the exact gain, nats, and the mean of that relative to it;
their rank correlation within a stage, the mean; and the share of stages at which the node of most gain per time is the
same, with what the formula's choice loses of the exact rate where it is not.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from scipy.stats import spearmanr

from tfg_drake.config import GAINS
from tfg_drake.diagrams.missions.paper_figures import stages_of
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario
from tfg_drake.pictures.paper_figures import gain_field
from tfg_drake.planning.candidates import time_at_goal
from tfg_drake.planning.parameters import PlanningParameters


def main() -> None:
    """Run the missions, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    rows: dict[str, list[list[float]]] = {name: [] for name in GAINS if name != "exact"}
    for seed in range(options.seeds):
        scenario = ApplySettings(LoadScenario(FindScenario(options.scenario)), options.settings)
        scenario.seed = seed
        stages, _, _ = stages_of(scenario, lambda stage, time: False)
        parameters = PlanningParameters(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer)
        stay = time_at_goal(scenario.tags, scenario.explorer)
        for stage in stages:
            nodes, exact = gain_field(stage, parameters)
            if len(nodes) < 10:
                continue
            rate = exact.gain / (stage.roadmap.travel_time[nodes] + stay)
            for name, found in rows.items():
                explorer = dataclasses.replace(scenario.explorer, gain=name)
                _, gains = gain_field(stage, dataclasses.replace(parameters, explorer=explorer))
                off = gains.gain - exact.gain
                best = int(np.argmax(gains.gain / (stage.roadmap.travel_time[nodes] + stay)))
                found.append(
                    [
                        off.mean(),
                        np.abs(off).max(),
                        np.abs(off).mean() / exact.gain.mean(),
                        spearmanr(gains.gain, exact.gain).statistic,
                        best == int(np.argmax(rate)),
                        1.0 - rate[best] / rate.max(),
                    ]
                )
    print(f"{len(next(iter(rows.values())))} stages")
    print("formula    mean nats  most nats   relative  rank corr.  same node  rate lost else")
    for name, found in rows.items():
        mean, most, relative, rank, same, lost = np.array(found).T
        loss = float(lost[same == 0.0].mean()) if (same == 0.0).any() else 0.0
        print(
            f"{name:10}{mean.mean():>10.2f}{most.max():>11.1f}{relative.mean():>11.3f}{np.nanmean(rank):>12.3f}"
            f"{same.mean():>11.3f}{loss:>16.3f}"
        )


if __name__ == "__main__":
    main()

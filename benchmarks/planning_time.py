"""CPU time of one stage of planning, part by part, and whether screening second looks changes the choice.

    python benchmarks/planning_time.py paper --seeds 5

CPU milliseconds a stage: the TFG's update, the roadmap's, the choice of a goal, the path there with every replanning;
the latter three together (planning) and all four; median, 99th percentile and largest over all stages of the missions.
Then the share of stages at which judging every place for a second look by all its tags, not only the best of those
screened, leads to the same goal. Alone on the machine, or it measures the neighbours too.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario
from tfg_drake.planning import goal_choice, planner, revisit
from tfg_drake.systems import info_gain_goal_selector, tfg_builder

# Functions that return the stage from the arguments of each part.
PARTS: dict[str, Callable[..., int]] = {
    "tfg": lambda _, estimate, *others: estimate.stage,
    "roadmap": lambda _, working, *others: working.stage,
    "goal": lambda now, *others: now.estimate.stage,
    "path": lambda _, task: task.mission.stage,
}


def timed(function: Callable[..., Any], part: str, spent: dict[str, dict[int, float]]) -> Callable[..., Any]:
    """The function, each call's CPU milliseconds added to its part's of the stage."""

    def inner(*arguments: Any, **options: Any) -> Any:
        begin = time.thread_time()
        result = function(*arguments, **options)
        stage = PARTS[part](*arguments)
        spent[part][stage] = spent[part].get(stage, 0.0) + 1e3 * (time.thread_time() - begin)
        return result

    return inner


def main() -> None:
    """Run the missions and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--max-time", type=float, default=3600.0)
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    spent: dict[str, dict[int, float]] = {part: {} for part in PARTS}
    stages: list[list[float]] = []
    same: list[bool] = []
    choose = timed(goal_choice.choose, "goal", spent)

    def compared(*arguments: Any, **named: Any) -> Any:
        choice = choose(*arguments, **named)
        with mock.patch.object(revisit, "SEEN", 10**9):
            same.append(goal_choice.choose(*arguments, **named).node == choice.node)
        return choice

    with (
        mock.patch.object(tfg_builder, "update", timed(tfg_builder.update, "tfg", spent)),
        mock.patch.object(planner, "grow", timed(planner.grow, "roadmap", spent)),
        mock.patch.object(planner, "_plan", timed(planner._plan, "path", spent)),
        mock.patch.object(info_gain_goal_selector, "choose", compared),
    ):
        for seed in range(-1, options.seeds):
            scenario = ApplySettings(LoadScenario(FindScenario(options.scenario)), options.settings)
            scenario.seed = max(seed, 0)
            done = run_mission(scenario, max_time=options.max_time, out_dir=Path(tempfile.mkdtemp(prefix="planning-")))
            if done.summary["outcome"] == "fault":
                sys.exit(done.summary["reason"])
            if seed < 0:  # It compiled the kernels.
                same.clear()
            else:
                stages += [[spent[part].get(stage, 0.0) for part in PARTS] for stage in spent["goal"]]
            for part in spent.values():
                part.clear()
    each = np.array(stages)
    columns = {part: each[:, i] for i, part in enumerate(PARTS)}
    columns |= {"planning": each[:, 1:].sum(axis=1), "all": each.sum(axis=1)}
    print(f"{len(same)} stages    median       p99   largest")
    for name, ms in columns.items():
        print(f"{name:10}{np.median(ms):>12.1f}{np.percentile(ms, 99):>10.1f}{ms.max():>10.1f}")
    print(f"same goal without screening: {np.mean(same):.3f}")


if __name__ == "__main__":
    main()

"""The map's loss by marginalising the way: goals only, path keyframes, and a batch smoother of every measurement.

    python benchmarks/keyframes.py paper --seeds 5

Each mission is driven once, by the estimator that maps at goals only. All that reached it is then given to one that
maps the way in pieces of --period seconds, and to the batch smoother. A row a seed: landmark RMSE of the three, m, over
the landmarks that all of them mapped, and the keyframes' over the smoother's.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from unittest import mock

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake.comparison.metrics import landmark_rmse
from tfg_drake.datasets.batch_smoother import smooth
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario, MakeWorld
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.shared import by_data_sheet
from tfg_drake.systems import slam_estimator

STEPS = ("process_scan", "process_odometry", "process_detections", "begin_turn", "end_turn")


def recorded(steps: list[tuple[str, object]], name: str) -> Callable:
    """An estimator's step that notes what it was given."""
    step = getattr(estimator, name)

    def noted(state, given, **options):
        steps.append((name, given))
        return step(state, given, **options)

    return noted


def newest_only(messages: list) -> tuple:
    """The messages with each stamp once."""
    return tuple({message.stamp: message for message in messages}.values())


def run_seed(name: str, seed: int, period: float) -> tuple[int, list[float]]:
    """Landmark RMSE, m: goals only, path keyframes, batch smoother."""
    scenario = ApplySettings(
        LoadScenario(FindScenario(name)), ["explorer.path_keyframe_period=0", "explorer.glance_period=0"]
    )
    scenario.seed = seed
    world = MakeWorld(scenario.world)
    steps: list[tuple[str, object]] = []
    with mock.patch.multiple(slam_estimator, **{name: recorded(steps, name) for name in STEPS}):
        run_mission(scenario, out_dir=Path(tempfile.mkdtemp(prefix="keyframes-")))

    maps = []
    with threadpool_limits(limits=1):
        for keyframes in (0.0, period):
            state = initial_state(scenario.odometry, keyframes, by_data_sheet(scenario.odometry, scenario.tags))
            for step, given in steps:
                state = getattr(estimator, step)(state, given)
            estimate = state.map
            maps.append((estimate.ids, estimate.p_ML))
        odometry = newest_only([given for step, given in steps if step == "process_odometry"])
        detections = newest_only([given for step, given in steps if step == "process_detections"])
        detections = tuple(frame for frame in detections if np.isfinite(frame.stamp))
        run = smooth(odometry, detections, scenario.odometry)
        maps.append((run.ids, run.p_ML))

    common = world.tag_ids
    for ids, _ in maps:
        common = np.intersect1d(common, ids)
    truth = transform(inverse(world.start), world.p_WT)[np.searchsorted(world.tag_ids, common)]
    return seed, [landmark_rmse(p_ML[np.searchsorted(ids, common)], truth) for ids, p_ML in maps]


def main() -> None:
    """Run the missions, print a row as each ends, then the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--period", type=float, default=1.0, help="s between path keyframes")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    print("seed  goals only   keyframes    smoother       ratio", flush=True)
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        pending = [pool.submit(run_seed, options.scenario, k, options.period) for k in range(options.seeds)]
        for done in as_completed(pending):
            seed, rmse = done.result()
            rows.append(rmse)
            print(f"{seed:>4}  " + "  ".join(f"{value:>10.4f}" for value in [*rmse, rmse[1] / rmse[2]]), flush=True)
    mean = np.mean(rows, axis=0)
    print("mean  " + "  ".join(f"{value:>10.4f}" for value in [*mean, mean[1] / mean[2]]))


if __name__ == "__main__":
    main()

"""Gross errors and misread ids in a recorded run: RMSE with and without them.

    python benchmarks/outliers.py DATASET --robots 1 2 3 4 5
    python benchmarks/outliers.py DATASET --seeds 5

Of the sightings, a share --outliers gets any range up to the farthest seen and a bearing 0.3 rad off, a share --wrong
the id of any other landmark. A row a robot: RMSE, m, each after its own alignment, of the smoothed and the online
trajectory and of the landmarks; clean, spoilt (the mean over the seeds), and their ratio. For the simulated missions
the scenario has tags.outlier_probability and tags.wrong_id_probability.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake.datasets.batch_smoother import smooth
from tfg_drake.datasets.evaluation import landmark_error, robot_error
from tfg_drake.datasets.online import run_online
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import Recording
from tfg_drake.hardware.recordings import load_dataset
from tfg_drake.messages import TagDetections, replace

BEARING = 0.3


def spoilt(recording: Recording, outliers: float, wrong: float, seed: int) -> Recording:
    """The recording with some sightings made worthless."""
    rng = np.random.default_rng(seed)
    all_ids = np.unique(np.concatenate([frame.ids for frame in recording.detections]))
    farthest = max(float(frame.range.max(initial=0.0)) for frame in recording.detections)

    def spoil(frame: TagDetections) -> TagDetections:
        n = len(frame.ids)
        chance = rng.random(n)
        gross, misread = chance < outliers, (chance >= outliers) & (chance < outliers + wrong)
        return replace(
            frame,
            range=np.where(gross, rng.uniform(0.0, farthest, n), frame.range),
            bearing=frame.bearing + np.where(gross, BEARING * rng.standard_normal(n), 0.0),
            ids=np.where(misread, rng.choice(all_ids, n), frame.ids),
        )

    return replace(recording, detections=tuple(spoil(frame) for frame in recording.detections))


def errors(recording: Recording) -> list[float]:
    """RMSE, m: smoothed, online, landmarks."""
    truth = recording.truth
    if truth is None:
        raise SystemExit(f"{recording.name} comes without a truth to compare with.")
    online = run_online(recording)
    run = smooth(recording.odometry, recording.detections, recording.model, way=(online.stamps, online.X_MB))
    return [
        robot_error(truth, run.stamps, run.X_MB).rmse,
        robot_error(truth, online.stamps[online.seen], online.X_MB[online.seen]).rmse,
        landmark_error(truth, run.ids, run.p_ML).rmse_without,
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--robots", type=int, nargs="+", default=[1])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--outliers", type=float, default=0.03)
    parser.add_argument("--wrong", type=float, default=0.02)
    options = parser.parse_args()
    logging.getLogger("tfg_drake").setLevel(logging.ERROR)  # Each sighting left out is a line.
    print("robot" + "".join(f"{name:>30}" for name in ("smoothed", "online", "landmarks")))
    for robot in options.robots:
        recording = load_dataset(options.dataset, robot)
        if isinstance(recording, PoseGraph):
            raise SystemExit(f"{options.dataset} is a pose graph: it has no sightings to spoil.")
        clean = np.array(errors(recording))
        seeds = [spoilt(recording, options.outliers, options.wrong, seed) for seed in range(options.seeds)]
        worse = np.mean([errors(one) for one in seeds], axis=0)
        cells = "".join(f"{a:>12.3f}{b:>9.3f}{b / a:>9.2f}" for a, b in zip(clean, worse, strict=True))
        print(f"{robot:>5}{cells}", flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()

"""Whether the estimator stays as quick for hours: CPU time of an update against simulated time.

    python benchmarks/endurance.py office --hours 4

The robot goes on when everything is mapped: no gain is too small for it. A row for every ten minutes: views and
landmarks in the map, the landmarks known jointly, and the CPU milliseconds of one view's update (its turn solved, the
map solved, joint covariance, filters started anew), mean and largest; then the last ten minutes' mean over that of the
first ten in which the map was large all the time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.systems import slam_estimator

BIN = 600.0  # s


def main() -> None:
    """Run the mission and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="office")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hours", type=float, default=4.0)
    options = parser.parse_args()
    scenario = LoadScenario(FindScenario(options.scenario))
    scenario.seed = options.seed
    scenario.explorer.stop_gain = 0.0

    rows: list[list[float]] = []
    bins: list[tuple[bool, float]] = []

    def report(end: float) -> None:
        inside = np.array([row for row in rows if end - BIN <= row[0] < end])
        if not len(inside):
            return
        _, views, landmarks, local, _ = inside[-1]
        mean, largest = inside[:, 4].mean(), inside[:, 4].max()
        bins.append((bool(np.all(inside[:, 3] < inside[:, 2])), mean))
        print(f"{end / 60:>6.0f}{views:>8.0f}{landmarks:>11.0f}{local:>9.0f}{mean:>10.0f}{largest:>10.0f}", flush=True)

    def timed(state: EstimatorState, stamp: float, *, explored: bool) -> EstimatorState:
        begin = time.process_time()
        state = estimator.end_turn(state, stamp, explored=explored)
        spent = 1e3 * (time.process_time() - begin)
        graph, estimate = state.graph, state.map
        assert estimate is not None
        if rows and stamp // BIN > rows[-1][0] // BIN:
            report((stamp // BIN) * BIN)
        rows.append([stamp, len(graph.view_keyframe), len(graph.ids), len(estimate.local), spent])
        return state

    print("   min   views  landmarks  jointly   ms mean   ms most")
    with mock.patch.object(slam_estimator, "end_turn", timed):
        folder = Path(tempfile.mkdtemp(prefix="endurance-"))
        summary = run_mission(scenario, max_time=3600.0 * options.hours, out_dir=folder).summary
    report((rows[-1][0] // BIN + 1) * BIN)
    print(f"{summary['outcome']}: {summary['reason']}")
    large = [mean for whole_bin_large, mean in bins if whole_bin_large]
    if len(large) > 1:
        print(f"last ten minutes over the first ten on a large map: {large[-1] / large[0]:.2f}")


if __name__ == "__main__":
    main()

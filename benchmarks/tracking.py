"""How far the robot strays from its path while it follows it, over whole missions.

    python benchmarks/tracking.py paper --seeds 5

The distance from the localiser's pose, which steers, to the path, at every command: root mean square, 99th percentile
and the largest, m, of all driving, of that at full speed, and of the first metre after the path was changed for another
on the way. The chance constraint counts on TRACKING_DEVIATION.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
import shapely

from tfg_drake.config import RobotConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.messages import FloatArray
from tfg_drake.planning.chance_constraint import TRACKING_DEVIATION
from tfg_drake.planning.pure_pursuit import PathCommand, follow
from tfg_drake.systems import pure_pursuit_follower

# The first SETTLED, m, of a path counts apart: it may begin beside the robot, which drove on during planning.
SETTLED = 1.0
FULL_SPEED = 0.95


def main() -> None:
    """Run the missions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    rows: list[tuple[float, float, float]] = []

    def noted(
        points: FloatArray, X_MB: FloatArray, speed: float, progress: float, turning: bool, robot: RobotConfig
    ) -> PathCommand:
        command = follow(points, X_MB, speed, progress, turning, robot)
        if not command.turning and not command.finished:
            away = shapely.distance(shapely.linestrings(points), shapely.points(X_MB[:2]))
            rows.append((float(away), speed / robot.max_speed, command.progress))
        return command

    with mock.patch.object(pure_pursuit_follower, "follow", noted):
        for seed in range(options.seeds):
            scenario = LoadScenario(FindScenario(options.scenario))
            scenario.seed = seed
            done = run_mission(scenario, out_dir=Path(tempfile.mkdtemp(prefix="tracking-")))
            if done.summary["outcome"] == "fault":
                sys.exit(done.summary["reason"])
    away, speed, progress = np.array(rows).T
    print(f"{len(away)} commands; the chance constraint counts on {TRACKING_DEVIATION} m")
    print("                             rms       99 %   largest")
    for name, which in (
        ("all", speed >= 0.0),
        ("at full speed, settled", (speed >= FULL_SPEED) & (progress >= SETTLED)),
        ("the path's first metre", progress < SETTLED),
    ):
        d = away[which]
        print(f"{name:24}{np.sqrt(np.mean(d**2)):>10.4f}{np.percentile(d, 99):>10.4f}{d.max():>10.4f}")


if __name__ == "__main__":
    main()

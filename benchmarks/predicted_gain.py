"""Predicted against realised information gain, stage by stage.

    python benchmarks/predicted_gain.py paper --seeds 10 --figure gain.png

The prediction is the exact gain of a turn at the pose where the robot really arrived, with the tags that it really saw
there, each as often as the mean of them: what is tested is the formula with its model of a turn, not the guess of what
will be in view. With --full-turn a tag counts as often as in a full turn, as in the explorer's choice: the robot turns
for less where what it came to see lies to one side. Exploitation: of
the landmarks known before, the entropy that the turn took away. Total: with the new ones, from the explorer's prior.
Then, apart, how many new tags a goal was expected to show when it was chosen, and how many it did.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path
from unittest import mock

import matplotlib.pyplot as plt
import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario, Scenario
from tfg_drake.messages import FloatArray, GoalChoice, MapEstimate
from tfg_drake.planning import goal_choice
from tfg_drake.planning.candidates import frontier_seen
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain
from tfg_drake.planning.expected_view import expected_frontiers
from tfg_drake.planning.information_gain import (
    departure_given_landmarks,
    odometry_covariance,
    sightings_of_turn,
    turn_noise,
)
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.slam.turn import TurnFrame
from tfg_drake.systems import info_gain_goal_selector, slam_estimator

# The predicted gain is that of the turn at a goal, so nothing is mapped on the way there.
ONLY_GOALS = ["explorer.path_keyframe_period=0", "explorer.glance_period=0"]
IN_REACH = np.array([1e9, 1.0])


def predicted(
    before: MapEstimate, after: MapEstimate, distance: float, sightings: float, scenario: Scenario
) -> FloatArray:
    """Exploitation and exploration, nats, of the newest goal of `after`, by the map before; sightings of each tag."""
    place = after.X_MA[-1:, :2].copy()
    seen = after.observation.ids
    rows = np.flatnonzero(np.isin(before.ids[before.local], seen))
    new = after.p_ML[np.isin(after.ids, np.setdiff1d(seen, before.ids))]
    time = np.array([distance / scenario.robot.max_speed])
    arrival = Arrival(
        before.X_MD,
        departure_given_landmarks(before),
        odometry_covariance(before.X_MD, place, np.array([distance]), time, scenario.odometry),
    )
    p_ML = before.local_p_ML
    tags = np.arange(len(p_ML)), np.tile(np.eye(2), (len(p_ML), 1, 1)), np.zeros_like(p_ML)
    known = Known(np.array([0, len(rows)]), rows, p_ML, *tags, before.covariance)
    offsets, each = np.array([0, len(new)]), np.arange(len(new))
    unknown = New(offsets, each, new, np.ones(len(new)), scenario.explorer.prior_sigma, IN_REACH)
    return exact_gain(place, arrival, known, unknown, turn_noise(scenario.tags, sightings))[0, :2]


def entropy(covariance: FloatArray) -> float:
    """Nats of a Gaussian."""
    return 0.5 * float(np.linalg.slogdet(2.0 * math.pi * math.e * covariance)[1])


def realised(before: MapEstimate, after: MapEstimate, explorer: ExplorerConfig) -> tuple[float, float]:
    """Exploitation and total, nats."""
    kept = np.flatnonzero(np.isin(after.ids[after.local], before.ids))
    rows = np.stack([2 * kept, 2 * kept + 1], axis=1).ravel()
    known = entropy(before.covariance[:-3, :-3])
    prior = (len(after.ids) - len(before.ids)) * math.log(2.0 * math.pi * math.e * explorer.prior_sigma**2)
    exploitation = known - entropy(after.covariance[np.ix_(rows, rows)])
    return exploitation, known + prior - entropy(after.covariance[:-3, :-3])


def mean_sightings(frames: tuple[TurnFrame, ...]) -> float:
    """How often each tag of a turn was seen, the mean."""
    _, count = np.unique(np.concatenate([np.zeros(0), *(frame.detections.ids for frame in frames)]), return_counts=True)
    return float(count.mean()) if len(count) else 0.0


def one_mission(scenario: Scenario, full_turn: bool) -> tuple[list[list[float]], list[list[float]]]:
    """Rows of a mission's stages: predicted and realised exploitation and total; and new tags expected and seen."""
    gains: list[list[float]] = []
    numbers: list[list[float]] = []
    expected: list[float] = []
    end_turn, choose = estimator.end_turn, goal_choice.choose

    def noted_turn(state: EstimatorState, stamp: float, *, explored: bool) -> EstimatorState:
        before, turn = state.map, state.turn
        state = end_turn(state, stamp, explored=explored)
        after = state.map
        assert after is not None
        if before is not None and len(before.local) == len(before.ids) and turn is not None:
            distance = float(np.hypot(*(after.X_MA[-1, :2] - before.X_MD[:2])))
            sightings = mean_sightings(turn.frames)
            if full_turn:
                sightings = sightings_of_turn(scenario.tags, scenario.explorer.turn_rate)
            exploitation, exploration = predicted(before, after, distance, sightings, scenario)
            known, total = realised(before, after, scenario.explorer)
            gains.append([exploitation, known, exploitation + exploration, total])
            if expected:
                numbers.append([expected[-1], len(after.ids) - len(before.ids)])
        return state

    def noted_choice(now, *others, **options) -> GoalChoice:  # type: ignore[no-untyped-def]
        choice, sensor, tfg = choose(now, *others, **options), scenario.tags, now.tfg
        if choice.node >= 0:
            view = expected_frontiers(choice.p_MG[None], tfg, sensor)
            length = frontier_seen(choice.p_MG[None], view, tfg, sensor).sum()
            expected.append(scenario.explorer.density * float(length))
        return choice

    with (
        mock.patch.object(slam_estimator, "end_turn", noted_turn),
        mock.patch.object(info_gain_goal_selector, "choose", noted_choice),
    ):
        done = run_mission(scenario, out_dir=Path(tempfile.mkdtemp(prefix="gain-")))
    if done.summary["outcome"] == "fault":
        sys.exit(done.summary["reason"])
    return gains, numbers


def fit(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of the line through the origin's neighbourhood (with intercept), and R^2 of y by x itself."""
    slope = float(np.polyfit(x, y, 1)[0])
    return slope, 1.0 - float(np.sum((y - x) ** 2) / np.sum((y - y.mean()) ** 2))


def main() -> None:
    """Run the missions, print slopes and R^2, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--set", action="append", default=[], dest="settings")
    parser.add_argument("--full-turn", action="store_true")
    parser.add_argument("--figure", type=Path, default=None)
    options = parser.parse_args()
    gains: list[list[float]] = []
    numbers: list[list[float]] = []
    for seed in range(options.seeds):
        scenario = ApplySettings(LoadScenario(FindScenario(options.scenario)), [*ONLY_GOALS, *options.settings])
        scenario.seed = seed
        more, counts = one_mission(scenario, options.full_turn)
        gains, numbers = gains + more, numbers + counts
    data, counted = np.array(gains), np.array(numbers)
    print(f"{len(data)} stages of {options.seeds} missions")
    panels = [("exploitation", data[:, 0], data[:, 1]), ("total", data[:, 2], data[:, 3])]
    for name, x, y in panels:
        slope, r2 = fit(x, y)
        print(
            f"{name:14} realised over predicted: slope {slope:.3f}, R^2 {r2:.3f}, mean {x.mean():.1f} -> {y.mean():.1f}"
        )
    print("new tags expected -> seen, by fifths of what was expected:")
    for part in np.array_split(counted[np.argsort(counted[:, 0])], 5):
        print(f"  {part[:, 0].mean():6.1f} -> {part[:, 1].mean():6.1f}   ({len(part)} stages)")
    if options.figure is not None:
        draw(panels, counted, options.figure)


def draw(panels: list[tuple[str, FloatArray, FloatArray]], counted: FloatArray, path: Path) -> None:
    """Predicted against realised, and new tags expected against seen."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    panels = [*panels, ("new tags", counted[:, 0], counted[:, 1])]
    for axis, (name, x, y) in zip(axes, panels, strict=True):
        most = max(x.max(), y.max())
        axis.plot([0, most], [0, most], color="0.7", linewidth=1)
        axis.scatter(x, y, s=10, alpha=0.5, linewidth=0)
        unit = "" if name == "new tags" else ", nats"
        axis.set(title=name, xlabel=f"predicted{unit}", ylabel=f"realised{unit}", aspect="equal")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()

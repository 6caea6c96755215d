"""The paper's figures and tables from missions of our own."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tfg_drake.comparison.paper_tables import METHODS as COMPARED
from tfg_drake.comparison.paper_tables import parameter_table, performance_table
from tfg_drake.comparison.runs import Run
from tfg_drake.config import DisturbanceConfig
from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.comparison_report import write_comparison
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.missions.sweep import run_sweep
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, PrepareScenario, Scenario
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.io.files import write_atomic
from tfg_drake.messages import FloatArray, GoalChoice, MapEstimate, Roadmap, TfgMap
from tfg_drake.pictures.figure_file import write_formats
from tfg_drake.pictures.paper_figures import Stage, draw_gains, draw_growth, draw_priors, draw_tfg
from tfg_drake.planning.parameters import PlanningParameters

# The stage whose gains are drawn, half-way through the mission.
GAIN_STAGE = 60
# Number of pictures of the map's growth.
GROWTH = 4
# Period of the checks of the mission, simulated s.
STEP = 0.5
LONGEST = 3600.0
# Number of missions per method for Table II, that of the paper's Fig. 8.
RUNS = 4
# PUSH: the push of Sec. IV-C, whose size is not printed. DISTURBED: the methods that are pushed: active, driven by an
# expert, and with a grid.
PUSH = DisturbanceConfig(time=120.0, duration=1.0, ahead=-0.5, turn=0.5)
DISTURBED = ("tfg", "scripted", "grid-nearest")
# Each figure, its content, and the paper's statement.
PAGE = (
    ("tfg.png", "Fig. 3: the TFG and goal points", "vertices are features, edges obstacle surfaces."),
    (
        "information_gain.png",
        "Fig. 4: information gain",
        "exploitation is largest where most features are seen, exploration near frontiers, more at larger ones.",
    ),
    (
        "priors.png",
        "Fig. 5: priors of new features",
        "with a high prior variance (text), or where many features are expected (caption), frontiers are preferred;"
        " with a low one the robot revisits.",
    ),
    ("table-2/maps.png", "Fig. 6: maps", "frontier exploration distorts the hallways; the TFG keeps the shape."),
    ("table-2/coverage.png", "Fig. 7: coverage", "the TFG is slightly slower than the greedy nearest frontier."),
    ("table-2/errors.png", "Fig. 8: pose error", "the TFG's is consistently smaller, above all in position."),
    ("growth.png", "Fig. 9: growth of the map", "from a partial map, frontier by frontier, until it covers the space."),
    (
        "felt/maps.png",
        "Fig. 11: after a disturbance that the gyro feels",
        "active SLAM recovers the space, the expert misses some surfaces, the grid map drifts for good.",
    ),
    ("unfelt/maps.png", "Fig. 11: after one that it does not feel", "does not tell which of the two it was."),
)


def stages_of(scenario: Scenario, on_stage: Callable[[int, float], bool]) -> tuple[list[Stage], FloatArray, FloatArray]:
    """The explorer's inputs at every stage of a mission, and its way: stamps (n,), s, and places p_MB (n, 2).

    Until the mission's end or until on_stage, called with stage and time (s) of each, says that it is enough.
    """
    mission, stages = Mission(MissionRequest(scenario)), list[Stage]()
    mission.begin()
    while mission.time < LONGEST and mission.status.phase != "done":
        mission.advance(mission.time + STEP)
        goal = mission.look("goal", GoalChoice)
        if goal.stage > len(stages):
            seen = mission.look("map", MapEstimate), mission.look("tfg", TfgMap), mission.look("roadmap", Roadmap)
            stages.append(Stage(*seen, goal))
            if on_stage(goal.stage, mission.time):
                break
    stamps, X_WB = mission.estimated_poses()
    return stages, stamps, transform(inverse(mission.X_WM), X_WB[:, :2])


def write_figures(
    folder: Path, on_stage: Callable[[int, float], bool], interrupted: threading.Event | None = None
) -> list[Path]:
    """Run a mission in `paper` by the method tfg and write the figures; returns the files, none if interrupted.

    on_stage: see `stages_of`.

    Raises:
        OSError: a file cannot be written.
    """
    scenario = LoadScenario("paper")
    stages, stamps, p_MB = stages_of(scenario, on_stage)
    if interrupted is not None and interrupted.is_set():
        return []
    chosen = stages[min(GAIN_STAGE, len(stages)) - 1]
    parameters = PlanningParameters(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer)
    growth = [stages[round(k * (len(stages) - 1) / (GROWTH - 1))] for k in range(GROWTH)]
    figures = {
        "information_gain": draw_gains(chosen, parameters),
        "priors": draw_priors(chosen, parameters),
        "tfg": draw_tfg(chosen),
        "growth": draw_growth(growth, stamps, p_MB),
    }
    return [path for name, figure in figures.items() for path in write_formats(folder, name, figure)]


def write_tables(folder: Path, interrupted: threading.Event, show: Callable[[str], object]) -> tuple[Path, list[str]]:
    """Run RUNS missions of each method of Table II in `paper`, and one of each of DISTURBED after a push with a gyro
    that feels it and with one that does not, less those that are in the folder; compare them, and write the tables and
    `paper.md`, the page of all. Returns that file, and a line for each comparison whose missions are not all there.

    show: is told how far they are.

    Raises:
        SweepError: the folder holds other missions.
        OSError: a file cannot be written.
    """
    scenarios, missing = [PrepareScenario("paper", seed=seed) for seed in range(RUNS)], list[str]()

    def compared(name: str, scenarios: Sequence[Scenario], world: str, methods: Sequence[str]) -> list[Run]:
        asked = [MissionRequest(one, name=world, world_name=world, max_time=LONGEST) for one in scenarios]
        tasks = [dataclasses.replace(one, method=METHODS[method]) for one in asked for method in methods]
        sweep = folder / name
        sweep.mkdir(parents=True, exist_ok=True)
        runs = run_sweep(tasks, sweep, 1, None, interrupted, show)
        write_comparison(runs, tasks, sweep, "tfg-drake figures", show)
        if (done := sum(run.summary is not None for run in runs)) < len(tasks):
            missing.append(f"{name}: {done} of {len(tasks)} missions are done")
        return runs

    runs = compared("table-2", scenarios, "paper", COMPARED)
    for name, feels in (("felt", True), ("unfelt", False)):
        pushed = LoadScenario("house")
        pushed.disturbances = [dataclasses.replace(PUSH, gyro_feels=feels)]
        compared(name, [pushed], "house", DISTURBED)
    scenario, world = scenarios[0], MakeWorld(scenarios[0].world)
    width, height = np.ptp(world.walls.reshape(-1, 2), axis=0)
    parameters = parameter_table((width, height), len(world.tag_ids), scenario.tags, scenario.scan, scenario.grid)
    write_atomic(folder / "tables.md", f"{parameters}\n{performance_table(runs, 'paper', RUNS)}")
    parts = ["# The paper's figures, from missions of our own"]
    if missing:
        parts.append(f"**Not whole.** {'; '.join(missing)}. The same command in the same folder goes on.")
    for file, title, says in PAGE:
        picture = f"![{title}]({file})" if (folder / file).is_file() else f"Missing: {file}."
        parts += [f"## {title}", picture, f"The paper: {says}"]
    page = folder / "paper.md"
    write_atomic(page, "\n\n".join([*parts, "The tables: tables.md."]) + "\n")
    return page, missing

"""`tfg-drake figures`: the paper's figures from a mission of our own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from threadpoolctl import threadpool_limits

from tfg_drake.diagrams.run import MakeMissionDiagram
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario, MakeWorld, Scenario
from tfg_drake.messages import FloatArray
from tfg_drake.paper_figures import Field, Stage, draw_gains, draw_growth, draw_priors, draw_tfg, write_figure

# The stage whose gains are drawn: much is known, much is open.
GAIN_STAGE = 8
# Pictures of the map's growth.
GROWTH = 4
# Simulated time between two looks at the mission, s.
STEP = 0.5
LONGEST = 3600.0


def stages_of(scenario: Scenario, on_stage: Callable[[int, float], bool]) -> tuple[list[Stage], FloatArray, FloatArray]:
    """What the explorer had before it at every stage of a mission, and its way: stamps (n,), s, and places p_MB (n, 2).

    Until the mission's end or until on_stage, called with stage and time (s) of each, says that it is enough.
    """
    diagram, _, pose_log = MakeMissionDiagram(scenario, MakeWorld(scenario.world), None, "")
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.SetRandomContext(context, RandomGenerator(scenario.seed))
    explorer = diagram.GetSubsystemByName("explorer")
    own = explorer.GetMyContextFromRoot(context)
    simulator.Initialize()
    stages: list[Stage] = []
    while context.get_time() < LONGEST:
        simulator.AdvanceTo(context.get_time() + STEP)
        goal = explorer.GetOutputPort("goal").Eval(own)
        if goal.stage > len(stages):
            estimate, tfg, roadmap = (explorer.GetOutputPort(name).Eval(own) for name in ("map", "tfg", "roadmap"))
            stages.append(Stage(estimate, tfg, roadmap, goal))
            if on_stage(goal.stage, context.get_time()):
                break
        if explorer.GetOutputPort("mission").Eval(own).phase == "done":
            break
    data = pose_log.FindLog(context).data()
    return stages, data[0], data[1:3].T


def write_figures(folder: Path, on_stage: Callable[[int, float], bool]) -> list[Path]:
    """Run a mission in `paper` and write the figures; returns the files.

    Raises:
        OSError: a file cannot be written.
    """
    scenario = LoadScenario(FindScenario("paper"))
    with threadpool_limits(limits=1):
        stages, stamps, p_MB = stages_of(scenario, on_stage)
    chosen = stages[min(GAIN_STAGE, len(stages)) - 1]
    field = Field(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer)
    growth = [stages[round(k * (len(stages) - 1) / (GROWTH - 1))] for k in range(GROWTH)]
    figures = {
        "information_gain": draw_gains(chosen, field),
        "priors": draw_priors(chosen, field),
        "tfg": draw_tfg(chosen),
        "growth": draw_growth(growth, stamps, p_MB),
    }
    return [path for name, figure in figures.items() for path in write_figure(figure, folder, name)]

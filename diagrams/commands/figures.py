"""`tfg-drake figures`: reproduces the paper's figures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import option
from tfg_drake.diagrams.compile_kernels import wait_for_kernels
from tfg_drake.diagrams.missions.run_folder import claimed
from tfg_drake.diagrams.screen import Screen


def figures(
    out: Annotated[Path, option("DIR", "Output folder.")] = Path("figures"),
) -> None:
    """Reproduce the paper's figures and tables with our own missions: gains, priors, the TFG, its growth, maps,
    coverage, errors, a disturbance, Tables I and II, and paper.md, which compares each with the paper. With the same
    DIR, continue an interrupted call."""
    command.make_writable(out)
    with Screen("loading") as show:
        wait_for_kernels(show, command.interruption)

        from tfg_drake.diagrams.missions.paper_figures import write_figures, write_tables

        def on_stage(stage: int, time: float) -> bool:
            show(f"the mission to draw: stage {stage}, {time:.0f} s")
            return command.interruption.is_set()

        with claimed(out):
            files, missing = write_figures(out, on_stage, command.interruption), ["the figures of one mission"]
            if files:
                page, missing = write_tables(out, command.interruption, show)
                files.append(page)
    for file in files:
        print(file)
    if missing:
        print(f"not whole: {'; '.join(missing)}; the same command in the same folder goes on")
    command.end_unless_interrupted()

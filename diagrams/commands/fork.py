"""`tfg-drake fork`: repeats a run to a stage, continues with another goal, and compares both."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, option, parse_place
from tfg_drake.diagrams.compile_kernels import wait_for_kernels
from tfg_drake.diagrams.screen import Screen

if TYPE_CHECKING:
    from tfg_drake.diagrams.missions.fork import Candidate

# Number of the stage's candidates to print.
SHOWN = 5


def fork(
    run: Annotated[Path, argument("RUN", "The folder of a simulated run.")],
    stage: Annotated[int, option("N", "The stage whose goal is changed.")],
    goal: Annotated[
        str | None,
        option(
            "X,Y", "Drive to the reachable place nearest to this one, at most 0.5 m from it, in the world frame, m."
        ),
    ] = None,
    candidate: Annotated[
        int | None, option("K", "Or drive to the stage's K-th candidate; 1 has the most gain.")
    ] = None,
    out: Annotated[
        Path | None, option("DIR", "The fork's folder [default: runs/<time>-<scenario>-fork-<seed>].")
    ] = None,
    as_json: command.AsJson = False,
) -> None:
    """Repeat a simulated run to a stage, continue with another goal, and compare both."""
    if goal is not None and candidate is not None:
        bad_input("--goal and --candidate exclude each other; name one of them")
    place = None if goal is None else parse_place("--goal", goal, "X,Y")
    command.make_ready(out)
    with Screen("loading") as show:
        wait_for_kernels(show, command.interruption)

        from tfg_drake.comparison.differences import difference_rows
        from tfg_drake.diagrams.missions import fork as forks
        from tfg_drake.diagrams.missions.run import run_mission

        before, request = forks.forkable(run, stage)
        if out is not None and out.resolve() == run.resolve():
            bad_input(f"--out {out}: holds the run that is forked; name another folder")
        change, summary = forks.Fork(stage, place, candidate), before.summary
        result = run_mission(
            request,
            out_dir=out,
            on_progress=lambda progress: show(progress.line),
            interrupted=command.interruption,
            monitor=change.monitor,
        )
        if change.failure is not None:
            if out is None:
                shutil.rmtree(result.folder)  # Its files are useless.
            raise change.failure
        forks.check_same(before, result.stages, stage)
    for line in aligned(candidate_rows(change.candidates)):
        print(line)
    print()
    for line in aligned(difference_rows(dict(summary), result.summary)):
        print(line)
    print(f"files: {result.folder}")
    command.end(result.summary, command.EXIT_CODES[result.summary["outcome"]], as_json)


def candidate_rows(candidates: Sequence[Candidate]) -> list[tuple[str, ...]]:
    """Return rows of the stage's best candidates and of the chosen one: number, place, gain and its parts (known
    landmarks, new landmarks, pose price), nats, travel time, s."""
    rows: list[tuple[str, ...]] = [("candidate", "x m", "y m", "gain", "known", "new", "price", "time s", "")]
    for number, one in enumerate(candidates, start=1):
        if number > SHOWN and not one.chosen:
            continue
        x, y = one.p_WG
        numbers = (one.gain, one.exploitation, one.exploration, one.pose_price, one.time)
        cells = [f"{value:.1f}" if math.isfinite(value) else "-" for value in numbers]
        rows.append((str(number), f"{x:.2f}", f"{y:.2f}", *cells, "chosen" if one.chosen else ""))
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Format the lines of a table: the first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip() for row in rows]

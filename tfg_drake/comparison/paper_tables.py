"""The paper's Tables I and II, its own columns beside ours."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tfg_drake.comparison.measures import CPU_IDLE, HEADING, POSITION, TIME, VARIABLES, Measure
from tfg_drake.comparison.report import Table, markdown_table
from tfg_drake.comparison.runs import Run, sample
from tfg_drake.comparison.statistics import spread
from tfg_drake.config import GridConfig, ScanConfig, TagSensorConfig

# The methods of the paper's Table II, and its values.
METHODS = ("tfg", "grid-nearest")
_PAPER = (
    (Measure("variables", "", 0, VARIABLES.read), "274", "800000"),
    (Measure("CPU idle time", "%", 0, CPU_IDLE.read), "75", "0"),
    (Measure("running time", "s", 0, TIME.read), "2433 ± 546", "2293 ± 375"),
    (Measure("position error", "m", 3, POSITION.read), "0.147 ± 0.115", "5.26 ± 3.53"),
    (Measure("orientation error", "rad", 4, HEADING.read), "0.0217 ± 0.016", "0.0213 ± 0.0165"),
)


def parameter_table(
    size: tuple[float, float], landmarks: int, tags: TagSensorConfig, scan: ScanConfig, grid: GridConfig
) -> str:
    """Table I, simulation parameters, as Markdown. size: of the environment, m."""
    rows = (
        ("size of environment", "46 m x 22 m", f"{size[0]:g} m x {size[1]:g} m"),
        ("landmarks", "274", str(landmarks)),
        ("sensor range", "10 m", f"tags {tags.range:g} m, scan {scan.range:g} m"),
        ("field of view", "124°", f"{math.degrees(tags.field_of_view):.0f}°"),
        ("particles of GMapping", "100", str(grid.particles)),
        (
            "rate of GMapping's updates",
            "0.33 Hz",
            f"{1.0 / grid.update_period:.2f} Hz in motion, and every {grid.update_distance:g} m"
            f" or {grid.update_angle:g} rad",
        ),
        ("rate of landmark measurements", "10 Hz", f"{tags.rate:g} Hz"),
    )
    return markdown_table(Table("Table I: simulation parameters", "", ("", "paper", "here"), rows)) + "\n"


def performance_table(runs: Sequence[Run], scenario: str, seeds: int) -> str:
    """Table II, performance, as Markdown: mean ± standard deviation over the runs of METHODS. seeds: how many there are
    to be; a cell of fewer runs says of how many it is."""
    ours, baseline = METHODS
    rows = [
        (one.label, paper_tfg, _cell(runs, ours, one, seeds), paper_grid, _cell(runs, baseline, one, seeds))
        for one, paper_tfg, paper_grid in _PAPER
    ]
    done = sum(run.summary is not None for run in runs)
    note = f"Partial: {done} of {len(METHODS) * seeds} missions are done." if done < len(METHODS) * seeds else ""
    title = f"Table II: performance, the paper over 4 runs in a world of its own, here over {seeds} of `{scenario}`"
    header = ("", "TFG active SLAM, paper", "`tfg`, here", "grid map frontier, paper", "`grid-nearest`, here")
    return markdown_table(Table(title, note, header, rows)) + "\n"


def _cell(runs: Sequence[Run], method: str, measure: Measure, seeds: int) -> str:
    one = spread(sample(runs, method, measure.read))
    if not one.n:
        return "-"
    few = f", n = {one.n}" if one.n < seeds else ""
    return measure.shown(one.mean.value) + (f" ± {one.std:.{measure.digits}f}" if one.n > 1 else "") + few

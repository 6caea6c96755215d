"""The paper's Tables I and II, its own columns beside ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from tfg_drake.comparison.measures import CPU_IDLE, HEADING, POSITION, TIME, VARIABLES
from tfg_drake.comparison.report import Table, markdown_table
from tfg_drake.comparison.runs import Run, sample
from tfg_drake.comparison.statistics import spread
from tfg_drake.config import GridConfig, ScanConfig, TagSensorConfig
from tfg_drake.percent import percent

# The methods of the paper's Table II, and what it says of them.
METHODS = ("tfg", "grid-nearest")
_PAPER: tuple[tuple[str, Callable[[dict[str, Any]], float | None], int, str, str], ...] = (
    ("variables", VARIABLES.read, 0, "274", "800000"),
    ("CPU idle time (%)", CPU_IDLE.read, 0, "75", "0"),
    ("running time (s)", TIME.read, 0, "2433 ± 546", "2293 ± 375"),
    ("position error (m)", POSITION.read, 3, "0.147 ± 0.115", "5.26 ± 3.53"),
    ("orientation error (rad)", HEADING.read, 4, "0.0217 ± 0.016", "0.0213 ± 0.0165"),
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


def performance_table(runs: Sequence[Run], scenario: str) -> str:
    """Table II, performance, as Markdown: mean ± standard deviation over the runs of METHODS."""
    ours, baseline = METHODS
    rows = [
        (name, paper_tfg, _cell(runs, ours, read, digits), paper_grid, _cell(runs, baseline, read, digits))
        for name, read, digits, paper_tfg, paper_grid in _PAPER
    ]
    number = len({run.seed for run in runs})
    title = f"Table II: performance, the paper over 4 runs in a world of its own, here over {number} of `{scenario}`"
    header = ("", "TFG active SLAM, paper", "`tfg`, here", "grid map frontier, paper", "`grid-nearest`, here")
    return markdown_table(Table(title, "", header, rows)) + "\n"


def _cell(runs: Sequence[Run], method: str, read: Callable[[dict[str, Any]], float | None], digits: int) -> str:
    values = sample(runs, method, read)
    if not len(values):
        return "-"
    one = spread(values)
    mean = percent(0.01 * one.mean.value, digits) if read is CPU_IDLE.read else one.mean.value
    return f"{mean:.{digits}f}" + (f" ± {one.std:.{digits}f}" if one.n > 1 else "")

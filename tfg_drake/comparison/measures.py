"""Figures compared of a run's summary: each one's name, unit and digits, and how it is read."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from tfg_drake.percent import percent


@dataclasses.dataclass(frozen=True)
class Measure:
    """A figure of a run.

    name, unit: as a table shows them, unit "" for none. digits: after the decimal point. read: its value in a summary,
    None where the run has none.
    """

    name: str
    unit: str
    digits: int
    read: Callable[[dict[str, Any]], float | None]

    def shown(self, value: float) -> str:
        """A value of it as a table shows it."""
        return f"{percent(0.01 * value, self.digits) if self.unit == '%' else value:.{self.digits}f}"

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


def _field(path: str, factor: float = 1.0) -> Callable[[dict[str, Any]], float | None]:
    def read(summary: dict[str, Any]) -> float | None:
        value: Any = summary
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        return None if value is None else factor * float(value)

    return read


def mapped_share(summary: dict[str, Any]) -> float | None:
    """Reachable tags in the map, %; None where there are none, or for a method that maps none."""
    mapped, reachable = summary.get("landmarks_mapped"), summary.get("landmarks_reachable")
    return None if mapped is None or not reachable else 100.0 * float(mapped) / float(reachable)


def variables(summary: dict[str, Any]) -> float | None:
    """How many scalar unknowns the map has, or cells."""
    counts = summary.get("map_variables")
    return None if not counts else float(sum(counts.values()))


def cpu_idle(summary: dict[str, Any]) -> float | None:
    """Share of one core, %, that estimator and planner leave idle at real time; 0 where they could not keep up."""
    cpu, time = (summary["estimator_cpu_s"], summary["planner_cpu_s"]), summary["sim_time_s"]
    if None in cpu or not time:
        return None
    return 100.0 * max(0.0, 1.0 - float(sum(cpu)) / float(time))


TIME = Measure("time", "s", 0, _field("sim_time_s"))
POSITION = Measure("position error, mean", "m", 4, _field("position_error_m.mean"))
MOVING = Measure("position error from the first drive on, mean", "m", 4, _field("position_error_moving_m.mean"))
HEADING = Measure("heading error, mean", "rad", 5, _field("heading_error_rad.mean"))
VARIABLES = Measure("variables of the map", "", 0, variables)
MAP_SIZE = Measure("map on disk", "kB", 1, _field("map_bytes", 1e-3))
CPU_IDLE = Measure("CPU idle at real time", "%", 1, cpu_idle)
# The paper's table first, then the rest.
MEASURES = (
    TIME,
    Measure("time to see 99 % of the area", "s", 0, _field("area_seen_s")),
    Measure("time until nothing was left to explore", "s", 0, _field("explored_s")),
    Measure("time until then over the best tour's", "", 2, _field("best_tour.explored_over_time")),
    Measure("driven", "m", 1, _field("distance_m")),
    Measure("way until then over the best tour's", "", 2, _field("best_tour.explored_over_distance")),
    POSITION,
    MOVING,
    Measure("position error, max", "m", 4, _field("position_error_m.max")),
    HEADING,
    VARIABLES,
    MAP_SIZE,
    Measure("peak memory", "MB", 0, _field("peak_rss_bytes", 1e-6)),
    CPU_IDLE,
    Measure("stage's planning, median", "CPU ms", 1, _field("stage_ms.median")),
    Measure("stages", "", 1, _field("stages")),
    Measure("tags mapped", "%", 2, mapped_share),
    Measure("walls mapped", "", 1, _field("walls_mapped")),
    Measure("map error, RMSE of tags", "m", 4, _field("landmark_rmse_m")),
    Measure("map error, RMSE of tags, aligned", "m", 4, _field("landmark_rmse_aligned_m")),
    Measure("tag ANEES", "", 2, _field("landmark_anees")),
    Measure("pose ANEES", "", 2, _field("pose_anees")),
    Measure("pose ANEES, online", "", 2, _field("online_pose_anees")),
    Measure("area seen", "%", 2, _field("area_coverage", 100.0)),
    Measure("surface within 5 cm", "%", 2, _field("surface_coverage_5cm", 100.0)),
    Measure("surface within 25 cm", "%", 2, _field("surface_coverage", 100.0)),
    Measure("surface mapped in error", "m", 2, _field("surface_phantom_m")),
    Measure("contacts", "", 2, _field("contacts")),
    Measure("least clearance", "m", 3, _field("min_clearance_m")),
)

"""The parameters of planning, and the usual cost of a roadmap's edge."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from tfg_drake.config import (
    ExplorerConfig,
    OdometryConfig,
    PlannerConfig,
    RobotConfig,
    ScanConfig,
    TagSensorConfig,
)
from tfg_drake.messages import FloatArray

# Clearance beyond which an edge costs only its length, m.
COMFORT = 1.0

# The costs (e,), m, of edges by their lengths (e,), m, and clearances (e,), m.
EdgeCost = Callable[[FloatArray, FloatArray], FloatArray]


def cost_of_edge(length: FloatArray, gap: FloatArray) -> FloatArray:
    """length * (1 + 2 max(0, 1 - gap / COMFORT)^2)."""
    return np.maximum(length, 1e-9) * (1.0 + 2.0 * np.maximum(0.0, 1.0 - gap / COMFORT) ** 2)


@dataclasses.dataclass(frozen=True)
class PlanningParameters:
    """The parameters of robot, sensors, explorer and planner for roadmap, paths and the choice of a goal.

    seed: of the samples and of the goal rule `random`. least_range, scan_range: m, least and greatest range of the
    scanner. cost: of edges.
    """

    robot: RobotConfig = dataclasses.field(default_factory=RobotConfig)
    sensor: TagSensorConfig = dataclasses.field(default_factory=TagSensorConfig)
    odometry: OdometryConfig = dataclasses.field(default_factory=OdometryConfig)
    explorer: ExplorerConfig = dataclasses.field(default_factory=ExplorerConfig)
    planner: PlannerConfig = dataclasses.field(default_factory=PlannerConfig)
    seed: int = 0
    least_range: float = 0.0
    scan_range: float = ScanConfig.range
    cost: EdgeCost = cost_of_edge

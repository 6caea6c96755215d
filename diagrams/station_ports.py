"""The ports of a station, simulated or real, and its safety filter between command and base."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import DiagramBuilder, InputPort, System

from tfg_drake.systems.ports import connect_by_name

# The station's outputs.
_OUTPUTS = ("base.odometry", "base.hazards", "base.enabled", "tags.detections", "scan.ranges")


def MakePorts(builder: DiagramBuilder, safety_filter: System, velocity: InputPort, sources: Sequence[System]) -> None:
    """Exports the ports that every station has, see MakeTurtlebotStation, and connects the safety filter.

    velocity: the base's. sources: the systems whose outputs are odometry, hazards, enabled, detections and ranges.
    """
    builder.Connect(safety_filter.GetOutputPort("velocity"), velocity)
    for name in ("velocity_commanded", "enable", "pose"):
        builder.ExportInput(safety_filter.GetInputPort(name), f"base.{name}")
    for source, name in zip(sources, _OUTPUTS, strict=True):
        builder.ExportOutput(source.GetOutputPort(name.partition(".")[2]), name)
    connect_by_name(builder, safety_filter, *sources, scan="ranges")

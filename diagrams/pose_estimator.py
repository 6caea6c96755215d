"""Makes an estimator from a system that outputs the robot's pose."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from tfg_drake.systems.pose_mapper import PoseMapper


def MakePoseEstimator(pose: System, sigma: Sequence[float] = (0.05, 0.05, 0.02)) -> Diagram:
    """Make an estimator for MakeTfgExplorer from the pose X_MB (x, y, theta), m and rad, in M, the robot's start pose.

    Args:
        pose: a System whose only output is that pose, a vector of size 3. Its inputs are connected by name, as those of
            any part: messages such as `MessageInputs(self, "odometry")`, or vectors such as truth.pose of a simulated
            station.
        sigma: standard deviations to state for the pose, m, m, rad.

    Raises TypeError if there is no such output.
    """
    sizes = [pose.get_output_port(i).size() for i in range(pose.num_output_ports())]
    if sizes != [3]:
        raise TypeError(f"{pose.get_name() or type(pose).__name__}: must have one output, a vector X_MB of size 3")
    builder = DiagramBuilder()
    if not pose.get_name():
        pose.set_name("pose_source")
    builder.AddSystem(pose)
    mapper = builder.AddSystem(PoseMapper(sigma))
    builder.Connect(pose.get_output_port(0), mapper.GetInputPort("X_MB"))
    exported: set[str] = set()
    for system in (pose, mapper):
        for port in (system.get_input_port(i) for i in range(system.num_input_ports())):
            name = port.get_name()
            if name in exported:
                builder.ConnectInput(name, port)
            elif name != "X_MB" or system is pose:
                builder.ExportInput(port, name)
                exported.add(name)
    for name in ("pose", "map"):
        builder.ExportOutput(mapper.GetOutputPort(name), name)
    diagram = builder.Build()
    diagram.set_name("pose_estimator")
    return diagram

"""Puts another plant into the station: motors with a lag, Drake's own low-pass filter before the base."""

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderLowPassFilter

import tfg_drake
from tfg_drake.diagrams.scenario import MakeWorld
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant

LAG = 0.3  # s


def MakeLaggingPlant(scenario):
    """A Diagram with the ports of DifferentialDrivePlant."""
    builder = DiagramBuilder()
    motors = builder.AddNamedSystem("motors", FirstOrderLowPassFilter(LAG, 2))
    base = builder.AddNamedSystem("base", DifferentialDrivePlant(MakeWorld(scenario.world), scenario.robot))
    builder.Connect(motors.get_output_port(), base.GetInputPort("velocity_commanded"))
    builder.ExportInput(motors.get_input_port(), "velocity_commanded")
    for name in ("pose", "hazards", "contacts", "clearance", "contacts_received"):
        builder.ExportOutput(base.GetOutputPort(name), name)
    return builder.Build()


for name, plant in (("as it is", None), (f"{LAG} s of lag", MakeLaggingPlant)):
    mission = tfg_drake.explore("corridor", plant=plant, until=120.0)
    print(f"{name}: {mission}, clearance {mission.look('truth.clearance')[0]:.2f} m")

"""A station that is a recorded run, behind the ports of any other."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder

from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.storage.port_recording import PortRecording
from tfg_drake.systems.port_player import PortPlayer


def MakeReplayStation(recording: PortRecording, source: object = None) -> Diagram:
    """The station that plays a recording, with the ports of PortPlayer: those of any station but for the truth.

    At any time its outputs are those of the recorded station; what was late then is as late again. The recorded robot
    cannot be told anything: the inputs are ignored. source: what the recording was made from, kept as the player's.
    """
    builder = DiagramBuilder()
    player = builder.AddNamedSystem("port_player", PortPlayer(recording, source))
    for port in (player.get_input_port(i) for i in range(player.num_input_ports())):
        builder.ExportInput(port, port.get_name())
    for port in (player.get_output_port(i) for i in range(player.num_output_ports())):
        builder.ExportOutput(port, port.get_name())
    station = builder.Build()
    station.set_name("station")
    return station


def ReplayRobot(recording: PortRecording) -> Robot:
    """Method and robot for `run_mission` that drive through a recording once more, with the scenario of its run.

    A simulated run's world is known still, the way that the robot really went is not.
    """
    known = recording.robot == SIMULATED.name
    return Robot(recording.robot, lambda _scenario: MakeReplayStation(recording), known, recording.end_time)

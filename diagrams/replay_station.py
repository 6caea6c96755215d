"""The robot of a recorded run: its station plays the recording, behind the ports of any other but for the truth."""

from __future__ import annotations

from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.storage.port_recording import PortRecording
from tfg_drake.systems.port_player import PortPlayer


def ReplayRobot(recording: PortRecording) -> Robot:
    """Method and robot for `run_mission` that drive through a recording once more, with the scenario of its run.

    A simulated run's world is known still, the way that the robot really went is not.
    """
    known = recording.robot == SIMULATED.name
    return Robot(recording.robot, lambda _scenario: PortPlayer(recording), known, recording.end_time)

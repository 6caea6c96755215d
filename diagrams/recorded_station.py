"""Stations that play what was recorded, a laser recording or a run, behind the ports of any other but for the truth."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from tfg_drake.config import TagSensorConfig
from tfg_drake.datasets.recording import Recording
from tfg_drake.diagrams.robots import RECORDED, SIMULATED, Robot
from tfg_drake.diagrams.scenario import Scenario, WorldConfig
from tfg_drake.hardware.recordings import load_laser_recording
from tfg_drake.messages import Hazards, LaserScan, Odometry, replace
from tfg_drake.simulation.tag_sensor import no_detections
from tfg_drake.storage.port_recording import PORTS, PortRecording, nanoseconds
from tfg_drake.systems.port_player import PortPlayer

# The mission ends once all is mapped, at the latest PATIENCE, s, after the end of the recording.
PATIENCE = 10.0
# A new wall needs one look per SCANS_PER_LOOK scans per metre of way, at least one and at most as many as in a mission.
SCANS_PER_LOOK = 3.0


def MakeRecordedStation(scenario: Scenario, *, recording: Recording | str | Path) -> PortPlayer:
    """The station of a laser recording, with the ports of PortPlayer: what was sensed is sensed again, and its
    inputs change nothing. The time begins with the first message; of the scenario nothing is read.

    recording: one that was loaded, or the path of a ROS 2 bag, a CARMEN or a BreezySLAM log.

    Raises:
        DatasetError: it cannot be used.
    """
    if not isinstance(recording, Recording):
        recording = load_laser_recording(Path(recording))
    return PortPlayer(_ports_of(recording), recording)


def RecordingOf(station: System) -> Recording | None:
    """The recording of a station that MakeRecordedStation made, None of another one."""
    return station.source if isinstance(station, PortPlayer) else None


def RecordedRobot(recording: Recording, station: System | None = None) -> Robot:
    """The robot that drove a recording. station: its station, if there is one already."""
    station = station or MakeRecordedStation(Scenario(), recording=recording)
    end = length_of(recording) + PATIENCE
    return Robot(RECORDED, lambda _scenario: station, world_known=False, end_time=end)


def RecordedScenario(recording: Recording, scenario: Scenario) -> Scenario:
    """The scenario with what is believed of the recorded odometry and scanner, and without a world."""
    result = copy.deepcopy(scenario)
    result.world, result.odometry = WorldConfig(), recording.model
    way = float(np.hypot(*np.diff([one.X_OB[:2] for one in recording.odometry], axis=0).T).sum())
    looks = min(result.scan.least_looks, int(len(recording.scans) / max(way, 1.0) / SCANS_PER_LOOK))
    reach = max(scan.range_max for scan in recording.scans)
    result.scan = dataclasses.replace(recording.scanner, range=reach, least_looks=max(looks, 1))
    result.tags = dataclasses.replace(TagSensorConfig(), range=scenario.tags.range)
    result.explorer.landmarks = "walls"
    return result


def ReplayRobot(recording: PortRecording) -> Robot:
    """Method and robot for `run_mission` that drive through a recording once more, with the scenario of its run.

    A simulated run's world is known still, the way that the robot really went is not.
    """
    known = recording.robot == SIMULATED.name
    return Robot(recording.robot, lambda _scenario: PortPlayer(recording), known, recording.end_time)


def _ports_of(recording: Recording) -> PortRecording:
    """A recording as messages of the station's ports, stamped from its first message on."""
    start = start_of(recording)
    odometry: list[Odometry] = [replace(one, stamp=one.stamp - start) for one in recording.odometry]
    scans: list[LaserScan] = [replace(one, stamp=one.stamp - start) for one in recording.scans]
    messages: dict[str, Sequence[Any]] = {
        **dict.fromkeys(PORTS, ()),
        "base.odometry": odometry,
        "base.hazards": [Hazards(0.0, 0, 0, 0)],
        "tags.detections": [no_detections()],
        "scan.ranges": scans,
    }
    times = {
        port: np.array([nanoseconds(max(one.stamp, 0.0)) for one in carried], dtype=np.int64)
        for port, carried in messages.items()
    }
    return PortRecording(Path(recording.name), RECORDED, times, messages, length_of(recording), whole=True)


def start_of(recording: Recording) -> float:
    """When the mission of a recording begins, s by its stamps."""
    return min(recording.odometry[0].stamp, recording.scans[0].stamp)


def length_of(recording: Recording) -> float:
    """How long a recording takes, s."""
    return max(recording.odometry[-1].stamp, recording.scans[-1].stamp) - start_of(recording)

"""The sequencers: of a mission, and of a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import RobotConfig
from tfg_drake.messages import FloatArray, MissionStatus, message, replace
from tfg_drake.mission.sequence import MissionInputs, initial_status, step
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState

# The outputs of the TFG explorer that map, by port.
MAPS = ("map", "tfg")
# A piece of the way is mapped after this length, m, and so many scans at least: some logs have but one a metre.
PIECE_LENGTH = 1.0
PIECE_SCANS = 2
# What is said of a recording at its end.
ENDED = "all of the recording is mapped"


class MissionSequencer(LeafSystem):
    """Runs `tfg_drake.mission.sequence.step` and ends the simulation with the mission.

    .. pydrake_system::

        name: MissionSequencer
        input_ports:
        - map (or whatever else maps)
        - tfg
        - goal
        - path
        - path_status
        - follower_status
        - hazards
        - pause
        - enable
        - stop
        output_ports:
        - mission

    goal: GoalChoice, path: Path, path_status: PathStatus, follower_status: FollowerStatus, hazards: Hazards, map:
    MapEstimate, tfg: TfgMap. mission: MissionStatus.

    Whatever maps, by default map and tfg, says with its message's stage that the newest view is in it. pause, enable
    and stop: (1,), true above 0.5; unconnected they read 0, 1 and 0.
    """

    def __init__(self, robot: RobotConfig, glance_period: float = 0.0, maps: Sequence[str] = MAPS):
        """glance_period: s, as explorer.glance_period. maps: the inputs that are maps, whose messages have a
        stage."""
        super().__init__()
        self._max_speed, self._glance_period = robot.max_speed, glance_period
        self._maps = tuple(maps)
        self._inputs = MessageInputs(self, "goal", "path", "path_status", "follower_status", "hazards", *maps)
        self._pause = self.DeclareVectorInputPort("pause", 1)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        self._status = MessageState(self, initial_status())
        self.DeclareStateOutputPort("mission", self._status.index)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        status = self._status(context)
        if status.phase == "done":
            return EventStatus.ReachedTermination(self, f"{status.outcome}: {status.reason}")
        inputs = MissionInputs(
            time=context.get_time(),
            follower=lambda: self._inputs(context, "follower_status"),
            goal=lambda: self._inputs(context, "goal"),
            path=lambda: self._inputs(context, "path"),
            path_status=lambda: self._inputs(context, "path_status"),
            mapped_stage=lambda: min(one.stage for one in self._inputs.each(context, *self._maps)),
            max_speed=self._max_speed,
            glance_period=self._glance_period,
            bumper=self._inputs(context, "hazards").bumper != 0,
            pause=flag(self._pause, context, False),
            enable=flag(self._enable, context, True),
            stop=flag(self._stop, context, False),
        )
        return self._status.set(state, step(status, inputs))


def flag(port, context: Context, default: bool) -> bool:
    """True if a (1,) input is above 0.5; the default if it is not connected."""
    return bool(port.Eval(context)[0] > 0.5) if port.HasValue(context) else default


@message
class _PieceState:
    """status: the mission's. p_OB: (2,) m, where the odometry was last, nan before the first; length: m of way, scans:
    looks since the piece began, scan_stamp: s, of the newest."""

    status: MissionStatus
    p_OB: FloatArray
    length: float = 0.0
    scans: int = 0
    scan_stamp: float = -math.inf


class PieceSequencer(LeafSystem):
    """Says when a piece of a recorded way is to be mapped, and ends the simulation with the recording.

    .. pydrake_system::

        name: PieceSequencer
        input_ports:
        - odometry
        - scan
        - map (or whatever else maps)
        - tfg
        - pause
        - stop
        output_ports:
        - mission
        - velocity_commanded

    odometry: Odometry, scan: LaserScan, map: MapEstimate, tfg: TfgMap. mission: MissionStatus, in phase "glance" as
    long as a piece goes on, "map" while it is mapped. velocity_commanded: (2,), zero. pause, stop: (1,), true above
    0.5; stop ends it, pause is not minded: what was recorded has been driven.
    """

    def __init__(self, end_time: float, maps: Sequence[str] = MAPS) -> None:
        """end_time: s, when the recording ends. maps: as of MissionSequencer, none where
        what maps needs no pieces."""
        super().__init__()
        self._end_time, self._maps = end_time, tuple(maps)
        self._inputs = MessageInputs(self, "odometry", "scan", *maps)
        self.DeclareVectorInputPort("pause", 1)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        begun = replace(initial_status(), phase="glance", moving=True)
        self._state = MessageState(self, _PieceState(begun, np.full(2, np.nan)))
        self._state.declare_outputs(self, mission=lambda now: now.status)
        self.DeclareVectorOutputPort("velocity_commanded", 2, lambda _context, _output: None)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        now, time = self._state(context), context.get_time()
        status = now.status
        if status.phase == "done":
            return EventStatus.ReachedTermination(self, f"{status.outcome}: {status.reason}")
        ended = time >= self._end_time
        if flag(self._stop, context, False):
            status = replace(status, phase="done", since=time, outcome="interrupted", reason="told to end")
        elif status.phase == "glance":
            now = self._driven(context, now)
            if self._maps and ((now.length >= PIECE_LENGTH and now.scans >= PIECE_SCANS) or (ended and now.scans)):
                status = replace(status, phase="map", since=time)
            elif ended:
                status = replace(status, phase="done", since=time, outcome="complete", reason=ENDED)
        elif min(one.stage for one in self._inputs.each(context, *self._maps)) > status.stage:
            now = replace(now, length=0.0, scans=0)
            status = replace(status, phase="glance", since=time, stage=status.stage + 1)
        return self._state.set(state, replace(now, status=status))

    def _driven(self, context: Context, now: _PieceState) -> _PieceState:
        odometry, scan = self._inputs.each(context, "odometry", "scan")
        step = float(np.hypot(*(odometry.X_OB[:2] - now.p_OB)))
        return replace(
            now,
            p_OB=odometry.X_OB[:2],
            length=now.length + (step if math.isfinite(step) else 0.0),
            scans=now.scans + (scan.stamp > now.scan_stamp),
            scan_stamp=max(scan.stamp, now.scan_stamp),
        )

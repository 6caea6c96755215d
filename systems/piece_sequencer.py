"""The sequencer of a recorded drive: there are no goals, and the way is mapped piece by piece."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.messages import FloatArray, MissionStatus, message, replace
from tfg_drake.mission.sequence import initial_status
from tfg_drake.systems.mission_sequencer import MAPS
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState, number

# A piece of the way is at least PIECE_LENGTH, m, long and has at least PIECE_SCANS scans: some logs have one per metre.
PIECE_LENGTH = 1.0
PIECE_SCANS = 2
# The reason of the outcome at a recording's end.
ENDED = "all of the recording is mapped"


@message
class _PieceState:
    """status: the mission's. p_OB: (2,) m, the last odometry position, nan before the first; length: m of way, scans:
    number of scans since the piece began, scan_stamp: s, of the newest scan."""

    status: MissionStatus
    p_OB: FloatArray
    length: float = 0.0
    scans: int = 0
    scan_stamp: float = -math.inf


class PieceSequencer(LeafSystem):
    """Starts the mapping of each piece of a recorded way, and ends the simulation with the recording.

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

    odometry: Odometry, scan: LaserScan, map: MapEstimate, tfg: TfgMap. mission: MissionStatus, in phase "glance" during
    a piece, "map" while it is mapped. velocity_commanded: (2,), zero. pause, stop: (1,), true above 0.5; stop ends the
    mission, pause is ignored, as the recorded drive is over.
    """

    def __init__(self, end_time: float, maps: Sequence[str] = MAPS) -> None:
        """end_time: s, when the recording ends. maps: as for MissionSequencer, empty if the mapper needs no pieces."""
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
        if number(self._stop, context, 0.0) > 0.5:
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
